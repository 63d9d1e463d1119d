"""Tracking error of a run: rms, largest error, and the shape error after the best delay."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.verification.scenarios import Path

_LONGEST_DELAY_s = 5e-3
_QUARTER = 0.25  # of a turn: beyond it another delay would fit as well
_ITERATIONS = 12
_ANGLES = 8


@dataclass(frozen=True, kw_only=True)
class Tracking:
    """Errors along a path; they are distances in the plane.

    rms_m          sqrt(mean(e_x^2 + e_y^2))
    rms_percent    of the path's diameter
    max_m          the largest
    aligned_rms_m  shape error, rms: distance from the path after the best common delay
    delay_s        that delay, positive where the stage is late
    radial_rms_m   of |position| - |reference|, about the middle of the path
    pitch_error    standard deviation of the distance between neighbouring turns, relative to the
                   pitch; None where there are no turns, or only one axis
    """

    rms_m: float
    rms_percent: float
    max_m: float
    aligned_rms_m: float
    delay_s: float
    radial_rms_m: float
    pitch_error: float | None


def track(
    reference: Mapping[str, Array],
    position: Mapping[str, Array],
    *,
    path: Path,
    radius_m: float,
    frequency_Hz: float,
    sampling_rate_Hz: float,
) -> Tracking:
    """Compare positions with references, (samples,) by axis, both about the path's middle."""
    references = np.stack([reference[axis] for axis in reference])
    positions = np.stack([position[axis] for axis in reference])
    error = np.sqrt(np.sum((positions - references) ** 2, axis=0))
    longest_s = min(_LONGEST_DELAY_s, _QUARTER / frequency_Hz)
    aligned, delay_s = align(references, positions, sampling_rate_Hz, longest_s)
    rms = float(np.sqrt(np.mean(error**2)))
    radial = np.sqrt(np.sum(positions**2, axis=0)) - np.sqrt(np.sum(references**2, axis=0))
    return Tracking(
        rms_m=rms,
        rms_percent=100.0 * rms / (2.0 * radius_m),
        max_m=float(error.max()),
        aligned_rms_m=aligned,
        delay_s=delay_s,
        radial_rms_m=float(np.sqrt(np.mean(radial**2))),
        pitch_error=_pitch_error(positions, path, radius_m) if len(positions) == 2 else None,
    )


def align(
    reference: Array, position: Array, sampling_rate_Hz: float, longest_s: float
) -> tuple[float, float]:
    """Return the rms after the best common delay, and the delay.

        minimise over tau  sum_axes sum_k |y(t_k) - r(t_k - tau)|^2     by Gauss-Newton from 0

    reference, position  (axes, samples)  four samples or more
    longest_s            bound of the delay; both ends of the record are left out by as much, down
                         to two samples
    """
    from scipy.interpolate import CubicSpline

    samples = reference.shape[1]
    longest = min(longest_s * sampling_rate_Hz, (samples - 2) // 2)
    out = int(np.ceil(longest))
    inner = position[:, out : samples - out]
    # (power, axes, samples - 1): powers of the share of an interval, the highest first
    spline = CubicSpline(np.arange(samples), reference, axis=1)
    pieces = np.ascontiguousarray(np.swapaxes(spline.c, 1, 2))
    delay = 0.0  # in samples
    for _ in range(_ITERATIONS):
        delayed, rate = _earlier(pieces, out, inner.shape[1], delay)
        power = float(np.sum(rate**2))
        if power == 0.0:
            break
        change = float(np.sum((inner - delayed) * rate)) / power
        previous, delay = delay, float(np.clip(delay - change, -longest, longest))
        if delay == previous:
            break
    delayed, _ = _earlier(pieces, out, inner.shape[1], delay)
    rms = float(np.sqrt(np.sum((inner - delayed) ** 2) / inner.shape[1]))
    return rms, delay / sampling_rate_Hz


def _earlier(pieces: Array, first: int, count: int, delay: float) -> tuple[Array, Array]:
    """Return signal and slope a delay before so many samples, (axes, count), slope per sample.

    Every sample lies at the same share of its interval, so that no interval is searched for.
    """
    samples = int(np.ceil(delay))
    begin = min(max(first - samples, 0), pieces.shape[2] - count)
    t = first - delay - begin
    c3, c2, c1, c0 = pieces[:, :, begin : begin + count]
    return ((c3 * t + c2) * t + c1) * t + c0, (3.0 * c3 * t + 2.0 * c2) * t + c1


def shape_error(
    reference: Array, position: Array, sampling_rate_Hz: float, delay_s: float
) -> Array:
    """Return the shape error, the distance from the path after a common delay, sample by sample.

    reference, position  (axes, samples)
    returned             (samples,); outside the record the path stands still
    """
    from scipy.interpolate import CubicSpline

    time_s = np.arange(reference.shape[1]) / sampling_rate_Hz
    delayed = CubicSpline(time_s, reference, axis=1)(np.clip(time_s - delay_s, 0.0, time_s[-1]))
    return np.asarray(np.sqrt(np.sum((position - delayed) ** 2, axis=0)))


def _pitch_error(position: Array, path: Path, radius_m: float) -> float | None:
    """Return the standard deviation of the distance between neighbouring turns, over the pitch."""
    angle = np.maximum.accumulate(np.unwrap(np.arctan2(position[1], position[0])))
    r = np.hypot(position[0], position[1])
    turns = int((angle[-1] - angle[0]) / (2.0 * np.pi)) - 1
    if path.turns == 0 or turns < 2:
        return None
    spacings = []
    for k in range(_ANGLES):
        first = angle[0] + 2.0 * np.pi * (1.0 + k / _ANGLES)  # the first turn has no direction
        at = first + 2.0 * np.pi * np.arange(turns)
        spacings.append(np.diff(np.interp(at[at <= angle[-1]], angle, r)))
    return float(np.std(np.concatenate(spacings)) / (radius_m / path.turns))
