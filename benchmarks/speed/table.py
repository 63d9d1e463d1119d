"""Table of relative times: one row for each stage."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from benchmarks.speed.stopwatch import Growth

SIZES = ("samples", "plays")
HEADINGS = (
    "stage",
    "sample loop",
    "compiled loop",
    "general solver",
    "itself",
    "grows with samples, plays",
)


@dataclass(frozen=True, kw_only=True)
class Row:
    """Relative times of one stage.

    loop      time of a NumPy loop over the samples (closed loop: calls from Python) over that of
              the stage
    compiled  times of loops compiled by numba over that of the stage, by name
    solvers   times of general solvers over that of the stage, by name
    bounds    time of the stage over that of an operation that limits it, by name
    """

    stage: str
    loop: float | None = None
    compiled: Mapping[str, float] = field(default_factory=dict)
    solvers: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, float] = field(default_factory=dict)


def short(value: float | None) -> str:
    """Format a number with two digits; return an empty text for None."""
    return "" if value is None else f"{float(f'{value:.2g}'):.10g}"


def table(rows: Sequence[Row], growths: Sequence[Growth]) -> str:
    """Return the table as Markdown."""
    lines = [HEADINGS, ["---"] * len(HEADINGS), *(_cells(row, growths) for row in rows)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _cells(row: Row, growths: Sequence[Growth]) -> list[str]:
    exponents = {g.quantity: f"{g.exponent:.1f}" for g in growths if g.stage == row.stage}
    return [
        row.stage,
        short(row.loop),
        *(
            ", ".join(f"{name} {short(value)}" for name, value in values.items())
            for values in (row.compiled, row.solvers)
        ),
        ", ".join(f"{short(value)} {name}" for name, value in row.bounds.items()),
        ", ".join(exponents.get(quantity, "-") for quantity in SIZES) if exponents else "",
    ]
