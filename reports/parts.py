"""Parts of a page: headings, sentences, tables, figures, their containers, and the HTML page."""

import base64
import hashlib
import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files as files_of
from typing import ClassVar

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from piezoid.errors import printable
from piezoid.identification.fit_statements import GOOD_PERCENT, NEAR_NOISE
from piezoid.identification.model import AxisModel
from piezoid.raw_counts import in_counts
from piezoid_reports.chart import Axis, Canvas, Layer

FIRST_SENTENCE = re.compile(r"(?<=[.;])\s")


@dataclass(frozen=True, kw_only=True)
class Heading:
    """A heading inside a section; ``tone`` is ``plain`` or ``bad``."""

    kind: ClassVar[str] = "heading"
    text: str
    tone: str = "plain"


def axis_heading(axis: AxisModel) -> Heading:
    """Return the heading of an axis, with a warning if the model does not apply."""
    if axis.verdict.applies:
        return Heading(text=f"Axis {axis.axis}")
    return Heading(
        text=f"Axis {axis.axis}: the model does not apply; these numbers only show why", tone="bad"
    )


@dataclass(frozen=True, kw_only=True)
class Prose:
    """One paragraph; ``tone`` is ``plain``, ``good``, ``middling`` or ``bad``."""

    kind: ClassVar[str] = "prose"
    text: str
    tone: str = "plain"


