"""Report displacement that saturates at the upper or lower end of the drive.

A turning point is saturated if, on the branch before it, the displacement stays within the sensor
noise s of its final value although the drive would move the stage visibly at the gain g of that
branch:

    |y - y_end| < 4 s  for v in [v_stop, v_end],   g |v_end - v_stop| > max(20 s, 3 % of range)

Unlike a clipped reading, such a displacement may be true: it is reported and fitted.
"""

from itertools import pairwise

import numpy as np

from piezoid.records.drive_signal import noise_of, reversals_of
from piezoid.records.recording import Recording
from piezoid.records.sample_statistics import noise_rms, step_size
from piezoid.statement import Statement, finding

NOISE_BAND = 4.0  # standard deviations; a Gaussian sample leaves it once in 16,000
MIN_MISSING_NOISE = 20.0  # missing displacement in standard deviations of the noise
MIN_MISSING_SHARE = 0.03  # of the range; no false alarm in 936 healthy recordings, thirteen laws
MIN_TURNS = 2  # at a similar level, which may drift; a single turn may be an intended pause
MAX_DRIVE_STEP = 0.25  # of the missing drive: behind a step of the drive the stage still moves
MIN_CORRELATION = 0.8  # of drive and displacement; butterfly loops are excluded


def check_saturation(recording: Recording, axis: str) -> list[Statement]:
    """Report each end of the drive with at least ``MIN_TURNS`` saturated turns at one level."""
    drive_V, displacement_m = recording.voltage_V(axis), recording.displacement_m(axis)
    if len(drive_V) < 50 or not np.ptp(drive_V) > 0.0 or not np.ptp(displacement_m) > 0.0:
        return []
    correlation = float(np.corrcoef(drive_V, displacement_m)[0, 1])
    if abs(correlation) < MIN_CORRELATION:
        return []
    is_valid = np.ones(recording.samples, dtype=bool)
    is_valid[list(recording.bridged)] = False
    statements = []
    for sign, side in ((1.0, "above"), (-1.0, "below")):
        # Upper turning points at which the displacement stopped before the drive did.
        v, y = sign * drive_V, sign * np.sign(correlation) * displacement_m
        noise_m = max(noise_rms(y), step_size(y))
        min_missing_m = max(MIN_MISSING_NOISE * noise_m, MIN_MISSING_SHARE * float(np.ptp(y)))
        min_turn_V = max(noise_of(v), 0.02 * float(np.ptp(v)))
        turns: list[tuple[float, float, float]] = []  # V at the stop and the turn; displacement
        for start, end in pairwise((0, *reversals_of(v, min_turn_V))):
            is_rising = v[end] > v[start] and end - start >= 10
            if not is_rising or is_valid[start:end].mean() < 0.8:
                continue
            level_m = float(np.median(y[end - 4 : end + 1]))
            outside = np.flatnonzero(np.abs(y[start:end] - level_m) > NOISE_BAND * noise_m)
            stop = start + (int(outside[-1]) + 1 if len(outside) else 0)
            missing_V = float(v[end] - v[stop])
            largest_step_V = np.abs(np.diff(v[stop : end + 1])).max(initial=0.0)
            is_stepped = largest_step_V > MAX_DRIVE_STEP * missing_V
            if stop - start < 5 or not is_valid[stop:end].all() or is_stepped:
                continue
            gain = (level_m - y[start]) / max(float(v[stop] - v[start]), 1e-12)
            if gain * missing_V > min_missing_m:
                turns.append((float(v[stop]), float(v[end]), level_m))
        lowest_m = max((level_m for _, _, level_m in turns), default=0.0) - min_missing_m
        turns = [turn for turn in turns if turn[2] > lowest_m]
        if len(turns) < MIN_TURNS:
            continue
        stops_V, turns_V, _ = zip(*turns, strict=True)
        stop_V, end_V = sign * float(np.median(stops_V)), sign * max(turns_V)
        text = (
            f"Displacement constant {side} {stop_V:.4g} V in {len(turns)} cycles (the "
            f"drive reaches {end_V:.4g} V): end of the range of amplifier, sensor or stage. Stay "
            f"{'below' if sign > 0 else 'above'} {stop_V:.4g} V, or leave these cycles out."
        )
        statements.append(finding("stands", text, axis=axis, value=stop_V, unit="V"))
    return statements
