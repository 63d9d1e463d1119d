"""Traces of spirals, rasters and steps for the report, thinned to a few hundred points."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.verification.closed_loop import LoopRecord
from piezoid.verification.scenarios import Path
from piezoid.verification.tracking import shape_error

MOTION_POINTS = 1000  # of 0.8 s of steps: a loop of 350 Hz settles within three of them
MOTION_KINDS = ("raster", "steps")  # of scenarios plotted over time
SPIRAL_POINTS = 300
SPIRALS_Hz = (10.0, 100.0)  # compared spirals that are plotted
UNCOMPENSATED = "none"  # method plotted with the shipped method
_DECIMALS = 12  # a picometre


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
    duration_s: float
    reference_m: tuple[float, ...]
    shipped_m: tuple[float, ...]
    uncompensated_m: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class SpiralTrace:
    """Trace of a spiral relative to its centre, with its shape error.

    method, frequency_Hz   as in the comparison
    axes                   that moved; with a single axis, y is the path of the missing axis
    x_m, y_m               (points,)
    shape_error_m          (points,)  distance from the path after the best common delay, rms from
                           this point to the next
    """

    method: str
    frequency_Hz: float
    axes: tuple[str, ...]
    x_m: tuple[float, ...]
    y_m: tuple[float, ...]
    shape_error_m: tuple[float, ...]


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
    reference, position = (
        np.stack([getattr(record, name) - centre_m[axis] for axis, record in records.items()])
        for name in ("reference", "position")
    )
    rate_Hz = next(iter(records.values())).sampling_rate_Hz
    error_m = shape_error(reference, position, rate_Hz, delay_s)
    starts = _evenly(len(error_m), SPIRAL_POINTS)
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
    rows = _evenly(len(shipped.reference), MOTION_POINTS)
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


def _evenly(count: int, points: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, count, points, endpoint=False).astype(np.intp))


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(np.round(values, _DECIMALS).tolist())
