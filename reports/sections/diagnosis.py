"""What the simulation gets wrong: each cause seen, faked, sized, and what it means for control."""

from piezoid.diagnosis.diagnosis import Diagnosis, Finding
from piezoid.diagnosis.effects import effect_named
from piezoid.diagnosis.something_else import CONTROL, NAME
from piezoid.readable import words
from piezoid_reports.compared import Compared, compared
from piezoid_reports.effect_figures import figure_of, unnamed_figure
from piezoid_reports.not_found import last_sentences, tables
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
    own = unnamed_figure(finding)
    figure = figure_of(finding, pictures) if own is None else own
    if figure is not None:
        parts.append(figure)
    elif pictures:
        parts.append(Prose(text=NO_PICTURE))
    control = CONTROL if finding.effect == NAME else effect_named(finding.effect).control
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
