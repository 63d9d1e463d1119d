"""Trials made in another process: those of the heaviest axis, and never waited for in vain."""

import pickle
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

import numpy as np

from piezoid.calibration.stage_jobs import AxisJob, TipJob
from piezoid.identification.fit import fit_axis, unfitted
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.order import Trial
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from piezoid_cli.aside import Aside, made, with_trials_aside
from tests.identification.hysteresis.stages import decaying, recording
from tests.identification.hysteresis.test_parts import stage

SHAPE = Shape(plays=2, below=0, above=0, bends=3)
TRIAL = Trial(shape=SHAPE, residual=np.zeros(3), fitted=())


class Free:
    """A process that is asked and never answers."""

    def __init__(self) -> None:
        self.asked: list[Any] = []

    def ask(self, _: Any, job: Any) -> "Future[Any]":
        self.asked.append(job)
        return Future()


def recorded(count: int) -> tuple[Recording, ...]:
    """Return so many short recordings of one stage."""
    drive = decaying(10, per_unit=10)
    return tuple(
        recording(drive, stage(drive, seed, 5e-8), f"{seed}.csv") for seed in range(count)
    )


def axis_job(count: int) -> AxisJob:
    held = recorded(count)
    return AxisJob(stage=unfitted(held, Lab()), axis="x", recordings=held, lab=None)


def test_the_heaviest_axis_alone_has_its_trials_made_elsewhere() -> None:
    light, heavy = axis_job(1), axis_job(2)
    tip = TipJob(stage=heavy.stage, recordings=(), sweeps=(), axes=("x",), lab=None)
    other: Any = Free()
    jobs = with_trials_aside([tip, light, heavy], [other])
    assert other.asked == [heavy]
    assert jobs[:2] == [tip, light]
    assert isinstance(jobs[2], AxisJob)
    assert jobs[2].elsewhere is not None
    assert replace(jobs[2], elsewhere=None) == heavy


def test_without_another_process_or_without_an_axis_every_job_stays_as_it_is() -> None:
    job, other = axis_job(1), Free()
    tip = TipJob(stage=job.stage, recordings=(), sweeps=(), axes=(), lab=None)
    assert with_trials_aside([job], []) == [job]
    assert with_trials_aside([tip], [other]) == [tip]  # type: ignore[list-item]
    assert other.asked == []


def test_a_trial_that_is_made_is_given_and_another_is_not() -> None:
    there: Future[tuple[Trial, ...]] = Future()
    there.set_result((TRIAL,))
    assert Aside(there)(SHAPE) is TRIAL
    assert Aside(there)(replace(SHAPE, bends=6)) is None


def test_what_nobody_has_begun_is_not_waited_for_and_never_begun() -> None:
    waiting: Future[tuple[Trial, ...]] = Future()
    assert Aside(waiting)(SHAPE) is None
    assert waiting.cancelled()


def test_what_was_lost_on_the_way_is_made_again_by_whoever_asks() -> None:
    lost: Future[tuple[Trial, ...]] = Future()
    lost.set_running_or_notify_cancel()
    lost.set_exception(EOFError())
    assert Aside(lost)(SHAPE) is None


def test_another_process_that_gets_the_job_asks_nobody() -> None:
    assert pickle.loads(pickle.dumps(Aside(Future()))) is None


def test_an_axis_is_the_same_whoever_made_its_trials() -> None:
    job = axis_job(2)
    there = {trial.shape: trial for trial in made(job, print)}
    asked: list[Shape] = []

    def elsewhere(shape: Shape) -> Trial | None:
        asked.append(shape)
        return there[shape]

    alone = fit_axis(job.recordings, "x", Lab())
    helped = fit_axis(job.recordings, "x", Lab(), elsewhere=elsewhere)
    assert helped.quality == alone.quality
    assert helped.hysteresis.plays.weight.tobytes() == alone.hysteresis.plays.weight.tobytes()
    assert set(asked) == set(there)
    assert [shape.bends for shape in asked] == [3, 6]
