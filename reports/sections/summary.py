"""Summary: verdict, limits and next step, and a card for each axis."""

from dataclasses import replace

from piezoid.formatting import count_of, words
from piezoid.identification.fit_statements import (
    GOOD_PERCENT,
    GOOD_SCORE,
    NEAR_NOISE,
    Grade,
    grade_of,
)
from piezoid.identification.model import AxisModel
from piezoid.runtime.schema import METHOD_NAMES
from piezoid.statement import Level
from piezoid_reports.page import Page, SPIRAL_Hz, guarantee, moving_axes, tracking_error
from piezoid_reports.parts import Card, Figure, Overview, Section, worst_tone
from piezoid_reports.quantities import number, percent, significant, with_interval
from piezoid_reports.sections import loops, residuals, tunnelling

LOOP_SIZE, RESIDUAL_SIZE = (300, 122), (440, 122)  # pixels, side by side
TONES = {Grade.GOOD: "good", Grade.LIMITED: "middling", Grade.POOR: "bad", Grade.REJECTED: "bad"}


def render(page: Page) -> Section:
    """Return verdict, error, limits and next step, and a card for each axis."""
    cards = [_card(page, axis) for axis in page.axes]
    cards += _tip_card(page)
    tones = [card.tone for card in cards]
    if has_failed_controller(page):
        tones.append("bad")
    overview = Overview(sentences=sentences(page), tone=worst_tone(tones), cards=tuple(cards))
    return Section(anchor="summary", title="Summary", lead="", parts=(overview,))


def sentences(page: Page) -> tuple[tuple[str, str], ...]:
    """Return the sentences at the top with their labels."""
    labels = {Level.ACTION: "Next", Level.WARNING: "Limits"}
    # The quantities of the statements that lower the grade of an axis.
    lacks = {
        axis.axis: [limit.lack for limit in axis.quality.limits if limit.most < GOOD_SCORE]
        for axis in page.axes
    }
    word, accuracy = "Tip", []
    verdict = "No axis with drive and displacement was recorded, only a tunnelling junction"
    if page.model.coupled is not None:
        word, verdict = "Coupled", "The linear coupling of the axes was fitted, no hysteresis"
    if page.axes:
        fitted = [axis.axis for axis in page.axes if axis.verdict.applies]
        rejected = [axis.axis for axis in page.axes if not axis.verdict.applies]
        if rejected:
            verdict = f"The hysteresis model does not apply to {_names(rejected)}"
            verdict += f", but it does to {_names(fitted)}" if fitted else ""
        else:
            verdict = f"The hysteresis model applies to {_names(fitted)}"
        grade = max((grade_of(axis) for axis in page.axes), key=list(Grade).index)
        word = {Grade.REJECTED: "Rejected"}.get(grade, words(grade).capitalize())
        if has_failed_controller(page) and grade is not Grade.REJECTED:
            word, verdict = "Fails", f"{verdict} (model {grade})"
        worst = max(page.axes, key=lambda axis: axis.quality.held_out_rms_percent)
        quality = worst.quality
        kind = "Held-out error" if quality.is_tested else "Error on the data of the fit"
        where = f" on axis {worst.axis} (the worst axis)" if len(page.axes) > 1 else ""
        error = number(quality.held_out_rms_m, "m")
        share = number(quality.held_out_rms_percent, "%")
        text = f"{kind}: {error} rms{where}, {share} of the {number(quality.range_m, 'm')} range."
        accuracy.append(("Error", text))
    verification, result = page.verification, ""
    if verification is not None:
        checks = count_of(len(verification.verdicts), "check")
        n_failed = sum(not verdict.passed for verdict in verification.verdicts)
        if n_failed:
            result = f"; its controllers failed {n_failed} of {checks}, so that none ships"
        elif not verification.passed:
            result = "; the controllers compiled again did not give the same bits"
        else:
            axes = list(verification.methods)
            whose = f"the controllers of {_names(axes)}" if len(axes) > 1 else "its controllers"
            result = f"; {whose} passed all {checks}"
    missing = "".join(f"; axis {name} has no controller" for name in page.unshipped)
    return (
        (word, f"{verdict}{result}{missing}."),
        *accuracy,
        *(("Reason", text) for text in _large_errors(page)),
        *(
            (
                "Reason" if fact.quantity in lacks.get(fact.axis, ()) else labels[fact.level],
                page.text_of(fact),
            )
            for fact in reversed(page.headline)
        ),
    )


