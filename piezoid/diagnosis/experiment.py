"""Plan the next experiment: the drive that best answers the open questions of a diagnosis.

The questions are, in this order: two effects that could not be separated, the size with the widest
interval, an effect that these recordings could hardly show. Every candidate drive is simulated on
the fitted model. The plan is for the first question that a drive answers, with the best drive or a
shorter one that is nearly as good. If no drive answers any question, the plan states the remaining
uncertainty with the best drive and the limit that prevents a better answer.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.drive_response import DriveResponse, driven_recording
from piezoid.diagnosis.effects.cross_coupling import NAME as COUPLING
from piezoid.diagnosis.planning.candidate_drives import (
    EXPERIMENTS,
    Playback,
    drive_of,
    equal_cycles,
)
from piezoid.diagnosis.planning.drive_limits import Bench, Drive, DriveLimits, bench_of
from piezoid.diagnosis.planning.open_questions import (
    POWER,
    Question,
    is_open,
    questions_of,
    remaining_uncertainty,
)
from piezoid.diagnosis.planning.separation import SeparationEstimate, estimate_separation
from piezoid.errors import ExcitationError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.model import AxisModel
from piezoid.raw_counts import VOLTAGE, refuse_counts
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording

ENOUGH = 5.0  # standard errors; beyond these, the similarity of two shapes limits, not the noise
SLOW_Hz = 0.5
CYCLE_ROWS = 200.0
MAX_LEFT = 0.8  # largest remaining share after a recording that is worth its time
NEARLY = 0.9  # of the best score: a shorter drive that reaches it is preferred
LOOSER = 4.0  # factor on each limit, to find the limit that prevents an answer
NOTICEABLE = 0.9  # ratio of remaining shares above which a limit does not prevent an answer


@dataclass(frozen=True, kw_only=True, eq=False)
class Alternative:
    """A candidate drive and the expected precision with it.

    drive     None if it cannot be played
    response  of the model to the drive
    refusal   why it cannot be played, or empty
    estimate  together with the recordings, if they were given; None if it cannot be played
    score     inverse relative error of the size in question; for two effects to be separated their
              separability, reduced below ``ENOUGH`` standard errors
    """

    name: str
    why: str
    drive: Drive | None = None
    response: DriveResponse | None = None
    refusal: str = ""
    estimate: SeparationEstimate | None = None
    score: float = 0.0

    @property
    def duration_s(self) -> float:
        """Return the duration of the drive; 0 if it cannot be played."""
        return 0.0 if self.drive is None else self.drive.duration_s


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """The next experiment: the best drive for one question.

    alternatives  all candidates, best first
    best          the best candidate, or a shorter one that is nearly as good
    recorded      estimate from the recordings; None without them
    bench         limits of the drive, with their origin
    forbids       if it is not worth a recording, the limit that prevents more, as a sentence; else
                  empty
    set_aside     more pressing questions, which no drive answers
    """

    question: Question
    alternatives: tuple[Alternative, ...]
    best: Alternative
    recorded: SeparationEstimate | None
    bench: Bench
    forbids: str = ""
    set_aside: tuple[Question, ...] = ()

    @property
    def axis(self) -> str:
        """Return the axis of the experiment."""
        return self.bench.axis

    @property
    def limits(self) -> DriveLimits:
        """Return the limits of the drive."""
        return self.bench.limits

    @property
    def drive(self) -> Drive:
        """Return the planned drive."""
        assert self.best.drive is not None
        return self.best.drive

    @property
    def planned(self) -> SeparationEstimate:
        """Return the estimate from the recordings and the planned drive."""
        assert self.best.estimate is not None
        return self.best.estimate

    @property
    def shows(self) -> bool:
        """Whether the drive can show the effect of the question."""
        return self.best.score > 0.0

    @property
    def answers(self) -> bool:
        """Whether the drive is worth a recording."""
        estimate, is_pair = self.best.estimate, self.question.kind == "separate"
        exceed_errors = estimate is not None and POWER * estimate.worst <= 1.0
        return (exceed_errors or not is_pair) and self.remaining_share <= MAX_LEFT

    @property
    def remaining_share(self) -> float:
        """Share of the uncertainty that remains after the drive, 0 to 1."""
        if not self.shows:
            return 1.0
        return remaining_uncertainty(self.question, self.recorded, self.planned)


@dataclass(frozen=True, kw_only=True, eq=False)
class CandidateTable:
    """All candidate drives within the limits of one stage, simulated.

    recorded    drives of the recordings
    reference   drives along which a diagnosed effect has its size
    candidates  not yet evaluated
    """

    bench: Bench
    diagnosis: Diagnosis
    recorded: tuple[DriveResponse, ...]
    reference: tuple[DriveResponse, ...]
    candidates: tuple[Alternative, ...]

    def plan(self, question: Question) -> Plan:
        """Return the best drive for a question, or a shorter one that is nearly as good."""
        evaluated = []
        for candidate in self.candidates:
            if candidate.response is None:
                evaluated.append(candidate)
                continue
            estimate = self._estimate(question, candidate.response)
            if question.kind == "separate":
                certainty = 1.0 / max(estimate.worst, 1e-30)
                score = estimate.separability * min(certainty / ENOUGH, 1.0)
            else:
                score = 1.0 / max(estimate.errors[0], 1e-30)
            evaluated.append(replace(candidate, estimate=estimate, score=score))
        ranked = tuple(sorted(evaluated, key=lambda alternative: -alternative.score))
        best = ranked[0]
        nearly = [a for a in ranked if a.score >= NEARLY * best.score > 0.0]
        shortest = min(nearly, key=lambda alternative: alternative.duration_s, default=best)
        best_plan = Plan(
            question=question,
            alternatives=ranked,
            best=best,
            recorded=self._estimate(question) if self.recorded else None,
            bench=self.bench,
        )
        shorter_plan = replace(best_plan, best=shortest)
        return shorter_plan if shorter_plan.answers else best_plan

    def _estimate(self, question: Question, *planned: DriveResponse) -> SeparationEstimate:
        noise_m, final_m = self.diagnosis.noise_floor_rms_m, self.diagnosis.final.rms_m
        return estimate_separation(
            [*self.recorded, *planned],
            question.suspects,
            self.reference,
            noise_m=noise_m,
            structure_m=max(final_m**2 - noise_m**2, 0.0) ** 0.5,
        )


def simulate_candidates(
    axis: AxisModel,
    bench: Bench,
    diagnosis: Diagnosis,
    recorded: Sequence[DriveResponse],
    seed: int,
) -> CandidateTable:
    """Simulate all candidate drives on the model of one axis, each after cycles over the range."""
    candidates = []
    for experiment in EXPERIMENTS:
        candidate = Alternative(name=experiment.name, why=experiment.why)
        try:
            drive = drive_of(experiment, bench, seed)
        except ExcitationError as refusal:
            candidates.append(replace(candidate, refusal=str(refusal)))
            continue
        others_V = {name: drive.voltage_V[:, k + 1] for k, name in enumerate(drive.axes[1:])}
        response = DriveResponse(
            model=axis,
            rate_Hz=drive.sampling_rate_Hz,
            voltage_V=drive.voltage_V[:, 0],
            others_V=others_V,
        )
        candidates.append(replace(candidate, drive=drive, response=response))
    return CandidateTable(
        bench=bench,
        diagnosis=diagnosis,
        recorded=tuple(recorded),
        reference=tuple(recorded) or usual_drives(axis, bench),
        candidates=tuple(candidates),
    )


def usual_drives(axis: AxisModel, bench: Bench) -> tuple[DriveResponse, ...]:
    """Return full cycles, slow and as fast as the stage was driven: the usual recordings."""
    limits = replace(bench.limits, slew_V_per_s=axis.certificate.slew_V_per_s)
    low_V, high_V = limits.range_V
    fast_Hz = max(limits.slew_V_per_s / (np.pi * (high_V - low_V)), SLOW_Hz)
    drives = []
    for frequency_Hz in (SLOW_Hz, fast_Hz):
        rate_Hz = min(bench.clock_Hz, CYCLE_ROWS * frequency_Hz)
        playback = Playback(limits=limits, rate_Hz=rate_Hz)
        voltage_V = equal_cycles(playback, frequency_Hz=frequency_Hz, cycles=5)
        drives.append(DriveResponse(model=axis, rate_Hz=rate_Hz, voltage_V=voltage_V))
    return tuple(drives)


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
    """Choose the next experiment on the diagnosed axis: for the first question a drive answers.

    If no question is answered, the plan is for the first question with a drive that shows its
    effect.

    recordings  those of the diagnosis: the expectation is then of all recordings together, and is
                compared with the present precision
    effect      to plan for; None: the most pressing open question
    clock_Hz    of the converters, if neither lab.toml nor the model states it
    seed        of the random parts of a drive

    Raises ``ExcitationError`` if no drive shows the effect, ``LabFileError`` if the drive was
    recorded in counts. Limitation: the expectation assumes that the shape of an effect is that of
    its tangent.
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

    def table_on(bench: Bench) -> CandidateTable:
        return simulate_candidates(axis, bench, diagnosis, recorded, seed)

    table = table_on(bench)
    questions = questions_of(diagnosis, effect)
    if effect is None and not bench.other_limits:  # no drive of this rig shows it
        questions = tuple(q for q in questions if COUPLING not in q.effects) or questions
    unanswered: list[Plan] = []
    for question in questions:
        best_plan = table.plan(question)
        if best_plan.answers:
            set_aside = tuple(earlier.question for earlier in unanswered)
            return replace(best_plan, set_aside=set_aside)
        unanswered.append(best_plan)
    best_plan = next((p for p in unanswered if p.shows), unanswered[0])
    question, forbids = best_plan.question, ""
    if question.kind != "detect" or is_open(question):
        forbids = limiting_factor(
            bench,
            lambda looser: table_on(looser).plan(question).remaining_share,
            best_plan.remaining_share,
        )
    if not best_plan.shows:
        raise ExcitationError(
            f"no drive shows {' and '.join(question.effects)} inside these limits",
            needed="a range and speed in which it moves the stage",
            remedy=f"{forbids} Declare wider limits in lab.toml, or the other axes that can be "
            "driven.",
        )
    return replace(best_plan, forbids=forbids)


