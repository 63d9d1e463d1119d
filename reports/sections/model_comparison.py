"""Comparison of an earlier model with the new recordings: does it still hold."""

from piezoid.diagnosis.compare import ModelComparison
from piezoid_reports.page import Page
from piezoid_reports.parts import Prose, Section, Table
from piezoid_reports.quantities import number, percent, significant


def render(page: Page) -> Section | None:
    """Return the section, where an earlier model was named."""
    comparison = page.comparison
    if comparison is None:
        return None
    return Section(
        anchor="model-comparison",
        title="Comparison with the earlier model",
        lead="Errors of the earlier model on the new recordings, on held-out blocks.",
        parts=(
            Prose(text=comparison.statement.text, tone="good" if comparison.holds else "middling"),
            Table(
                caption="The earlier model, unchanged and refitted.",
                columns=("model", "error, rms", "of the motion"),
                rows=_rows(comparison),
            ),
        ),
    )


def _rows(comparison: ModelComparison) -> tuple[tuple[str, ...], ...]:
    ratio, low, high = comparison.gain_ratio
    rescaled = f"new sensitivity: {significant(ratio, 4)} ({significant(low, 4)} to "
    errors = {
        "unchanged": comparison.unchanged_error_m,
        f"{rescaled}{significant(high, 4)}) times the old": comparison.rescaled_error_m,
        "refitted": comparison.refitted_error_m,
    }
    rows = [
        (name, number(error_m, "m"), percent(error_m / comparison.motion_m))
        for name, error_m in errors.items()
    ]
    return (("at the fit", number(comparison.fitted_error_m, "m"), ""), *rows)