def _large_errors(page: Page) -> list[str]:
    """Return as sentences which axes are not good because of their error."""
    texts = []
    for axis in page.axes:
        grade, quality = grade_of(axis), axis.quality
        is_near_noise = quality.held_out_rms_m <= NEAR_NOISE * quality.noise_rms_m
        is_large = quality.held_out_rms_percent > GOOD_PERCENT and not is_near_noise
        if grade in (Grade.LIMITED, Grade.POOR) and is_large:
            texts.append(
                f"Axis {axis.axis} is {grade.value}: its error exceeds "
                f"{number(GOOD_PERCENT, '%')} of the range and {NEAR_NOISE:g} times the sensor "
                "noise."
            )
    return texts


def has_failed_controller(page: Page) -> bool:
    """Return whether a designed controller does not ship."""
    verification = page.verification
    return bool(page.unshipped) or (verification is not None and not verification.passed)


def _names(axes: list[str]) -> str:
    if len(axes) == 1:
        return f"axis {axes[0]}"
    return f"axes {', '.join(axes[:-1])} and {axes[-1]}"


def _card(page: Page, axis: AxisModel) -> Card:
    grade, traces = grade_of(axis), page.plotted_traces(axis)
    figures: tuple[Figure, ...] = ()
    if traces:
        # Loop and residual of the recording with the largest residual are linked in time.
        name = traces[0].recording.name
        link = f"axis-{list(page.model.axes).index(axis.axis)}"
        width, height = RESIDUAL_SIZE
        residual = residuals.over_time(traces[0], axis, width=width, height=height)
        span = float(traces[0].time_s[-1]) / residual.canvas.x.scale.factor
        loop = loops.without_line(page, axis, traces[0], size=LOOP_SIZE)
        figures = (
            replace(loop, link=link, short_title=f"{name}: loop"),
            replace(
                residual, is_small=True, link=link, span=span, short_title=f"{name}: residual"
            ),
        )
    quality, design = axis.quality, page.loop_of(axis.axis)
    noise_m, error_m = quality.noise_rms_m, quality.held_out_rms_m
    closure = f"{significant(error_m / noise_m, 2)} times noise" if noise_m else ""
    speed = [("Bandwidth", "none")]
    if design is not None:
        bandwidth, error = number(design.bandwidth_Hz, "Hz"), tracking_error(page, axis.axis)
        speed = [("Bandwidth of the feedback, at least", bandwidth)]
        if error:
            spiral_axes = moving_axes(page.verification)
            label = f"Simulated error on a {SPIRAL_Hz:g} Hz spiral, {spiral_axes}"
            speed.append((label, f"{error} rms"))
    return Card(
        title=f"Axis {axis.axis}",
        tone=TONES[grade],
        word=grade.value,
        figures=figures,
        facts=(
            (
                "Held-out error" if quality.is_tested else "Error in sample",
                f"{number(error_m, 'm')} rms, {percent(error_m / quality.range_m)}",
            ),
            (
                "Sensor noise; closure",
                f"{quality.noise_bound}{number(noise_m, 'm')} rms; {closure}",
            ),
            *speed,
            ("Guaranteed error", guarantee(page, axis, has_speeds=True)),
            ("Ships", ships(page, axis.axis)),
        ),
    )


def ships(page: Page, axis: str) -> str:
    """Return whether the controller of an axis ships, with its method or the reason."""
    if axis in page.unshipped:
        return "no: see limits"
    if page.loop_of(axis) is None:
        return "no: not designed"
    verification = page.verification
    if verification is None or axis not in verification.methods:
        return "no: not verified"
    method = METHOD_NAMES[verification.methods[axis]]
    return f"yes: {method}" if verification.passed else f"no: verification failed ({method})"


def _tip_card(page: Page) -> tuple[Card, ...]:
    junction = page.model.tunnelling
    law, plant = (None, None) if junction is None else (junction.gap_law, junction.loop_plant)
    estimate = law or plant
    if estimate is None:
        return ()
    tone, word = tunnelling.CONFIDENCE[estimate.confidence]
    loop = next(
        (design for design in page.axis_designs if design.recommended.method == "rst"), None
    )
    barriers = [
        (
            f"Barrier, {source}",
            with_interval(barrier.barrier_eV, barrier.barrier_interval_eV, "eV"),
        )
        for source, barrier in (("sweeps", law), ("closed loop", plant))
        if barrier is not None
    ]
    facts = (
        *barriers,
        ("Bandwidth", "none" if loop is None else number(loop.recommended.bandwidth_Hz, "Hz")),
        ("Ships", ships(page, "z" if loop is None else loop.axis)),
    )
    figures = tuple(
        replace(figure, is_small=True, short_title=figure.title.partition(",")[0])
        for figure in tunnelling.law_figures(page, sizes=(LOOP_SIZE, RESIDUAL_SIZE))
    )
    return (Card(title="Tip", tone=tone, word=word, figures=figures, facts=facts),)
