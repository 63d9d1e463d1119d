"""Files of Igor and of JPK give the numbers that were written, or the reason they cannot."""

import zipfile
from pathlib import Path

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
def test_a_wave_of_igor_is_read_by_its_labels_and_its_clock(order: str, tmp_path: Path) -> None:
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


def test_a_wave_of_a_microscope_takes_its_rate_from_the_note(tmp_path: Path) -> None:
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


def test_a_force_curve_gives_the_drive_in_volts_and_each_segment_its_clock(tmp_path: Path) -> None:
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


def test_many_curves_and_a_curve_without_a_sensor_are_refused(tmp_path: Path) -> None:
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
        zipfile.ZipFile(tmp_path / "whole.jpk-force") as whole,
        zipfile.ZipFile(tmp_path / "blind.jpk-force", "w") as blind,
    ):
        for item in whole.infolist():
            if "Sensor" not in item.filename:
                blind.writestr(item, whole.read(item))
    with pytest.raises(UnreadableFileError, match="capacitiveSensorHeight"):
        read_table(tmp_path / "blind.jpk-force")
