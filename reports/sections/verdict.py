"""The first screen: what is good, what limits, what to do next, and a row for each axis."""

from math import log2

from piezoid.identification.model import AxisModel
from piezoid.verification.verification import Verification
from piezoid_reports.first_screen import facts, figures, left_out, tip_cards
from piezoid_reports.junction_words import judged, loop_judged
from piezoid_reports.page import Card, Cards, Page, Prose, Said, Section
from piezoid_reports.quantities import percent, told
from piezoid_reports.traces import Trace, rms
from piezoid_reports.weaknesses import Weakness, weaknesses_of
from piezoid_reports.what_is_left import named

GOOD, MIDDLING = 90, 50
DOUBLED = 5  # points, where the error is twice the noise and where it is four times
CONTRADICTION = 0.9  # times the noise: what no model can leave, but for chance
WORDS = {"good": "good", "middling": "usable with care", "bad": "poor"}
UNSCORED = ("middling", "no score")
REFUSED = ("bad", "does not apply")
OPEN = 50  # of the score: what caps it so low leaves open whether there is a loop, or what it is


def render(page: Page) -> Section:
    """Return what a reader must know if nothing else is read."""
    if not page.axes:
        return _of_junction(page)
    tones = [judgement_of(axis, score_of(axis, page.traces[axis.axis]))[0] for axis in page.axes]
    failed = page.verification is not None and not page.verification.passed
    if failed or page.unshipped:
        tones.append("bad")
    worst = "bad" if "bad" in tones else "middling" if "middling" in tones else "good"
    return Section(
        anchor="verdict",
        title="Verdict",
        lead="",
        parts=(
            Said(sentences=sentences(page), tone=worst),
            Cards(cards=(*(_card(page, axis) for axis in page.axes), *tip_cards(page))),
        ),
    )


def _of_junction(page: Page) -> Section:
    """Return the verdict on a stage of which only the tunnelling current was recorded."""
    tip = page.model.tunnelling
    known = [] if tip is None or tip.gap_law is None else [judged(tip.gap_law)]
    known += [] if tip is None or tip.loop_plant is None else [loop_judged(tip.loop_plant)]
    return Section(
        anchor="verdict",
        title="Verdict",
        lead="",
        parts=(
            *known,
            Prose(
                text="No axis with drive and displacement was recorded: nothing is said of "
                "hysteresis, and no lateral controller can be designed from this."
            ),
            Cards(cards=tip_cards(page)),
        ),
    )


def sentences(page: Page) -> tuple[tuple[str, str], ...]:
    """Return what each sentence answers, and the sentence: what holds, what limits, what next."""
    good = [axis for axis in page.axes if axis.verdict.applies]
    wrong = [axis for axis in page.axes if not axis.verdict.applies]
    applies = _applies(good, wrong).removesuffix(".") + _ships(page)
    worst_first = sorted(good, key=_held_out_percent, reverse=True)
    limits, then = _what_next(page, [*wrong, *worst_first])
    return (
        (_answer(good, wrong), applies),
        *_data([*wrong, *worst_first], applies),
        ("Limits", f"{_how_well(page, good, wrong)} {limits}"),
        ("Next", then),
    )


def _data(axes: list[AxisModel], said: str) -> tuple[tuple[str, str], ...]:
    """Return what is odd about the recordings and not said yet: nobody guesses it from a score."""
    odd = [limit.reason for axis in axes for limit in axis.quality.limits if limit.is_odd]
    left = [reason for reason in dict.fromkeys(odd) if reason not in said]
    return (("Data", f"{'; '.join(left)}."),) if left else ()


def _ships(page: Page) -> str:
    """End the first sentence with what became of the controllers, and which of them is missing."""
    missing = "".join(f"; axis {name} has no controller" for name in page.unshipped)
    return f"{_verified(page.verification)}{missing}."


