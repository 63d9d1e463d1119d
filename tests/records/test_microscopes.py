"""Files of Igor and JPK are read with the written numbers, or refused with a reason."""

import zipfile

import numpy as np
import pytest

from piezoid.errors import UnitError, UnreadableFileError
from piezoid.records.collection import collect
from piezoid.records.readers import read_table
from tests.records.microscopes import write_ibw, write_jpk
from tests.records.tables import lab_with

RATE_Hz = 2000.0
TIME_s = np.arange(600) / RATE_Hz
DRIVE_V = 40 + 30 * np.sin(2 * np.pi * 17 * TIME_s)
HEIGHT_m = 9e-6 + 6e-6 * np.sin(2 * np.pi * 17 * TIME_s - 0.2)
WAVE = np.column_stack([DRIVE_V, 1e6 * HEIGHT_m])


@pytest.mark.parametrize("order", ["<", ">"])
def test_an_igor_wave_is_read_by_labels_and_clock(order, tmp_path):
    write_ibw(
        tmp_path / "run.ibw",
        WAVE,
        labels=("voltage [V]", "position [um]"),
        step=1e3 / RATE_Hz,
        step_unit="ms",
        order=order,
    )
    recording = collect([tmp_path / "run.ibw"])[0]
    assert recording.sampling_rate_Hz == RATE_Hz
    np.testing.assert_allclose(recording.voltage_V(), DRIVE_V)
    np.testing.assert_allclose(recording.displacement_m(), HEIGHT_m)


def test_a_microscope_wave_has_the_rate_of_its_note(tmp_path):
    note = "Version: 16\rNumPtsPerSec: 2000\rImagingMode: Contact\r"
    labels = ("Raw", "Defl", "ZSnsr")
    values = np.column_stack([1.2e-7 * DRIVE_V, 0 * DRIVE_V, HEIGHT_m])
    write_ibw(tmp_path / "run.ibw", values, labels=labels, unit="m", note=note)
    columns = {"voltage": "Raw", "displacement": "ZSnsr"}
    with pytest.raises(UnitError, match="volts times a sensitivity"):
        collect([tmp_path / "run.ibw"], lab_with(file="run.ibw", columns=columns))[0]
    lab = lab_with(file="run.ibw", columns=columns, scale={"voltage": 1 / 1.2e-7})
    recording = collect([tmp_path / "run.ibw"], lab)[0]
    assert recording.sampling_rate_Hz == RATE_Hz
    np.testing.assert_allclose(recording.voltage_V(), DRIVE_V)
    np.testing.assert_allclose(recording.displacement_m(), HEIGHT_m)


def test_a_force_curve_has_its_drive_in_volts_and_a_clock_per_segment(tmp_path):
    half = 300
    segments = [
        (half / RATE_Hz, DRIVE_V[:half], HEIGHT_m[:half]),
        (half / RATE_Hz, DRIVE_V[half:], HEIGHT_m[half:]),
    ]
    for name in ("curve.jpk-force", "renamed.zip"):
        write_jpk(tmp_path / name, segments)
        recording = collect([tmp_path / name])[0]
        assert recording.sampling_rate_Hz == RATE_Hz
        np.testing.assert_allclose(recording.voltage_V(), DRIVE_V, atol=1e-7)
        np.testing.assert_allclose(recording.displacement_m(), HEIGHT_m, atol=1e-13)
    write_jpk(tmp_path / "hold.jpk-force", [segments[0], (8 * half / RATE_Hz, *segments[1][1:])])
    slow, fast = collect([tmp_path / "hold.jpk-force"]).recordings
    assert (slow.sampling_rate_Hz, fast.sampling_rate_Hz) == (RATE_Hz, RATE_Hz / 8)


def test_maps_and_incomplete_curves_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "map.jpk-force-map", "w") as archive:
        for name in ("header.properties", "index/", "index/0/", "index/1/"):
            archive.writestr(name, "")
    with pytest.raises(UnreadableFileError, match="JPK archive of 2 curves"):
        read_table(tmp_path / "map.jpk-force-map")
    write_jpk(tmp_path / "none.jpk-force", [])
    with pytest.raises(UnreadableFileError, match="the JPK reader stopped"):
        read_table(tmp_path / "none.jpk-force")
    write_jpk(tmp_path / "whole.jpk-force", [(0.3, DRIVE_V, HEIGHT_m)])
    with (
        zipfile.ZipFile(tmp_path / "whole.jpk-force") as complete,
        zipfile.ZipFile(tmp_path / "blind.jpk-force", "w") as reduced,
    ):
        for item in complete.infolist():
            if "Sensor" not in item.filename:
                reduced.writestr(item, complete.read(item))
    with pytest.raises(UnreadableFileError, match="capacitiveSensorHeight"):
        read_table(tmp_path / "blind.jpk-force")
