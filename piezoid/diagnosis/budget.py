"""Error budget: split the held-out error of the baseline into named causes and the noise.

The budget is a chain of errors, each contained in the one before:

    baseline^2 = sum_i effect_i^2 + extrapolation^2 + loop_shape^2 + unexplained^2 + noise^2

    baseline     held-out error of the simulation without any effect
    final        held-out error of the model that ships:  effects        = baseline^2 - final^2
    explained    its error in sample, corrected for the   extrapolation  = final^2 - explained^2
                 number of parameters
    wide class   error of the widest class of hysteresis  loop_shape     = explained^2 - wide^2
    noise        of the sensor                            unexplained    = wide^2 - noise^2

A sensor's converter with steps D adds an error D / sqrt(12), which no model removes. Its part
above the noise is taken from ``unexplained``.

The gain of the model is divided among the effects in proportion to the rise of the error without
each of them. An error that is larger than the error before it in the chain counts as equal to it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import erfc, sqrt
from types import MappingProxyType

import numpy as np

from piezoid.diagnosis.candidate import QUANTISATION
from piezoid.diagnosis.diagnosis import (
    NOISE_RATIO,
    SOMETHING_ELSE,
    BudgetPart,
    Diagnosis,
    Finding,
    NotDetected,
    Size,
    held_out_gain,
    with_finding,
)
from piezoid.diagnosis.effects import effect_named, every_effect
from piezoid.diagnosis.effects.loop_shape import NAME as LOOP_SHAPE
from piezoid.diagnosis.null_distribution import ALPHA
from piezoid.diagnosis.residual_coordinates import coordinate_words, next_experiment
from piezoid.formatting import with_unit, words

RESONANCE = "resonance"  # an unresolved mode widens loops as another loop shape does
ONE_LOOP_EXPERIMENT = (
    "Record three equal cycles, and the same ten times slower: loop shape repeats in all of them."
)
ONE_SIDED_95 = 1.645
DOMINANT = 5.0  # ratio of the residual of one recording to the largest of all others


@dataclass(frozen=True, kw_only=True)
class RemainingErrors:
    """Errors of the final model that determine the parts of the budget which no effect explains.

    explained_m   in sample, corrected for the number of parameters
    wide_m        of the widest class of hysteresis with every effect, corrected in the same way
    scatter       relative standard error of a mean square of the residual, from blocks
    before_m      held-out error with every effect but without the wider class of hysteresis; None
                  if the model has no wider class
    structure_m   rms of unexplained structure, which the model does not contain and which was
                  subtracted from the readings before ``wide_m`` was computed
    is_compared   whether the model class applies, so that it can be compared with the widest class
    recordings_m  error of the model in sample by recording; empty if it was not computed
    converter_m   error of the steps of the sensor's converter, rms
    """

    explained_m: float
    wide_m: float
    scatter: float
    before_m: float | None = None
    structure_m: float = 0.0
    is_compared: bool = True
    recordings_m: Mapping[str, float] = field(default_factory=dict)
    converter_m: float = 0.0


def with_budget(
    diagnosis: Diagnosis,
    errors: RemainingErrors,
    other_recordings: Mapping[str, str] = MappingProxyType({}),
    gains: Mapping[str, float] = MappingProxyType({}),
) -> Diagnosis:
    """Return a diagnosis with its error budget, and with the largest remaining part as a finding.

    Args:
        diagnosis: with all findings of the search; ``final`` is of the model that ships.
        errors: of that model in sample, and of the widest class of hysteresis.
        other_recordings: findings whose errors are those of other recordings than the baseline, by
            name, with the reason; their part of this budget is 0.
        gains: reduction of the squared error by findings that were measured on other recordings
            and are part of the model, by name; at most what the other findings leave.
    """
    explained_rms_m = min(errors.explained_m, diagnosis.final.rms_m)
    final = replace(diagnosis.final, explained_rms_m=explained_rms_m)
    diagnosis = replace(diagnosis, final=final)
    total = diagnosis.baseline.rms_m**2
    noise = min(diagnosis.noise_floor_rms_m**2, total)
    final_power = float(np.clip(final.rms_m**2, noise, total))
    explained = float(np.clip(errors.explained_m**2, noise, final_power))
    remaining = {"extrapolation": final_power - explained}
    if errors.structure_m > 0.0:
        remaining[SOMETHING_ELSE] = min(errors.structure_m**2, explained - noise)
        explained -= remaining[SOMETHING_ELSE]
    wide = float(np.clip(errors.wide_m**2, noise, explained))
    remaining["unexplained"] = wide - noise
    if errors.converter_m > 0.0:
        above_noise = max(errors.converter_m**2 - noise, 0.0)
        remaining[QUANTISATION] = min(above_noise, remaining["unexplained"])
        remaining["unexplained"] -= remaining[QUANTISATION]
    in_sequence = {}  # gains of parts that were added to the model one after another
    if errors.before_m is None:
        remaining[LOOP_SHAPE] = explained - wide
    else:
        remaining["unexplained"] += explained - wide
        in_sequence[LOOP_SHAPE] = (
            float(np.clip(errors.before_m**2, final_power, total)) - final_power
        )
    if errors.is_compared:
        is_largest = max(remaining, key=lambda name: remaining[name]) == LOOP_SHAPE
        diagnosis = _with_loop_shape(diagnosis, errors, explained - wide, is_largest=is_largest)
    diagnosis, remaining = _with_something_else(diagnosis, errors, remaining)
    effects_power = total - final_power - sum(in_sequence.values())
    parts = [
        *_effect_parts(diagnosis, effects_power, in_sequence, remaining, other_recordings, gains),
        *(_remaining_part(name, power, diagnosis, errors) for name, power in remaining.items()),
        BudgetPart(part="noise", rms_m=sqrt(noise), is_explained=False, text="Sensor noise."),
    ]
    return replace(diagnosis, budget=tuple(parts))


def _with_something_else(
    diagnosis: Diagnosis, errors: RemainingErrors, remaining: Mapping[str, float]
) -> tuple[Diagnosis, dict[str, float]]:
    """Add a finding of the unexplained residual if it dominates the final error.

    A residual that healthy stages show as often is no finding: the budget only states its size.
    The finding does not change the final error, because the residual is not modelled.

    Returns the diagnosis with that finding, and the remaining parts, in which it is separate.
    """
    powers, unexplained, final = dict(remaining), diagnosis.unexplained, diagnosis.final
    if (
        unexplained is None
        or unexplained.p_value > ALPHA
        or SOMETHING_ELSE in diagnosis.names
        or final.rms_m <= NOISE_RATIO * diagnosis.noise_floor_rms_m
        or max(powers, key=lambda name: powers[name]) != "unexplained"
    ):
        return diagnosis, powers
    powers[SOMETHING_ELSE] = unexplained.gain * powers["unexplained"]
    powers["unexplained"] -= powers[SOMETHING_ELSE]
    rms_m = sqrt(powers[SOMETHING_ELSE])
    low, high = (sqrt(max(1.0 + side * 1.96 * errors.scatter, 0.0)) for side in (-1.0, 1.0))
    coordinate = coordinate_words(unexplained.coordinate)
    finding = Finding(
        effect=SOMETHING_ELSE,
        held_out_gain=0.0,
        held_out_rms_before_m=final.rms_m,
        held_out_rms_after_m=final.rms_m,
        p_value=unexplained.p_value,
        rms_percent=100.0 * rms_m / diagnosis.stroke_m,
        size=Size(value=1e9 * rms_m, unit="nm, rms", ci95=(1e9 * low * rms_m, 1e9 * high * rms_m)),
        not_separable_from=(),
        explanation="The residual exceeds the noise and no effect of the catalogue explains it. "
        f"{coordinate.capitalize()} explains {100.0 * unexplained.gain:.0f} % of its power "
        "on left-out blocks, more than any other coordinate.",
        next_experiment=next_experiment(unexplained.coordinate),
        parameters={},
        coordinate=unexplained.coordinate,
    )
    return with_finding(diagnosis, finding), powers


def _effect_parts(
    diagnosis: Diagnosis,
    power: float,
    in_sequence: Mapping[str, float],
    remaining: Mapping[str, float],
    other_recordings: Mapping[str, str],
    gains: Mapping[str, float],
) -> list[BudgetPart]:
    """Divide the gain of the model among the findings, without loop shape outside the model.

    power        gain of all effects together, of the model without loop shape
    in_sequence  gains of parts that were measured one after another, by name
    remaining    parts of the final error, which the model does not remove
    """
    rises = {
        finding.effect: max(
            finding.held_out_rms_before_m**2 - finding.held_out_rms_after_m**2, 0.0
        )
        for finding in diagnosis.findings
        if finding.effect not in {*other_recordings, *in_sequence, *remaining, *gains}
    }
    # Effects of other recordings: their refits also change the hysteresis, and with it the error.
    unattributed = max(power - sum(rises.values()), 0.0)
    scale = min(unattributed / max(sum(gains.values()), 1e-300), 1.0)
    rises |= {name: scale * gain for name, gain in gains.items()}
    total_rise = sum(rises.values())
    if total_rise == 0.0 and power > 0.0:
        # the model's lag, which is no finding if it cannot be separated from a width of the loop
        rises["lag"] = total_rise = power
    parts = []
    for name in dict.fromkeys((*diagnosis.names, *rises, *in_sequence)):
        if name in remaining:
            continue
        share = rises.get(name, 0.0) / total_rise if total_rise > 0.0 else 0.0
        text = "Cause outside the catalogue."
        if name != SOMETHING_ELSE:
            is_fault = effect_named(name).fault is not None
            remedy = "repaired in the data" if is_fault else "modelled"
            text = f"{words(name).capitalize()}, {remedy}."
        parts.append(
            BudgetPart(
                part=name,
                rms_m=sqrt(in_sequence.get(name, power * share)),
                is_explained=True,
                text=other_recordings.get(name, text),
            )
        )
    return sorted(parts, key=lambda part: -part.rms_m)


def _remaining_part(
    name: str, power: float, diagnosis: Diagnosis, errors: RemainingErrors
) -> BudgetPart:
    """Return a part of the final error, with its meaning and what to do about it."""
    rms_m, noise_m = sqrt(max(power, 0.0)), diagnosis.noise_floor_rms_m
    sizes = f"{with_unit(rms_m, 'm')} rms; sensor noise {with_unit(noise_m, 'm')}"
    if name == LOOP_SHAPE:
        text = f"Loop shape that the model class cannot represent ({sizes})."
    elif name == QUANTISATION:
        text = (
            f"Steps of the sensor's converter ({with_unit(errors.converter_m, 'm')} rms), as far "
            "as they exceed the noise; no model removes them."
        )
    elif name == "extrapolation":
        # one recording causes the error if its error is far larger than that of all others
        recordings_m = errors.recordings_m
        *smaller, worst = sorted(recordings_m, key=lambda name: recordings_m[name]) or [""]
        if smaller and recordings_m[worst] >= DOMINANT * recordings_m[smaller[-1]]:
            rms, others_rms = (with_unit(recordings_m[name], "m") for name in (worst, smaller[-1]))
            text = (
                f"The error comes from {worst}: the model misses it by {rms} rms, the other "
                f"recordings by at most {others_rms}. Leave it out, or record it again; a chirp "
                "needs a smaller amplitude, at the rate of the controller or faster."
            )
        else:
            held_out_m = diagnosis.final.rms_m
            in_sample_m = sqrt(max(held_out_m**2 - rms_m**2, 0.0))
            text = (
                f"The error on left-out data ({with_unit(held_out_m, 'm')} rms) exceeds that of "
                f"the fit ({with_unit(in_sample_m, 'm')} rms). To reduce it, record the same "
                "drives again."
            )
    elif name == SOMETHING_ELSE:
        text = (
            "Systematic residual that no effect explains; the model does not contain it "
            f"({sizes})."
        )
    else:
        text, unexplained = f"Residual that no effect explains ({sizes}).", diagnosis.unexplained
        if unexplained is not None and unexplained.p_value > ALPHA:
            text += " Healthy stages show as much: no action is needed, feedback reduces it."
        elif unexplained is not None:
            experiment = next_experiment(unexplained.coordinate)
            text += f" Healthy stages show less. {experiment}".rstrip()
    return BudgetPart(part=name, rms_m=rms_m, is_explained=False, text=text)


def _with_loop_shape(
    diagnosis: Diagnosis, errors: RemainingErrors, power: float, *, is_largest: bool
) -> Diagnosis:
    """Add loop shape to the findings or to the effects that were not detected.

    It is a finding if the error without it is above the noise and one of three conditions holds:
    the model has a wider class of hysteresis, or loop shape is the largest remaining part, or it
    is a significant half of the error in sample above the noise.

    power  that the widest class of hysteresis explains and the model does not
    """
    effect, experiment = effect_named(LOOP_SHAPE), effect_named(LOOP_SHAPE).experiment
    noise_m, after_m = diagnosis.noise_floor_rms_m, diagnosis.final.rms_m
    in_model = errors.before_m is not None
    if errors.before_m is None:
        before_m, power_std = after_m, max(errors.scatter, 1e-6) * errors.explained_m**2
        is_half = power > 0.5 * (errors.explained_m**2 - noise_m**2)
        is_named = is_largest or (is_half and power > ONE_SIDED_95 * power_std)
    else:
        before_m, is_named = errors.before_m, True
        power = max(before_m**2 - after_m**2, 0.0)
        power_std = max(errors.scatter, 1e-6) * before_m**2
    if before_m <= NOISE_RATIO * noise_m or power <= 0.0 or not is_named:
        bound_m = sqrt(max(power, 0.0) + ONE_SIDED_95 * power_std)
        bounded = NotDetected(
            effect=LOOP_SHAPE,
            upper_bound_m=bound_m,
            detection_limit_m=bound_m,
            reason="the widest class of hysteresis takes at most "
            f"{with_unit(bound_m, 'm')} rms off the error of the model",
            next_experiment=experiment,
        )
        absences = [absence for absence in diagnosis.not_detected if absence.effect != LOOP_SHAPE]
        return replace(diagnosis, not_detected=(*absences, bounded))
    confounded = [
        f.effect for f in diagnosis.findings if f.effect == RESONANCE and not f.held_out_gain
    ]
    model = diagnosis.model
    if in_model and model is not None and not model.quality.is_tested:
        # Along one loop the widest class explained 46 of 59 nm of plays with a lag of 20 ms, and
        # beside a drift of plays 61 nm of loop shape that the stage does not have.
        confounded += [effect.name for effect in every_effect() if effect.may_be_loop_shape]
        experiment = ONE_LOOP_EXPERIMENT
    low, high = (sqrt(max(power + side * 1.96 * power_std, 0.0)) for side in (-1.0, 1.0))
    evidence = (
        "The model also contains a wider class of hysteresis; the exported controller does not."
        if in_model
        else f"In sample the model reaches {with_unit(errors.explained_m, 'm')}, the widest "
        f"class of hysteresis {with_unit(errors.wide_m, 'm')}."
    )
    finding = Finding(
        effect=LOOP_SHAPE,
        held_out_gain=held_out_gain(before_m, after_m),
        held_out_rms_before_m=before_m,
        held_out_rms_after_m=after_m,
        p_value=0.5 * erfc(power / power_std / sqrt(2.0)) if power_std > 0.0 else 0.0,
        rms_percent=100.0 * sqrt(power) / diagnosis.stroke_m,
        size=Size(value=1e9 * sqrt(power), unit=effect.unit, ci95=(1e9 * low, 1e9 * high)),
        not_separable_from=tuple(confounded),
        explanation=f"{effect.summary} {evidence}",
        next_experiment=experiment,
        parameters={},
    )
    return with_finding(diagnosis, finding)
