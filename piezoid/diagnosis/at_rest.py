"""A drive at rest: drift, hum, other axes and noise, with no hysteresis to be told from them.

    y = c + drift(t) + sum_h a_h cos(2 pi h f t) + b_h sin(2 pi h f t) + sum_j g_j u_j + noise

All of it is linear but the frequency f, which is sought within half a hertz of 50 and 60 Hz. Each
cause is judged by what it takes off the error of blocks of time that were left out, with the other
causes at work. Drift is a cubic of time; where the logarithm of the time from the beginning does
as well, it is not told from creep after what the drive did before.

Source: Bendat & Piersol for lines beside a trend; Arlot & Celisse (2010) on blocks.
"""

from collections.abc import Mapping, Sequence
from math import erfc, sqrt

import numpy as np

from piezoid.diagnosis.diagnosis import (
    Diagnosis,
    Finding,
    HeldOut,
    NotDetected,
    Size,
    Unexplained,
)
from piezoid.diagnosis.discovery import highest
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.tracks import Places
from piezoid.numerics.arrays import Array
from piezoid.numerics.noise import white_noise_rms
from piezoid.readable import told
from piezoid.records.recording import Quantity, Recording

DRIFT, HUM, OTHERS = "thermal_drift", "mains_interference", "cross_coupling"
GRIDS_Hz, OFF_Hz, HARMONICS = (50.0, 60.0), 0.5, 3
BLOCKS, FOLDS = 40, 5  # blocks of time, each fold every fifth of them
SURE = 3.3  # standard errors of the gain of blocks: as every effect asks for
WORTH = 0.01  # of the error: less is not worth a name
SLOWS = 1.02  # times what a cubic leaves: a logarithm of time that leaves no more does as well
LOWEST = 4  # periods in the recording: what is slower is no line
ROWS = 60_000  # of a recording: enough for a line of a ten-thousandth of the noise

Columns = Mapping[str, Array]


def is_at_rest(recording: Recording, axis: str) -> bool:
    """Tell whether the drive of an axis does nothing but read its own noise."""
    voltage_V = recording.voltage_V(axis)
    span = float(np.ptp(voltage_V))
    return span <= 10.0 * white_noise_rms(voltage_V) or span == 0.0


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
    columns = _columns(recording, axis, keep, time_s, y)
    block = np.arange(len(y)) * BLOCKS // len(y)
    chosen = _chosen(columns, y, block)
    final = _held(y, [columns[name] for name in chosen], block)
    baseline = _held(y, [], block)
    noise_m = white_noise_rms(reading_m)
    span_m = max(float(np.ptp(reading_m)), 1e-30)
    findings = [_finding(name, columns, chosen, y, block, time_s) for name in chosen]
    findings.sort(key=lambda finding: finding.held_out_gain, reverse=True)
    return Diagnosis(
        axis=axis,
        stroke_m=span_m,
        baseline=_error(baseline, span_m),
        final=_error(final, span_m),
        envelope_rms_m=float(np.sqrt(np.mean(final**2))),
        noise_floor_rms_m=noise_m,
        explained_fraction=_explained(baseline, final, noise_m),
        unexplained=_unexplained(final, noise_m),
        findings=tuple(findings),
        not_detected=tuple(
            _absent(effect, columns, final) for effect in EFFECTS if effect.name not in chosen
        ),
    )


def _unexplained(left_m: Array, noise_m: float) -> Unexplained:
    """Return what is left beyond the noise, and how surely its highest line is none of that.

    The p-value is of the highest line beside the power around it, for all lines.
    """
    power = np.abs(np.fft.rfft(left_m - left_m.mean())) ** 2
    power[:LOWEST] = 0.0
    lines = highest(power)
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


def _columns(
    recording: Recording, axis: str, keep: Places, time_s: Array, y: Array
) -> dict[str, Array]:
    """Return the columns of every cause that these rows can show, each about its mean."""
    along = 2.0 * (time_s - time_s[0]) / max(float(np.ptp(time_s)), 1e-30) - 1.0
    found = {DRIFT: np.column_stack([along, along**2, along**3])}
    lines = _lines(recording.sampling_rate_Hz, time_s, y, found[DRIFT])
    if lines is not None:
        found[HUM] = lines
    others = [
        channel.values[keep]
        for channel in recording.channels
        if channel.quantity is Quantity.VOLTAGE
        and channel.axis != axis
        and np.ptp(channel.values) > 10.0 * white_noise_rms(channel.values)
    ]
    if others:
        found[OTHERS] = np.column_stack([u / max(float(np.ptp(u)), 1e-30) for u in others])
    return {name: values - values.mean(axis=0) for name, values in found.items()}


def _lines(rate_Hz: float, time_s: Array, y: Array, drift: Array) -> Array | None:
    """Return the lines of the grid that fits best, at its own frequency."""
    span_s = float(np.ptp(time_s))
    if rate_Hz <= 2.0 * GRIDS_Hz[0] or span_s * OFF_Hz < 1.0:
        return None
    calm = y - drift @ np.linalg.lstsq(drift, y, rcond=None)[0]
    steps = np.arange(-OFF_Hz, OFF_Hz, 0.25 / span_s)
    tried = [f + step for f in GRIDS_Hz if rate_Hz > 2.0 * f for step in steps.tolist()]
    power = [abs(np.exp(-2j * np.pi * f * time_s) @ calm) for f in tried[:4000]]
    best = tried[int(np.argmax(power))]
    turns = [
        2 * np.pi * h * best * time_s for h in range(1, HARMONICS + 1) if 2 * h * best < rate_Hz
    ]
    return np.column_stack([wave(turn) for turn in turns for wave in (np.cos, np.sin)])