def _verified(found: Verification | None) -> str:
    if found is None:
        return ""
    failed = [verdict for verdict in found.verdicts if not verdict.passed]
    if not failed and found.passed:
        return f", and the controller that ships passed all {len(found.verdicts)} verdicts"
    if not failed:
        return ", but a rebuild of the controller that ships did not give the same bits"
    return (
        f", but the controller that ships failed {len(failed)} of {len(found.verdicts)} verdicts, "
        f"{failed[0].name} ({failed[0].scenario}) first"
    )


def _applies(good: list[AxisModel], wrong: list[AxisModel]) -> str:
    if not wrong:
        return f"The hysteresis model applies to {_axes(good)}{_as_far_as(good)}."
    reasons = "; ".join(f"axis {axis.axis}: {axis.verdict.reason}" for axis in wrong)
    also = f", though it does to {_axes(good)}" if good else ""
    return f"The hysteresis model does not apply to {_axes(wrong)}{also} ({reasons})."


def _answer(good: list[AxisModel], wrong: list[AxisModel]) -> str:
    """Return the word in front: nothing is good of which a loop or its cause was not measured."""
    if wrong:
        return "Bad"
    open_ = any(limit.most <= OPEN for axis in good for limit in axis.quality.limits)
    return "Open" if open_ else "Good"


def _as_far_as(good: list[AxisModel]) -> str:
    """Say what was never measured on the axis of which least was, the gravest lack alone."""
    lacking = [axis for axis in good if axis.quality.limits]
    if not lacking:
        return ""
    worst = min(lacking, key=lambda axis: axis.quality.limits[0].most)
    limit = worst.quality.limits[0]
    whose = f" of axis {worst.axis}" if len(good) > 1 else ""
    return f" as far as can be told{whose}, for {limit.reason} (a score of at most {limit.most})"


def _how_well(page: Page, good: list[AxisModel], wrong: list[AxisModel]) -> str:
    if not good:
        share = max(axis.quality.held_out_rms_percent for axis in wrong)
        return (
            f"Do not build a controller on it: the numbers below, such as a held-out error of "
            f"{told(share, '%')} of the range, only show where it fails."
        )
    worst = max(good, key=_held_out_percent)
    quality = worst.quality
    alone = len(good) + len(wrong) == 1
    seen = "it was not fitted to" if quality.is_tested else "it was fitted to"
    whose = "" if alone else f" of axis {worst.axis}{_least_known(good)}"
    return (
        f"On data {seen}, the model misses the measured displacement{whose} by "
        f"{told(quality.held_out_rms_m, 'm')} rms, "
        f"{told(quality.held_out_rms_percent, '%')} of "
        f"the {told(quality.range_m, 'm')} range, where the sensor's own noise is "
        f"{quality.noise_bound}{told(quality.noise_rms_m, 'm')} rms{_not_counted(page, good)}."
    )


def _not_counted(page: Page, axes: list[AxisModel]) -> str:
    """Say what the fit left out of the axis of which it left out most."""
    counted = [(*left_out(page.traces.get(axis.axis, ())), axis) for axis in axes]
    missing, total, axis = max(counted, key=lambda one: one[0] / max(one[1], 1))
    if not missing:
        return ""
    whose = f" of axis {axis.axis}" if len(axes) > 1 else ""
    return f"; the fit left out {missing} of {total} samples{whose} ({percent(missing / total)})"


def _what_next(page: Page, axes: list[AxisModel]) -> tuple[str, str]:
    """Return the gravest weakness and what to do about it, a sentence each."""
    for axis in axes:
        found = weaknesses_of(axis, page.diagnosis_of(axis))
        if found:
            whose = f"axis {axis.axis}" if len(axes) > 1 else "it"
            first, _, _ = found[0].remedy.partition(". ")
            return (
                f"What weakens {whose} most is {found[0].what}.",
                f"{first.rstrip('.')}.",
            )
    return "Nothing in this data speaks against it.", "Use it within its range."


