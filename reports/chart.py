"""Charts: two axes in engineering units, and layers as SVG paths on a grid of fine steps.

Paths consist of integers, each relative to the previous point: they are short, and the same bytes
on every machine. One step is a twentieth of a pixel, so that curves can be magnified.
"""

import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.formatting import Scale, scale_for
from piezoid.numerics.arrays import Array, runs_of
from piezoid_reports.quantities import MINUS

MAX_SPLIT = 50_000  # samples of a curve at which it may be split
Indices = NDArray[np.int_]

MAX_INTERVALS = 7  # between labels
MIN_LABELS = 3  # on a logarithmic axis
MANTISSAS = ((1,), (1, 2, 5), tuple(range(1, 10)))

Ticks = tuple[tuple[float, str], ...]  # position along the axis, label

WIDTH, HEIGHT = 640, 360  # pixels
STEPS = 20  # fine steps per pixel
INVISIBLE = 0.15 * STEPS
TIME_STEPS = 10_000  # resolution of the times of points, per duration of a recording
BINS = 520
MARGIN = 0.04  # of the range, added at both ends of an axis


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One axis of a chart.

    label      name of the quantity, without unit
    scale      the unit it is shown in
    low, high  ends of the axis, in that unit
    decades    the axis is logarithmic: values are log10 of the labelled numbers
    """

    label: str
    scale: Scale
    low: float
    high: float
    decades: bool = False

    @property
    def ticks(self) -> tuple[tuple[float, str], ...]:
        """Round numbers along the axis: position as a fraction of its length, and label."""
        numbers = (decade_ticks if self.decades else even_ticks)(self.low, self.high)
        length = self.high - self.low
        return tuple(((value - self.low) / length, label) for value, label in numbers)

    def positions(self, values: Array, length: int) -> Array:
        """Return the positions of SI values, in fine steps from the low end."""
        scaled = np.asarray(values) / self.scale.factor
        return np.asarray((scaled - self.low) / (self.high - self.low) * (length * STEPS))


@dataclass(frozen=True, kw_only=True)
class Layer:
    """One curve or band.

    role   decides colour and stroke: ``measured``, ``model``, ``noise``, ...
    name   for the legend
    path   its points, in fine steps
    kind   ``line`` or ``area``
    times  time of each point in 1 / ``TIME_STEPS`` of the recording, or empty
    """

    role: str
    name: str
    path: str
    kind: str
    times: str = ""


def axis_over(label: str, values: Sequence[Array], unit: str, *, symmetric: bool = False) -> Axis:
    """Return an axis over all finite values, on request symmetric about zero."""
    finite = np.concatenate([np.asarray(v)[np.isfinite(v)] for v in values])
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    if symmetric:
        high = max(abs(low), abs(high))
        low = -high
    if high <= low:
        spread = abs(high) or 1.0
        low, high = low - 0.5 * spread, high + 0.5 * spread
    scale = scale_for(max(abs(low), abs(high)), unit)
    margin = MARGIN * (high - low)
    return Axis(
        label=label,
        scale=scale,
        low=(low - margin) / scale.factor,
        high=(high + margin) / scale.factor,
    )


def axis_from_zero(label: str, largest: float, unit: str) -> Axis:
    """Return an axis from zero to slightly above a value in SI units."""
    scale = scale_for(largest, unit)
    high = (1.0 + MARGIN) * (largest or 1.0) / scale.factor
    return Axis(label=label, scale=scale, low=0.0, high=high)


def decades_over(label: str, values: Sequence[Array], unit: str) -> Axis:
    """Return a logarithmic axis; values are log10 of numbers in ``unit``, prefix included."""
    linear = axis_over(label, values, "")
    return replace(linear, scale=Scale(factor=1.0, unit=unit), decades=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class Canvas:
    """Two axes and the area on which layers are drawn."""

    x: Axis
    y: Axis
    width: int = WIDTH
    height: int = HEIGHT

    def line(
        self, role: str, name: str, x: Array, y: Array, *, points: int = 2400, timed: bool = False
    ) -> Layer:
        """Draw a curve with at most ``points`` points.

        timed  save the time of each point; the samples must be evenly spaced in time
        """
        across, up = self.x.positions(x, self.width), self.y.positions(y, self.height)
        parts = finite_runs(across + up)
        total = max(sum(part.stop - part.start for part in parts), 1)
        path = ""
        times: list[int] = []
        for part in parts:
            share = max(2, int(points * (part.stop - part.start) / total))
            a, b = across[part], up[part]
            indices = simplify_curve(a, b, tolerance=INVISIBLE, points=share)
            path += self._path(a[indices], b[indices], repeats=timed)
            if timed:
                times += (TIME_STEPS * (indices + part.start) // len(x)).tolist()
        return Layer(role=role, name=name, path=path, kind="line", times=" ".join(map(str, times)))

    def dots(self, role: str, name: str, x: Array, y: Array) -> Layer:
        """Draw a dot for every pair of finite values, as a stroke of zero length."""
        is_finite = np.isfinite(x) & np.isfinite(y)
        across = self.x.positions(x[is_finite], self.width)
        up = self.y.positions(y[is_finite], self.height)
        strokes = (self._path(across[k : k + 1], up[k : k + 1]) for k in range(len(across)))
        return Layer(role=role, name=name, path="".join(strokes), kind="line")

    def band(self, role: str, name: str, x: Array, low: Array, high: Array) -> Layer:
        """Draw the area between two curves."""
        across = self.x.positions(x, self.width)
        up = np.concatenate(
            [self.y.positions(high, self.height), self.y.positions(low, self.height)[::-1]]
        )
        path = self._path(np.concatenate([across, across[::-1]]), up) + "z"
        return Layer(role=role, name=name, path=path, kind="area")

    def quantiles(self, role: str, name: str, share: str, bins: Array) -> tuple[Layer, ...]:
        """Draw the band between two quantiles, and the median; nothing for less than two bins.

        share  of the values in the band, for the legend
        bins   (bins, 4)  coordinate, low quantile, median, high quantile
        """
        if len(bins) < 2:
            return ()
        middle, low, median, high = bins.T
        return (
            self.band(f"{role}-band", f"{name}: {share}", middle, low, high),
            self.line(role, f"{name}: median", middle, median),
        )

    def range_over_time(self, role: str, name: str, x: Array, y: Array) -> Layer:
        """Draw minimum and maximum of y in every bin, or a line if the samples are few."""
        path = ""
        is_line = np.isfinite(y).sum() <= 2 * BINS
        for part in finite_runs(y):
            if is_line:
                across = self.x.positions(x[part], self.width)
                path += self._path(across, self.y.positions(y[part], self.height))
                continue
            share = max(2, round(BINS * (part.stop - part.start) / len(y)))
            path += self.band(role, name, *envelope(x[part], y[part], share)).path
        return Layer(role=role, name=name, path=path, kind="line" if is_line else "area")

    def _path(self, across: Array, up: Array, *, repeats: bool = False) -> str:
        """Write points as one relative path, with y downwards as in SVG.

        repeats  also write points that coincide with the previous point
        """
        x = np.rint(across).astype(int)
        y = np.rint(self.height * STEPS - up).astype(int)
        dx, dy = np.diff(x), np.diff(y)
        steps = [f"{a},{b}" for a, b in zip(dx.tolist(), dy.tolist(), strict=True)]
        steps = [step for step in steps if repeats or step != "0,0"]
        # A minus needs no separator before it.
        text = " ".join(steps).replace(" -", "-").replace(",-", "-")
        return f"M{x[0]},{y[0]}l{text or '0,0'}"


def even_ticks(low: float, high: float) -> Ticks:
    """Return round numbers from low to high."""
    # The smallest of 1, 2, 5 times a power of ten that gives few enough intervals.
    size = (high - low) / MAX_INTERVALS
    power = 10.0 ** math.floor(math.log10(size))
    step = next((d * power for d in (1.0, 2.0, 5.0) if size <= d * power * 1.0000001), 10 * power)
    first, stop = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return tuple(
        (k * step, f"{k * step + 0.0:.{decimals}f}".replace("-", MINUS))
        for k in range(first, stop + 1)
    )


def decade_ticks(low: float, high: float) -> Ticks:
    """Return round numbers on a logarithmic axis; ends and positions are log10."""
    for mantissas in MANTISSAS:
        numbers = [
            (k + math.log10(m), m, k)
            for k in range(math.floor(low), math.ceil(high) + 1)
            for m in mantissas
            if low - 1e-9 <= k + math.log10(m) <= high + 1e-9
        ]
        if len(numbers) >= MIN_LABELS:
            spacing = math.ceil(len(numbers) / MAX_INTERVALS) if mantissas == (1,) else 1
            return tuple((value, _power(m, k)) for value, m, k in numbers if k % spacing == 0)
    ticks = even_ticks(10.0**low, 10.0**high)
    return tuple((math.log10(value), label) for value, label in ticks if value > 0.0)


def _power(mantissa: int, power: int) -> str:
    if 0 <= power < 6:
        return str(mantissa * 10**power)
    if -4 <= power < 0:
        return f"{mantissa * 10.0**power:.{-power}f}"
    return f"{mantissa}e{power}".replace("-", MINUS)


def simplify_curve(x: Array, y: Array, *, tolerance: float, points: int) -> Indices:
    """Return the samples of a polyline that stays close to a curve.

    The chord with the largest distance is split at its farthest sample, until no distance exceeds
    the tolerance or ``points`` is reached (Douglas and Peucker 1973, largest distance first).

    x, y       (samples,)  in the same unit
    tolerance  largest distance that is not visible
    points     largest number of points
    returned   (points,)  indices
    """
    # Samples at which the curve enters another cell. Cells grow until at most MAX_SPLIT remain.
    cell = 0.5 * tolerance
    while True:
        number = np.floor(np.stack([x, y]) / cell)
        enters = np.any(np.diff(number, axis=1) != 0.0, axis=0)
        if enters.sum() <= MAX_SPLIT:
            break
        cell *= 2.0
    samples = np.unique(np.concatenate([[0], 1 + np.flatnonzero(enters), [len(x) - 1]]))
    x, y = x[samples], y[samples]
    selected, chords = {0, len(x) - 1}, [_farthest(x, y, 0, len(x) - 1)]
    while -chords[0][0] > tolerance and len(selected) < points:
        _, middle, first, stop = heapq.heappop(chords)
        selected.add(middle)
        heapq.heappush(chords, _farthest(x, y, first, middle))
        heapq.heappush(chords, _farthest(x, y, middle, stop))
    return np.asarray(samples[sorted(selected)])


def _farthest(x: Array, y: Array, first: int, stop: int) -> tuple[float, int, int, int]:
    """Return minus the largest distance from a chord, its sample, and the ends of the chord."""
    if stop - first < 2:
        return 0.0, first, first, stop
    a, b = x[first + 1 : stop] - x[first], y[first + 1 : stop] - y[first]
    across, up = x[stop] - x[first], y[stop] - y[first]
    share = (a * across + b * up) / (across * across + up * up or 1.0)
    along = np.minimum(np.maximum(share, 0.0), 1.0)
    distance = np.hypot(a - along * across, b - along * up)
    index = int(distance.argmax())
    return -float(distance[index]), first + 1 + index, first, stop


def envelope(x: Array, y: Array, bins: int) -> tuple[Array, Array, Array]:
    """Return the centre, minimum and maximum of y in every bin of x that is not empty.

    x  (samples,)  not decreasing
    """
    edges = np.linspace(x[0], x[-1], bins + 1)
    first = np.unique(np.searchsorted(x, edges[:-1], side="left"))
    first = first[first < len(x)]
    stop = np.append(first[1:], len(x))
    middle = (x[first] + x[stop - 1]) / 2
    return middle, np.minimum.reduceat(y, first), np.maximum.reduceat(y, first)


def bins_of(x: Array, edges: Array, min_samples: int) -> list[tuple[int, Indices]]:
    """Return index and samples of every bin with enough samples; the last includes its edge."""
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    order = np.argsort(index, kind="stable")
    cuts = np.searchsorted(index[order], np.arange(len(edges)))
    runs = enumerate(itertools.pairwise(cuts.tolist()))
    return [(k, order[a:b]) for k, (a, b) in runs if b - a >= min_samples]


def finite_runs(y: Array) -> list[slice]:
    """Return the runs of at least two finite samples."""
    return [slice(a, b) for a, b in runs_of(np.isfinite(y)) if b - a > 1]
