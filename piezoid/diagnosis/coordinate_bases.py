"""Coordinates: where a remainder may live, each with the columns that a curve along it is made of.

Three kinds of curves. Hats along anything that has a value at every sample (drive, displacement,
speed, ...): straight between knots,

    f(x) = sum_j c_j max(1 - |x - x_j| / (x_(j+1) - x_j), 0)

waves of one frequency in time or in distance travelled, with a phase of every track; and cells
that repeat with the index of the sample.

Source: de Boor (1978) on linear splines; Bretthorst (1988) on waves of unknown frequency.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.segments import Places, Track
from piezoid.numerics.arrays import Array

KNOTS = 24  # of drive, displacement and reading: a twenty-third of the range is a feature
FINE_KNOTS = 96  # of displacement, for what is narrow
SPEED_KNOTS, TURN_KNOTS, OTHER_KNOTS, TIME_KNOTS = 17, 12, 16, 64
OUTSIDE = 5e-4  # of all samples on either side of the outermost knots
SLOW = 0.1  # half strokes per second: slower is told on an even scale, faster in decades

Signals = tuple[Array, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Basis:
    """Columns of a curve along one coordinate.

    coordinate  its name
    unit        of ``place``
    place       (samples,) of every track: where each sample stands, in ``unit``
    columns     (rows, columns)  of the view that it was made for
    made        (track, coefficients) -> the curve at every sample of a track
    per_unit    periods in one unit of ``along``, of what repeats; 0 of what does not
    harmonics   of what repeats
    """

    coordinate: str
    unit: str
    place: Signals
    columns: Array
    made: Callable[[int, Array], Array]
    per_unit: float = 0.0
    harmonics: int = 0


def along_signals(view: View) -> list[Basis]:
    """Return the curves along every signal that has a value at each sample."""
    tracks, static = view.tracks, view.static
    half_m, half_V = view.stroke_m, view.voltage_V
    drive = tuple(t.drive - view.rest for t in tracks)  # 0 at 0 V
    speed = tuple(np.gradient(s) * t.rate_Hz for s, t in zip(static, tracks, strict=True))
    found = [
        _hats(view, "drive", "V", drive, KNOTS, half_V),
        _hats(view, "displacement", "m", static, KNOTS, half_m),
        _hats(view, "displacement", "m", static, FINE_KNOTS, half_m),
        _hats(view, "speed", "m/s", speed, SPEED_KNOTS, half_m, bent=SLOW),
        _since_turn(view),
    ]
    for axis in sorted({axis for track in tracks for axis in track.others}):
        there = tuple(t.others.get(axis, np.full(len(t.drive), np.nan)) for t in tracks)
        name = f"drive of axis {axis}"
        found.append(_hats(view, name, "half ranges", there, OTHER_KNOTS, 1.0))
    return found


def along_displacement(view: View) -> Basis:
    """Return the curve along the static response."""
    return _hats(view, "displacement", "m", view.static, KNOTS, view.stroke_m)


def along_reading(view: View, left: Array | None = None) -> Basis:
    """Return the curve along the reading's own value.

    left  (rows,)  what stands in the place of the remainder in it; None: the remainder itself
    """
    readings = []
    for k, (track, static) in enumerate(zip(view.tracks, view.static, strict=True)):
        own = track.response - float(np.median(track.response - static))  # of a common zero
        if left is not None:
            rows = slice(view.nuisance.edges[k], view.nuisance.edges[k + 1])
            own = static.copy()
            own[track.place] += left[rows]
        readings.append(own)
    return _hats(view, "reading", "m", tuple(readings), KNOTS, view.stroke_m)


def along_time(view: View, k: int) -> Array:
    """Return hats of time at the rows of one track, (rows, knots)."""
    track = view.tracks[k]
    return hats(track.place.astype(np.float64), np.linspace(0, len(track.drive) - 1, TIME_KNOTS))


def in_time(view: View) -> Basis:
    """Return a curve in time of every recording's own; its columns come track by track."""
    tracks = view.tracks

    def made(k: int, c: Array) -> Array:
        samples = len(tracks[k].drive)
        own = c[k * TIME_KNOTS : (k + 1) * TIME_KNOTS]
        return np.interp(np.arange(samples), np.linspace(0, samples - 1, TIME_KNOTS), own)

    return Basis(
        coordinate="time",
        unit="s",
        place=tuple(track.time_s for track in tracks),
        columns=np.zeros((len(view.response), 0)),
        made=made,
    )


