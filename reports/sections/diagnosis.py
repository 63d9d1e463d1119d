"""What the simulation gets wrong: each cause seen, faked, sized, and what it means for control."""

from statistics import median

from piezoid.diagnosis.diagnosis import Diagnosis, Finding, NotDetected
from piezoid.diagnosis.effects import effect_named
from piezoid.diagnosis.something_else import CONTROL, NAME
from piezoid.formatting import words
from piezoid_reports.compared import Compared, compared
from piezoid_reports.effect_figures import figure_of, unnamed_figure
from piezoid_reports.page import Fold, Heading, Page, Part, Prose, Section, Table
from piezoid_reports.quantities import percent, significant, size_of, told
from piezoid_reports.what_is_left import largest_first, nothing_named

LEAST_GAIN = 1e-3  # of the held-out error: below, refitting alone moves it as much

NO_PICTURES = (
    "Pictures of the causes need a model fitted to these recordings: piezoid fit draws them."
)

NO_PICTURE = (
    "No picture: in the samples that the model is fitted to, its residual is the same without it."
)


def render(page: Page) -> Section | None:
    """Return a figure for each finding of every axis, and tables of all that was tested."""
    if not page.diagnoses and not page.undiagnosed:
        return None
    parts: list[Part] = [Prose(text=said, tone="middling") for said in page.undiagnosed]
    for found in page.diagnoses:
        parts += diagnosis_parts(found, page)
    return Section(
        anchor="diagnosis",
        title="What the simulation gets wrong, and why",
        lead="The difference between a plain simulation with hysteresis and the recordings, cause "
        "by cause; what could not be found, and how small it would have to be.",
        parts=tuple(parts),
    )


def diagnosis_parts(found: Diagnosis, page: Page) -> tuple[Part, ...]:
    """Return the chapter's parts of one axis."""
    axis = page.model.axes.get(found.axis)
    traces = page.traces.get(found.axis, ())
    pictures = {} if axis is None else compared(axis, traces, found)
    parts: list[Part] = [Heading(text=f"Axis {found.axis}"), *_first(found), _summary(found)]
    if found.findings:
        parts.append(_gains(found))
    if found.findings and not pictures:
        parts.append(Prose(text=NO_PICTURES))
    if pictures and page.note:
        parts.append(Prose(text=page.note))
    for finding in largest_first(found):
        parts += _chapter(found.axis, finding, pictures.get(finding.effect, ()))
    parts += _open_questions(found)
    parts += tables(found)
    parts.append(Prose(text=last_sentences(found), tone="good" if found.findings else "plain"))
    return tuple(parts)


def _first(found: Diagnosis) -> list[Part]:
    """Say first what has no name, where it is larger than every cause that has one."""
    leading = largest_first(found)[:1]
    return [Prose(text=one.explanation, tone="middling") for one in leading if one.effect == NAME]


def _summary(found: Diagnosis) -> Prose:
    before, after = found.baseline, found.final
    change = (
        f"On rows left out, the plain simulation is wrong by {told(before.rms_m, 'm')} rms "
        f"({percent(before.rms_percent / 100.0)} of the stroke)"
    )
    if not found.findings:
        return Prose(text=f"{change}. {nothing_named(found)}")
    names = ", ".join(words(finding.effect) for finding in found.findings)
    return Prose(
        text=f"{change}; with {names} it is {told(after.rms_m, 'm')} "
        f"({percent(after.rms_percent / 100.0)}).{_in_it_already(found)}",
        tone="good" if after.rms_m < before.rms_m else "middling",
    )


def _in_it_already(found: Diagnosis) -> str:
    """Name what even the plain simulation has, so that its gain is no part of the change."""
    held = [f for f in found.findings if f.held_out_rms_before_m > 1.001 * found.baseline.rms_m]
    if not held:
        return ""
    said = ", ".join(
        f"{words(f.effect)} (without it: {told(f.held_out_rms_before_m, 'm')})" for f in held
    )
    return f" Part of the plain simulation already: {said}."


def _gain(finding: Finding) -> str:
    """Return what a finding takes off the error, or why it is named where it takes off nothing."""
    if finding.held_out_gain >= LEAST_GAIN:
        return percent(finding.held_out_gain)
    return f"under {percent(LEAST_GAIN)}: seen in the data, remedied by a new measurement alone"


def _gains(found: Diagnosis) -> Table:
    return Table(
        caption="What was found, largest gain first. Gain: the part of the error on rows left out "
        "that goes with this effect alone in or out of the model, refitted both times. p: the "
        "probability that a healthy stage shows as much, by its rank among healthy stages of "
        "many laws of hysteresis: whether it is there. The interval is of its size: how large "
        "it is.",
        columns=("effect", "gain", "without it", "with it", "size", "p"),
        wordy=(1, 4),
        rows=tuple(
            (
                words(f.effect),
                _gain(f),
                told(f.held_out_rms_before_m, "m"),
                told(f.held_out_rms_after_m, "m"),
                size_of(f),
                significant(f.p_value, 2),
            )
            for f in found.findings
        ),
    )


def _chapter(axis: str, finding: Finding, pictures: tuple[Compared, ...]) -> list[Part]:
    parts: list[Part] = [
        Heading(text=f"Axis {axis}: {words(finding.effect)}"),
        Prose(text=finding.explanation),
    ]
    unnamed = finding.effect == NAME
    figure = unnamed_figure(finding) if unnamed else figure_of(finding, pictures)
    if figure is not None:
        parts.append(figure)
    elif pictures:
        parts.append(Prose(text=NO_PICTURE))
    control = CONTROL if unnamed else effect_named(finding.effect).control
    parts.append(Prose(text=f"For control: {control}"))
    return parts