@dataclass(frozen=True, kw_only=True)
class Listing:
    """A list of sentences."""

    kind: ClassVar[str] = "listing"
    items: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of texts.

    caption  content of the table, with its limits
    columns  headings with units
    rows     one text for each column
    digests  indices of the columns that hold digests, which may break anywhere
    wordy    indices of the columns that hold sentences, which keep some width on a phone
    links    relative address for the first entry of each row; empty for none
    is_open  False: the table is folded under the first sentence of its caption
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
        """Title of the folded table: the first sentence of its caption, without full stop."""
        return FIRST_SENTENCE.split(self.caption, maxsplit=1)[0].rstrip(".;:")

    @property
    def details(self) -> str:
        """Caption of the table; if folded, without its first sentence, which is the title."""
        if self.is_open:
            return self.caption
        return "".join(FIRST_SENTENCE.split(self.caption, maxsplit=1)[1:])

    def __post_init__(self) -> None:
        if self.links and len(self.links) != len(self.rows):
            raise ValueError(f"{self.caption}: {len(self.links)} links for {len(self.rows)} rows")
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError(f"{self.caption}: a row does not have {len(self.columns)} entries")


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A chart with its numbers.

    title        one line
    caption      one sentence with the most important numbers and their units
    guide        how good and bad results look; shown once per page
    canvas       on which the layers were drawn
    layers       bottom first
    is_small     drawn for the summary: no buttons, and the caption only for screen readers
    short_title  shown instead of ``title`` in the summary, or empty; screen readers read ``title``
    link         figures with the same link show the same interval of time, or empty
    span         duration of the linked recording, in the unit of x; 0 if x is not time
    """

    kind: ClassVar[str] = "figure"
    title: str
    caption: str
    guide: str
    canvas: Canvas
    layers: tuple[Layer, ...]
    is_small: bool = False
    short_title: str = ""
    link: str = ""
    span: float = 0.0

    @property
    def margins(self) -> tuple[int, int, int, int]:
        """Margins for ticks and labels in pixels: left, top, right, bottom."""
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
    """Bars on one linear scale from zero.

    Args:
        title: one line.
        caption: one sentence.
        axis: along the bars.
        bars: from top to bottom.
    """

    kind: ClassVar[str] = "waterfall"
    title: str
    caption: str
    axis: Axis
    bars: tuple[Bar, ...]

    def share(self, value_m: float) -> float:
        """Return the position of a value along the axis, 0 to 1."""
        return value_m / self.axis.scale.factor / self.axis.high


@dataclass(frozen=True, kw_only=True)
class Card:
    """Summary of one axis.

    Args:
        title: name of the axis.
        tone: ``good``, ``middling`` or ``bad``.
        word: the grade as text.
        figures: the loop and the residual against time, if they are plotted.
        facts: names and values of the row next to the figures.
    """

    title: str
    tone: str
    word: str
    figures: tuple[Figure, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Overview:
    """Sentences of the summary with their labels and tone, and the axes side by side."""

    kind: ClassVar[str] = "overview"
    sentences: tuple[tuple[str, str], ...]
    tone: str
    cards: tuple[Card, ...]


@dataclass(frozen=True, kw_only=True)
class Fold:
    """Parts that are hidden until the reader opens them."""

    kind: ClassVar[str] = "fold"
    summary: str
    parts: tuple["Part", ...]


Part = Heading | Prose | Listing | Table | Figure | Waterfall | Overview | Fold
TONES = ("plain", "good", "middling", "bad")


def worst_tone(tones: Iterable[str]) -> str:
    """Return the worst of several tones."""
    return max(tones, key=TONES.index, default="plain")


@dataclass(frozen=True, kw_only=True)
class Section:
    """One section of the page.

    anchor  for links within the page; a fixed word, never a name from the data
    title   heading
    lead    one or two sentences about the content of the section
    """

    anchor: str
    title: str
    lead: str
    parts: tuple[Part, ...] = field(default=())

    @property
    def tone(self) -> str:
        """The worst tone of the parts, for the mark in the navigation."""
        return worst_tone(p.tone for p in self.parts if isinstance(p, Heading | Prose | Overview))

    @property
    def blocks(self) -> tuple[tuple[Part, ...], ...]:
        """The parts under each heading; the parts before the first heading are one block."""
        starts = [k for k, part in enumerate(self.parts) if isinstance(part, Heading)]
        cuts = sorted({0, *starts, len(self.parts)})
        return tuple(self.parts[a:b] for a, b in itertools.pairwise(cuts))

    @property
    def is_narrow(self) -> bool:
        """Whether blocks fit side by side: none contains more than one figure."""
        return all(
            sum(isinstance(part, Figure | Waterfall | Overview) for part in block) <= 1
            for block in self.blocks
        )

    @property
    def is_folded(self) -> bool:
        """Whether the section contains only folded parts; it is then not printed on paper."""
        return all(
            isinstance(part, Heading | Fold) or (isinstance(part, Table) and not part.is_open)
            for part in self.parts
        )


def side_by_side(columns: Sequence[Mapping[str, str]]) -> tuple[tuple[str, ...], ...]:
    """Return one row per name with its texts in all columns, without rows of empty texts."""
    names = dict.fromkeys(name for column in columns for name in column)
    rows = ((name, *(column.get(name, "") for column in columns)) for name in names)
    return tuple(row for row in rows if any(row[1:]))


def with_rows(*tables: Table) -> list[Table]:
    """Return the tables that have rows."""
    return [table for table in tables if table.rows]


def folded(summary: str, parts: Sequence[Part]) -> list[Part]:
    """Return parts in one fold, or nothing if there are none."""
    return [Fold(summary=summary, parts=tuple(parts))] if parts else []


def folded_listing(summary: str, items: Iterable[str]) -> list[Part]:
    """Return sentences in one fold, or nothing if there are none."""
    listing = Listing(items=tuple(items))
    return folded(summary, [listing] if listing.items else [])


def html(
    title: str,
    sections: Sequence[Section],
    *,
    alarm: tuple[str, str] | None = None,
    counted: Sequence[str] = (),
) -> str:
    """Return an HTML page.

    title     a name from the data, shown as text
    sections  in the order of the page
    alarm     warning above the sections and its explanation, or None
    counted   quantities recorded in counts; their metres or volts are shown as counts
    """

    def escaped(value: object) -> object:
        is_text = isinstance(value, str) and not hasattr(value, "__html__")
        return printable(in_counts(str(value), counted)) if is_text else value

    environment = Environment(
        loader=FunctionLoader(_template),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=escaped,
    )
    # The policy allows this style and script and no network.
    style, script = _template("style.css"), _template("figures.js")
    return environment.get_template("page.html.j2").render(
        title=title,
        alarm=alarm,
        sections=sections,
        style=Markup(style),
        script=Markup(script),
        policy=f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}'; "
        "base-uri 'none'; form-action 'none'",
        good_percent=GOOD_PERCENT,
        near_noise=NEAR_NOISE,
    )


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _template(name: str) -> str:
    return (files_of("piezoid_reports") / "templates" / name).read_text(encoding="utf-8")
