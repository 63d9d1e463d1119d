"""What a chapter is given, and what it may be made of."""

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from piezoid.counts import DISPLACEMENT
from piezoid.design.design import Design
from piezoid.diagnosis.compare import ModelComparison
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.formatting import Scale
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.model import AxisModel
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from piezoid.records.table import RawTable
from piezoid.verification.verification import Verification
from piezoid_reports.chart import Axis, Canvas, Layer
from piezoid_reports.traces import Trace

FIGURES_IN_FULL = 6  # recordings of an axis that are drawn; the rest stand in a table
NANO = 1e-9
COUNT = Scale(factor=1.0, unit="m")  # of displacement, as the page writes it
FIRST_SENTENCE = re.compile(r"(?<=[.;])\s")


def scale_of_errors(axis: AxisModel) -> Scale:
    """Return the unit of errors on logarithmic scales: nanometres, or counts."""
    return COUNT if DISPLACEMENT in axis.counted else Scale(factor=NANO, unit="nm")


@dataclass(frozen=True, kw_only=True, eq=False)
class Page:
    """The records behind the page.

    model         what was found
    recordings    what it was found in
    traces        measurement beside model, by axis, worst fitted first
    model_digest  of model.json; empty where the model is in no file
    sweeps        Z spectroscopies the junction was fitted to
    responses     measured frequency responses the dynamics were found in
    design        controllers, where they were designed
    undesigned    why they were not, or empty
    diagnoses     of every axis that has one
    note          what must be known of their pictures, or empty
    undiagnosed   why others have none, whole sentences
    verification  of what ships, where it was run
    unshipped     by axis, why it does not ship beside the others
    lab           what the laboratory declared
    comparison    of an earlier model with these recordings, where one was named
    files         sealed files of the folder by name, for the chain of digests
    """

    model: ActuatorModel
    recordings: tuple[Recording, ...]
    traces: Mapping[str, tuple[Trace, ...]]
    model_digest: str
    sweeps: tuple[RawTable, ...] = ()
    responses: tuple[FrequencyResponseRecord, ...] = ()
    design: Design | None = None
    undesigned: str = ""
    diagnoses: tuple[Diagnosis, ...] = ()
    note: str = ""
    undiagnosed: tuple[str, ...] = ()
    verification: Verification | None = None
    unshipped: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, bytes] = field(default_factory=dict)
    lab: Lab | None = None
    comparison: ModelComparison | None = None

    @property
    def counted(self) -> tuple[str, ...]:
        """What was recorded in counts, of ``displacement`` and ``voltage``."""
        own = {one for diagnosis in self.diagnoses for one in diagnosis.counted}
        return tuple(sorted({*self.model.counted, *own}))

    @property
    def axes(self) -> tuple[AxisModel, ...]:
        """All axes of the stage."""
        return tuple(self.model.axes.values())

    def diagnosis_of(self, axis: AxisModel) -> Diagnosis | None:
        """The diagnosis of an axis, where there is one."""
        return next((one for one in self.diagnoses if one.axis == axis.axis), None)

    def drawn(self, axis: AxisModel) -> tuple[Trace, ...]:
        """Return the recordings of an axis that get figures: those fitted worst."""
        return self.traces[axis.axis][:FIGURES_IN_FULL]

    @property
    def points(self) -> int:
        """Points for one curve, so that a page of many figures stays light."""
        drawn = sum(len(self.drawn(axis)) for axis in self.axes)
        return max(400, min(2400, 40_000 // max(drawn, 1)))


@dataclass(frozen=True, kw_only=True)
class Heading:
    """A heading inside a chapter, such as an axis' name; ``tone`` is ``plain`` or ``bad``."""

    kind: ClassVar[str] = "heading"
    text: str
    tone: str = "plain"


def axis_heading(axis: AxisModel) -> Heading:
    """Return the heading of an axis, warning where the model does not apply."""
    if axis.verdict.applies:
        return Heading(text=f"Axis {axis.axis}")
    return Heading(
        text=f"Axis {axis.axis}: the model does not apply, these numbers only show why",
        tone="bad",
    )


@dataclass(frozen=True, kw_only=True)
class Prose:
    """One paragraph; ``tone`` is ``plain``, ``good``, ``middling`` or ``bad``."""

    kind: ClassVar[str] = "prose"
    text: str
    tone: str = "plain"


@dataclass(frozen=True, kw_only=True)
class Listing:
    """Sentences one below the other."""

    kind: ClassVar[str] = "listing"
    items: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows of texts.

    caption  what the table holds, with its limits
    columns  headings with units
    rows     texts; a row as long as ``columns``
    digests  numbers of the columns that hold digests, which may break anywhere
    wordy    numbers of the columns that hold sentences, which keep some width on a phone
    links    for each row the relative place its first entry leads to; empty for none

    On the page it is folded behind the first sentence of its caption.
    """

    kind: ClassVar[str] = "table"
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    digests: tuple[int, ...] = ()
    wordy: tuple[int, ...] = ()
    links: tuple[str, ...] = ()

    @property
    def summary(self) -> str:
        """What the folded table is called: the first sentence of its caption, without its stop."""
        return FIRST_SENTENCE.split(self.caption, maxsplit=1)[0].rstrip(".;:")

    def __post_init__(self) -> None:
        if self.links and len(self.links) != len(self.rows):
            raise ValueError(f"{self.caption}: {len(self.links)} links for {len(self.rows)} rows")
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError(f"{self.caption}: a row has not {len(self.columns)} entries")


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A chart that carries its numbers.

    title    one line
    numbers  what was measured on it, with units
    look     what good and bad look like
    canvas   on which the layers were drawn
    layers   bottom first
    flicker  roles that may be shown in turn, or empty
    is_small  drawn for the first screen: no buttons, the caption for listeners alone
    seen_as   title where there is little room, or empty; who hears the page is told ``title``
    link     figures of the same name show the same stretch of time, or empty
    span     of the record that is linked, in the unit of x; 0 where x is no time
    """

    kind: ClassVar[str] = "figure"
    title: str
    numbers: str
    look: str
    canvas: Canvas
    layers: tuple[Layer, ...]
    flicker: tuple[str, ...] = ()
    is_small: bool = False
    seen_as: str = ""
    link: str = ""
    span: float = 0.0

    @property
    def margins(self) -> tuple[int, int, int, int]:
        """Room for ticks and names: left, top, right, bottom."""
        return (52, 22, 8, 34) if self.is_small else (64, 34, 16, 50)


@dataclass(frozen=True, kw_only=True)
class Rung:
    """One measure of an error: how large, what it means, and whether it may be quoted."""

    name: str
    value_m: float
    meaning: str
    is_quotable: bool


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """Measures of one axis' error on one logarithmic scale, the smallest first."""

    kind: ClassVar[str] = "ladder"
    title: str
    axis: Axis
    unit: Scale
    rungs: tuple[Rung, ...]

    def share(self, rung: Rung) -> float:
        """Return where a rung lies along the axis, 0 to 1."""
        place = math.log10(rung.value_m / self.unit.factor)
        return (place - self.axis.low) / (self.axis.high - self.axis.low)


@dataclass(frozen=True, kw_only=True)
class Card:
    """One axis at a glance.

    score    0 to 100, or None where a score would be a lie
    tone     ``good``, ``middling`` or ``bad``
    figures  the loop and the residual in time, where they are drawn
    facts    names and values of the row beside them
    """

    title: str
    score: int | None
    tone: str
    word: str
    why: str
    remedy: str
    figures: tuple[Figure, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Said:
    """The sentences on top, each with what it answers; ``tone`` as of ``Prose``."""

    kind: ClassVar[str] = "said"
    sentences: tuple[tuple[str, str], ...]
    tone: str = "plain"


@dataclass(frozen=True, kw_only=True)
class Fold:
    """Parts that a reader opens, such as the recordings that are fitted best."""

    kind: ClassVar[str] = "fold"
    summary: str
    parts: tuple["Part", ...]


@dataclass(frozen=True, kw_only=True)
class Cards:
    """The axes of a stage beside each other."""

    kind: ClassVar[str] = "cards"
    cards: tuple[Card, ...]


Part = Heading | Prose | Listing | Table | Figure | Cards | Said | Fold | Ladder
TONES = ("plain", "good", "middling", "bad")


@dataclass(frozen=True, kw_only=True)
class Section:
    """One chapter.

    anchor  for links within the page; our own word, never a name from the data
    title   heading
    lead    one or two sentences that say what the chapter shows
    """

    anchor: str
    title: str
    lead: str
    parts: tuple[Part, ...] = field(default=())

    @property
    def tone(self) -> str:
        """The worst tone of anything the chapter says, for its mark in the navigation."""
        tones = [part.tone for part in self.parts if isinstance(part, Heading | Prose | Said)]
        tones += [c.tone for part in self.parts if isinstance(part, Cards) for c in part.cards]
        return max(tones, key=TONES.index, default="plain")

    @property
    def blocks(self) -> tuple[tuple[Part, ...], ...]:
        """The parts under each heading, those before the first by themselves."""
        starts = [k for k, part in enumerate(self.parts) if isinstance(part, Heading)]
        cuts = sorted({0, *starts, len(self.parts)})
        return tuple(self.parts[a:b] for a, b in itertools.pairwise(cuts))

    @property
    def is_narrow(self) -> bool:
        """Tell whether blocks may stand beside each other: none holds more than one figure."""
        return all(
            sum(isinstance(part, Figure | Ladder | Cards) for part in block) <= 1
            for block in self.blocks
        )

    @property
    def is_folded(self) -> bool:
        """Tell whether nothing but folded tables is in it: then paper leaves it out."""
        return all(isinstance(part, Table | Heading | Fold) for part in self.parts)


def first_open(drawn: Sequence[tuple[Figure, ...]], *, shown: int = 0) -> list[Part]:
    """Return the figures of the first recording, all others in one fold.

    drawn  figures of each recording, worst fitted first
    shown  how many of the first recording's stand open; 0 for all
    """
    if not drawn:
        return []
    open_ones = drawn[0][: shown or len(drawn[0])]
    rest = (*drawn[0][len(open_ones) :], *(one for figures in drawn[1:] for one in figures))
    if not rest:
        return list(open_ones)
    count = len(drawn) - 1
    more = {0: "", 1: ", 1 further recording"}.get(count, f", {count} further recordings")
    plural = "1 figure" if len(rest) == 1 else f"{len(rest)} figures"
    return [*open_ones, Fold(summary=f"More of it{more}: {plural}", parts=rest)]


def figures_in(parts: Sequence[Part]) -> Iterator[Figure]:
    """Yield every figure, those in folds as well."""
    for part in parts:
        if isinstance(part, Figure):
            yield part
        elif isinstance(part, Fold):
            yield from figures_in(part.parts)
