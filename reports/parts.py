"""The parts of a section: headings, sentences, tables, figures, and their containers."""

import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from piezoid.identification.model import AxisModel
from piezoid_reports.chart import Axis, Canvas, Layer

FIRST_SENTENCE = re.compile(r"(?<=[.;])\s")


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

    caption  content of the table, with its limits
    columns  headings with units
    rows     texts; a row as long as ``columns``
    digests  numbers of the columns that hold digests, which may break anywhere
    wordy    numbers of the columns that hold sentences, which keep some width on a phone
    links    for each row the relative place its first entry leads to; empty for none
    is_open  whether it is shown at once; else it is folded behind its caption's first sentence
    """

    kind: ClassVar[str] = "table"
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    digests: tuple[int, ...] = ()
    wordy: tuple[int, ...] = ()
    links: tuple[str, ...] = ()
    is_open: bool = False

    @property
    def summary(self) -> str:
        """Title of the folded table: the first sentence of its caption, without its stop."""
        return FIRST_SENTENCE.split(self.caption, maxsplit=1)[0].rstrip(".;:")

    @property
    def details(self) -> str:
        """The caption, if folded without the sentence by which the table is unfolded."""
        if self.is_open:
            return self.caption
        return "".join(FIRST_SENTENCE.split(self.caption, maxsplit=1)[1:])

    def __post_init__(self) -> None:
        if self.links and len(self.links) != len(self.rows):
            raise ValueError(f"{self.caption}: {len(self.links)} links for {len(self.rows)} rows")
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError(f"{self.caption}: a row has not {len(self.columns)} entries")


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A chart that carries its numbers.

    title    one line
    caption  one sentence with the figures that matter, with units
    guide    how to read it: what good and bad look like; shown once in a section
    canvas   on which the layers were drawn
    layers   bottom first
    flicker  roles that may be shown in turn, or empty
    is_small  drawn for the first screen: no buttons, the caption for listeners alone
    seen_as   title where there is little room, or empty; screen readers read ``title``
    link     figures of the same name show the same stretch of time, or empty
    span     of the record that is linked, in the unit of x; 0 where x is no time
    """

    kind: ClassVar[str] = "figure"
    title: str
    caption: str
    guide: str
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
class Bar:
    """One step of a waterfall, from ``start_m`` to ``end_m``; ``role`` decides its colour."""

    name: str
    start_m: float
    end_m: float
    value: str
    role: str


@dataclass(frozen=True, kw_only=True)
class Waterfall:
    """Bars below each other on one linear scale from zero.

    Args:
        title: one line.
        caption: one sentence.
        axis: along the bars.
        bars: in the order of the picture.
    """

    kind: ClassVar[str] = "waterfall"
    title: str
    caption: str
    axis: Axis
    bars: tuple[Bar, ...]

    def share(self, value_m: float) -> float:
        """Return where a value lies along the axis, 0 to 1."""
        return value_m / self.axis.scale.factor / self.axis.high


@dataclass(frozen=True, kw_only=True)
class Card:
    """One axis at a glance.

    Args:
        title: name of the axis.
        tone: ``good``, ``middling`` or ``bad``.
        word: the grade that a reader sees.
        figures: the loop and the residual against time, if they are drawn.
        facts: names and values of the row beside them.
    """

    title: str
    tone: str
    word: str
    figures: tuple[Figure, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Headline:
    """The sentences of the summary, each with its label; ``tone`` as of ``Prose``."""

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


Part = Heading | Prose | Listing | Table | Figure | Waterfall | Cards | Headline | Fold
TONES = ("plain", "good", "middling", "bad")


def worst_tone(tones: Iterable[str]) -> str:
    """Return the worst of some tones."""
    return max(tones, key=TONES.index, default="plain")


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
        """The worst tone of its parts, for its mark in the navigation."""
        tones = [part.tone for part in self.parts if isinstance(part, Heading | Prose | Headline)]
        tones += [c.tone for part in self.parts if isinstance(part, Cards) for c in part.cards]
        return worst_tone(tones)

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
            sum(isinstance(part, Figure | Waterfall | Cards) for part in block) <= 1
            for block in self.blocks
        )

    @property
    def is_folded(self) -> bool:
        """Tell whether nothing but folded tables is in it: then paper leaves it out."""
        return all(
            isinstance(part, Heading | Fold) or (isinstance(part, Table) and not part.is_open)
            for part in self.parts
        )


def with_rows(*tables: Table) -> list[Part]:
    """Return the tables that have rows."""
    return [table for table in tables if table.rows]


def folded(summary: str, parts: Sequence[Part]) -> list[Part]:
    """Return parts in one fold, or nothing if there are none."""
    return [Fold(summary=summary, parts=tuple(parts))] if parts else []


def count_of(number: int, noun: str) -> str:
    """Return a number with its noun: ``1 figure``, ``3 figures``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