def limiting_factor(
    bench: Bench, share_left: Callable[[Bench], float], present_share: float
) -> str:
    """State which limit prevents a better answer, or that none does.

    share_left     (bench) -> share of the uncertainty that remains with the best drive
    present_share  share that remains within the present limits
    """
    limits, margin_V = bench.limits, 0.5 * (LOOSER - 1.0) * np.ptp(bench.limits.range_V)
    low_V, high_V = limits.range_V
    wider = replace(limits, voltage_min_V=low_V - margin_V, voltage_max_V=high_V + margin_V)
    faster = replace(limits, slew_V_per_s=LOOSER * limits.slew_V_per_s)
    looser = {
        f"the speed, {limits.slew_V_per_s:.3g} V/s ({bench.speed_from})": replace(
            bench, limits=faster
        ),
        f"the converters' clock, {bench.clock_Hz:g} Hz (sampling_rate_Hz of lab.toml, or "
        "--rate)": replace(bench, clock_Hz=LOOSER * bench.clock_Hz),
        f"the range, {low_V:.4g} to {high_V:.4g} V ({bench.range_from})": replace(
            bench, limits=wider
        ),
    }
    shares = {name: share_left(looser_bench) for name, looser_bench in looser.items()}
    name, smallest = min(shares.items(), key=lambda pair: pair[1])
    if smallest > NOTICEABLE * present_share:
        return f"{LOOSER:g} times the range, the slew rate or the sampling rate would not help" + (
            "." if bench.other_limits else "; no other axis that can be driven is declared."
        )
    return (
        f"The limit is {name}: {LOOSER:g} times as much would leave {100 * smallest:.0f} % of the "
        f"uncertainty, not {100 * present_share:.0f} %."
    )
