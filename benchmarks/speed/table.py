"""The table: one row for each stage, every figure a ratio of two times of the same run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from benchmarks.speed.stopwatch import Growth

SIZES = ("samples", "plays", "recordings")
HEADINGS = (
    "stage",
    "sample loop",
    "compiled loop",
    "general solver",
    "itself",
    "grows with samples, plays, recordings",
)


@dataclass(frozen=True, kw_only=True)
class Row:
    """What one stage was compared with.

    loop      how many times as long a loop over the samples takes in NumPy (of the closed loop:
              calls from Python)
    compiled  the same of loops in compiled languages, by their names
    solvers   the same of general solvers, by their names
    bounds    how many times as long as something that bounds it the stage itself takes
    """

    stage: str
    loop: float | None = None
    compiled: Mapping[str, float] = field(default_factory=dict)
    solvers: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, float] = field(default_factory=dict)


def short(value: float | None) -> str:
    """Return two digits of a number; nothing of none."""
    return "" if value is None else f"{float(f'{value:.2g}'):.10g}"


def table(rows: Sequence[Row], growths: Sequence[Growth]) -> str:
    """Return the table as Markdown; what only grew has a row as well."""
    compared = {row.stage for row in rows}
    others = dict.fromkeys(one.stage for one in growths if one.stage not in compared)
    rows = [*rows, *(Row(stage=stage) for stage in others)]
    lines = [HEADINGS, ["---"] * len(HEADINGS), *(_cells(row, growths) for row in rows)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _cells(row: Row, growths: Sequence[Growth]) -> list[str]:
    power = {one.what: f"{one.exponent:.1f}" for one in growths if one.stage == row.stage}
    return [
        row.stage,
        short(row.loop),
        _named(row.compiled),
        _named(row.solvers),
        ", ".join(f"{short(value)} {name}" for name, value in row.bounds.items()),
        ", ".join(power.get(what, "-") for what in SIZES) if power else "",
    ]


def _named(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {short(value)}" for name, value in values.items())
