"""Trials of the heaviest axis, made in another process while this one makes the others."""

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from piezoid.calibration.stage_jobs import AxisJob, TipJob, Told, weight_of

if TYPE_CHECKING:
    from piezoid.identification.hysteresis.order import Trial
    from piezoid_cli.other_process import Other


def with_trials_aside(
    jobs: "Sequence[AxisJob | TipJob]", begun: "Sequence[Other]"
) -> "list[AxisJob | TipJob]":
    """Return the jobs, the heaviest of them with its trials under way in the first process begun.

    Nobody is slower than whoever does the heaviest axis, and the others have little to do: they
    take over what of it is ready to be taken over.
    """
    heaviest = max(jobs, key=weight_of, default=None)
    if not begun or not isinstance(heaviest, AxisJob):
        return list(jobs)
    trials = Aside(begun[0].ask(made, heaviest))
    return [replace(job, elsewhere=trials) if job is heaviest else job for job in jobs]


def made(job: AxisJob, _: Told) -> "tuple[Trial, ...]":
    """Make those trials of an axis that need nothing of the others."""
    from piezoid.identification.fit import trials_of
    from piezoid.records.lab import Lab

    return trials_of(job.recordings, job.axis, job.lab or Lab())


class Aside:
    """Trials that are under way; what was lost on the way is made again by whoever asks."""

    def __init__(self, trials: "Future[tuple[Trial, ...]]") -> None:
        """Hold what will be there."""
        self._trials = trials

    def __call__(self, shape: Any) -> "Trial | None":
        """Wait for the trial of a shape; None where nobody has begun, or will ever tell."""
        if self._trials.cancel():
            return None
        try:
            made_there = self._trials.result()
        except Exception:  # where it is made again, it shows itself
            return None
        return next((trial for trial in made_there if trial.shape == shape), None)

    def __reduce__(self) -> tuple[Any, ...]:
        """Stay here: in another process there is nobody to ask."""
        return _nobody, ()


def _nobody() -> None:
    """Stand for trials in another process."""
