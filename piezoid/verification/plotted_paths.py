"""Paths for the report: spirals, rasters and steps, thinned to a few hundred points."""

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
UNCOMPENSATED = "none"  # method plotted beside the one that ships
_DECIMALS = 12  # a picometre


@dataclass(frozen=True, kw_only=True)
class Motion:
    """One axis along one path, about the path's centre.

    scenario         its name
    duration_s       of the path
    reference_m      (points,)
    shipped_m        (points,)  position under the controller that ships
    uncompensated_m  (points,)  under a static gain; empty where it was not run
    """

    scenario: str
    axis: str
    duration_s: float
    reference_m: tuple[float, ...]
    shipped_m: tuple[float, ...]
    uncompensated_m: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class SpiralTrace:
    """Positions on a spiral about its centre, and the shape error there.

    method, frequency_Hz   as in the comparison
    axes                   that moved; with a single axis, y is the path of the missing one
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
    """Thin the run of one spiral, records by axis, to ``SPIRAL_POINTS`` positions."""
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
    at = _evenly(len(shipped.reference), MOTION_POINTS)
    compared = () if uncompensated is None else _rounded(uncompensated.position[at] - centre_m)
    return Motion(
        scenario=scenario,
        axis=shipped.axis,
        duration_s=len(shipped.reference) / shipped.sampling_rate_Hz,
        reference_m=_rounded(shipped.reference[at] - centre_m),
        shipped_m=_rounded(shipped.position[at] - centre_m),
        uncompensated_m=compared,
    )


def _evenly(count: int, points: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, count, points, endpoint=False).astype(np.intp))


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(np.round(values, _DECIMALS).tolist())
