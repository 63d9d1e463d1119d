"""Model discrepancy for verification: a second hysteresis term that no controller contains.

A model that is verified against its own inverse has no error. A real stage has at least the
held-out error, most of which is unmodelled hysteresis. The verification plant therefore adds

    d[u] = sum_i sum_n c_in (z_i / reach)^n,   n = 1 .. 3

Plays with powers of their states are a Preisach operator in play form [Krejci 1996], a wider class
than the exported one. The prior of c_in is normal, with a variance typical of other hysteresis
laws. The posterior variance is widened until it explains the remaining residual on the recorded
rows. It is then larger for loops that were not recorded, and d is a draw of this size.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from piezoid.identification.hysteresis.uncertainty import adversarial_drives
from piezoid.identification.model import AxisModel, Discrepancy
from piezoid.identification.quality import FitQuality
from piezoid.identification.simulation import fitted_pieces
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

PLAYS = 10
THRESHOLDS = np.linspace(0.0, 0.9, PLAYS)  # of half the range
POWERS = 3
SEED = 0  # of the draw and of the drives on which slopes are limited
MAX_ROWS = 40_000  # of a recording
# Standard deviation of a weight over half the stroke, by `python -m benchmarks.discrepancy`: on a
# spiral unlike all recordings, the size of d agrees with the model error within a factor of 2 on
# 21 of 29 independent stages (4 of 29 with ridge regression instead) and on 52 of 78 of the zoo.
# With 0.04 and 0.08 results are similar; with 0.02 full cycles give a third of the error.
PRIOR = 0.06
_RIDGE = 1e-2  # of the mean square of a column, for the slope of the residual
_STEPS_PER_PLAY = 20  # slopes over drive steps shorter than reach / (20 plays) are rounding
_TURNS, _SAMPLES, _RADIUS = 5, 5000, 0.7  # of the spiral on which a draw is scaled
# Of the model's smallest slope: the response with d rises, as that of any ceramic.
_MIN_SLOPE = 0.5


def with_discrepancy(axis: AxisModel, recordings: Sequence[Recording]) -> AxisModel:
    """Return the axis with the model discrepancy estimated on the recordings of its fit.

    recordings  of the fit; a recording that the model does not contain is ignored

    Without such recordings the discrepancy is None.
    """
    low_V, high_V = axis.voltage_V
    centre_V, reach_V = 0.5 * (low_V + high_V), 0.5 * (high_V - low_V)
    tables, residuals_m = [], []  # centred states and residual of every piece, thinned
    for recording in recordings:
        step = max(recording.samples // MAX_ROWS, 1)
        for piece in fitted_pieces(axis, recording):
            measured_m = recording.displacement_m(axis.axis)[piece.samples]
            error_m = axis.polarity * (measured_m - piece.simulate(axis))[::step]
            states = _states(piece.voltage_V - centre_V, reach_V)[::step]
            tables.append(states - states.mean(axis=0))
            residuals_m.append(error_m - error_m.mean())
    if not tables:
        return replace(axis, discrepancy=None)
    columns, residual_m = np.concatenate(tables), np.concatenate(residuals_m)
    mean_m, draw_m = _draw(columns, residual_m, axis.quality, reach_V)
    # Fit the residual itself to get its slope.
    gram = columns.T @ columns
    ridge = _RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    residual_weight_m = np.linalg.solve(gram + ridge, columns.T @ residual_m)
    # Slopes of the response, d and the residual over the adversarial drives of the certificate.
    drive_V = adversarial_drives(reach_V, SEED)
    states, step_V = _states(drive_V, reach_V), np.diff(drive_V)
    operator = axis.operator
    response_m, _ = operator.run(centre_V + drive_V, operator.virgin_memory())
    is_long = np.abs(step_V) > reach_V / (_STEPS_PER_PLAY * PLAYS)
    slope, draw_slope, residual_slope = (
        np.diff(path_m)[is_long] / step_V[is_long]
        for path_m in (response_m, states @ (mean_m + draw_m), states @ residual_weight_m)
    )
    margin = np.maximum(slope - _MIN_SLOPE * slope.min(), 1e-300)
    factor = 1.0 / float(np.max(-draw_slope / margin, initial=1.0))
    max_slope_m_per_V = float(np.abs(residual_slope).max(initial=0.0))
    optimism = 1.0
    if axis.quality.rms_m > 0.0:  # the residual of readings without noise may be 0
        optimism = max(axis.quality.held_out_rms_m / axis.quality.rms_m, 1.0)
    return replace(
        axis,
        discrepancy=Discrepancy(
            centre_V=centre_V,
            reach_V=reach_V,
            threshold_V=reach_V * THRESHOLDS,
            weight_m=factor * (mean_m + draw_m).reshape(POWERS, PLAYS),
            steepest_m_per_V=optimism * max_slope_m_per_V,
        ),
    )


def _states(drive_V: Array, reach_V: float) -> Array:
    """Return the powers of the states of plays, (samples, powers * plays), power by power.

    drive_V  (samples,)  relative to the middle of its range
    """
    threshold_V = reach_V * THRESHOLDS
    first_V = np.clip(np.zeros(PLAYS), drive_V[0] - threshold_V, drive_V[0] + threshold_V)
    z = play_columns(np.ascontiguousarray(drive_V), threshold_V, first_V)[0] / reach_V
    return np.hstack([z**n for n in range(1, POWERS + 1)])


def _draw(
    columns: Array, residual_m: Array, quality: FitQuality, reach_V: float
) -> tuple[Array, Array]:
    """Return the posterior mean of the weights, and a draw around it of average size on a spiral.

        mean = (X'X + s^2 / p)^-1 X'r,   variance = v (X'X + v / p)^-1,   prior c ~ N(0, p)

    s^2 is the mean square of the residual. v is chosen such that the variance explains the part of
    the remaining residual that exceeds the sensor noise, scaled by the ratio of held-out to
    in-sample error. Its lower bound is the remaining residual, for independent rows.
    """
    curvature, vectors = np.linalg.eigh(columns.T @ columns)
    curvature, rows = np.maximum(curvature, 0.0), len(residual_m)
    moment, power = vectors.T @ (columns.T @ residual_m), float(np.mean(residual_m**2))
    prior = (PRIOR * quality.range_m / 2.0) ** 2
    mean = moment / (curvature + power / prior)
    remainder = max(power + float(curvature @ mean**2 - 2.0 * mean @ moment) / rows, 1e-9 * power)
    optimism = max(quality.held_out_rms_m**2 / max(power, 1e-300), 1.0)
    missing = max(remainder * optimism - quality.noise_rms_m**2, 0.0)
    upper, goal = float(curvature.sum()) * prior, missing * rows

    def excess(logarithm: float) -> float:
        residual = np.exp(logarithm)
        return float(np.sum(curvature * residual / (curvature + residual / prior))) - goal

    if goal >= upper:  # the prior is too small
        variance = np.full(len(curvature), prior * goal / max(upper, 1e-300))
    else:
        low = high = float(np.log(max(remainder, 1e-300)))
        while excess(high) < 0.0:
            high += 1.0
        residual = np.exp(brentq(excess, low, high) if high > low else low)
        variance = residual / (curvature + residual / prior)
    turn = np.linspace(0.0, 1.0, _SAMPLES)
    spiral_V = _RADIUS * reach_V * turn * np.sin(2.0 * np.pi * _TURNS * turn)
    states = _states(spiral_V, reach_V)
    states = states - states.mean(axis=0)
    mean_m = vectors @ mean
    deviates = np.random.default_rng(SEED).standard_normal(len(mean_m))
    draw_m = vectors @ (np.sqrt(variance) * deviates)
    mean_path, draw_path = states @ mean_m, states @ draw_m
    share = float(draw_path @ mean_path) / max(float(mean_path @ mean_path), 1e-300)
    draw_m, draw_path = draw_m - share * mean_m, draw_path - share * mean_path
    expected = float(np.mean((states @ vectors) ** 2 @ variance))
    size = np.sqrt(expected / max(float(np.mean(draw_path**2)), 1e-300))
    return mean_m, draw_m * size
