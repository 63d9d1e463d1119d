"""Real recordings are read with channels and units, or refused for a true reason."""

import re

import numpy as np
import pytest

from piezoid.errors import UnitError, UnreadableFileError
from piezoid.records.collection import collect
from piezoid.records.inspection import inspect_files
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.readers import READERS, read_table

FORMATS = {
    "Bias-Spectroscopy002.dat": ("Nanonis", 1024, ["V", "A", "A", "A", "A"]),
    "a.dat": ("Nanonis", 201, ["m", "s", "V", "A", "m", "deg", "m", "V", "Hz"]),
    "DS1102D-A.csv": ("Rigol oscilloscope", 1024, ["s", "V", "V"]),
    "DS2072A-6.csv": ("Rigol oscilloscope", 1400, ["V"]),
    "fmt-hdf5-fd_version_0.13.3.h5": ("HDF5", 7796, ["N", "m", "m", "", "s"]),
    "long_single_header_multi_ch.lvm": ("LabVIEW measurement", 16384, ["g", "m/s^2", "m/s^2"]),
    "multi_time_column.lvm": ("LabVIEW measurement", 3, ["s", "V", "g"]),
    "short.lvm": ("LabVIEW measurement", 10, ["Newtons", "m/s^2"]),
    "with_comments.lvm": ("LabVIEW measurement", 9, ["s", "MPa", "K", "ml"]),
}
REASONS = {
    "Bias-Spectroscopy002.dat": "over 'Bias calc \\(V\\)', not over time",
    "a.dat": "over 'Amplitude Setpoint \\(m\\)', not over time",
    "DS1102D-A.csv": "CH 2.*in volts may be a drive or a sensor's output",
    "DS2072A-6.csv": "CH1.*in volts may be a drive or a sensor's output",
    "fmt-hdf5-fd_version_0.13.3.h5": "both claim to be the displacement",
    "long_single_header_multi_ch.lvm": "no column is a drive voltage or a displacement",
    "short.lvm": "no column is a drive voltage or a displacement",
    "with_comments.lvm": "time steps from 0.325 s to 4.127 s",
}


def test_every_file_of_the_folder_is_listed(realdata):
    assert {path.name for path in (realdata / "formats").iterdir()} == set(FORMATS)
    assert {name for name, _, _ in FORMATS.values()} <= {reader.name for reader in READERS}


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_has_its_channels_and_units_and_the_reason_of_its_refusal(name, realdata):
    format_name, rows, units = FORMATS[name]
    (inspection,) = inspect_files([realdata / "formats" / name])
    assert (inspection.format, inspection.rows) == (format_name, rows)
    assert [column.si_unit for column in inspection.columns] == units
    assert (inspection.refusal is None) == (name not in REASONS)
    assert re.search(REASONS.get(name, "^$"), inspection.refusal or "")


def test_segments_without_headers_of_their_own_are_found(realdata):
    table = read_table(realdata / "formats" / "long_single_header_multi_ch.lvm")
    assert table.segment_starts == (8192,)


FLEXURE = RecordingEntry(
    file="Model_Vi_Do.dat",
    columns={"voltage": 1, "displacement": 5},
    units={"voltage": "V", "displacement": "um"},
    sampling_rate_Hz=200,
)
ACTUATOR = RecordingEntry(
    file="hysteresis_v_150_1hz.csv",
    columns={"time": 2, "voltage": 4, "displacement": 3},
    units={"time": "s", "voltage": "V", "displacement": "um"},
)


def test_the_flexure_is_read_with_columns_and_rate_of_lab_toml(realdata):
    path = realdata / "flexure" / "Model_Vi_Do.dat"
    with pytest.raises(UnitError, match=r'file = "Model_Vi_Do.dat"'):
        collect([path])[0]
    recording = collect([path], Lab(recordings=(FLEXURE,)))[0]
    assert (recording.samples, recording.sampling_rate_Hz) == (8027, 200)
    assert np.ptp(recording.voltage_V()) == pytest.approx(3.6)
    assert np.median(recording.displacement_m()) == pytest.approx(-96e-6, rel=0.05)
    dead = [p.place for p in recording.statements if p.quantity == "dead"]
    assert dead == [f"column {k}" for k in (2, 3, 4, 6, 7)]
    (inspection,) = inspect_files([path], Lab(recordings=(FLEXURE,)))
    assert inspection.reversals == 80
    assert inspection.levels_V == pytest.approx((0.0, 3.6), abs=0.01)


def test_the_actuator_has_an_empty_column_and_its_own_clock(realdata):
    path = realdata / "actuator_150V" / "hysteresis_v_150_1hz.csv"
    recording = collect([path], Lab(recordings=(ACTUATOR,)))[0]
    assert recording.sampling_rate_Hz == 5000
    assert not recording.breaks
    assert np.ptp(recording.voltage_V()) == 300
    assert {problem.quantity for problem in recording.statements} == {"empty"}


def test_a_spectroscopy_is_a_table_of_heights_and_currents(realdata):
    table = read_table(realdata / "stm_current_vs_z" / "z.dat")
    height_m, current_A = table.si("Z rel (m)"), table.si("Current [00001] (A)")
    assert height_m[0] == pytest.approx(-0.21e-9)
    assert current_A[0] == pytest.approx(-753.434e-12)
    (sweep,) = collect([realdata / "stm_current_vs_z" / "z.dat"]).sweeps
    assert sweep.independent == "Z rel (m)"


def test_arrays_of_four_axes_are_refused_with_their_shape(realdata):
    for path in sorted((realdata / "steering_mirror").glob("*.npy")):
        with pytest.raises(UnreadableFileError, match=r"4 axes of lengths \(8192, 3, 6, 2\)"):
            read_table(path)
