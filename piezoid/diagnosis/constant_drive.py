"""A drive at rest: drift, jumps, hum, other axes and noise; no hysteresis is to be told from them.

    y = c + drift(t) + jump(t - t0) + sum_h a_h cos(2 pi h f t) + b_h sin(2 pi h f t)
        + a cos(2 pi f1 t) + b sin(2 pi f1 t) + sum_j g_j u_j + noise

All of it is linear but the grid's frequency f, the instant t0 and the frequency f1 of a line of
its own (``rest_columns``). Each cause is judged by what it takes off the error of blocks of time
that were left out, with the other causes at work. Where the logarithm of the time from the
beginning does as well as a cubic, drift is not told from creep after what the drive did before.

Source: Bendat & Piersol for lines beside a trend; Arlot & Celisse (2010) on blocks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import erfc, sqrt

import numpy as np

from piezoid.diagnosis.blocked_regression import gain_z
from piezoid.diagnosis.budget import RemainingErrors, relative_scatter, with_budget
from piezoid.diagnosis.coordinate_tests import highest
from piezoid.diagnosis.diagnosis import (
    Diagnosis,
    FinalError,
    Finding,
    HeldOut,
    NotDetected,
    Seen,
    Size,
    Unexplained,
    fraction_explained,
)
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.effects import effect_named, every_effect
from piezoid.diagnosis.residual_structure import NAME as SOMETHING_ELSE
from piezoid.diagnosis.rest_columns import (
    BLOCKS,
    DRIFT,
    FOLDS,
    JUMP,
    LINE,
    Columns,
    Rest,
    held,
    line_in,
    rest_columns,
    spectrum_of,
)
from piezoid.diagnosis.segments import Places
from piezoid.diagnosis.signals import GRIDS_Hz
from piezoid.diagnosis.structure_findings import NEXT, seen_in_classes
from piezoid.formatting import significant, with_unit
from piezoid.identification.hysteresis.sensor_noise import noise_rms
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

SURE = 3.3  # standard errors of the gain of blocks: as every effect asks for
WORTH = 0.01  # of the error: less is not worth a name
JUMPS = 0.05  # of the error beside any drift: a jump found by search takes off less by chance
CHANCE = 1e-4  # p-value of a line that stands alone: there are thousands of frequencies to try
RESTS = "the drive rests, and nothing in these recordings excites it"
ROWS = 60_000  # of a recording: enough for a line of a ten-thousandth of the noise


def diagnose_at_rest(recordings: Sequence[Recording], axis: str) -> Diagnosis:
    """Return what moves a stage whose drive rests.

    recordings  of one stage, each with the displacement of the axis

    The longest is diagnosed; others are other hours. Effects that need a drive are not tested.
    """
    recording = max(recordings, key=lambda r: r.duration_s)
    keep = np.setdiff1d(np.arange(recording.samples), recording.bridged)
    keep = keep[:: max(1, len(keep) // ROWS)] if _is_slow(recording) else keep[:ROWS]
    reading_m = recording.displacement_m(axis)
    time_s = keep / recording.sampling_rate_Hz
    y = reading_m[keep] - reading_m[keep].mean()
    block = np.arange(len(y)) * BLOCKS // len(y)
    rest = rest_columns(recording, axis, keep, time_s, y, every_effect())
    chosen = _chosen(rest.columns, y, block)
    final = held(y, [rest.columns[name] for name in chosen], block)
    line_Hz = line_in(final, time_s, CHANCE)
    if line_Hz is not None:
        wider = rest.with_line(line_Hz)
        if _is_worth(LINE, _gain(wider.columns, chosen, LINE, y, block)):
            rest, chosen = wider, [*chosen, LINE]
            final = held(y, [rest.columns[name] for name in chosen], block)
    noise_m = noise_rms((y, final))
    span_m = max(float(np.ptp(reading_m)), 1e-30)
    before, after = _error(held(y, [], block), span_m), _error(final, span_m)
    findings = [_finding(name, rest, chosen, y, block) for name in chosen]
    findings.sort(key=lambda finding: finding.held_out_gain, reverse=True)
    diagnosis = Diagnosis(
        axis=axis,
        stroke_m=span_m,
        baseline=before,
        final=FinalError(rms_m=after.rms_m, rms_percent=after.rms_percent),
        envelope_rms_m=after.rms_m,
        noise_floor_rms_m=noise_m,
        explained_fraction=fraction_explained(before.rms_m, after.rms_m, noise_m),
        unexplained=_unexplained(final, noise_m),
        findings=tuple(findings),
        not_detected=tuple(
            _absent(effect, rest, final) for effect in every_effect() if effect.name not in chosen
        ),
    )
    errors = RemainingErrors(
        explained_m=after.rms_m,
        wide_m=after.rms_m,
        scatter=relative_scatter(final),
        is_compared=False,
    )
    return with_budget(diagnosis, errors)


def _unexplained(left_m: Array, noise_m: float) -> Unexplained:
    """Return what is left beyond the noise, and how surely its highest line is none of that.

    The p-value is of the highest line beside the power around it, for all lines.
    """
    lines = highest(spectrum_of(left_m))
    total_m2 = float(np.mean(left_m**2))
    above_m2 = max(total_m2 - noise_m**2, 0.0)
    line, p_value = (lines[0][0], max(lines[0][1], 1e-12)) if lines else (0.0, 1.0)
    return Unexplained(
        rms_m=sqrt(above_m2),
        share=above_m2 / max(total_m2, 1e-300),
        p_value=p_value,
        coordinate="frequency",
        gain=min(2.0 * line / max(total_m2 * len(left_m) ** 2, 1e-300), 1.0),
    )


def _is_slow(recording: Recording) -> bool:
    """Tell whether no line of the grid can be seen anyway, so that rows may be spread."""
    return recording.sampling_rate_Hz <= 2.0 * GRIDS_Hz[0]


def _chosen(columns: Columns, y: Array, block: Places) -> list[str]:
    """Return the causes that are sure and worth a name, the largest first, each beside others.

    A jump is asked beside drift, which follows the half of any jump.
    """
    chosen = [JUMP] if _is_worth(JUMP, _gain(columns, [DRIFT], JUMP, y, block)) else []
    while True:
        rest = [name for name in columns if name not in (*chosen, JUMP)]
        seen = {name: _gain(columns, chosen, name, y, block) for name in rest}
        sure = [name for name in rest if _is_worth(name, seen[name])]
        if not sure:
            return chosen
        chosen.append(max(sure, key=lambda one: seen[one][0]))


def _is_worth(name: str, seen: tuple[float, float]) -> bool:
    gain, z = seen
    return gain >= (JUMPS if name == JUMP else WORTH) and z >= SURE


def _gain(
    columns: Columns, beside: Sequence[str], name: str, y: Array, block: Places
) -> tuple[float, float]:
    """Return by how much a cause lowers the rms of blocks left out, and how surely."""
    rest = [columns[other] for other in beside if other != name]
    without, within = held(y, rest, block), held(y, [*rest, columns[name]], block)
    better = np.bincount(block, without**2 - within**2, BLOCKS).astype(np.float64)
    made = np.bincount(block, (without - within) ** 2, BLOCKS).astype(np.float64)
    gain = 1.0 - float(np.sqrt(np.mean(within**2) / max(float(np.mean(without**2)), 1e-300)))
    return gain, gain_z(better, made, gain)


def _finding(name: str, found: Rest, chosen: Sequence[str], y: Array, block: Places) -> Finding:
    columns = found.columns
    gain, z = _gain(columns, chosen, name, y, block)
    rest = [columns[other] for other in chosen if other != name]
    before, after = held(y, rest, block), held(y, [*rest, columns[name]], block)
    design = np.column_stack([*rest, columns[name]])
    width = columns[name].shape[1]
    sizes = [
        _size(design[block % FOLDS != out], y[block % FOLDS != out], width) for out in range(FOLDS)
    ]
    value, spread = (
        _size(design, y, width),
        float(np.std(sizes, ddof=1)) * (FOLDS - 1) / sqrt(FOLDS),
    )
    said = _said(name, found, value, design, y)
    return Finding(
        effect=said.effect,
        held_out_gain=float(np.clip(gain, 0.0, 1.0)),
        held_out_rms_before_m=float(np.sqrt(np.mean(before**2))),
        held_out_rms_after_m=float(np.sqrt(np.mean(after**2))),
        p_value=min(1.0, max(0.5 * erfc(z / sqrt(2.0)), 1e-12) * len(columns)),
        rms_percent=100.0 * value / max(float(np.ptp(y)), 1e-30),
        size=Size(
            value=1e9 * value,
            unit="nm, rms",
            ci95=(1e9 * max(value - 1.96 * spread, 0.0), 1e9 * (value + 1.96 * spread)),
        ),
        not_separable_from=said.confounded,
        explanation=said.explanation,
        next_experiment=said.experiment,
        parameters=said.parameters,
        coordinate=said.coordinate,
        seen=_seen(name, found, design, y) if said.coordinate else None,
    )


def _seen(name: str, found: Rest, design: Array, y: Array) -> Seen:
    """Return the picture of something else: what is left along time or phase, and its curve."""
    width = found.columns[name].shape[1]
    every = design - design.mean(axis=0)
    coefficients = _coefficients(design, y)
    curve = every[:, -width:] @ coefficients[-width:]
    left = y - y.mean() - every @ coefficients + curve
    phase = (found.time_s * found.line_Hz) % 1.0
    if name == JUMP:
        return seen_in_classes(found.time_s, left, curve, unit="s", recording=found.recording)
    return seen_in_classes(phase, left, curve, unit="")


@dataclass(frozen=True, kw_only=True)
class _Said:
    """How a cause is called and told, fields as of ``Finding``."""

    effect: str
    explanation: str
    experiment: str
    confounded: tuple[str, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    coordinate: str = ""


def _said(name: str, rest: Rest, value_m: float, design: Array, y: Array) -> _Said:
    """Return a cause in words.

    design, y  rows of all that was found, the cause's own columns last
    """
    size = f"At rest it is {with_unit(value_m, 'm')} rms."
    if name == LINE:
        return _Said(
            effect=SOMETHING_ELSE,
            explanation="No effect of the catalogue stands for it: a line at "
            f"{significant(rest.line_Hz, 5)} Hz, of the floor, a pump or another instrument. "
            f"{size}",
            experiment=NEXT["frequency"],
            parameters={"frequency_Hz": rest.line_Hz},
            coordinate="frequency",
        )
    if name == JUMP:
        high_m = float(_coefficients(design, y)[-1])
        return _Said(
            effect=SOMETHING_ELSE,
            explanation="No effect of the catalogue stands for it: one jump by "
            f"{with_unit(high_m, 'm')} at {with_unit(rest.jump_s, 's')}, of the stage, its mount "
            "or the sensor.",
            experiment=NEXT["time"],
            parameters={"instant_s": rest.jump_s, "jump_m": high_m},
            coordinate="time",
        )
    effect = effect_named(name)
    creeps = name == DRIFT and rest.is_creep
    if creeps:
        size += (
            " It slows down as the logarithm of the time does: drift and creep after what the "
            "drive did before are not separable here."
        )
    return _Said(
        effect=name,
        explanation=f"{effect.summary} {size}",
        experiment="Step to mid-range and hold the drive for ten times as long: creep goes "
        "on slowing down, thermal drift does not."
        if creeps
        else effect.experiment,
        confounded=effect.confounded if creeps else (),
    )


def _coefficients(design: Array, y: Array) -> Array:
    return np.asarray(np.linalg.lstsq(design - design.mean(axis=0), y - y.mean(), rcond=None)[0])


def _size(design: Array, y: Array, width: int) -> float:
    """Return the rms of what the last columns add to a fit of all."""
    part = design[:, -width:] @ _coefficients(design, y)[-width:]
    return float(np.std(part))


def _absent(effect: Effect, rest: Rest, final: Array) -> NotDetected:
    if effect.name not in rest.columns:
        return NotDetected(
            effect=effect.name,
            upper_bound_m=None,
            detection_limit_m=None,
            reason=rest.unseen.get(effect.name, RESTS),
            next_experiment=effect.experiment,
        )
    # a sum of so many columns within the noise of all rows, one-sided 95 %
    rms_m = float(np.sqrt(np.mean(final**2)))
    width = rest.columns[effect.name].shape[1]
    bound_m = max(rms_m * sqrt(2.0 * WORTH), 3.0 * rms_m * sqrt(width / len(final)))
    return NotDetected(
        effect=effect.name,
        upper_bound_m=bound_m,
        detection_limit_m=bound_m,
        reason=f"not detected; {with_unit(bound_m, 'm')} rms would have been",
        next_experiment=effect.experiment,
    )


def _error(left: Array, span_m: float) -> HeldOut:
    rms_m = float(np.sqrt(np.mean(left**2)))
    return HeldOut(rms_m=rms_m, rms_percent=100.0 * rms_m / span_m)