def _chosen(columns: Columns, y: Array, block: Places) -> list[str]:
    """Return the causes that are sure and worth a name, the largest first, each beside others."""
    chosen: list[str] = []
    while len(chosen) < len(columns):
        rest = [name for name in columns if name not in chosen]
        seen = {name: _gain(columns, chosen, name, y, block) for name in rest}
        name = max(rest, key=lambda one: seen[one][0])
        gain, z = seen[name]
        if gain < WORTH or z < SURE:
            break
        chosen.append(name)
    return chosen


def _gain(
    columns: Columns, beside: Sequence[str], name: str, y: Array, block: Places
) -> tuple[float, float]:
    """Return by how much a cause lowers the rms of blocks left out, and how surely."""
    rest = [columns[other] for other in beside if other != name]
    without, within = _held(y, rest, block), _held(y, [*rest, columns[name]], block)
    better = np.bincount(block, without**2 - within**2, BLOCKS)
    error = float(np.std(better, ddof=1)) / sqrt(BLOCKS)
    gain = 1.0 - float(np.sqrt(np.mean(within**2) / max(float(np.mean(without**2)), 1e-300)))
    return gain, float(better.mean()) / max(error, 1e-300)


def _held(y: Array, parts: Sequence[Array], block: Places) -> Array:
    """Return what columns and a constant leave of rows they were not fitted to, (rows,)."""
    design = np.column_stack([np.ones(len(y)), *parts])
    left, fold = np.empty(len(y)), block % FOLDS
    for out in range(FOLDS):
        inside = fold != out
        found = np.linalg.lstsq(design[inside], y[inside], rcond=None)[0]
        left[~inside] = y[~inside] - design[~inside] @ found
    return left


def _finding(
    name: str, columns: Columns, chosen: Sequence[str], y: Array, block: Places, time_s: Array
) -> Finding:
    effect = next(one for one in EFFECTS if one.name == name)
    gain, z = _gain(columns, chosen, name, y, block)
    rest = [columns[other] for other in chosen if other != name]
    before, after = _held(y, rest, block), _held(y, [*rest, columns[name]], block)
    design = np.column_stack([*rest, columns[name]])
    width = columns[name].shape[1]
    sizes = [
        _size(design[block % FOLDS != out], y[block % FOLDS != out], width) for out in range(FOLDS)
    ]
    value, spread = (
        _size(design, y, width),
        float(np.std(sizes, ddof=1)) * (FOLDS - 1) / sqrt(FOLDS),
    )
    creeps = name == DRIFT and _slows_down(y, rest, columns[name], block, time_s)
    said = f"At rest it is {told(value, 'm')} rms."
    if creeps:
        said += (
            " It slows down as the logarithm of the time does: drift and creep after what the "
            "drive did before are not separable here."
        )
    return Finding(
        effect=name,
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
        not_separable_from=("creep",) if creeps else (),
        explanation=f"{' '.join(effect.explanation.partition(chr(10) * 2)[0].split())} {said}",
        next_experiment="Step to mid-range and hold the drive for ten times as long: creep goes "
        "on slowing down, thermal drift does not."
        if creeps
        else effect.experiment,
        parameters={},
    )


def _size(design: Array, y: Array, width: int) -> float:
    """Return the rms of what the last columns add to a fit of all."""
    found = np.linalg.lstsq(design - design.mean(axis=0), y - y.mean(), rcond=None)[0]
    part = design[:, -width:] @ found[-width:]
    return float(np.std(part))


def _slows_down(
    y: Array, rest: Sequence[Array], cubic: Array, block: Places, time_s: Array
) -> bool:
    """Tell whether a logarithm of time leaves as little as a cubic."""
    since_s = time_s - time_s[0]
    span_s = float(since_s[-1])
    least = np.inf
    for share in (0.003, 0.03, 0.1):
        slow = np.log1p(since_s / (share * span_s))[:, None]
        least = min(least, float(np.mean(_held(y, [*rest, slow], block) ** 2)))
    return least <= SLOWS**2 * float(np.mean(_held(y, [*rest, cubic], block) ** 2))


def _absent(effect: Effect, columns: Columns, final: Array) -> NotDetected:
    if effect.name not in columns:
        return NotDetected(
            effect=effect.name,
            upper_bound_m=None,
            detection_limit_m=None,
            reason="the drive rests, and nothing in these recordings excites it",
            next_experiment=effect.experiment,
        )
    # a sum of so many columns within the noise of all rows, one-sided 95 %
    rms_m = float(np.sqrt(np.mean(final**2)))
    bound_m = max(
        rms_m * sqrt(2.0 * WORTH), 3.0 * rms_m * sqrt(columns[effect.name].shape[1] / len(final))
    )
    return NotDetected(
        effect=effect.name,
        upper_bound_m=bound_m,
        detection_limit_m=bound_m,
        reason=f"no sign of it; {told(bound_m, 'm')} rms would have shown",
        next_experiment=effect.experiment,
    )


def _error(left: Array, span_m: float) -> HeldOut:
    rms_m = float(np.sqrt(np.mean(left**2)))
    return HeldOut(rms_m=rms_m, rms_percent=100.0 * rms_m / span_m)


def _explained(baseline: Array, final: Array, noise_m: float) -> float:
    explainable = float(np.mean(baseline**2)) - noise_m**2
    if explainable <= 0.0:
        return 0.0
    return float(np.clip((np.mean(baseline**2) - np.mean(final**2)) / explainable, 0.0, 1.0))
