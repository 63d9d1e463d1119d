"""Model discrepancy for verification: a second hysteresis term that no controller contains.

A model verified against its own inverse shows an error of nothing. What a stage really leaves is
at least what recordings leave that the fit did not see, and most of that is hysteresis of another
kind, so it is put behind the plant's drive as

    d[u] = sum_i sum_n c_in (z_i / reach)^n,   n = 1 .. 3

Plays with powers of their states are a Preisach operator in play form [Krejci 1996], a wider class
than the one that ships. Before the recordings the c_in are normal, as large as of other laws.
What the class leaves of the residual stands in their uncertainty: that is widened until it says as
much of the rows that were recorded. Of loops that were not recorded it then says more, and d is as
large as it says.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from piezoid.errors import IdentificationError
from piezoid.identification.hysteresis.uncertainty import adversarial_drives
from piezoid.identification.model import AxisModel, Discrepancy
from piezoid.identification.quality import FitQuality
from piezoid.identification.simulation import simulate_recording
from piezoid.numerics.arrays import Array, runs_of
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

PLAYS = 10
POWERS = 3
MAX_ROWS = 40_000  # of a recording
# Standard deviation of a weight, of half the stroke, by `python -m benchmarks.discrepancy`: on a
# spiral that no recording is like, d is as large as what the model misses there within a factor of
# 2 on 21 of 29 stages of strangers (4 of 29 with a ridge in its place) and on 52 of 78 of the zoo.
# With 0.04 and 0.08 about as many are; with 0.02 full cycles say a third of what is missed.
PRIOR = 0.06
_RIDGE = 1e-2  # of the mean square of a column, for what recordings say of slopes
_STEPPED = 20  # steps of the reach: over shorter ones a sampled slope is rounding
_TURNS, _SAMPLES, _RADIUS = 5, 5000, 0.7  # the spiral over which a draw is brought to its size
_RISES = 0.5  # of the model's least slope: with d the response rises, as that of any ceramic


def with_discrepancy(
    axis: AxisModel, recordings: Sequence[Recording], *, seed: int = 0
) -> AxisModel:
    """Return the axis with its model discrepancy on the recordings of its fit.

    recordings  of the fit; one that the model does not know is passed over
    seed        of the draw

    Without such recordings it stays unknown, and verification says so by its figures alone.
    """
    low_V, high_V = axis.voltage_V
    reach_V = 0.5 * (high_V - low_V)
    rows = [part for recording in recordings for part in _rows(axis, recording, reach_V)]
    if not rows:
        return replace(axis, discrepancy=None)
    columns = np.concatenate([states for states, _ in rows])
    residual_m = np.concatenate([residual_m for _, residual_m in rows])
    mean_m, draw_m = _draw(columns, residual_m, axis.quality, reach_V, seed)
    # Weights that follow the residual where many rows agree say how steep it is.
    gram = columns.T @ columns
    ridge = _RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    followed_m = np.linalg.solve(gram + ridge, columns.T @ residual_m)
    rising, steepest_m_per_V = _slopes(axis, reach_V, mean_m + draw_m, followed_m)
    unseen = 1.0
    if axis.quality.rms_m > 0.0:  # readings without noise may be followed to the last bit
        unseen = max(axis.quality.held_out_rms_m / axis.quality.rms_m, 1.0)
    return replace(
        axis,
        discrepancy=Discrepancy(
            centre_V=0.5 * (low_V + high_V),
            reach_V=reach_V,
            threshold_V=_threshold_V(reach_V),
            weight_m=rising * (mean_m + draw_m).reshape(POWERS, PLAYS),
            steepest_m_per_V=unseen * steepest_m_per_V,
        ),
    )


def _threshold_V(reach_V: float) -> Array:
    return reach_V * np.linspace(0.0, 0.9, PLAYS)


def _states(drive_V: Array, reach_V: float) -> Array:
    """Return the powers of the states, (samples, powers * plays), power by power.

    drive_V  (samples,)  from the middle of its range
    """
    threshold_V = _threshold_V(reach_V)
    first_V = np.clip(np.zeros(PLAYS), drive_V[0] - threshold_V, drive_V[0] + threshold_V)
    z = play_columns(np.ascontiguousarray(drive_V), threshold_V, first_V)[0] / reach_V
    return np.hstack([z**n for n in range(1, POWERS + 1)])


def _rows(axis: AxisModel, recording: Recording, reach_V: float) -> list[tuple[Array, Array]]:
    """Return states and residual of every piece of a recording, thinned, without their means."""
    try:
        simulated_m = simulate_recording(axis, recording)
    except IdentificationError:
        return []
    drive_V = recording.voltage_V(axis.axis) - 0.5 * sum(axis.voltage_V)
    residual_m = axis.polarity * (recording.displacement_m(axis.axis) - simulated_m)
    is_simulated = np.isfinite(residual_m)
    step = max(recording.samples // MAX_ROWS, 1)
    rows = []
    for first, stop in runs_of(is_simulated):
        states = _states(drive_V[first:stop], reach_V)[::step]
        piece_m = residual_m[first:stop:step]
        rows.append((states - states.mean(axis=0), piece_m - piece_m.mean()))
    return rows


def _draw(
    columns: Array, residual_m: Array, quality: FitQuality, reach_V: float, seed: int
) -> tuple[Array, Array]:
    """Return mean weights and a draw to be added, as large on a spiral as draws are on average.

        mean = (X'X + s^2 / p)^-1 X'r,   variance = v (X'X + v / p)^-1,   c ~ N(0, p) beforehand

    s^2 the residual's mean square. What is left beyond the sensor's noise, as much larger as the
    error on rows left out is than that of the fit, is what the variance must say of the rows, and
    v is found from that; it is at least what would be left if all rows were independent.
    """
    curvature, axes = np.linalg.eigh(columns.T @ columns)
    curvature, rows = np.maximum(curvature, 0.0), len(residual_m)
    slope, power = axes.T @ (columns.T @ residual_m), float(np.mean(residual_m**2))
    prior = (PRIOR * quality.range_m / 2.0) ** 2
    mean = slope / (curvature + power / prior)
    remainder = max(power + float(curvature @ mean**2 - 2.0 * mean @ slope) / rows, 1e-9 * power)
    unseen = max(quality.held_out_rms_m**2 / max(power, 1e-300), 1.0)
    missing = max(remainder * unseen - quality.noise_rms_m**2, 0.0)
    variance = _widened(curvature, prior, remainder, missing * rows)
    turn = np.linspace(0.0, 1.0, _SAMPLES)
    spiral_V = _RADIUS * reach_V * turn * np.sin(2.0 * np.pi * _TURNS * turn)
    states = _states(spiral_V, reach_V)
    states = states - states.mean(axis=0)
    mean_m = axes @ mean
    kicks = np.random.default_rng(seed).standard_normal(len(mean_m))
    draw_m = axes @ (np.sqrt(variance) * kicks)
    of_mean, of_draw = states @ mean_m, states @ draw_m
    share = float(of_draw @ of_mean) / max(float(of_mean @ of_mean), 1e-300)
    draw_m, of_draw = draw_m - share * mean_m, of_draw - share * of_mean
    expected = float(np.mean((states @ axes) ** 2 @ variance))
    size = np.sqrt(expected / max(float(np.mean(of_draw**2)), 1e-300))
    return mean_m, draw_m * size


def _widened(curvature: Array, prior: float, narrowest: float, missing: float) -> Array:
    """Return variances of the weights that explain as much of all rows together as is missing."""
    widest = float(curvature.sum()) * prior
    if missing >= widest:  # more than was taken for possible
        return np.full(len(curvature), prior * missing / max(widest, 1e-300))

    def excess(logarithm: float) -> float:
        width = np.exp(logarithm)
        return float(np.sum(curvature * width / (curvature + width / prior))) - missing

    low = high = float(np.log(max(narrowest, 1e-300)))
    while excess(high) < 0.0:
        high += 1.0
    width = np.exp(brentq(excess, low, high) if high > low else low)
    return np.asarray(width / (curvature + width / prior))


def _slopes(
    axis: AxisModel, reach_V: float, weight_m: Array, followed_m: Array
) -> tuple[float, float]:
    """Return which part of d leaves the response rising, and how steep the followed residual is.

    Both over the adversarial drives of the certificate.
    """
    drive_V = adversarial_drives(reach_V, seed=0)
    states, operator = _states(drive_V, reach_V), axis.operator
    centre_V = 0.5 * sum(axis.voltage_V)
    response_m, _ = operator.run(centre_V + drive_V, operator.virgin_memory())
    step_V = np.diff(drive_V)
    is_long = np.abs(step_V) > reach_V / (_STEPPED * PLAYS)
    slope, of_draw, of_residual = (
        np.diff(moved_m)[is_long] / step_V[is_long]
        for moved_m in (response_m, states @ weight_m, states @ followed_m)
    )
    room = np.maximum(slope - _RISES * slope.min(), 1e-300)
    rising = 1.0 / float(np.max(-of_draw / room, initial=1.0))
    return rising, float(np.abs(of_residual).max(initial=0.0))