def waves(
    view: View, coordinate: str, along: Signals, per_unit: float, unit: str, harmonics: int = 1
) -> Basis:
    """Return waves of one frequency along a signal, with amplitudes of every track's own.

    along     (samples,) of every track
    per_unit  periods in a unit of it
    """
    orders = range(1, harmonics + 1)

    def turning(k: int, places: Places | slice) -> Array:
        turn = 2.0 * np.pi * per_unit * along[k][places]
        return np.column_stack([w(n * turn) for n in orders for w in (np.cos, np.sin)])

    tracks, wide = view.tracks, 2 * harmonics
    columns = np.zeros((len(view.response), wide * len(tracks)))
    for k, track in enumerate(tracks):
        rows = slice(view.nuisance.edges[k], view.nuisance.edges[k + 1])
        columns[rows, k * wide : (k + 1) * wide] = turning(k, track.place)
    return Basis(
        coordinate=coordinate,
        unit=unit,
        place=along,
        columns=columns,
        made=lambda k, c: turning(k, slice(None)) @ c[k * wide : (k + 1) * wide],
        per_unit=per_unit,
        harmonics=harmonics,
    )


def every(view: View, period: int) -> Basis:
    """Return a value for every sample of a period, the same in all recordings."""
    cell = np.concatenate([track.place % period for track in view.tracks])
    columns = np.zeros((len(cell), period))
    columns[np.arange(len(cell)), cell] = 1.0
    samples = tuple(np.arange(len(track.drive)) % period for track in view.tracks)
    return Basis(
        coordinate="sample_index",
        unit=f"samples of {period}",
        place=tuple(one.astype(np.float64) for one in samples),
        columns=columns,
        made=lambda k, c: c[samples[k]],
        per_unit=1.0 / period,
    )


def travelled(view: View) -> Signals:
    """Return the way every track has gone since it began, in half strokes."""
    return tuple(np.cumsum(np.abs(np.diff(s, prepend=s[:1]))) for s in view.static)


def hats(x: Array, knots: Array) -> Array:
    """Return linear splines that are 1 at one knot each, 0 where there is no place."""
    there = np.isfinite(x)
    inside = np.clip(np.where(there, x, knots[0]), knots[0], knots[-1])
    low = np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, len(knots) - 2)
    part = (inside - knots[low]) / (knots[low + 1] - knots[low])
    found, rows = np.zeros((len(x), len(knots))), np.arange(len(x))
    found[rows, low] = np.where(there, 1.0 - part, 0.0)
    found[rows, low + 1] = np.where(there, part, 0.0)
    return found


def _hats(
    view: View, name: str, unit: str, x: Signals, count: int, scale: float, bent: float = 0.0
) -> Basis:
    """Return hats along a signal.

    scale  what 1 of it is in ``unit``
    bent   from where it is told in decades; 0: never
    """
    told = tuple(np.arcsinh(one / bent) for one in x) if bent else x
    rows = view.rows(told)
    knots = _knots(rows[np.isfinite(rows)], count)

    def made(k: int, c: Array) -> Array:
        there = np.isfinite(told[k])
        return np.where(there, np.interp(np.where(there, told[k], 0.0), knots, c), 0.0)

    return Basis(
        coordinate=name,
        unit=unit,
        place=tuple(scale * one for one in x),
        columns=hats(rows, knots),
        made=made,
    )


def _since_turn(view: View) -> Basis:
    """Return hats of the time since the drive turned, alike after all turns and by direction."""
    since, way = zip(*(_turned(track) for track in view.tracks), strict=True)
    decades = tuple(np.log10(one) for one in since)
    rows, direction = view.rows(decades), view.rows(way)
    knots = _knots(rows, TURN_KNOTS)
    plain = hats(rows, knots)

    def made(k: int, c: Array) -> Array:
        even = np.interp(decades[k], knots, c[:TURN_KNOTS])
        return np.asarray(even + way[k] * np.interp(decades[k], knots, c[TURN_KNOTS:]))

    return Basis(
        coordinate="time_since_turn",
        unit="s",
        place=since,
        columns=np.hstack([plain, plain * direction[:, None]]),
        made=made,
    )


def _turned(track: Track) -> tuple[Array, Array]:
    """Return the time since the drive last turned, and the direction in which it last went."""
    step = np.sign(np.diff(track.drive, prepend=track.drive[:1]))
    place = np.arange(len(step))
    moved = np.maximum.accumulate(np.where(step != 0.0, place, 0))
    way = step[moved]
    reversals = np.flatnonzero((way[1:] != way[:-1]) & (way[:-1] != 0.0)) + 1
    last = np.maximum.accumulate(np.where(np.isin(place, reversals), place, 0))
    return (place - last + 1) / track.rate_Hz, way


def _knots(rows: Array, count: int) -> Array:
    if not len(rows):
        return np.linspace(0.0, 1.0, count)
    low, high = np.quantile(rows, [OUTSIDE, 1.0 - OUTSIDE])
    return np.linspace(low, max(high, low + 1e-9), count)
