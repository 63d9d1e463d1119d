"""Error budgets and statements on the terminal."""

from collections.abc import Iterable, Sequence
from textwrap import fill
from typing import TYPE_CHECKING

from piezoid_cli.progress import VERBOSE
from piezoid_cli.terminal import rich_text

if TYPE_CHECKING:
    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.statement import Level, Statement

MAX_SHOWN = 5
INDENT = "  "


def show_statements(statements: "Iterable[Statement]", minimum: "Level | None" = None) -> None:
    """Print at most five statements at or above a level (default: action), or all with -v."""
    from rich.console import Console

    from piezoid.statement import Level, select

    is_verbose = VERBOSE.get()
    lowest = Level.NOTE if is_verbose else Level.ACTION if minimum is None else minimum
    selected = select(statements, minimum=lowest)
    listed = selected if is_verbose else selected[:MAX_SHOWN]
    console = Console()
    if listed and lowest is Level.ACTION:
        console.print(rich_text("needs action:"))
    for statement in listed:
        axis = f"axis {statement.axis}: " if statement.axis else ""
        style = {Level.ACTION: "bold", Level.NOTE: "dim"}.get(statement.level, "")
        text = fill(
            f"{axis}{statement.text}",
            width=console.width,
            initial_indent=INDENT,
            subsequent_indent=INDENT,
        )
        console.print(rich_text(text, style=style))
    if len(selected) > len(listed):
        omitted = len(selected) - len(listed)
        console.print(rich_text(f"  {omitted} more in the report and with --verbose"))


def budget_lines(diagnoses: "Sequence[Diagnosis]", legend: str = "") -> list[str]:
    """Return the error budget of each diagnosed axis as a line, followed by a legend."""
    from piezoid.formatting import with_unit
    from piezoid.raw_counts import in_counts
    from piezoid_reports.sections.error_budget import label_of, visible_parts

    lines = []
    for diagnosis in diagnoses:
        terms = ", ".join(
            f"{label_of(part.part)} {with_unit(part.rms_m, 'm')}{'*' if part.is_explained else ''}"
            for part in visible_parts(diagnosis)
        )
        total = with_unit(diagnosis.baseline.rms_m, "m")
        name = "simulation" if diagnosis.model is None else "base model"
        line = f"error budget {diagnosis.axis}: {name} {total}; of this {terms}"
        lines.append(in_counts(line, diagnosis.counted))
    if any("*" in line for line in lines):
        lines.append(
            "(rms, squares add up; * removed by the final model, the others are its held-out error"
            f"{legend})"
        )
    return lines
