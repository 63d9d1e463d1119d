"""Comparison of an earlier model with new recordings."""

from piezoid_reports.page import Page
from piezoid_reports.parts import Prose, Section, Table
from piezoid_reports.quantities import number, percent, significant


def render(page: Page) -> Section | None:
    """Return the errors of the earlier model, if one was named."""
    comparison = page.comparison
    if comparison is None:
        return None
    ratio, low, high = (significant(value, 4) for value in comparison.gain_ratio)
    errors = {
        "unchanged": comparison.unchanged_error_m,
        f"new sensitivity: {ratio} ({low} to {high}) times the old": comparison.rescaled_error_m,
        "refitted": comparison.refitted_error_m,
    }
    rows = [
        (name, number(error_m, "m"), percent(error_m / comparison.motion_m))
        for name, error_m in errors.items()
    ]
    fitted = [("at the fit", number(comparison.fitted_error_m, "m"), "")]
    if comparison.shaped_error_m is not None:
        fitted.append(("at the fit, with loop shape", number(comparison.shaped_error_m, "m"), ""))
    return Section(
        anchor="model-comparison",
        title="Comparison with the earlier model",
        lead="Held-out errors of the earlier model on the new recordings.",
        parts=(
            Prose(text=comparison.statement.text, tone="good" if comparison.holds else "middling"),
            Table(
                caption="The earlier model, unchanged and refitted.",
                columns=("model", "error, rms", "of the motion"),
                rows=(*fitted, *rows),
            ),
        ),
    )
