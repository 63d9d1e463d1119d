"""Statements about a diagnosis: confounded effects, unexplained residual, next recordings.

The table of the findings contains their sizes; a statement is made only if a reader has to know
more than a size.
"""

from math import pi

from piezoid.diagnosis.diagnosis import (
    NOISE_RATIO,
    NOT_EXCITED,
    SOMETHING_ELSE,
    Diagnosis,
    Finding,
)
from piezoid.diagnosis.effects import delay, lag
from piezoid.diagnosis.effects.loop_shape import NAME as LOOP_SHAPE
from piezoid.diagnosis.null_distribution import ALPHA
from piezoid.diagnosis.residual_coordinates import coordinate_words
from piezoid.formatting import significant, with_unit, words
from piezoid.identification.fit_statements import GOOD_PERCENT
from piezoid.statement import Kind, Level, Statement

MIN_GAIN = 0.01  # of the power: less has no coordinate
# Of the corner of a lag: there it differs from a delay by 2 % in gain and 0.15 degrees in phase.
EQUAL_SHARE = 0.2
LAG_AND_DELAY = frozenset((lag.EFFECT.name, delay.EFFECT.name))

SHAPE_EXPERIMENT = (
    "Record reversals of many sizes at several biases, each reached from above and from below."
)


def diagnosis_statements(diagnosis: Diagnosis) -> tuple[Statement, ...]:
    """Return the statements about one diagnosis, most important first.

    The part that dominates a final error far above the noise is stated, unless it is along one
    coordinate: then it is a finding. Every fit predicts new recordings worse than its own, so
    extrapolation needs action only if it is most of an error that is not good.
    """
    findings, part, statements = diagnosis.findings, diagnosis.largest_remaining, []
    is_tested = any(absence.upper_bound_m is not None for absence in diagnosis.not_detected)
    is_named = any(f.effect not in (SOMETHING_ELSE, LOOP_SHAPE) for f in findings)
    if not (is_tested or is_named):
        statements.append(_nothing_found(diagnosis))
    for finding in findings:
        if finding.effect == SOMETHING_ELSE:
            text = f"{finding.explanation} {finding.next_experiment}".strip()
            size_m = finding.share * diagnosis.stroke_m
            statements.append(
                _statement(diagnosis, Kind.FINDING, Level.ACTION, SOMETHING_ELSE, text, size_m)
            )
    statements += [_confounded(diagnosis, f) for f in findings if f.not_separable_from]
    if part is not None and part.part != SOMETHING_ELSE and (is_tested or findings):
        is_most = part.rms_m**2 > 0.5 * diagnosis.final.rms_m**2
        is_large = diagnosis.final.rms_percent > GOOD_PERCENT
        is_action = part.part == "extrapolation" and is_most and is_large
        level = Level.ACTION if is_action else Level.WARNING
        statements.append(
            _statement(diagnosis, Kind.LIMIT, level, part.part, part.text, part.rms_m)
        )
    elif not findings and is_tested:
        statements.append(_nothing_found(diagnosis))
    return tuple(statements)


def largest_first(diagnosis: Diagnosis) -> tuple[Finding, ...]:
    """Return the findings, with unexplained structure first if it exceeds every effect."""
    unnamed = [finding for finding in diagnosis.findings if finding.effect == SOMETHING_ELSE]
    catalogued = [finding for finding in diagnosis.findings if finding.effect != SOMETHING_ELSE]
    if all(first.share > second.share for first in unnamed for second in catalogued):
        return (*unnamed, *catalogued)
    return diagnosis.findings


def _confounded(diagnosis: Diagnosis, finding: Finding) -> Statement:
    """State that a finding cannot be separated from other effects, and whether that matters."""
    text = (
        f"{words(finding.effect).capitalize()} cannot be separated from "
        f"{' or '.join(map(words, finding.not_separable_from))}"
    )
    if LAG_AND_DELAY.issuperset((finding.effect, *finding.not_separable_from)):
        equal_Hz = EQUAL_SHARE / (2.0 * pi * 1e-6 * finding.size.value)  # the size is in us
        text += f"; a loop below {with_unit(equal_Hz, 'Hz', 2)} is the same with either"
    text = f"{text}. {finding.next_experiment}"
    quantity = f"{finding.effect}_confounded"
    level = Level.ACTION if finding.needs_recording else Level.WARNING
    return _statement(diagnosis, Kind.LIMIT, level, quantity, text)


def _nothing_found(diagnosis: Diagnosis) -> Statement:
    """State why no effect is named, and what to record if the error exceeds the noise."""
    n_tested = sum(absence.upper_bound_m is not None for absence in diagnosis.not_detected)
    if not n_tested:
        reason, *further_reasons = {absence.reason for absence in diagnosis.not_detected} or {""}
        reason = reason.rstrip(".")
        why = f" because {reason}" if reason and not further_reasons else ""
        text = f"No effect was tested{why}."
        return _statement(diagnosis, Kind.LIMIT, Level.WARNING, "no_effect_tested", text)
    residual_m, noise_m = diagnosis.envelope_rms_m, diagnosis.noise_floor_rms_m
    times = f", {significant(residual_m / noise_m, 2)} times the sensor noise" if noise_m else ""
    at_rest = any(absence.reason == NOT_EXCITED for absence in diagnosis.not_detected)
    where = "at constant drive" if at_rest else "beyond hysteresis of any shape"
    count = (
        "1 effect was tested and not" if n_tested == 1 else f"{n_tested} effects were tested, none"
    )
    fitted = " and ".join(words(part.part) for part in diagnosis.budget if part.is_explained)
    beyond = f" beyond the {fitted} of the fit" if fitted else ""
    residual = with_unit(residual_m, "m")
    text = f"{count} detected{beyond}: the residual {where} is {residual} rms{times}."
    structure = diagnosis.unexplained
    if structure is not None and structure.gain >= MIN_GAIN:
        coordinate, percent = coordinate_words(structure.coordinate), 100 * structure.p_value
        usual = f"; {percent:.0f} % of healthy stages show as much"
        text += f" {100 * structure.gain:.2g} % of its power depends on {coordinate}"
        text += f"{'' if structure.p_value <= ALPHA else usual}."
    exceeds = not at_rest and residual_m > NOISE_RATIO * noise_m > 0.0
    if exceeds:
        text += f" {SHAPE_EXPERIMENT}"
    level = Level.ACTION if exceeds else Level.NOTE
    return _statement(diagnosis, Kind.LIMIT, level, "no_effect_detected", text, residual_m)


def _statement(
    diagnosis: Diagnosis,
    kind: Kind,
    level: Level,
    quantity: str,
    text: str,
    value_m: float | None = None,
) -> Statement:
    return Statement(
        kind=kind,
        level=level,
        quantity=quantity,
        text=text,
        axis=diagnosis.axis,
        value=value_m,
        unit="" if value_m is None else "m",
    )