def _open_questions(found: Diagnosis) -> list[Part]:
    doubtful = [f for f in found.findings if f.not_separable_from]
    if not doubtful:
        return []
    return [
        Heading(text=f"Axis {found.axis}: what these recordings cannot tell apart"),
        *(
            Fold(
                summary=f"{words(f.effect).capitalize()}, or "
                f"{' or '.join(words(name) for name in f.not_separable_from)}",
                parts=(
                    Prose(
                        text=f"{f.next_experiment} (piezoid plan chooses a drive for it and "
                        "writes it.)"
                    ),
                ),
            )
            for f in doubtful
        ),
    ]


def tables(found: Diagnosis) -> tuple[Part, ...]:
    """Return causes and faults of the data that were not found, the least known first."""
    causes, faults = _causes(found), _faults(found)
    noise_m = found.noise_floor_rms_m
    parts: list[Part] = []
    if causes:
        parts.append(
            Table(
                caption="What was looked for and not found, what hides best first. At most: what "
                "it could be (rms, 95 %). Would show from: the size found in four of five cases. "
                f"Beside the noise: the larger of both, in parts of {told(noise_m, 'm')} rms."
                f"{_placebos(causes)}",
                columns=("effect", "at most", "would show from", "beside the noise", "evidence"),
                rows=tuple(_row(one, noise_m) for one in causes),
                wordy=(4,),
            )
        )
    if faults:
        parts.append(
            Table(
                caption="Faults of the data that were looked for and not found: heights of single "
                "spikes and steps.",
                columns=("fault", "would show from", "found"),
                rows=tuple(
                    (words(one.effect), _length(one.detection_limit_m), _sign(one))
                    for one in faults
                ),
            )
        )
    return tuple(parts)


def last_sentences(found: Diagnosis) -> str:
    """Return what is explained, and how small anything else must be."""
    floor = f"he sensor's noise floor is {told(found.noise_floor_rms_m, 'm')} rms"
    explained = f"T{floor}"
    if found.findings:
        part = percent(found.explained_fraction)
        explained = f"Of the explainable error, {part} is explained; t{floor}"
    causes = _causes(found)
    known = [one for one in causes if one.detection_limit_m is not None]
    if not known:
        return f"{explained}."
    limits_m = [_hidden_m(one) for one in known]
    hidden = len(causes) - len(known)
    beyond = "" if not hidden else f" {hidden} more could not be tested with these recordings."
    return (
        f"{explained}; no other cause that was tested is larger than "
        f"{told(limits_m[0], 'm')} rms{_of_noise(limits_m[0], found.noise_floor_rms_m)} "
        f"({words(known[0].effect)} hides best; half of them would show from "
        f"{told(median(limits_m), 'm')}).{beyond}{_about_faults(found)}"
    )


def _about_faults(found: Diagnosis) -> str:
    tested = [one for one in _faults(found) if one.detection_limit_m is not None]
    if not tested:
        return ""
    said = ", ".join(
        f"{words(one.effect)} from {told(one.detection_limit_m or 0.0, 'm')}" for one in tested
    )
    return f" Of faults of the data, these would have shown: {said}."


def _causes(found: Diagnosis) -> list[NotDetected]:
    return _hidden_first([one for one in found.not_detected if not _is_fault(one)])


def _faults(found: Diagnosis) -> list[NotDetected]:
    return _hidden_first([one for one in found.not_detected if _is_fault(one)])


def _is_fault(one: NotDetected) -> bool:
    """Tell what is found in the samples themselves before anything is fitted.

    Such sizes are heights of spikes and steps, which no rms can be compared with.
    """
    return effect_named(one.effect).fault is not None


def _hidden_first(absent: list[NotDetected]) -> list[NotDetected]:
    """Order by what could be there unseen; what could not be tested comes last."""
    return sorted(absent, key=lambda one: -_hidden_m(one))


def _hidden_m(one: NotDetected) -> float:
    """Return the larger of bound and limit: below it nothing is known of an effect."""
    return max(one.detection_limit_m or 0.0, one.upper_bound_m or 0.0)


def _row(one: NotDetected, noise_m: float) -> tuple[str, ...]:
    tested = one.detection_limit_m is not None
    return (
        words(one.effect),
        _length(one.upper_bound_m),
        _length(one.detection_limit_m),
        _times(_hidden_m(one), noise_m) if tested else "",
        _besides(one),
    )


def _besides(one: NotDetected) -> str:
    """Return the reason without the size that stands beside it in the table already."""
    first, _, rest = one.reason.partition("; ")
    return rest if rest and first.startswith("at most ") else one.reason


def _sign(one: NotDetected) -> str:
    """Return what was found of a fault, without the size beside it."""
    return one.reason.partition("; ")[0]


def _placebos(causes: list[NotDetected]) -> str:
    if not any("its placebo" in one.reason for one in causes):
        return ""
    return (
        " A placebo has the same freedom and no physics (creep run backwards, hum between the "
        "grids): what it takes off, chance takes off."
    )


def _of_noise(size_m: float, noise_m: float) -> str:
    return f", {_times(size_m, noise_m)} the noise" if noise_m > 0.0 else ""


def _times(size_m: float, noise_m: float) -> str:
    return f"{significant(size_m / noise_m, 2)} times" if noise_m > 0.0 else ""


def _length(value_m: float | None) -> str:
    return "not testable" if value_m is None else told(value_m, "m")
