"""What a chapter is given, and what it may be made of."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from piezoid.design.design import Design
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.identification.model import ActuatorModel, AxisModel
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from piezoid.records.table import RawTable
from piezoid.verification.verification import Verification
from piezoid_reports.chart import Axis, Canvas, Layer
from piezoid_reports.traces import Trace

FIGURES_IN_FULL = 6  # recordings of an axis that are drawn; the rest stand in a table


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
    """

    kind: ClassVar[str] = "table"
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    digests: tuple[int, ...] = ()
    wordy: tuple[int, ...] = ()
    links: tuple[str, ...] = ()

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
    layers   bottom first
    flicker  roles that may be shown in turn, or empty
    """

    kind: ClassVar[str] = "figure"
    title: str
    numbers: str
    look: str
    x: Axis
    y: Axis
    layers: tuple[Layer, ...]
    flicker: tuple[str, ...] = ()
    width: int = Canvas.width
    height: int = Canvas.height


@dataclass(frozen=True, kw_only=True)
class Card:
    """One axis at a glance.

    score  0 to 100, or None where a score would be a lie
    tone   ``good``, ``middling`` or ``bad``
    """

    title: str
    score: int | None
    tone: str
    word: str
    why: str
    remedy: str


@dataclass(frozen=True, kw_only=True)
class Cards:
    """The axes of a stage beside each other."""

    kind: ClassVar[str] = "cards"
    cards: tuple[Card, ...]


Part = Heading | Prose | Listing | Table | Figure | Cards


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
