"""What a spiral looked like: a few hundred places with the error there, for a picture."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.verification.closed_loop import LoopRecord
from piezoid.verification.scenarios import Path
from piezoid.verification.tracking import Tracking, shape_error

MOTION_POINTS = 1000  # of 0.8 s of steps: a loop of 350 Hz settles within three of them
SHOWN = ("raster", "steps")  # kinds of scenarios; spirals are kept as ``SpiralTrace``


@dataclass(frozen=True, kw_only=True)
class Motion:
    """One axis along one path, about the path's middle.

    scenario         its name
    duration_s       from the first place to one step after the last
    reference_m      (points,)
    shipped_m        (points,)  position under what ships
    uncompensated_m  (points,)  under a static gain; empty where it was not run
    """

    scenario: str
    axis: str
    duration_s: float
    reference_m: tuple[float, ...]
    shipped_m: tuple[float, ...]
    uncompensated_m: tuple[float, ...]


POINTS = 300
TRACED_Hz = (10.0, 100.0)  # spirals of these frequencies are kept
TRACED_BESIDE = "none"  # the method that is kept beside what ships
_DECIMALS = 12  # a picometre


@dataclass(frozen=True, kw_only=True)
class SpiralTrace:
    """Where a spiral went, about its middle, and how far its shape was wrong there.

    method, frequency_Hz   as in the comparison
    axes                   that moved; with one only, y is where a second one should have been
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


def is_traced(method: str, shipped: str, frequency_Hz: float) -> bool:
    """Return whether this run is kept for a picture."""
    return method in (shipped, TRACED_BESIDE) and frequency_Hz in TRACED_Hz


def trace_of(
    method: str,
    found: Tracking,
    reference: Mapping[str, Array],
    position: Mapping[str, Array],
    *,
    path: Path,
    radius_m: float,
    frequency_Hz: float,
    sampling_rate_Hz: float,
) -> SpiralTrace:
    """Thin one run, (samples,) by axis about the path's middle, to ``POINTS`` places."""
    axes = tuple(reference)
    wanted = np.stack([reference[axis] for axis in axes])
    moved = np.stack([position[axis] for axis in axes])
    error = shape_error(wanted, moved, sampling_rate_Hz, found.delay_s)
    starts = np.unique(np.linspace(0, len(error), POINTS, endpoint=False).astype(np.intp))
    second = moved[1] if len(axes) > 1 else radius_m * path.y
    return SpiralTrace(
        method=method,
        frequency_Hz=frequency_Hz,
        axes=axes,
        x_m=_rounded(moved[0][starts]),
        y_m=_rounded(second[starts]),
        shape_error_m=_rounded(rms_from(starts, error)),
    )


def rms_from(starts: NDArray[np.intp], values: Array) -> Array:
    """Return the rms of values from each start to the next, (starts,)."""
    counts = np.diff(np.append(starts, len(values)))
    return np.asarray(np.sqrt(np.add.reduceat(values**2, starts) / counts))


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(np.round(values, _DECIMALS).tolist())


def motions_of(
    scenario: str,
    shipped: Mapping[str, LoopRecord],
    beside: Mapping[str, LoopRecord],
    centre_m: Mapping[str, float],
    rate_Hz: float,
) -> tuple[Motion, ...]:
    """Thin the runs of one scenario to ``POINTS`` places, axis by axis."""
    found = []
    for axis, record in shipped.items():
        count = len(record.reference)
        at = np.unique(np.linspace(0, count, MOTION_POINTS, endpoint=False).astype(np.intp))
        other = beside.get(axis)
        found.append(
            Motion(
                scenario=scenario,
                axis=axis,
                duration_s=count / rate_Hz,
                reference_m=_about(record.reference[at], centre_m[axis]),
                shipped_m=_about(record.position[at], centre_m[axis]),
                uncompensated_m=()
                if other is None
                else _about(other.position[at], centre_m[axis]),
            )
        )
    return tuple(found)


def _about(values_m: Array, centre_m: float) -> tuple[float, ...]:
    return tuple(np.round(values_m - centre_m, _DECIMALS).tolist())
