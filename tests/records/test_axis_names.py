"""Recordings of one axis under two names are asked about; an entry proposes the axis of others."""

import re

import pytest

from piezoid.errors import UnitError
from piezoid.identification.fit import unfitted_stage
from piezoid.records.checks.axis_names import check_axis_names
from piezoid.records.collection import collect
from piezoid.records.inspection import inspect_files
from piezoid.records.lab import Lab
from tests.laws import LAWS, triangles, write

FIELD = triangles(4, 200, 0.1)
PLAIN, HIGH = "voltage [V],displacement [um]", "voltage_z [V],displacement_z [um]"
UNKNOWN = "drive,position"


def written(folder, name, *, headings=PLAIN, gain_um=10.0, zero_um=3.0, field=FIELD):
    path = write(folder / name, field, zero_um + gain_um * LAWS["plays"](field))
    path.write_text(path.read_text().replace(PLAIN, headings))
    return path


def questions(*paths):
    return check_axis_names(collect(paths).recordings)


def test_an_axis_that_no_heading_names_is_asked_about(tmp_path):
    paths = (
        written(tmp_path, "loops.csv", headings=HIGH),
        written(tmp_path, "run.csv", field=0.8 * triangles(3, 300)),
    )
    (statement,) = questions(*paths)
    assert statement.recording == "run.csv"
    assert 'axis = "z"' in statement.text
    assert statement.text in unfitted_stage(collect(paths).recordings, Lab()).remarks


@pytest.mark.parametrize(
    "other",
    [
        {"name": "x_run.csv"},
        {"gain_um": 4.0},
        {"zero_um": 9.0},
    ],
    ids=["a file named after its axis", "another gain", "another zero"],
)
def test_different_axes_are_not_asked_about(other, tmp_path):
    named = written(tmp_path, "loops.csv", headings=HIGH)
    assert questions(named, written(tmp_path, **{"name": "run.csv", **other})) == []


def test_two_named_axes_are_not_asked_about(tmp_path):
    headings = (HIGH.replace("_z", "_y"), HIGH)
    paths = [written(tmp_path, f"{k}.csv", headings=h) for k, h in enumerate(headings)]
    assert questions(*paths) == []


def test_an_entry_to_complete_proposes_the_axis_of_the_other_files(tmp_path):
    paths = [
        written(tmp_path, "loops.csv", headings=HIGH),
        written(tmp_path, "run.csv", headings=UNKNOWN),
    ]
    with pytest.raises(UnitError) as refusal:
        collect(paths)
    refused = inspect_files(paths)[1].refusal or ""
    for text in (refusal.value.remedy, str(refusal.value), refused):
        assert re.findall(r'^axis = "(.)"$', text, flags=re.MULTILINE) == ["z"]
    alone = inspect_files(paths[1:])[0].refusal or ""
    assert re.findall(r'^axis = "(.)"$', alone, flags=re.MULTILINE) == ["x"]
