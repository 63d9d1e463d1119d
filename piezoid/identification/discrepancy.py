"""What the model class does not follow, as a second hysteresis: for verification, never shipped.

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
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from piezoid.errors import IdentificationError
from piezoid.identification.hysteresis.certificate import adversarial_drives
from piezoid.identification.model import AxisModel, Discrepancy
from piezoid.identification.quality import FitQuality
from piezoid.identification.simulation import simulate_recording
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

PLAYS = 10
POWERS = 3
MOST_ROWS = 40_000  # of a recording
# Standard deviation of a weight, of half the stroke, by `python -m benchmarks.discrepancy`: on a
# spiral that no recording is like, d is as large as what the model misses there within a factor of
# 2 on 21 of 29 stages of strangers (4 of 29 with a ridge in its place) and on 52 of 78 of the zoo.
# With 0.04 and 0.08 about as many are; with 0.02 full cycles say a third of what is missed.
PRIOR = 0.06
_RIDGE = 1e-2  # of the mean square of a column, for what recordings say of slopes
_STEPPED = 20  # steps of the reach: over shorter ones a sampled slope is rounding
_TURNS, _SAMPLES, _FAR = 5, 5000, 0.7  # the spiral over which a draw is brought to its size
_RISES = 0.5  # of the model's least slope: with d the response rises, as that of any ceramic


@dataclass(frozen=True, kw_only=True, eq=False)
class _Class:
    """The plays and the powers of their states, over the range of the recorded drive."""

    centre_V: float
    reach_V: float

    @property
    def threshold_V(self) -> Array:
        return self.reach_V * np.linspace(0.0, 0.9, PLAYS)

    def states(self, away_V: Array) -> Array:
        """Return the powers of the states, (samples, powers * plays), power by power.

        away_V  (samples,)  of the drive from the middle of its range
        """
        threshold_V = self.threshold_V
        first_V = np.clip(np.zeros(PLAYS), away_V[0] - threshold_V, away_V[0] + threshold_V)
        z = play_columns(np.ascontiguousarray(away_V), threshold_V, first_V)[0] / self.reach_V
        return np.hstack([z**n for n in range(1, POWERS + 1)])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rows:
    """States and residual of one piece, thinned, without their means."""

    columns: Array
    residual_m: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class _Weights:
    """What a residual says of the weights, along axes in which they are independent.

    axes         (weights, weights)  one in a column
    mean_m       (weights,)  along them
    variance_m2  (weights,)  along them
    """

    axes: Array
    mean_m: Array
    variance_m2: Array


def with_discrepancy(
    axis: AxisModel, recordings: Sequence[Recording], *, seed: int = 0
) -> AxisModel:
    """Return the axis with what its class does not follow on the recordings of its fit.

    recordings  of the fit; one that the model does not know is passed over
    seed        of the draw

    Without such recordings it stays unknown, and verification says so by its figures alone.
    """
    low_V, high_V = axis.voltage_V
    wide = _Class(centre_V=0.5 * (low_V + high_V), reach_V=0.5 * (high_V - low_V))
    parts = [rows for recording in recordings for rows in _rows(axis, recording, wide)]
    if not parts:
        return replace(axis, discrepancy=None)
    columns = np.concatenate([part.columns for part in parts])
    residual_m = np.concatenate([part.residual_m for part in parts])
    weight_m = _drawn(_weights(columns, residual_m, axis.quality), wide, seed)
    rising, steepest_m_per_V = _slopes(axis, wide, weight_m, _told(columns, residual_m))
    unseen = 1.0
    if axis.quality.rms_m > 0.0:  # readings without noise may be followed to the last bit
        unseen = max(axis.quality.held_out_rms_m / axis.quality.rms_m, 1.0)
    return replace(
        axis,
        discrepancy=Discrepancy(
            centre_V=wide.centre_V,
            reach_V=wide.reach_V,
            threshold_V=wide.threshold_V,
            weight_m=rising * weight_m.reshape(POWERS, PLAYS),
            steepest_m_per_V=unseen * steepest_m_per_V,
        ),
    )


def _rows(axis: AxisModel, recording: Recording, wide: _Class) -> list[_Rows]:
    """Return what is known of every piece of one recording."""
    try:
        simulated_m = simulate_recording(axis, recording)
    except IdentificationError:
        return []
    drive_V = recording.voltage_V(axis.axis)
    residual_m = axis.polarity * (recording.displacement_m(axis.axis) - simulated_m)
    known = np.isfinite(residual_m)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(int), [0]])))
    step = max(recording.samples // MOST_ROWS, 1)
    found = []
    for first, last in pairwise(edges.tolist()):
        if not known[first]:
            continue
        states = wide.states(drive_V[first:last] - wide.centre_V)[::step]
        rest_m = residual_m[first:last:step]
        found.append(
            _Rows(columns=states - states.mean(axis=0), residual_m=rest_m - rest_m.mean())
        )
    return found


def _told(columns: Array, residual_m: Array) -> Array:
    """Return weights that follow the residual where many rows agree, (weights,)."""
    gram = columns.T @ columns
    ridge = _RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    return np.linalg.solve(gram + ridge, columns.T @ residual_m)


def _weights(columns: Array, residual_m: Array, quality: FitQuality) -> _Weights:
    """Return mean and variance of the weights, c ~ N(0, p) before the recordings.

        mean = (X'X + s^2 / p)^-1 X'r,   variance = v (X'X + v / p)^-1

    s^2 the residual's mean square. What is left beyond the sensor's noise, as much larger as the
    error on rows left out is than that of the fit, is what the variance must say of the rows, and
    v is found from that; it is at least what would be left if all rows were independent.
    """
    curvature, axes = np.linalg.eigh(columns.T @ columns)
    curvature, rows = np.maximum(curvature, 0.0), len(residual_m)
    slope, power = axes.T @ (columns.T @ residual_m), float(np.mean(residual_m**2))
    prior = (PRIOR * quality.range_m / 2.0) ** 2
    mean = slope / (curvature + power / prior)
    left = max(power + float(curvature @ mean**2 - 2.0 * mean @ slope) / rows, 1e-9 * power)
    unseen = max(quality.held_out_rms_m**2 / max(power, 1e-300), 1.0)
    missing = max(left * unseen - quality.noise_rms_m**2, 0.0)
    return _Weights(
        axes=axes, mean_m=mean, variance_m2=_widened(curvature, prior, left, missing * rows)
    )


def _widened(curvature: Array, prior: float, least: float, missing: float) -> Array:
    """Return variances of the weights that say as much of all rows together as is missing."""
    most = float(curvature.sum()) * prior
    if missing >= most:  # more than was taken for possible
        return np.full(len(curvature), prior * missing / max(most, 1e-300))

    def beyond(logarithm: float) -> float:
        width = np.exp(logarithm)
        return float(np.sum(curvature * width / (curvature + width / prior))) - missing

    low = high = float(np.log(max(least, 1e-300)))
    while beyond(high) < 0.0:
        high += 1.0
    width = np.exp(brentq(beyond, low, high) if high > low else low)
    return np.asarray(width / (curvature + width / prior))


def _drawn(known: _Weights, wide: _Class, seed: int) -> Array:
    """Return mean weights and a draw beside them that is as large on a spiral as draws are."""
    turn = np.linspace(0.0, 1.0, _SAMPLES)
    states = wide.states(_FAR * wide.reach_V * turn * np.sin(2.0 * np.pi * _TURNS * turn))
    states = states - states.mean(axis=0)
    mean_m = known.axes @ known.mean_m
    kicks = np.random.default_rng(seed).standard_normal(len(mean_m))
    draw_m = known.axes @ (np.sqrt(known.variance_m2) * kicks)
    followed, drawn = states @ mean_m, states @ draw_m
    share = float(drawn @ followed) / max(float(followed @ followed), 1e-300)
    draw_m, drawn = draw_m - share * mean_m, drawn - share * followed
    wanted = float(np.mean((states @ known.axes) ** 2 @ known.variance_m2))
    return np.asarray(mean_m + draw_m * np.sqrt(wanted / max(float(np.mean(drawn**2)), 1e-300)))


def _slopes(axis: AxisModel, wide: _Class, weight_m: Array, told_m: Array) -> tuple[float, float]:
    """Return which part of d leaves the response rising, and how much the told one is steeper.

    Both over the adversarial drives of the certificate.
    """
    away_V = adversarial_drives(wide.reach_V, seed=0)
    states, operator = wide.states(away_V), axis.operator
    followed_m, _ = operator.run(wide.centre_V + away_V, operator.virgin_memory())
    step_V = np.diff(away_V)
    long = np.abs(step_V) > wide.reach_V / (_STEPPED * PLAYS)
    slope, beside, told = (
        np.diff(moved_m)[long] / step_V[long]
        for moved_m in (followed_m, states @ weight_m, states @ told_m)
    )
    room = np.maximum(slope - _RISES * slope.min(), 1e-300)
    return 1.0 / float(np.max(-beside / room, initial=1.0)), float(np.abs(told).max(initial=0.0))
