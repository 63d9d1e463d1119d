"""Rank candidate drives by what each adds to the recordings, simulated on the fitted model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.drive_response import ROWS, DriveResponse, rows_of, scaled_drives
from piezoid.diagnosis.planning.candidate_drives import EXPERIMENTS, Experiment, drive_of
from piezoid.diagnosis.planning.drive_limits import Bench, Drive
from piezoid.diagnosis.planning.open_questions import Question, answers, remaining_uncertainty
from piezoid.diagnosis.planning.separation import Errors, SeparationEstimate, estimate_separation
from piezoid.diagnosis.planning.waveforms import equal_cycles
from piezoid.errors import ExcitationError
from piezoid.identification.model import AxisModel

ENOUGH = 5.0  # standard errors; beyond these, the similarity of two shapes limits, not the noise
SLOW_Hz = 0.5
CYCLE_ROWS = 200.0
NEARLY = 0.9  # of the best score: a shorter drive that reaches it is preferred


@dataclass(frozen=True, kw_only=True)
class Alternative:
    """A candidate drive and the expected precision with it.

    estimate  together with the recordings, if they were given; None if it cannot be played
    score     inverse relative error of the size in question; for two effects to be separated their
              separability, reduced below ``ENOUGH`` standard errors
    refusal   why it cannot be played, or empty
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

    alternatives     all candidates, best first
    best             the best candidate, or a shorter one that is nearly as good
    recorded         estimate from the recordings; None without them
    remaining_share  share of the uncertainty that remains after the drive, 0 to 1
    """

    question: Question
    alternatives: tuple[Alternative, ...]
    best: Alternative
    recorded: SeparationEstimate | None
    remaining_share: float

    @property
    def shows(self) -> bool:
        """Whether the drive can show the effect of the question."""
        return self.best.score > 0.0

    @property
    def answers(self) -> bool:
        """Whether the drive is worth a recording."""
        estimate = self.best.estimate
        if estimate is None or not self.shows:
            return False
        return answers(self.question, self.recorded, estimate)


@dataclass(frozen=True, kw_only=True, eq=False)
class CandidateTable:
    """All candidate drives within the limits of one stage, simulated.

    recorded   drives of the recordings
    reference  drives along which a diagnosed effect has its size
    drives     by name: a drive, or why it cannot be played
    responses  response of the model to each drive that can be played
    """

    errors: Errors
    recorded: tuple[DriveResponse, ...]
    reference: tuple[DriveResponse, ...]
    drives: Mapping[str, Drive | str]
    responses: Mapping[str, DriveResponse]

    def choice(self, question: Question) -> Choice:
        """Return the best drive for a question, or a shorter one that is nearly as good."""
        recorded = self._estimate(question) if self.recorded else None
        alternatives = [self._alternative(experiment, question) for experiment in EXPERIMENTS]
        ranked = tuple(sorted(alternatives, key=lambda alternative: -alternative.score))
        best = ranked[0]
        choice = Choice(
            question=question,
            alternatives=ranked,
            best=best,
            recorded=recorded,
            remaining_share=_share_left(question, recorded, best),
        )
        nearly = [a for a in ranked if a.score >= NEARLY * best.score > 0.0]
        if not nearly:
            return choice
        shortest = min(nearly, key=lambda alternative: alternative.duration_s)
        shorter = replace(
            choice, best=shortest, remaining_share=_share_left(question, recorded, shortest)
        )
        return shorter if shorter.answers else choice

    def _alternative(self, experiment: Experiment, question: Question) -> Alternative:
        name, why, drive = experiment.name, experiment.why, self.drives[experiment.name]
        if isinstance(drive, str):
            return Alternative(name=name, why=why, duration_s=0.0, estimate=None, refusal=drive)
        estimate = self._estimate(question, self.responses[name])
        if question.kind == "separate":
            certainty = 1.0 / max(estimate.worst, 1e-30)
            score = estimate.separability * min(certainty / ENOUGH, 1.0)
        else:
            score = 1.0 / max(estimate.errors[0], 1e-30)
        return Alternative(
            name=name, why=why, duration_s=drive.duration_s, estimate=estimate, score=score
        )

    def _estimate(self, question: Question, *planned: DriveResponse) -> SeparationEstimate:
        drives = [*self.recorded, *planned]
        return estimate_separation(drives, question.suspects, self.reference, self.errors)


def _share_left(
    question: Question, recorded: SeparationEstimate | None, alternative: Alternative
) -> float:
    if alternative.estimate is None or alternative.score <= 0.0:
        return 1.0
    return remaining_uncertainty(question, recorded, alternative.estimate)


def simulate_candidates(
    axis: AxisModel,
    bench: Bench,
    diagnosis: Diagnosis,
    recorded: Sequence[DriveResponse],
    seed: int,
) -> CandidateTable:
    """Simulate all candidate drives on the model of one axis."""
    drives: dict[str, Drive | str] = {}
    for experiment in EXPERIMENTS:
        try:
            drives[experiment.name] = drive_of(experiment, bench, seed)
        except ExcitationError as refusal:
            drives[experiment.name] = str(refusal)
    noise_m, final_m = diagnosis.noise_floor_rms_m, diagnosis.final.rms_m
    return CandidateTable(
        errors=Errors(noise_m=noise_m, structure_m=max(final_m**2 - noise_m**2, 0.0) ** 0.5),
        recorded=tuple(recorded),
        reference=tuple(recorded) or usual_drives(axis, bench),
        drives=drives,
        responses={
            name: response_to(axis, drive)
            for name, drive in drives.items()
            if isinstance(drive, Drive)
        },
    )


def response_to(axis: AxisModel, drive: Drive) -> DriveResponse:
    """Return the model's response to a planned drive, after cycles over the range."""
    return DriveResponse(
        name=drive.name,
        model=axis,
        rate_Hz=drive.sampling_rate_Hz,
        voltage_V=drive.voltage_V[:, 0],
        rows=rows_of(len(drive.voltage_V), ROWS),
        other_drives=scaled_drives(
            {name: drive.voltage_V[:, k + 1] for k, name in enumerate(drive.axes[1:])}
        ),
    )


def usual_drives(axis: AxisModel, bench: Bench) -> tuple[DriveResponse, ...]:
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
            DriveResponse(
                name="full cycles", model=axis, rate_Hz=rate_Hz, voltage_V=voltage_V, rows=rows
            )
        )
    return tuple(drives)
