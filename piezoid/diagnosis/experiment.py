"""The next experiment: the drive that answers best what a diagnosis left open.

The questions come first: two effects that could not be separated, else the size with the widest
interval, else an effect these recordings could hardly have shown. Every drive of the menu is then
played on the fitted model, and the first question that one of them answers is taken; the drive
that answers it best is planned, the shorter one where two are nearly as good. Where none answers,
the plan says how little the best would give and which limit forbids more. Nothing is measured
here: the expectation is that of separation.py.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.drive_response import driven_recording
from piezoid.diagnosis.planning.drive_limits import Bench, Drive, DriveLimits, bench_of
from piezoid.diagnosis.planning.open_questions import Question, is_open, questions_of
from piezoid.diagnosis.planning.plan_ranking import Alternative, Choice, Table, table_of
from piezoid.diagnosis.planning.separation import SeparationEstimate
from piezoid.errors import ExcitationError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.raw_counts import VOLTAGE, refuse_counts
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording

LOOSER = 4.0  # times the limit
FELT = 0.9  # of what is left open: a limit that changes less does not stand in the way

Best = Callable[[Bench], float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """The next experiment.

    before        what the recordings there are can tell; None where they were not given
    after         with the planned one
    answers       whether the drive is worth a recording
    forbids       where it is not: the limit that forbids more; empty where nothing is missing
    set_aside     more pressing questions, which no drive of the menu answers
    alternatives  the whole menu, best first; the first is the one that was chosen
                  unless a shorter one is nearly as good
    limits_from   where the limits come from, in words
    """

    axis: str
    question: Question
    drive: Drive
    limits: DriveLimits
    limits_from: str
    before: SeparationEstimate | None
    after: SeparationEstimate
    answers: bool
    forbids: str
    set_aside: tuple[Question, ...]
    alternatives: tuple[Alternative, ...]

    @property
    def duration_s(self) -> float:
        """Return how long the drive takes."""
        return self.drive.duration_s


def plan(
    model: ActuatorModel,
    diagnosis: Diagnosis,
    *,
    lab: Lab | None = None,
    recordings: Sequence[Recording] = (),
    effect: str | None = None,
    clock_Hz: float | None = None,
    seed: int = 0,
) -> Plan:
    """Choose the next experiment on the axis that was diagnosed.

    recordings  those of the diagnosis, where they are at hand: the expectation is then of all
                recordings together and can say how much better than now that is
    effect      ask about this one; default: what was left most open
    clock_Hz    of the converters, where neither lab.toml nor the model say
    seed        of what is left to chance in a drive

    Raises ``ExcitationError`` where no drive shows any of it, ``LabFileError`` where the drive was
    recorded in counts. What goes wrong: an effect whose
    real shape differs much from its tangent is told apart more or less well than is promised.
    """
    axis = model[diagnosis.axis]
    refuse_counts(axis.axis, axis.counted, quantities=(VOLTAGE,))
    bench = bench_of(model, axis, lab or Lab(), recordings, clock_Hz)
    recorded = [
        driven_recording(axis, recording)
        for recording in recordings
        if (channel := recording.find(Quantity.VOLTAGE, axis.axis)) is not None
        and float(np.ptp(channel.values)) > 0.0
    ]

    def table_on(bench: Bench) -> Table:
        return table_of(axis, bench, diagnosis, recorded, seed)

    def remaining_share(looser: Bench) -> float:
        return table_on(looser).choice(chosen.question).left

    table = table_on(bench)
    chosen, set_aside = _first_answered(table, questions_of(diagnosis, effect))
    is_missing = chosen.question.kind != "detect" or is_open(chosen.question)
    forbids = (
        what_forbids(bench, remaining_share, chosen.left)
        if is_missing and not chosen.answers
        else ""
    )
    drive, estimate = table.drives[chosen.best.name], chosen.best.estimate
    if not chosen.shows or estimate is None or not isinstance(drive, Drive):
        raise ExcitationError(
            f"no drive shows {' and '.join(chosen.question.effects)} inside these limits",
            needed="a range and speed in which it moves the stage",
            remedy=f"{forbids} Declare wider limits in lab.toml, or the other axes that can be "
            "driven.",
        )
    return Plan(
        axis=bench.axis,
        question=chosen.question,
        drive=drive,
        limits=bench.limits,
        limits_from=bench.limits_from,
        before=chosen.before,
        after=estimate,
        answers=chosen.answers,
        forbids=forbids,
        set_aside=set_aside,
        alternatives=chosen.alternatives,
    )


def _first_answered(
    table: Table, questions: Sequence[Question]
) -> tuple[Choice, tuple[Question, ...]]:
    """Return the first question that a drive answers, and those before it.

    Where none is answered: the first of which a drive shows anything, else the first.
    """
    tried: list[Choice] = []
    for question in questions:
        choice = table.choice(question)
        if choice.answers:
            return choice, tuple(one.question for one in tried)
        tried.append(choice)
    return next((one for one in tried if one.shows), tried[0]), ()


def what_forbids(bench: Bench, best: Best, left: float) -> str:
    """Return which limit forbids more, or that none does, as one sentence.

    best  (bench) -> how much of the question the best drive of the menu leaves there
    left  what it leaves inside the limits there are
    """
    limits, margin_V = bench.limits, 0.5 * (LOOSER - 1.0) * np.ptp(bench.limits.range_V)
    wider = replace(
        limits,
        voltage_min_V=limits.voltage_min_V - margin_V,
        voltage_max_V=limits.voltage_max_V + margin_V,
    )
    faster = replace(limits, slew_V_per_s=LOOSER * limits.slew_V_per_s)
    looser = {
        f"the speed, {limits.slew_V_per_s:.3g} V/s ({bench.speed_from})": replace(
            bench, limits=faster
        ),
        f"the converters' clock, {bench.clock_Hz:g} Hz (sampling_rate_Hz of lab.toml, or "
        "--rate)": replace(bench, clock_Hz=LOOSER * bench.clock_Hz),
        f"the range, {limits.voltage_min_V:.4g} to {limits.voltage_max_V:.4g} V "
        f"({bench.range_from})": replace(bench, limits=wider),
    }
    shares = {name: best(one) for name, one in looser.items()}
    name, least = min(shares.items(), key=lambda pair: pair[1])
    if least > FELT * left:
        return f"{LOOSER:g} times the range, the slew rate or the sampling rate would not help" + (
            "." if bench.others else "; no other axis that can be driven is declared."
        )
    return (
        f"The limit is {name}: {LOOSER:g} times as much would leave {100 * least:.0f} % of the "
        f"uncertainty, not {100 * left:.0f} %."
    )
