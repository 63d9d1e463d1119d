"""What following a raster and steps looked like in time: where an axis was to be, and was."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.verification.closed_loop import LoopRecord

POINTS = 1000  # of 0.8 s of steps: a loop of 350 Hz settles within three of them
SHOWN = ("raster", "steps")  # kinds of scenarios; spirals are kept as ``SpiralTrace``
BESIDE = "none"  # the method that is shown beside what ships
_DECIMALS = 12  # a picometre


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
        at = np.unique(np.linspace(0, count, POINTS, endpoint=False).astype(np.intp))
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
