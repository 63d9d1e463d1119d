"""Detected effects with figures and advice, and limits of the effects not detected."""

import math
from collections.abc import Sequence
from itertools import chain

from piezoid.diagnosis.diagnosis import SOMETHING_ELSE, Diagnosis, Finding
from piezoid.diagnosis.diagnosis_statements import largest_first
from piezoid.diagnosis.effects import delay, effect_named, lag, resonance, thermal_drift
from piezoid.diagnosis.null_distribution import ALPHA
from piezoid.diagnosis.residual_coordinates import CONTROL_ADVICE
from piezoid.formatting import p_value, words
from piezoid.identification.dynamics.behind_hysteresis import excites_dynamics
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.fit_statements import ZERO_DRIFT
from piezoid.identification.model import AxisModel
from piezoid_reports.effect_figures import compare_effects, figure_of, unnamed_figure
from piezoid_reports.page import Page
from piezoid_reports.parts import Heading, Part, Prose, Section, Table, folded_listing, with_rows
from piezoid_reports.quantities import number, percent, size_of
from piezoid_reports.sections.error_budget import fitted_parts

MAX_BOUND = 0.1  # of the range: a larger bound of an effect is not useful
MIN_GAIN = 1e-3  # of the held-out error: refitting alone changes it by as much
NO_FIGURES = "No figures: they need a model of these recordings. Run piezoid fit."
NO_FIGURE = "No figure: the recordings in the model do not show the effect."
READING = (
    "Four numbers in nm describe an effect, and differ. Table: held-out error without and with "
    "it, refitted. Error budget: its part of a common sum. Figure: residual after its removal, "
    "without a new fit. Text: the part that no hysteresis can imitate, the evidence for it.",
    "Only the row of loop shape, which is added last, ends at the error of the final model. A "
    "mode that was identified from a chirp has the errors on this chirp.",
    "p is a rank among 52 simulated stages, 0.019 at least. Data faults, modes, loop shape and "
    "lines are compared with the scatter of the residual instead.",
    f"An effect with p above {ALPHA:g} is named only if the error of the final model is clearly "
    "larger without it. The initial state is exempt, because healthy stages contain no evidence "
    "of it. Loop shape is exempt, because the model contains it if it predicts left-out data "
    "better.",
)
OF_DYNAMICS = (resonance.EFFECT.name, delay.EFFECT.name, lag.EFFECT.name)


def render(page: Page) -> Section | None:
    """Return a figure and a paragraph for each finding, and tables of effects not detected."""
    if not page.diagnoses:
        return None
    parts: list[Part] = [findings_table(page.diagnoses)]
    if any(diagnosis.findings for diagnosis in page.diagnoses):
        parts += folded_listing("How to read this table", READING)
    described: dict[str, str] = {}  # by effect, the first axis that has it
    for diagnosis in page.diagnoses:
        axis = page.model.axes.get(diagnosis.axis)
        traces = page.traces.get(diagnosis.axis, ())
        simulations = {} if axis is None else compare_effects(axis, traces, diagnosis)
        if diagnosis.findings and not simulations:
            parts.append(Prose(text=NO_FIGURES))
        for finding in largest_first(diagnosis):
            effect, of_effect = finding.effect, simulations.get(finding.effect, ())
            parts.append(Heading(text=f"Axis {diagnosis.axis}: {words(effect)}"))
            is_unnamed = effect == SOMETHING_ELSE
            figure = unnamed_figure(finding) if is_unnamed else figure_of(finding, of_effect)
            if figure is not None:
                parts.append(figure)
            elif of_effect:
                parts.append(Prose(text=NO_FIGURE))
            earlier_axis = described.get(effect)
            if is_unnamed:  # the statements contain its explanation and experiment
                parts += [] if earlier_axis else [Prose(text=f"For control: {CONTROL_ADVICE}")]
            elif earlier_axis:
                parts.append(Prose(text=f"Described under axis {earlier_axis}."))
            else:
                control = f"For control: {effect_named(effect).control}"
                values = controller_values(page, axis, finding)
                texts = (finding.explanation, *doubts(finding), *values, control)
                parts.append(Prose(text=" ".join(texts)))
                if not any(finding.next_experiment in fact.text for fact in page.statements):
                    parts.append(Prose(text=f"To confirm, optional: {finding.next_experiment}"))
        described = {**{f.effect: diagnosis.axis for f in diagnosis.findings}, **described}
    parts.append(Heading(text="Not detected"))
    return Section(
        anchor="findings",
        title="Findings",
        lead="Effects that the base model lacks. Look-alike: the residual of a stage with such "
        "an effect alone, at a standard frequency or time: compare its shape only.",
        parts=(*parts, *_not_detected_tables(page)),
    )


def doubts(finding: Finding) -> tuple[str, ...]:
    """Return what to know of a finding that is uncertain, or does not reduce the error."""
    before_m, after_m = finding.held_out_rms_before_m, finding.held_out_rms_after_m
    sentences = []
    low, high = finding.size.ci95
    if low <= 0.0 <= high and not finding.not_separable_from:
        sentences.append("The interval of its size includes zero: the effect may be absent.")
    if after_m > before_m:
        sentences.append(
            "It was found with the widest class of hysteresis. The model of this page predicts "
            f"left-out data no better with it ({number(after_m, 'm', 4)}) than without it "
            f"({number(before_m, 'm', 4)}): expect no smaller error from it."
        )
    return tuple(sentences)


