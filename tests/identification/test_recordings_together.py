"""Recordings of one stage before a fit: every recording that is left out is named."""

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
    recordings = read(tmp_path, sweep=lines(), copy=in_nm)
    assert [r.name for r in driven_recordings(recordings, "x")] == ["sweep.csv"]
    (remark,) = unfitted_stage(recordings, Lab()).remarks
    assert remark.startswith("copy.csv holds samples of sweep.csv")


@pytest.mark.parametrize("cut", [slice(0, -1), slice(100, None), slice(120, -150)])
def test_an_excerpt_of_a_recording_is_left_out_and_named(tmp_path, cut):
    recordings = read(tmp_path, sweep=lines(), excerpt=lines(table=columns()[cut]))
    assert [r.name for r in driven_recordings(recordings, "x")] == ["sweep.csv"]
    (remark,) = unfitted_stage(recordings, Lab()).remarks
    assert remark.startswith("excerpt.csv holds samples of sweep.csv")


def test_a_nearly_constant_drive_is_named_and_gives_no_stage_name(tmp_path):
    resting = columns()
    resting[:, 1:] = 1e-3 * resting[::-1, 1:] + [50, 9]
    rows = lines(table=resting, written="{:.6f}".format)
    recordings = read(tmp_path, resting=rows, sweep=lines())
    assert [r.name for r in driven_recordings(recordings, "x")] == ["sweep.csv"]
    stage = unfitted_stage(recordings, Lab())
    assert stage.stage == "sweep"
    assert any("resting.csv: the drive of axis x moves by" in remark for remark in stage.remarks)


def test_a_recording_of_opposite_polarity_is_refused_before_the_fit(tmp_path):
    recordings = read(tmp_path, sweep=lines(), inverted=lines(table=columns() * [1, -1, 1]))
    with pytest.raises(RecordingError, match=r"inverted.csv moves .* opposite polarity"):
        unfitted_stage(recordings, Lab())


def test_a_file_without_time_column_is_named_with_its_assumed_rate(tmp_path):
    text(lines(table=columns()[:, 1:], names=NAMES[1:]))(tmp_path / "notime.csv")
    lab = Lab(acquisition=Acquisition(sampling_rate_Hz=1000.0))
    (remark,) = unfitted_stage(collect([tmp_path / "notime.csv"], lab).recordings, lab).remarks
    assert remark.startswith("notime.csv: ")
    assert "1000 Hz" in remark
    assert "[acquisition]" in remark


def test_a_loop_of_a_tip_has_the_sampling_rate_of_its_controller():
    lab = read_lab(piezoid_datasets.LAB)
    loops = [path for path in piezoid_datasets.recordings() if "z_loop" in path.name]
    recordings = collect(loops, lab).recordings
    assert {r.sampling_rate_Hz for r in recordings} == {lab.acquisition.sampling_rate_Hz}
    assert not any(
        "No time column" in remark for remark in unfitted_stage(recordings, lab).remarks
    )
