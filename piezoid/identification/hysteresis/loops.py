"""Loops of drive against displacement, seen without any model."""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array, freeze
from piezoid.records.reversals import reversals_of

POINTS = 41
GAP = 0.2  # of a branch, passed between two samples: a parabola's chord is off by its square, 4 %


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """The opening of one loop: falling branch minus rising branch at the same drive.

    drive     (points,)  inside the span that both branches share
    opening   (points,)  positive where the displacement lags the drive
    rise      (points,)  the rising branch
    span      drive range of the loop
    """

    drive: Array
    opening: Array
    rise: Array
    span: float

    def __post_init__(self) -> None:
        freeze(self, "drive", "opening", "rise")


def loops_of(drive: Array, response: Array, noise: float) -> tuple[Loop, ...]:
    """Return the loops made by successive rising and falling branches of nearly equal span.

    A branch that the drive jumped over was never seen, and makes no loop.

    drive, response  (samples,)
    noise            excursions of the drive that make no reversal
    """
    turns = np.array(reversals_of(drive, noise), dtype=int)
    found = []
    for a, b, c in zip(turns[:-2], turns[1:-1], turns[2:], strict=True):
        first, second = drive[b] - drive[a], drive[c] - drive[b]
        if abs(first + second) > 0.15 * abs(first):
            continue
        rising = slice(a, b + 1) if first > 0 else slice(b, c + 1)
        falling = slice(b, c + 1) if first > 0 else slice(a, b + 1)
        if max(_widest_gap(drive[rising]), _widest_gap(drive[falling])) > GAP * abs(first):
            continue
        found.append(_loop(drive, response, rising, falling))
    return tuple(found)


def _loop(drive: Array, response: Array, rising: slice, falling: slice) -> Loop:
    low = max(drive[rising].min(), drive[falling].min())
    high = min(drive[rising].max(), drive[falling].max())
    grid = np.linspace(low, high, POINTS + 2)[1:-1]
    up = _on(grid, drive[rising], response[rising])
    down = _on(grid, drive[falling], response[falling])
    return Loop(drive=grid, opening=down - up, rise=up, span=float(high - low))


def _widest_gap(drive: Array) -> float:
    return float(np.diff(np.sort(drive)).max())


def _on(grid: Array, drive: Array, response: Array) -> Array:
    """Return a branch on a grid of the drive: the mean of the samples around each point."""
    order = np.argsort(drive, kind="stable")
    edges = np.concatenate([[-np.inf], (grid[1:] + grid[:-1]) / 2, [np.inf]])
    place = np.searchsorted(drive[order], edges)
    place[0], place[-1] = np.searchsorted(
        drive[order], [1.5 * grid[0] - 0.5 * grid[1], 1.5 * grid[-1] - 0.5 * grid[-2]]
    )
    sums = np.concatenate([[0.0], np.cumsum(response[order])])
    count = np.diff(place)
    mean = np.diff(sums[place]) / np.maximum(count, 1)
    interpolated = np.interp(grid, drive[order], response[order])
    return np.asarray(np.where(count > 2, mean, interpolated))