def controller_values(page: Page, axis: AxisModel | None, finding: Finding) -> tuple[str, ...]:
    """Return which values the controllers use, for an effect that the linear dynamics contain."""
    effect = finding.effect
    if page.design is None or axis is None or effect not in OF_DYNAMICS:
        return ()
    if axis.dynamics is not None:
        delay_s = axis.dynamics.delay_s
        values = [f"the mode at {number(f, 'Hz', 4)}" for f in axis.dynamics.mode_frequency_Hz]
        values.append(f"a delay of {number(delay_s, 's', 4)}" if delay_s else "no delay")
        source = "fitted to the response under Dynamics"
    else:
        is_mode = effect == resonance.EFFECT.name
        modes = [e for e in axis.extensions if is_mode and isinstance(e, LinearMode)]
        values = [f"the mode at {number(mode.frequency_Hz, 'Hz', 4)}" for mode in modes]
        source = "refitted with all effects"
    if not values:
        return ()
    sentences = [
        f"The controllers use {' and '.join(values)}, {source}; the size in the table is from "
        "the search for effects."
    ]
    if finding.not_separable_from and axis.dynamics is not None and page.recordings:
        fitted = {trace.recording.name for trace in page.traces[axis.axis]}
        excited = excites_dynamics(page.recordings, axis.axis)
        small = [recording.name for recording, _ in excited if recording.name not in fitted]
        if small:
            sentences.append(
                f"The search does not use {' and '.join(small)}, which shows no hysteresis; the "
                "fit under Dynamics does."
            )
    return tuple(sentences)


def findings_table(diagnoses: Sequence[Diagnosis]) -> Table | Prose:
    """Return every finding with its size, the errors without and with it, and its p-value."""
    rows = tuple(
        (
            diagnosis.axis,
            _effect_cell(finding),
            size_of(finding),
            number(finding.held_out_rms_before_m, "m"),
            number(finding.held_out_rms_after_m, "m"),
            percent(finding.held_out_gain) if finding.held_out_gain >= MIN_GAIN else "none",
            p_value(finding.p_value),
        )
        for diagnosis in diagnoses
        for finding in diagnosis.findings
    )
    if not rows:
        parts = dict.fromkeys(part for d in diagnoses for part in fitted_parts(d))
        of_fit = f" The error budget contains {' and '.join(parts)} of the fit." if parts else ""
        return Prose(text=f"No effect was found.{of_fit}")
    return Table(
        caption="Size with 95 % interval; held-out error of the model refitted without and with "
        "the effect; loop shape is added last. p: probability of such a result on a healthy "
        "stage.",
        columns=("axis", "effect", "size", "error without", "with", "gain", "p"),
        rows=rows,
        is_open=True,
    )


def _effect_cell(finding: Finding) -> str:
    """Return the name of an effect, with the effects that it cannot be separated from."""
    if not finding.not_separable_from:
        return words(finding.effect)
    alternatives = " or ".join(map(words, finding.not_separable_from))
    return f"{words(finding.effect)} (not separable from {alternatives})"


def _not_detected_tables(page: Page) -> list[Table]:
    """Return the effects and data faults that were not detected, largest limit first."""
    axes = [diagnosis.axis for diagnosis in page.diagnoses]
    absences = {(a.effect, d.axis): a for d in page.diagnoses for a in d.not_detected}
    # An effect smaller than both bound and limit would not be noticed.
    ordered = sorted(
        absences.values(), key=lambda a: -max(a.detection_limit_m or 0.0, a.upper_bound_m or 0.0)
    )
    names = dict.fromkeys(absence.effect for absence in ordered)
    effects = [name for name in names if effect_named(name).fault is None]
    faults = [name for name in names if effect_named(name).fault is not None]
    confounded = {
        (alternative, diagnosis.axis): finding.effect
        for diagnosis in page.diagnoses
        for finding in diagnosis.findings
        for alternative in finding.not_separable_from
    }
    # On these axes the fit models a drift of the zero; the limits apply to additional drift.
    drifting = {fact.axis for fact in page.statements if fact.quantity == ZERO_DRIFT}

    def cells(name: str, axis: str) -> tuple[str, str]:
        """Return bound and detection limit, or why the effect could not be tested."""
        absence, model = absences.get((name, axis)), page.model.axes.get(axis)
        if absence is None:
            return "found", ""
        if (name, axis) in confounded:
            return f"not separable from {words(confounded[name, axis])}", ""
        if absence.detection_limit_m is None:
            return f"not tested: {absence.reason}", ""
        bound, limit = "", number(absence.detection_limit_m, "m")
        if absence.upper_bound_m is not None:
            max_m = math.inf if model is None else MAX_BOUND * model.quality.range_m
            is_useful = absence.upper_bound_m <= max_m
            bound = number(absence.upper_bound_m, "m") if is_useful else "no useful bound"
        if name == thermal_drift.EFFECT.name and axis in drifting:
            limit += ", in addition to the drift in the fit"
        return bound, limit

    headings = [(f"axis {axis}: at most", f"axis {axis}: detected from") for axis in axes]
    of_effects = Table(
        caption="Effects not detected, rms. At most: 95 % upper bound, in addition to what the "
        "model contains. Detected from: size that is found in four of five cases.",
        columns=("effect", *chain.from_iterable(headings)),
        rows=tuple(
            (words(name), *chain.from_iterable(cells(name, axis) for axis in axes))
            for name in effects
        ),
    )
    of_faults = Table(
        caption="Data faults not detected: size from which they are detected. Of a spike or step "
        "its height, of a timestamp fault the error of the displacement.",
        columns=("fault", *(f"axis {axis}" for axis in axes)),
        rows=tuple(
            (words(name), *(limit or bound for bound, limit in (cells(name, a) for a in axes)))
            for name in faults
        ),
    )
    return with_rows(of_effects, of_faults)
