"""What the simulation gets wrong: each cause seen, faked, sized, and what it means for control."""

from statistics import median

from piezoid.diagnosis.diagnosis import Diagnosis, Finding
from piezoid_reports.compared import Compared, compared
from piezoid_reports.effect_figures import figure_of
from piezoid_reports.effect_words import CONTROL, words
from piezoid_reports.page import Heading, Listing, Page, Part, Prose, Section, Table
from piezoid_reports.quantities import percent, significant, told

NO_PICTURES = (
    "Pictures of the causes need a model fitted to these recordings: piezoid fit draws them."
)


def render(page: Page) -> Section | None:
    """Return a figure for each finding, and a table of everything that was tested."""
    found = page.diagnosis
    if found is None:
        return None
    return Section(
        anchor="diagnosis",
        title="What the simulation gets wrong, and why",
        lead="The difference between a plain simulation with hysteresis and the recordings, cause "
        "by cause; what could not be found, and how small it would have to be.",
        parts=diagnosis_parts(found, page),
    )


def diagnosis_parts(found: Diagnosis, page: Page) -> tuple[Part, ...]:
    """Return the chapter's parts."""
    axis = page.model.axes.get(found.axis)
    traces = page.traces.get(found.axis, ())
    pictures = {} if axis is None else compared(axis, traces, found)
    parts: list[Part] = [Heading(text=f"Axis {found.axis}"), _summary(found)]
    if found.findings:
        parts.append(_gains(found))
    if found.findings and not pictures:
        parts.append(Prose(text=NO_PICTURES))
    for finding in found.findings:
        parts += _chapter(finding, pictures.get(finding.effect, ()))
    parts += _open_questions(found)
    if found.not_detected:
        parts.append(_absent(found))
    parts.append(Prose(text=last_sentence(found), tone="good" if found.findings else "plain"))
    return tuple(parts)


def last_sentence(found: Diagnosis) -> str:
    """Return what is explained, and how small anything else must be."""
    limits = [
        (absent.detection_limit_m, absent.effect)
        for absent in found.not_detected
        if absent.detection_limit_m is not None
    ]
    explained = (
        f"Of the explainable error, {percent(found.explained_fraction)} is explained; "
        f"the sensor's noise floor is {told(found.noise_floor_rms_m, 'm')} rms."
    )
    if not limits:
        return explained
    largest_m, effect = max(limits)
    middle_m = median(limit_m for limit_m, _ in limits)
    untested = len(found.not_detected) - len(limits)
    beyond = "" if not untested else f" {untested} more could not be tested with these recordings."
    return (
        f"{explained[:-1]}; nothing else that was tested is visible above "
        f"{told(largest_m, 'm')} rms ({words(effect)} hides best; half of it would show from "
        f"{told(middle_m, 'm')}).{beyond}"
    )


def _summary(found: Diagnosis) -> Prose:
    before, after = found.baseline, found.final
    change = (
        f"On rows left out, the plain simulation is wrong by {told(before.rms_m, 'm')} rms "
        f"({percent(before.rms_percent / 100.0)} of the stroke)"
    )
    if not found.findings:
        return Prose(text=f"{change}. No cause that was looked for is visible in it.")
    names = ", ".join(words(finding.effect) for finding in found.findings)
    return Prose(
        text=f"{change}; with {names} it is {told(after.rms_m, 'm')} "
        f"({percent(after.rms_percent / 100.0)}).",
        tone="good" if after.rms_m < before.rms_m else "middling",
    )


def _size(finding: Finding) -> str:
    size = finding.size
    low, high = size.ci95
    return (
        f"{significant(size.value)} {size.unit} (95 %: {significant(low)} to {significant(high)})"
    )


def _gains(found: Diagnosis) -> Table:
    return Table(
        caption="What was found, largest gain first. Gain: the part of the error on rows left out "
        "that goes with this effect alone in or out of the model, refitted both times. p: chance "
        "of such evidence without the effect, times the number of effects tried.",
        columns=("effect", "gain", "without it", "with it", "size", "p"),
        rows=tuple(
            (
                words(f.effect),
                percent(f.held_out_gain),
                told(f.held_out_rms_before_m, "m"),
                told(f.held_out_rms_after_m, "m"),
                _size(f),
                significant(f.p_value, 2),
            )
            for f in found.findings
        ),
    )


def _chapter(finding: Finding, pictures: tuple[Compared, ...]) -> list[Part]:
    parts: list[Part] = [
        Heading(text=words(finding.effect).capitalize()),
        Prose(text=finding.explanation),
    ]
    figure = figure_of(finding, pictures)
    if figure is not None:
        parts.append(figure)
    parts.append(
        Listing(
            items=(
                f"Size: {_size(finding)}.",
                f"Gain: {percent(finding.held_out_gain)} of the error on rows left out, from "
                f"{told(finding.held_out_rms_before_m, 'm')} to "
                f"{told(finding.held_out_rms_after_m, 'm')} rms.",
                f"For control: {CONTROL[finding.effect]}",
            )
        )
    )
    return parts


def _open_questions(found: Diagnosis) -> list[Part]:
    doubtful = [f for f in found.findings if f.not_separable_from]
    if not doubtful:
        return []
    return [
        Heading(text="What these recordings cannot tell apart"),
        Listing(
            items=tuple(
                f"{words(f.effect).capitalize()}, or "
                f"{' or '.join(words(name) for name in f.not_separable_from)}. "
                f"{f.next_experiment} (piezoid plan chooses a drive for it and writes it.)"
                for f in doubtful
            )
        ),
    ]


def _absent(found: Diagnosis) -> Table:
    return Table(
        caption="What was looked for and not found. Bound: the most it could be (rms, 95 %). "
        "Limit: from this size on it would have been found in four of five cases.",
        columns=("effect", "at most", "would show from", "why not"),
        rows=tuple(
            (
                words(absent.effect),
                _length(absent.upper_bound_m),
                _length(absent.detection_limit_m),
                absent.reason,
            )
            for absent in found.not_detected
        ),
    )


def _length(value_m: float | None) -> str:
    return "not testable" if value_m is None else told(value_m, "m")
