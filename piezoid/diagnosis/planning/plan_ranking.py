"""Rank candidate drives on a fitted model by what each adds to the recordings there are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.drive_response import ROWS, Driven, rows_of, scaled_drives
from piezoid.diagnosis.planning.candidate_drives import MENU, played
from piezoid.diagnosis.planning.drive_limits import Bench, Drive
from piezoid.diagnosis.planning.open_questions import Question, answers, left_open
from piezoid.diagnosis.planning.separation import Errors, SeparationEstimate, estimate_separation
from piezoid.diagnosis.planning.waveforms import equal_cycles
from piezoid.errors import ExcitationError
from piezoid.identification.model import AxisModel

ENOUGH = 5.0  # standard errors; beyond, it is likeness of shape that misleads, not noise
SLOW_Hz = 0.5
CYCLE_ROWS = 200.0
NEARLY = 0.9  # of the best: a shorter drive that reaches it is taken


@dataclass(frozen=True, kw_only=True)
class Alternative:
    """One candidate drive and what it would bring.

    estimate with the recordings there are, where they were given; None where it cannot be played
    score    standard errors of the size asked about; of two effects to be separated their
             separability, once both exceed ``ENOUGH`` standard errors
    refusal  why it cannot be played, or empty
    """

    name: str
    why: str
    duration_s: float
    estimate: SeparationEstimate | None
    score: float = 0.0
    refusal: str = ""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The best drive for one question.

    alternatives  all candidates, best first
    best          of these, the shorter one of two that are nearly as good
    before        what the recordings there are tell; None without them
    left          how much of the question it leaves open, 0 to 1
    """

    question: Question
    alternatives: tuple[Alternative, ...]
    best: Alternative
    before: SeparationEstimate | None
    left: float

    @property
    def answers(self) -> bool:
        """Whether the drive is worth a recording."""
        estimate = self.best.estimate
        return (
            self.shows and estimate is not None and answers(self.question, self.before, estimate)
        )

    @property
    def shows(self) -> bool:
        """Whether the drive shows the effect of the question at all."""
        return self.best.score > 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """All candidate drives on one bench, simulated.

    recorded   drives of the recordings there are
    reference  drives along which a diagnosed effect has its size
    drives     by name: a drive, or why this bench cannot play it
    driven     response of the model to those it can play
    """

    errors: Errors
    recorded: tuple[Driven, ...]
    reference: tuple[Driven, ...]
    drives: Mapping[str, Drive | str]
    driven: Mapping[str, Driven]

    def choice(self, question: Question) -> Choice:
        """Return the best drive for a question, or a shorter one that is nearly as good."""
        before = self._estimate(question) if self.recorded else None
        ranked = tuple(
            sorted(self._alternatives(question), key=lambda alternative: -alternative.score)
        )

        def choice(best: Alternative) -> Choice:
            is_shown = best.estimate is not None and best.score > 0.0
            left = (
                left_open(question, before, best.estimate) if is_shown and best.estimate else 1.0
            )
            return Choice(
                question=question, alternatives=ranked, best=best, before=before, left=left
            )

        near = [one for one in ranked if one.score >= NEARLY * ranked[0].score > 0.0]
        if near:
            shorter = choice(min(near, key=lambda one: one.duration_s))
            if shorter.answers:
                return shorter
        return choice(ranked[0])

    def _alternatives(self, question: Question) -> list[Alternative]:
        found = []
        for one in MENU:
            drive = self.drives[one.name]
            if isinstance(drive, str):
                refused = Alternative(
                    name=one.name, why=one.why, duration_s=0.0, estimate=None, refusal=drive
                )
                found.append(refused)
                continue
            estimate = self._estimate(question, self.driven[one.name])
            score = 1.0 / max(
                estimate.worst if question.kind == "separate" else estimate.errors[0], 1e-30
            )
            if question.kind == "separate":
                score = estimate.separability * min(score / ENOUGH, 1.0)
            found.append(
                Alternative(
                    name=one.name,
                    why=one.why,
                    duration_s=drive.duration_s,
                    estimate=estimate,
                    score=score,
                )
            )
        return found

    def _estimate(self, question: Question, *planned: Driven) -> SeparationEstimate:
        drives = [*self.recorded, *planned]
        return estimate_separation(drives, question.suspects, self.reference, self.errors)


def table_of(
    axis: AxisModel, bench: Bench, diagnosis: Diagnosis, recorded: Sequence[Driven], seed: int
) -> Table:
    """Simulate all candidate drives on the model of one axis."""
    drives: dict[str, Drive | str] = {}
    for one in MENU:
        try:
            drives[one.name] = played(one, bench, seed)
        except ExcitationError as refusal:
            drives[one.name] = str(refusal)
    noise_m, left_m = diagnosis.noise_floor_rms_m, diagnosis.final.rms_m
    return Table(
        errors=Errors(noise_m=noise_m, structure_m=max(left_m**2 - noise_m**2, 0.0) ** 0.5),
        recorded=tuple(recorded),
        reference=tuple(recorded) or usual_drives(axis, bench),
        drives=drives,
        driven={
            name: driven_drive(axis, drive)
            for name, drive in drives.items()
            if isinstance(drive, Drive)
        },
    )


def driven_drive(axis: AxisModel, drive: Drive) -> Driven:
    """Return a planned drive, from an initial state that cycled over the range."""
    return Driven(
        name=drive.name,
        model=axis,
        rate_Hz=drive.sampling_rate_Hz,
        voltage_V=drive.voltage_V[:, 0],
        rows=rows_of(len(drive.voltage_V), ROWS),
        others=scaled_drives(
            {name: drive.voltage_V[:, k + 1] for k, name in enumerate(drive.axes[1:])}
        ),
    )


def usual_drives(axis: AxisModel, bench: Bench) -> tuple[Driven, ...]:
    """Return full cycles, slow and as fast as the stage was driven: the usual recordings."""
    limits = replace(bench.limits, slew_V_per_s=axis.certificate.slew_V_per_s)
    low_V, high_V = limits.range_V
    fast_Hz = max(limits.slew_V_per_s / (np.pi * (high_V - low_V)), SLOW_Hz)
    drives = []
    for frequency_Hz in (SLOW_Hz, fast_Hz):
        rate_Hz = min(bench.clock_Hz, CYCLE_ROWS * frequency_Hz)
        voltage_V = equal_cycles(limits, rate_Hz, frequency_Hz=frequency_Hz, cycles=5)
        rows = rows_of(len(voltage_V), ROWS)
        drives.append(
            Driven(name="full cycles", model=axis, rate_Hz=rate_Hz, voltage_V=voltage_V, rows=rows)
        )
    return tuple(drives)
