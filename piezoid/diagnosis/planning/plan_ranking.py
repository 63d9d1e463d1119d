"""The menu played on a fitted model: what every drive would tell, beside what is known already."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.planning.candidate_drives import MENU, Experiment, played
from piezoid.diagnosis.planning.drive_limits import Bench
from piezoid.diagnosis.planning.drive_response import Driven
from piezoid.diagnosis.planning.excitation import Drive
from piezoid.diagnosis.planning.open_questions import Question, answers, left_open
from piezoid.diagnosis.planning.separation import Errors, Told, told_apart
from piezoid.diagnosis.planning.simulated_drives import driven_drive, usual_drives
from piezoid.errors import ExcitationError
from piezoid.identification.model import AxisModel

ENOUGH = 5.0  # standard errors; beyond, it is likeness of shape that misleads, not noise
NEARLY = 0.9  # of the best: a shorter drive that reaches it is taken


@dataclass(frozen=True, kw_only=True)
class Alternative:
    """One entry of the menu and what it would bring.

    told     with the recordings there are, where they were given; None where it cannot be played
    score    how good it is: standard errors of the size asked about; of two that are to be
             separated rather their separability, once both stand out enough
    refusal  why it cannot be played, or empty
    """

    name: str
    why: str
    duration_s: float
    told: Told | None
    score: float = 0.0
    refusal: str = ""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The best drive for one question.

    alternatives  the whole menu, best first
    best          of these, the shorter one of two that are nearly as good
    before        what the recordings there are tell; None without them
    left          how much of the question it leaves open, 0 to 1
    """

    question: Question
    alternatives: tuple[Alternative, ...]
    best: Alternative
    before: Told | None
    left: float

    @property
    def answers(self) -> bool:
        """Whether that is worth a recording."""
        told = self.best.told
        return self.shows and told is not None and answers(self.question, self.before, told)

    @property
    def shows(self) -> bool:
        """Whether the drive shows what is asked about at all."""
        return self.best.score > 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """The menu on one bench.

    recorded   what the recordings there are played
    reference  along which what was found has its size
    drives     by name: a drive, or why this bench cannot play it
    driven     what the model makes of those it can
    """

    errors: Errors
    recorded: tuple[Driven, ...]
    reference: tuple[Driven, ...]
    drives: Mapping[str, Drive | str]
    driven: Mapping[str, Driven]

    def choice(self, question: Question) -> Choice:
        """Return the best drive for a question."""
        found = [self._alternative(one, question) for one in MENU]
        found.sort(key=lambda alternative: -alternative.score)
        before = self._told(question) if self.recorded else None
        return _chosen(question, before, tuple(found))

    def _told(self, question: Question, *planned: Driven) -> Told:
        drives = [*self.recorded, *planned]
        return told_apart(drives, question.suspects, self.reference, self.errors)

    def _alternative(self, one: Experiment, question: Question) -> Alternative:
        drive = self.drives[one.name]
        if isinstance(drive, str):
            return Alternative(
                name=one.name, why=one.why, duration_s=0.0, told=None, refusal=drive
            )
        told = self._told(question, self.driven[one.name])
        return Alternative(
            name=one.name,
            why=one.why,
            duration_s=len(drive.voltage_V) / drive.sampling_rate_Hz,
            told=told,
            score=_score(question, told),
        )


def _score(question: Question, told: Told) -> float:
    if question.kind != "separate":
        return 1.0 / max(told.errors[0], 1e-30)
    return told.separability * min(1.0 / max(told.worst, 1e-30) / ENOUGH, 1.0)


def _chosen(
    question: Question, before: Told | None, alternatives: tuple[Alternative, ...]
) -> Choice:
    """Return the first, or a shorter one that is nearly as good where that answers as well."""
    first = _of(question, before, alternatives, alternatives[0])
    near = [one for one in alternatives if one.score >= NEARLY * alternatives[0].score > 0.0]
    if not near:
        return first
    shorter = _of(question, before, alternatives, min(near, key=lambda one: one.duration_s))
    return shorter if shorter.answers else first


def _of(
    question: Question,
    before: Told | None,
    alternatives: tuple[Alternative, ...],
    best: Alternative,
) -> Choice:
    shows = best.told is not None and best.score > 0.0
    return Choice(
        question=question,
        alternatives=alternatives,
        best=best,
        before=before,
        left=left_open(question, before, best.told) if shows and best.told else 1.0,
    )


def table_of(
    axis: AxisModel, bench: Bench, diagnosis: Diagnosis, recorded: Sequence[Driven], seed: int
) -> Table:
    """Play the whole menu on the model of one axis."""
    drives = {one.name: _drive_of(one, bench, seed) for one in MENU}
    usual = tuple(driven_drive(axis, drive) for drive in usual_drives(axis, bench))
    return Table(
        errors=_errors(diagnosis),
        recorded=tuple(recorded),
        reference=tuple(recorded) or usual,
        drives=drives,
        driven={
            name: driven_drive(axis, drive)
            for name, drive in drives.items()
            if isinstance(drive, Drive)
        },
    )


def _errors(diagnosis: Diagnosis) -> Errors:
    noise_m, left_m = diagnosis.noise_floor_rms_m, diagnosis.final.rms_m
    return Errors(noise_m=noise_m, structure_m=max(left_m**2 - noise_m**2, 0.0) ** 0.5)


def _drive_of(one: Experiment, bench: Bench, seed: int) -> Drive | str:
    """Return a drive, or why this bench cannot play it."""
    if one.needs_other and not bench.others:
        return "no other axis is known to the model or to lab.toml"
    try:
        return played(one, bench, seed)
    except ExcitationError as refusal:
        return str(refusal)
