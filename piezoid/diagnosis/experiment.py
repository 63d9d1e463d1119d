"""The next experiment: the drive that answers best what a diagnosis left open.

The question comes first: two effects that could not be separated, else the size with the widest
interval, else an effect these recordings could hardly have shown. Every drive of the menu is then
played on the fitted model; the one that answers best is planned, the shorter one where two are
nearly as good. Nothing is measured here: the expectation is that of separation.py.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.planning.bench import Bench, bench_of
from piezoid.diagnosis.planning.menu import MENU, Experiment, played
from piezoid.diagnosis.planning.playing import (
    driven_drive,
    driven_recording,
    drives_axis,
    usual_drives,
)
from piezoid.diagnosis.planning.question import Question, question_of
from piezoid.diagnosis.planning.separation import Errors, Told, told_apart
from piezoid.errors import ExcitationError
from piezoid.identification.model import ActuatorModel
from piezoid.records.excitation import Drive, DriveLimits
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording

ENOUGH = 5.0  # standard errors; beyond, it is likeness of shape that misleads, not noise
NEARLY = 0.9  # of the best: a shorter drive that reaches it is taken


@dataclass(frozen=True, kw_only=True)
class Alternative:
    """One entry of the menu and what it would bring.

    told     with the recordings there are, where they were given; None where it cannot be played
    refusal  why not, or empty
    """

    name: str
    why: str
    duration_s: float
    told: Told | None
    refusal: str = ""

    @property
    def score(self) -> float:
        """Return how good this is: standard errors of the least known strength; of two that are
        to be separated rather their separability, once both stand out enough.
        """
        if self.told is None:
            return 0.0
        stands_out = 1.0 / max(self.told.worst, 1e-30)
        if len(self.told.errors) == 1:
            return stands_out
        return self.told.separability * min(stands_out / ENOUGH, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """The next experiment.

    before        what the recordings there are can tell; None where they were not given
    after         with the planned one
    alternatives  the whole menu, best first; the first is the one that was chosen
                  unless a shorter one is nearly as good
    limits_from   where the limits come from, in words
    """

    axis: str
    question: Question
    drive: Drive
    limits: DriveLimits
    limits_from: str
    before: Told | None
    after: Told
    alternatives: tuple[Alternative, ...]

    @property
    def duration_s(self) -> float:
        """Return how long the drive takes."""
        return len(self.drive.voltage_V) / self.drive.sampling_rate_Hz


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

    Raises ``ExcitationError`` where no drive can answer. What goes wrong: an effect whose real
    shape differs much from its tangent is told apart more or less well than is promised.
    """
    lab = lab or Lab()
    axis = model[diagnosis.axis]
    played_before = [driven_recording(axis, one) for one in recordings if drives_axis(one, axis)]
    bench = bench_of(model, axis, lab, recordings, clock_Hz)
    question = question_of(diagnosis, effect)
    errors = _errors(diagnosis)
    usual = [driven_drive(axis, drive) for drive in usual_drives(axis, bench)]
    reference = played_before or usual
    menu = {one.name: _drive_of(one, bench, seed) for one in MENU}
    found = []
    for one in MENU:
        drive = menu[one.name]
        told = None
        if isinstance(drive, Drive):
            drives = [*played_before, driven_drive(axis, drive)]
            told = told_apart(drives, question.suspects, reference, errors)
        found.append(_alternative(one, drive, told))
    found.sort(key=lambda alternative: -alternative.score)
    best = _chosen(found, question)
    chosen = menu[best.name]
    if not isinstance(chosen, Drive) or best.told is None:
        raise TypeError(best.name)
    return Plan(
        axis=diagnosis.axis,
        question=question,
        drive=chosen,
        limits=bench.limits,
        limits_from=bench.limits_from,
        before=told_apart(played_before, question.suspects, reference, errors)
        if played_before
        else None,
        after=best.told,
        alternatives=tuple(found),
    )


def _errors(diagnosis: Diagnosis) -> Errors:
    noise_m, left_m = diagnosis.noise_floor_rms_m, diagnosis.final.rms_m
    return Errors(noise_m=noise_m, structure_m=max(left_m**2 - noise_m**2, 0.0) ** 0.5)


def _chosen(found: Sequence[Alternative], question: Question) -> Alternative:
    best = found[0]
    if not best.score > 0.0:
        raise ExcitationError(
            f"no drive of the menu shows {' and '.join(question.effects)} inside these limits",
            needed="a range and speed in which it moves the stage",
            remedy="Declare wider limits in lab.toml, or the other axes that can be driven.",
        )
    near = [one for one in found if one.score >= NEARLY * best.score]
    return min(near, key=lambda one: one.duration_s)


def _alternative(one: Experiment, drive: Drive | str, told: Told | None) -> Alternative:
    if isinstance(drive, str):
        return Alternative(name=one.name, why=one.why, duration_s=0.0, told=None, refusal=drive)
    duration_s = len(drive.voltage_V) / drive.sampling_rate_Hz
    return Alternative(name=one.name, why=one.why, duration_s=duration_s, told=told)


def _drive_of(one: Experiment, bench: Bench, seed: int) -> Drive | str:
    """Return a drive, or why this bench cannot play it."""
    if one.needs_other and not bench.others:
        return "no other axis is known to the model or to lab.toml"
    try:
        return played(one, bench, seed)
    except ExcitationError as refusal:
        return str(refusal)
