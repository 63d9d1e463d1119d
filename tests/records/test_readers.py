"""Every format gives the known recording with its channels and units."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from piezoid.errors import UnreadableFileError
from piezoid.records import readers
from piezoid.records.collection import collect
from piezoid.records.lab import Lab, RecordingEntry, Sensor
from piezoid.records.readers import READERS, read_table
from piezoid.records.readers.reader import Reader
from tests.records.formats import DESCRIBED, SAMPLES, VOLTAGE_V, DISPLACEMENT_um, RATE_Hz

# The files print six decimals of a micrometre at most.
ATOL_m = 1e-12
ATOL_V = 1e-6


def test_every_reader_of_the_folder_is_registered():
    modules = [
        importlib.import_module(f"{readers.__name__}.{path.stem}")
        for path in Path(readers.__file__).parent.glob("*.py")
    ]
    defined = {
        id(value) for m in modules for value in vars(m).values() if isinstance(value, Reader)
    }
    assert defined == set(map(id, READERS))
    assert len({reader.name for reader in READERS}) == len(READERS)


@pytest.mark.parametrize("name", DESCRIBED)
def test_every_format_gives_the_same_recording(name, write):
    recording = collect([write(name)])[0]
    assert recording.sampling_rate_Hz == RATE_Hz
    assert recording.axis == "x"
    if name == "run73.mat":  # HDF5 keeps no order
        assert next(channel.quantity.name for channel in recording.channels) == "DISPLACEMENT"
    # Only the exclusion of a text column is reported.
    assert {problem.quantity for problem in recording.statements} <= {"text_column"}
    np.testing.assert_allclose(recording.voltage_V(), VOLTAGE_V, rtol=0, atol=ATOL_V)
    np.testing.assert_allclose(recording.displacement_m(), DISPLACEMENT_um * 1e-6, atol=ATOL_m)


@pytest.mark.parametrize("name", ["rigol.csv", "tek.csv", "tek2.csv"])
def test_volts_of_an_oscilloscope_become_a_displacement_by_the_gain(name, write):
    lab = Lab(
        sensor=Sensor(gain_V_per_m=1e5),
        recordings=(RecordingEntry(file=name, columns={"voltage": "CH1", "displacement": "CH2"}),),
    )
    recording = collect([write(name)], lab)[0]
    assert recording.sampling_rate_Hz == RATE_Hz
    np.testing.assert_allclose(recording.voltage_V(), VOLTAGE_V, rtol=0, atol=1e-5)
    np.testing.assert_allclose(recording.displacement_m(), DISPLACEMENT_um * 1e-6, atol=1e-11)


def test_an_array_without_names_is_read_by_column_numbers(write):
    entry = RecordingEntry(
        file="run.npy",
        columns={"time": 1, "voltage": 2, "displacement": 3},
        units={"time": "s", "voltage": "V", "displacement": "um"},
    )
    recording = collect([write("run.npy")], Lab(recordings=(entry,)))[0]
    assert recording.sampling_rate_Hz == RATE_Hz
    np.testing.assert_array_equal(recording.voltage_V(), VOLTAGE_V)


def test_an_array_with_many_columns_is_transposed(tmp_path):
    path = tmp_path / "side.npy"
    np.save(path, np.arange(1500.0).reshape(3, 500))
    table = read_table(path)
    assert (len(table.columns), table.rows) == (3, 500)
    assert [problem.quantity for problem in table.statements] == ["transposed"]
    np.save(path, np.zeros((30, 500)))
    with pytest.raises(UnreadableFileError, match="Transpose"):
        read_table(path)


def test_a_missing_reader_package_is_named_with_its_extra(write, monkeypatch):
    path = write("run.h5")
    monkeypatch.setitem(sys.modules, "h5py", None)  # as where it is not installed
    with pytest.raises(UnreadableFileError, match=r"pip install 'piezoid\[io\]'"):
        read_table(path)


@pytest.mark.parametrize(
    ("text", "labels", "first_line"),
    [
        (",U [V]\n0,1\n1,2\n2,3\n", ["", "U [V]"], 2),
        ("rig: 42\nnote\n\n# time [s] U [V]\n0 1\n1 2\n2 3\n", ["time [s]", "U [V]"], 5),
    ],
    ids=["nameless first column", "preamble"],
)
def test_headings_and_first_row_are_located(text, labels, first_line, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(text)
    table = read_table(path)
    assert [column.label for column in table.columns] == labels
    assert table.first_line == first_line


def test_preamble_lines_are_metadata_and_readings_out_of_range_nan(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("Operator: Ada\n# gain = 15\ntime [s],U [V]\n0,1\n1,2\n")
    assert dict(read_table(path).metadata) == {"Operator": "Ada", "gain": "15"}
    path.write_text("time [s],U [V]\n0,1\n1,9.9E37\n2,1e308\n3,inf\n4,5\n")
    assert np.isnan(read_table(path).si("U")).tolist() == [False, True, True, True, False]


def test_labview_segments_are_separate_acquisitions(write):
    path = write("run.lvm")
    text = path.read_text()
    path.write_text(text + "\n" + text[text.index("Channels") :])
    recording = collect([path])[0]
    assert recording.samples == 2 * SAMPLES
    assert recording.breaks == (SAMPLES,)
    path.write_text("".join(text.splitlines(keepends=True)[:-50]))
    (cut,) = collect([path])[0].statements
    assert (cut.quantity, "200 samples, the file holds 150" in cut.text) == ("truncated", True)
