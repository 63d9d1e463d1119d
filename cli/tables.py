"""Records on the terminal: tables, error budgets and statements."""

from textwrap import fill
from typing import TYPE_CHECKING

from piezoid_cli.terminal import VERBOSE, display, rich_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import JustifyMethod, RenderableType
    from rich.table import Table

    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.statement import Level, Statement
    from piezoid_reports.parts import Table as ReportTable

NARROW, MINUS = "\u202f", "\u2212"  # typography of the report
MAX_SHOWN = 5  # statements
MIN_WORDS = 11  # characters of a first column with names of several words
INDENT = "  "


def table(
    title: str,
    headings: "Sequence[str]",
    rows: "Iterable[Sequence[RenderableType]]",
    n_words: int = 0,
) -> "Table":
    """Return a table with cells that are shown as text.

    n_words  number of leading columns with words; the others are right-aligned numbers
    """
    from rich.table import Table

    cells, rows = Table(title=rich_text(title)), list(rows)
    has_names = any(len(str(row[0])) > 2 * MIN_WORDS for row in rows)
    for k, heading in enumerate(headings):
        justify: JustifyMethod = "left" if k < n_words else "right"
        # No cell is cut off, and words of the first column stay whole.
        width = MIN_WORDS if k == 0 and has_names else None
        cells.add_column(heading, justify=justify, overflow="fold", min_width=width)
    for row in rows:
        cells.add_row(*(rich_text(cell) if isinstance(cell, str) else cell for cell in row))
    return cells


def report_table(part: "ReportTable", title: str = "") -> "Table":
    """Return a table of the report for a console; default title: that of the report."""
    plain = str.maketrans({NARROW: " ", MINUS: "-"})
    rows = ([cell.translate(plain) for cell in row] for row in part.rows)
    return table(title or part.summary, part.columns, rows, n_words=len(part.columns))


def show_statements(statements: "Iterable[Statement]", minimum: "Level | None" = None) -> None:
    """Print at most five statements at or above a level (default: action), or all with -v."""
    from rich.console import Console

    from piezoid.statement import Level, select

    is_verbose = VERBOSE.get()
    lowest = Level.NOTE if is_verbose else Level.ACTION if minimum is None else minimum
    selected = select(statements, minimum=lowest)
    listed = selected if is_verbose else selected[:MAX_SHOWN]
    width = Console().width
    if listed and lowest is Level.ACTION:
        display("needs action:")
    for statement in listed:
        axis = f"axis {statement.axis}: " if statement.axis else ""
        style = {Level.ACTION: "bold", Level.NOTE: "dim"}.get(statement.level, "")
        text = f"{axis}{statement.text}"
        display(fill(text, width, initial_indent=INDENT, subsequent_indent=INDENT), style)
    if len(selected) > len(listed):
        display(f"  {len(selected) - len(listed)} more in the report and with --verbose")


def budget_lines(diagnoses: "Sequence[Diagnosis]") -> list[str]:
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
        is_tested = diagnosis.model is None or diagnosis.model.quality.is_tested
        sample = "" if is_tested else " in sample"
        line = f"error budget {diagnosis.axis}: {name} {total}{sample}, from {terms}"
        if diagnosis.final.rms_m > diagnosis.baseline.rms_m:
            final = with_unit(diagnosis.final.rms_m, "m")
            line += f"; the final model has a larger error, {final}"
        lines.append(in_counts(line, diagnosis.counted))
    if any("*" in line for line in lines):
        lines.append(
            "(budget: rms on held-out data unless in sample; squares add up; base model: "
            "hysteresis alone; the final model removes the parts with *, the others make up its "
            "error)"
        )
    return lines
