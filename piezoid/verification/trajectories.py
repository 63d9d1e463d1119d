"""Spirals, rasters and steps about 0 in the unit circle or square."""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array, frozen, same_length

_CLV_CAP = 3.0
_TABLE = 20001
_ROUNDED = 0.1  # of a raster line, at either end, is turned on a parabola


@dataclass(frozen=True, kw_only=True, eq=False)
class Path:
    """Where to be, sample by sample; the radius is 1.

    x, y   (samples,)
    turns  how many turns a spiral has, 0 for anything else: its pitch is 1 / turns
    """

    x: Array
    y: Array
    turns: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "x", frozen(self.x, "x"))
        object.__setattr__(self, "y", frozen(self.y, "y"))
        same_length([("x", self.x), ("y", self.y)])


def constant_angular_velocity(rate_Hz: float, frequency_Hz: float, turns: float) -> Path:
    """Return an Archimedean spiral from the middle outwards, `frequency_Hz` turns a second.

    theta = 2 pi f t,   r = theta / (2 pi turns)
    """
    theta = 2.0 * np.pi * frequency_Hz / rate_Hz * np.arange(round(turns * rate_Hz / frequency_Hz))
    return _spiral(np.asarray(theta), turns)


def constant_linear_velocity(rate_Hz: float, frequency_Hz: float, turns: float) -> Path:
    """Return an Archimedean spiral of constant speed, `frequency_Hz` turns a second at its rim.

        ds/dtheta = p / (2 pi) sqrt(1 + theta^2),   dtheta/dt at most 3 times that at the rim

    The cap keeps the turns near the middle, where the radius is small, from being infinitely fast.
    """
    end = 2.0 * np.pi * turns
    theta = np.linspace(0.0, end, _TABLE)
    fastest = 2.0 * np.pi * frequency_Hz * np.sqrt(1.0 + end**2) / np.sqrt(1.0 + theta**2)
    turning = np.minimum(fastest, 2.0 * np.pi * frequency_Hz * _CLV_CAP)
    spent_s = np.concatenate([[0.0], np.cumsum(np.diff(theta) * 2 / (turning[1:] + turning[:-1]))])
    time_s = np.arange(int(spent_s[-1] * rate_Hz) + 1) / rate_Hz
    return _spiral(np.interp(time_s, spent_s, theta), turns)


def _spiral(theta: Array, turns: float) -> Path:
    r = theta / (2.0 * np.pi * turns)
    return Path(x=r * np.cos(theta), y=r * np.sin(theta), turns=turns)


def raster(rate_Hz: float, frequency_Hz: float, lines: float) -> Path:
    """Return to-and-fro lines in x, `frequency_Hz` of them a second, while y creeps from -1 to 1.

    It begins in the middle, so its first half second of a line leads in; the ends are rounded.
    """
    count = round(lines * rate_Hz / frequency_Hz)
    phase = np.arange(count) * frequency_Hz / rate_Hz
    x = _rounded_triangle(np.asarray(phase))
    y = np.linspace(0.0, 1.0, count)
    return Path(x=x, y=np.where(y < 0.25, -4.0 * y, (8.0 * y - 5.0) / 3.0))


def _rounded_triangle(phase: Array) -> Array:
    """Return a triangle of period 1 from 0 upwards, its corners parabolas, its peaks at 1."""
    folded = np.abs((phase + 0.25) % 1.0 - 0.5)  # 1/4 at the start, 0 at the upper corner
    width = 0.5 * _ROUNDED
    ends = np.minimum(folded, 0.5 - folded)
    straight = np.sign(0.25 - folded) * (0.25 - ends)
    cut = np.maximum(width - ends, 0.0) ** 2 / (2.0 * width)
    bent = np.sign(0.25 - folded) * (0.25 - ends - cut)
    found = np.where(ends < width, bent, straight)
    return np.asarray(found / (0.25 - 0.5 * width))


def steps(rate_Hz: float, hold_s: float) -> Path:
    """Return steps of x up and down, held; y does the same half a hold later."""
    levels = np.array([0.0, 0.5, 0.0, -0.5, 0.0, 0.9, -0.9, 0.0])
    hold = round(hold_s * rate_Hz)
    x = np.repeat(levels, hold)
    return Path(x=x, y=np.concatenate([np.zeros(hold // 2), x])[: len(x)])