def _card(page: Page, axis: AxisModel) -> Card:
    traces = page.traces[axis.axis]
    score = score_of(axis, traces)
    tone, word = judgement_of(axis, score)
    found = weaknesses_of(axis, page.diagnosis_of(axis))
    first = (
        found[0] if found else Weakness(what="", why="No weakness was found.", remedy="Use it.")
    )
    return Card(
        title=f"Axis {axis.axis}",
        score=score,
        tone=tone,
        word=word,
        why=f"{_against_line(axis, traces)}{first.why}{_also_found(page, axis, first)}",
        remedy=first.remedy,
        figures=figures(page, axis),
        facts=facts(page, axis),
    )


def _held_out_percent(axis: AxisModel) -> float:
    return axis.quality.held_out_rms_percent


def _least_known(good: list[AxisModel]) -> str:
    return ", its worst," if len(good) > 1 else ""


def _against_line(axis: AxisModel, traces: tuple[Trace, ...]) -> str:
    """Say what the model is better than, unless it must not be used."""
    if not traces or not axis.verdict.applies:
        return ""
    held = axis.quality
    return (
        f"A straight line leaves {told(line_rms_m(traces), 'm')} rms, the model "
        f"{told(held.held_out_rms_m, 'm')} on {held.held_out_words}, "
        f"{percent(held.held_out_rms_m / held.range_m)} of the range; the sensor's noise is "
        f"{held.noise_bound}{told(held.noise_rms_m, 'm')} rms. "
    )


def _also_found(page: Page, axis: AxisModel, first: Weakness) -> str:
    """Name the causes of a diagnosis where the gravest weakness is another matter."""
    found = page.diagnosis_of(axis)
    if found is None or not found.findings or named(found) in first.why:
        return ""
    return f" The diagnosis finds {named(found)}, and took it out."


def _axes(axes: list[AxisModel]) -> str:
    names = [axis.axis for axis in axes]
    if len(names) == 1:
        return f"axis {names[0]}"
    return f"axes {', '.join(names[:-1])} and {names[-1]}"


def score_of(axis: AxisModel, traces: tuple[Trace, ...]) -> int | None:
    """Return the score, 0 to 100; None where the class does not apply or nothing can be scored.

        100 (line - held out) / (line - noise),   all rms

    100: only the sensor's noise is left; 0: no better than a straight line. Three things cap it.
    An error of twice the noise is 95 at most, of four times or more 90: beside a wide loop it may
    be 1 % of the line and yet all that readings show. What was never measured has its own limit.
    And no error below what is called noise is perfect, for one of the two is wrong. Where the
    noise is not known but only no more than what the model leaves, none is taken off.
    """
    if not axis.verdict.applies or not traces:
        return None
    line_m = line_rms_m(traces)
    noise_m = 0.0 if axis.quality.noise_is_most else axis.quality.noise_rms_m
    if line_m <= noise_m:
        return None
    held_m = axis.quality.held_out_rms_m
    share = (line_m - held_m) / (line_m - noise_m)
    most = min((limit.most for limit in axis.quality.limits), default=100)
    if held_m < CONTRADICTION * noise_m:
        most = min(most, GOOD - 1)
    elif held_m > noise_m > 0.0:
        most = min(most, max(round(100 - DOUBLED * log2(held_m / noise_m)), GOOD))
    return min(round(100 * min(max(share, 0.0), 1.0)), most)


def line_rms_m(traces: tuple[Trace, ...]) -> float:
    """Return what the best straight line leaves on the samples the fit used, m rms."""
    squares = sum(rms(t.line_residual_m) ** 2 * t.counted for t in traces)
    return float((squares / sum(t.counted for t in traces)) ** 0.5)


def judgement_of(axis: AxisModel, score: int | None) -> tuple[str, str]:
    """Return ``good``, ``middling`` or ``bad``, and the word a reader sees."""
    if not axis.verdict.applies:
        return REFUSED
    if score is None:
        return UNSCORED
    tone = "bad" if score < MIDDLING else "middling" if score < GOOD else "good"
    return tone, WORDS[tone]
