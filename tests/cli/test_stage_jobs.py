"""What of a stage is done apart: how many threads each axis is diagnosed by."""

from types import SimpleNamespace

import pytest

from piezoid_cli import stage_jobs


@pytest.mark.parametrize(
    ("processes", "axes", "threads"), [(1, "x", 1), (2, "x", 2), (2, "xy", 1), (5, "xy", 2)]
)
def test_cores_that_no_axis_takes_help_those_that_are_there(
    monkeypatch, processes, axes, threads
) -> None:
    fit = "piezoid.identification.fit"
    monkeypatch.setattr(f"{fit}.axes_of", lambda _: tuple(axes))
    monkeypatch.setattr(f"{fit}.unfitted", lambda *_: "stage")
    monkeypatch.setattr(f"{fit}.recorded_of", lambda *_: ())
    held = SimpleNamespace(recordings=(), sweeps=())
    _, jobs = stage_jobs.jobs_of(held, None, processes)
    assert [(job.axis, job.threads) for job in jobs] == [(axis, threads) for axis in axes]
