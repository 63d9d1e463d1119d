"""Recordings of one stage before a fit: none is left out without a word."""

from pathlib import Path

import pytest

import piezoid_datasets
from piezoid.errors import RecordingError
from piezoid.identification.fit import driven_recordings, unfitted_stage
from piezoid.records.collection import collect
from piezoid.records.lab import Acquisition, Lab, read_lab
from piezoid.records.recording import Recording
from tests.records.messy.writers import NAMES, columns, lines, text


def read(folder: Path, **tables: list[str]) -> tuple[Recording, ...]:
    for name, rows in tables.items():
        text(rows)(folder / f"{name}.csv")
    return collect([folder / f"{name}.csv" for name in tables]).recordings


def test_a_copy_in_another_unit_is_left_out_and_named(tmp_path):
    in_nm = lines(table=columns() * [1, 1, 1e3], names=(*NAMES[:2], "position [nm]"))
    recordings = read(tmp_path, sweep=lines(), again=in_nm)
    assert [r.name for r in driven_recordings(recordings, "x")] == ["sweep.csv"]
    (said,) = unfitted_stage(recordings, Lab()).remarks
    assert said.startswith("again.csv holds samples of sweep.csv")


@pytest.mark.parametrize("cut", [slice(0, -1), slice(100, None), slice(120, -150)])
def test_a_part_of_a_recording_is_never_held_out_against_it(tmp_path, cut):
    recordings = read(tmp_path, sweep=lines(), part=lines(table=columns()[cut]))
    assert [r.name for r in driven_recordings(recordings, "x")] == ["sweep.csv"]
    (said,) = unfitted_stage(recordings, Lab()).remarks
    assert said.startswith("part.csv holds samples of sweep.csv")


def test_a_drive_that_hardly_moves_is_named_and_names_no_stage(tmp_path):
    resting = columns()
    resting[:, 1:] = 1e-3 * resting[::-1, 1:] + [50, 9]
    rows = lines(table=resting, written="{:.6f}".format)
    recordings = read(tmp_path, resting=rows, sweep=lines())
    assert [r.name for r in driven_recordings(recordings, "x")] == ["sweep.csv"]
    stage = unfitted_stage(recordings, Lab())
    assert stage.stage == "sweep"
    assert any("resting.csv: the drive of axis x moves by" in said for said in stage.remarks)


def test_a_file_of_the_other_polarity_ends_before_the_fit(tmp_path):
    recordings = read(tmp_path, sweep=lines(), turned=lines(table=columns() * [1, -1, 1]))
    with pytest.raises(RecordingError, match=r"turned.csv moves .* opposite polarity"):
        unfitted_stage(recordings, Lab())


def test_a_file_without_time_read_at_the_rate_of_the_controller_is_named(tmp_path):
    text(lines(table=columns()[:, 1:], names=NAMES[1:]))(tmp_path / "notime.csv")
    lab = Lab(acquisition=Acquisition(sampling_rate_Hz=1000.0))
    (said,) = unfitted_stage(collect([tmp_path / "notime.csv"], lab).recordings, lab).remarks
    assert said.startswith("notime.csv: ")
    assert "1000 Hz" in said
    assert "[acquisition]" in said


def test_a_loop_of_a_tip_has_the_rate_of_its_controller_by_definition():
    lab = read_lab(piezoid_datasets.LAB)
    loops = [place for place in piezoid_datasets.recordings() if "z_loop" in place.name]
    recordings = collect(loops, lab).recordings
    assert {r.sampling_rate_Hz for r in recordings} == {lab.acquisition.sampling_rate_Hz}
    assert not any("No time column" in said for said in unfitted_stage(recordings, lab).remarks)
