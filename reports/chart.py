"""A chart: two axes in engineering units, and layers as paths on a grid of fine steps.

Paths are written with whole numbers, each relative to the one before: short, and the same bytes on
every machine. One step is a twentieth of a pixel, so a curve may be magnified before it shows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.readable import Scale
from piezoid_reports.polyline import envelope, thinned, whole_parts
from piezoid_reports.quantities import scale_for
from piezoid_reports.ticks import decade_ticks, even_ticks

WIDTH, HEIGHT = 640, 360
FINE = 20
INVISIBLE = 0.15 * FINE
TIMES = 10_000  # parts of a record by which a point of a curve is told when it was
BINS = 520
ROOM = 0.04  # of the range, left free at both ends of an axis


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One axis of a chart.

    label      what is along it, without unit
    scale      the unit it is shown in
    low, high  its ends, in that unit
    decades    values along it are log10 of what is shown; labels are the numbers themselves
    """

    label: str
    scale: Scale
    low: float
    high: float
    decades: bool = False

    @property
    def ticks(self) -> tuple[tuple[float, str], ...]:
        """Round numbers along the axis: place as a share of its length, and label."""
        found = (decade_ticks if self.decades else even_ticks)(self.low, self.high)
        length = self.high - self.low
        return tuple(((place - self.low) / length, label) for place, label in found)

    def places(self, values: Array, length: int) -> Array:
        """Return where SI values lie, in fine steps from the low end."""
        shown = np.asarray(values) / self.scale.factor
        return np.asarray((shown - self.low) / (self.high - self.low) * (length * FINE))


@dataclass(frozen=True, kw_only=True)
class Layer:
    """One curve or band.

    role   what it shows, which decides colour and stroke: ``measured``, ``model``, ``noise``, ...
    name   for the legend
    path   its points, in fine steps
    kind   ``line`` or ``area``
    times  when each of its points was, in ten thousandths of the record; or empty
    """

    role: str
    name: str
    path: str
    kind: str
    times: str = ""


def axis_over(label: str, values: Sequence[Array], unit: str, *, even: bool = False) -> Axis:
    """Return an axis that shows all finite values, symmetric about zero if ``even``."""
    finite = np.concatenate([np.asarray(v)[np.isfinite(v)] for v in values])
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    if even:
        high = max(abs(low), abs(high))
        low = -high
    if high <= low:
        spread = abs(high) or 1.0
        low, high = low - 0.5 * spread, high + 0.5 * spread
    scale = scale_for(max(abs(low), abs(high)), unit)
    room = ROOM * (high - low)
    return Axis(
        label=label,
        scale=scale,
        low=(low - room) / scale.factor,
        high=(high + room) / scale.factor,
    )


def decades_over(label: str, values: Sequence[Array], unit: str) -> Axis:
    """Return a logarithmic axis; values are log10 of numbers in ``unit``, prefix included."""
    even = axis_over(label, values, "")
    return replace(even, scale=Scale(factor=1.0, unit=unit), decades=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class Canvas:
    """Two axes and the area between them, on which layers are drawn."""

    x: Axis
    y: Axis
    width: int = WIDTH
    height: int = HEIGHT

    def line(
        self, role: str, name: str, x: Array, y: Array, *, points: int = 2400, timed: bool = False
    ) -> tuple[Layer, float]:
        """Draw a curve; return it and how far, in SI units of y, it may be from its samples.

        timed  keep when each point was, for a curve whose samples are evenly spaced in time
        """
        across, up = self.x.places(x, self.width), self.y.places(y, self.height)
        parts = whole_parts(across + up)
        total = max(sum(part.stop - part.start for part in parts), 1)
        path, furthest = "", 0.0
        times: list[int] = []
        for part in parts:
            share = max(2, int(points * (part.stop - part.start) / total))
            a, b = across[part], up[part]
            kept, left = thinned(a, b, tolerance=INVISIBLE, points=share)
            path += self._path(a[kept], b[kept], is_whole=timed)
            furthest = max(furthest, left)
            if timed:
                times += (TIMES * (kept + part.start) // len(x)).tolist()
        per_step = self.y.scale.factor * (self.y.high - self.y.low) / (self.height * FINE)
        told = " ".join(map(str, times))
        return Layer(role=role, name=name, path=path, kind="line", times=told), furthest * per_step

    def dots(self, role: str, name: str, x: Array, y: Array) -> Layer:
        """Draw a dot for every pair of finite values: a stroke of no length with a round end."""
        there = np.isfinite(x) & np.isfinite(y)
        across = self.x.places(x[there], self.width)
        up = self.y.places(y[there], self.height)
        ends = (self._path(across[k : k + 1], up[k : k + 1]) for k in range(len(across)))
        return Layer(role=role, name=name, path="".join(ends), kind="line")

    def band(self, role: str, name: str, x: Array, low: Array, high: Array) -> Layer:
        """Draw the area between two curves."""
        across = self.x.places(x, self.width)
        up = np.concatenate(
            [self.y.places(high, self.height), self.y.places(low, self.height)[::-1]]
        )
        path = self._path(np.concatenate([across, across[::-1]]), up) + "z"
        return Layer(role=role, name=name, path=path, kind="area")

    def range_over_time(self, role: str, name: str, x: Array, y: Array) -> Layer:
        """Draw least and greatest y of every pixel; a line where samples are few."""
        path = ""
        few = np.isfinite(y).sum() <= 2 * BINS
        for part in whole_parts(y):
            if few:
                a, b = self.x.places(x[part], self.width), self.y.places(y[part], self.height)
                path += self._path(a, b)
                continue
            share = max(2, round(BINS * (part.stop - part.start) / len(y)))
            path += self.band(role, name, *envelope(x[part], y[part], share)).path
        return Layer(role=role, name=name, path=path, kind="line" if few else "area")

    def _path(self, across: Array, up: Array, *, is_whole: bool = False) -> str:
        """Write points as one relative path; y runs downwards on a page.

        is_whole  with those that stand where the one before stood
        """
        x = np.rint(across).astype(int)
        y = np.rint(self.height * FINE - up).astype(int)
        dx, dy = np.diff(x), np.diff(y)
        steps = [f"{a},{b}" for a, b in zip(dx.tolist(), dy.tolist(), strict=True)]
        steps = [step for step in steps if is_whole or step != "0,0"]
        # The separator before a minus is the minus itself.
        text = " ".join(steps).replace(" -", "-").replace(",-", "-")
        return f"M{x[0]},{y[0]}l{text or '0,0'}"
