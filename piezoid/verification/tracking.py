"""Signals of a run in closed loop, its tracking errors, and its traces for the report.

The errors are rms, largest error, and shape error after the best common delay. The traces of
spirals, rasters and steps are thinned to a few hundred points.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.runtime.schema import METHODS
from piezoid.verification.scenarios import Path

if TYPE_CHECKING:
    from pandas import DataFrame

_LONGEST_DELAY_s = 5e-3
_QUARTER = 0.25  # of a turn, beyond which the best delay is not unique
_ITERATIONS = 12
_ANGLES = 8

MOTION_POINTS = 1000  # of 0.8 s of steps: a loop of 350 Hz settles within three of them
MOTION_KINDS = ("raster", "steps")  # of scenarios plotted over time
SPIRAL_POINTS = 300
SPIRALS_Hz = (10.0, 100.0)  # compared spirals that are plotted
UNCOMPENSATED = "none"  # method plotted with the shipped method
_DECIMALS = 12  # a picometre

# Values of a file that a stage can have and a picture can show.
MethodName = Annotated[str, msgspec.Meta(pattern=f"^({'|'.join(METHODS)})$")]
Plottable_Hz = Annotated[float, msgspec.Meta(ge=1e-9, le=1e9)]
Plottable_s = Annotated[float, msgspec.Meta(ge=1e-9, le=1e9)]
Plottable_m = Annotated[float, msgspec.Meta(ge=-1e3, le=1e3)]


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopRecord:
    """Signals of one axis in closed loop.

    reference  (samples,)  m (junction: A)
    position   (samples,)  m (junction: A), in front of the sensor
    measured   (samples,)  reading of the controller
    voltage_V  (samples,)  output of the controller
    status     (samples,)  the runtime's bits
    driven     (samples,)  largest input of the response in a sample: V behind the amplifier
               (junction: nepers, the tip's extension times the decay)
    unit       of reference, position and measured: ``m`` or ``A``
    """

    axis: str
    sampling_rate_Hz: float
    reference: Array
    position: Array
    measured: Array
    voltage_V: Array
    status: NDArray[np.uint32]
    driven: Array
    unit: str = "m"

    @property
    def time_s(self) -> Array:
        """Time of every sample from the first, (samples,)."""
        return np.asarray(np.arange(len(self.reference)) / self.sampling_rate_Hz)

    @property
    def error(self) -> Array:
        """Reference less position, (samples,), m (junction: A)."""
        return np.asarray(self.reference - self.position)

    @property
    def rms_error(self) -> float:
        """Root of the mean squared error."""
        return float(np.sqrt(np.mean(self.error**2)))

    def after(self, samples: int) -> "LoopRecord":
        """Return the record without its first samples.

        >>> reference_m = np.full(4000, model["x"].zero_m)
        >>> loop = piezoid.simulate_loop(model, reference_m, shipping)
        >>> len(loop.after(1000).error)
        3000
        """
        names = ("reference", "position", "measured", "voltage_V", "status", "driven")
        return replace(self, **{name: getattr(self, name)[samples:] for name in names})

    def to_frame(self) -> "DataFrame":
        """Return a pandas DataFrame, a row for each sample; positions in m (junction: A).

        >>> loop = piezoid.simulate_loop(model, np.full(4000, model["x"].zero_m), shipping)
        >>> list(loop.to_frame())[:3]
        ['time_s', 'reference', 'position']
        """
        from pandas import DataFrame

        names = ("time_s", "reference", "position", "measured", "voltage_V", "error", "status")
        return DataFrame({name: getattr(self, name) for name in names})


@dataclass(frozen=True, kw_only=True)
class Tracking:
    """Errors along a path, as distances in the plane.

    rms_m          sqrt(mean(e_x^2 + e_y^2))
    rms_percent    of the path's diameter
    max_m          largest distance
    aligned_rms_m  shape error, rms: distance from the path after the best common delay
    delay_s        best common delay, positive if the stage lags
    radial_rms_m   of |position| - |reference|, about the centre of the path
    pitch_error    standard deviation of the distance between adjacent turns, relative to the
                   pitch; None for a path without turns, and for a single axis
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
    """Return the tracking errors of positions, (samples,) by axis, relative to the path's centre.

    radius_m  of the path; references and positions are relative to its centre as well
    """
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
    longest_s            bound of the delay; the record is shortened by it at both ends, to at
                         least two samples
    """
    from scipy.interpolate import CubicSpline

    samples = reference.shape[1]
    longest = min(longest_s * sampling_rate_Hz, (samples - 2) // 2)
    margin = int(np.ceil(longest))
    inner = position[:, margin : samples - margin]
    # (power, axes, samples - 1): powers of the share of an interval, the highest first
    spline = CubicSpline(np.arange(samples), reference, axis=1)
    pieces = np.ascontiguousarray(np.swapaxes(spline.c, 1, 2))
    delay = 0.0  # in samples
    for _ in range(_ITERATIONS):
        delayed, slope = _evaluate_delayed(pieces, margin, inner.shape[1], delay)
        power = float(np.sum(slope**2))
        if power == 0.0:
            break
        change = float(np.sum((inner - delayed) * slope)) / power
        previous, delay = delay, float(np.clip(delay - change, -longest, longest))
        if delay == previous:
            break
    delayed, _ = _evaluate_delayed(pieces, margin, inner.shape[1], delay)
    rms = float(np.sqrt(np.sum((inner - delayed) ** 2) / inner.shape[1]))
    return rms, delay / sampling_rate_Hz


def _evaluate_delayed(pieces: Array, first: int, count: int, delay: float) -> tuple[Array, Array]:
    """Return a spline and its slope per sample, (axes, count), a delay before consecutive samples.

    All samples lie at the same share of their intervals, so that no interval is searched for.
    """
    samples = int(np.ceil(delay))
    begin = min(max(first - samples, 0), pieces.shape[2] - count)
    t = first - delay - begin
    c3, c2, c1, c0 = pieces[:, :, begin : begin + count]
    return ((c3 * t + c2) * t + c1) * t + c0, (3.0 * c3 * t + 2.0 * c2) * t + c1


def _pitch_error(position: Array, path: Path, radius_m: float) -> float | None:
    """Return the standard deviation of the distance between adjacent turns, over the pitch."""
    angle = np.maximum.accumulate(np.unwrap(np.arctan2(position[1], position[0])))
    r = np.hypot(position[0], position[1])
    turns = int((angle[-1] - angle[0]) / (2.0 * np.pi)) - 1
    if path.turns == 0 or turns < 2:
        return None
    spacings = []
    for k in range(_ANGLES):
        first = angle[0] + 2.0 * np.pi * (1.0 + k / _ANGLES)  # the first turn has no direction
        turn = first + 2.0 * np.pi * np.arange(turns)
        spacings.append(np.diff(np.interp(turn[turn <= angle[-1]], angle, r)))
    return float(np.std(np.concatenate(spacings)) / (radius_m / path.turns))


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Trace of one axis along one path, relative to the path's centre.

    scenario         name
    duration_s       of the path
    reference_m      (points,)
    shipped_m        (points,)  position with the shipped controller
    uncompensated_m  (points,)  position with a static gain; empty if that was not simulated
    """

    scenario: str
    axis: str
    duration_s: Plottable_s
    reference_m: tuple[Plottable_m, ...]
    shipped_m: tuple[Plottable_m, ...]
    uncompensated_m: tuple[Plottable_m, ...]


@dataclass(frozen=True, kw_only=True)
class SpiralTrace:
    """Trace of a spiral relative to its centre, with its shape error.

    method, frequency_Hz   as in the comparison
    axes                   that moved; with a single axis, y is the path of the missing axis
    x_m, y_m               (points,)
    shape_error_m          (points,)  distance from the path after the best common delay, rms from
                           this point to the next
    """

    method: MethodName
    frequency_Hz: Plottable_Hz
    axes: tuple[str, ...]
    x_m: tuple[Plottable_m, ...]
    y_m: tuple[Plottable_m, ...]
    shape_error_m: tuple[Plottable_m, ...]


def spiral_trace(
    method: str,
    records: Mapping[str, LoopRecord],
    *,
    path: Path,
    delay_s: float,
    centre_m: Mapping[str, float],
    radius_m: float,
    frequency_Hz: float,
) -> SpiralTrace:
    """Thin the records of one spiral, by axis, to ``SPIRAL_POINTS`` positions."""
    from scipy.interpolate import CubicSpline

    reference, position = (
        np.stack([getattr(record, name) - centre_m[axis] for axis, record in records.items()])
        for name in ("reference", "position")
    )
    # The path is constant before and after the record.
    time_s = next(iter(records.values())).time_s
    delayed = CubicSpline(time_s, reference, axis=1)(np.clip(time_s - delay_s, 0.0, time_s[-1]))
    error_m = np.asarray(np.sqrt(np.sum((position - delayed) ** 2, axis=0)))
    samples = np.linspace(0, len(error_m), SPIRAL_POINTS, endpoint=False)
    starts = np.unique(samples.astype(np.intp))
    second = position[1] if len(records) > 1 else radius_m * path.y
    return SpiralTrace(
        method=method,
        frequency_Hz=frequency_Hz,
        axes=tuple(records),
        x_m=_rounded(position[0][starts]),
        y_m=_rounded(second[starts]),
        shape_error_m=_rounded(rms_from(starts, error_m)),
    )


def rms_from(starts: NDArray[np.intp], values: Array) -> Array:
    """Return the rms of values from each start to the next, (starts,)."""
    counts = np.diff(np.append(starts, len(values)))
    return np.asarray(np.sqrt(np.add.reduceat(values**2, starts) / counts))


def motion_of(
    scenario: str, shipped: LoopRecord, uncompensated: LoopRecord | None, centre_m: float
) -> Motion:
    """Thin the runs of one axis in one scenario to ``MOTION_POINTS`` positions."""
    samples = np.linspace(0, len(shipped.reference), MOTION_POINTS, endpoint=False)
    rows = np.unique(samples.astype(np.intp))
    uncompensated_m: tuple[float, ...] = ()
    if uncompensated is not None:
        uncompensated_m = _rounded(uncompensated.position[rows] - centre_m)
    return Motion(
        scenario=scenario,
        axis=shipped.axis,
        duration_s=len(shipped.reference) / shipped.sampling_rate_Hz,
        reference_m=_rounded(shipped.reference[rows] - centre_m),
        shipped_m=_rounded(shipped.position[rows] - centre_m),
        uncompensated_m=uncompensated_m,
    )


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(np.round(values, _DECIMALS).tolist())
