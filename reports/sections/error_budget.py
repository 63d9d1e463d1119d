"""Error budget: held-out error of the base model, split into its causes."""

from math import sqrt

from piezoid.diagnosis.diagnosis import BudgetPart, Diagnosis
from piezoid.formatting import words
from piezoid_reports.chart import axis_from_zero
from piezoid_reports.page import Page
from piezoid_reports.parts import Bar, Section, Waterfall
from piezoid_reports.quantities import number

NOISE = "noise"
LABELS = {NOISE: "sensor noise", "extrapolation": "excess on held-out data"}
OF_EVERY_FIT = ("lag", "loop_shape")  # parts that the model removes without a finding
NEGLIGIBLE = 1e-3  # of the power of the final error: no bar


def render(page: Page) -> Section | None:
    """Return a waterfall for each axis with an error budget."""
    waterfalls = []
    for diagnosis in page.diagnoses:
        if not diagnosis.budget:
            continue
        parts, total_m = visible_parts(diagnosis), diagnosis.baseline.rms_m
        total = number(total_m, "m")
        axis = page.model.axes.get(diagnosis.axis)
        at_most = "" if axis is None else axis.quality.noise_bound
        bars = [Bar(name="base model", start_m=0.0, end_m=total_m, value=total, role="total")]
        remaining_m2 = total_m**2
        for part in parts:
            end_m, is_noise = sqrt(remaining_m2), part.part == NOISE
            remaining_m2 = max(remaining_m2 - part.rms_m**2, 0.0)
            bars.append(
                Bar(
                    name=label_of(part.part),
                    start_m=0.0 if is_noise else sqrt(remaining_m2),
                    end_m=part.rms_m if is_noise else end_m,
                    value=f"{at_most if is_noise else ''}{number(part.rms_m, 'm')}",
                    role="noise" if is_noise else "modelled" if part.is_explained else "open",
                )
            )
        modelled = [label_of(part.part) for part in parts if part.is_explained]
        removed = f"{', '.join(modelled)} (red)" if modelled else "none"
        of_fit = fitted_parts(diagnosis)
        verb = "comes from the fit and is no finding"
        if len(of_fit) > 1:
            verb = "come from the fit and are no findings"
        belongs = f" {' and '.join(of_fit).capitalize()} {verb}." if of_fit else ""
        outside = [label_of(p.part) for p in diagnosis.budget if p.is_explained and p.rms_m == 0.0]
        note = f" Found, but not part of this error: {', '.join(outside)}." if outside else ""
        waterfalls.append(
            Waterfall(
                title=f"Axis {diagnosis.axis}: error budget",
                caption=f"Removed by the model: {removed}; held-out error of the model: "
                f"{number(diagnosis.final.rms_m, 'm')}.{belongs}{note}",
                axis=axis_from_zero("error, rms", total_m, "m"),
                bars=tuple(bars),
            )
        )
    if not waterfalls:
        return None
    return Section(
        anchor="error-budget",
        title="Error budget",
        lead="Held-out error of the base model (hysteresis without a lag or another effect), "
        "split into its causes. Each number is the rms of one part. Their squares add up, so the "
        "bars between the first and the last are shorter than their numbers. Excess on held-out "
        "data: error on left-out blocks beyond that of the fit. Unexplained: residual of the "
        "widest class of hysteresis beyond the noise.",
        parts=tuple(waterfalls),
    )


def visible_parts(diagnosis: Diagnosis) -> tuple[BudgetPart, ...]:
    """Return the parts of the error that are not negligible, the noise last."""
    threshold_m2 = NEGLIGIBLE * diagnosis.final.rms_m**2
    return tuple(p for p in diagnosis.budget if p.rms_m**2 > threshold_m2 or p.part == NOISE)


def fitted_parts(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return the parts that the model removes although they are no findings, in words."""
    return tuple(
        label_of(part.part)
        for part in visible_parts(diagnosis)
        if part.part in OF_EVERY_FIT and part.is_explained and part.part not in diagnosis.names
    )


def label_of(part: str) -> str:
    """Return the name of a part of the budget in words."""
    return LABELS.get(part, words(part))
