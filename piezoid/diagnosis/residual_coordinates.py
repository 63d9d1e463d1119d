"""Coordinates of a systematic residual: curves along each, words, next experiment and profile.

Curves are linear splines along a signal, with knots x_j,

    f(x) = sum_j c_j max(1 - |x - x_j| / (x_(j+1) - x_j), 0),

waves of one frequency in time or along a signal, with a separate phase for each track, or a value
for each sample of a period, the same in all recordings.

Source: de Boor (1978) on linear splines; Bretthorst (1988) on waves of unknown frequency.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.diagnosis import CoordinateProfile
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.segments import Places, Track
from piezoid.numerics.arrays import Array

KNOTS = 24  # of drive, displacement and reading: they resolve a twenty-third of the range
FINE_KNOTS = 96  # of displacement, for narrow features
SPEED_KNOTS, TURN_KNOTS, OTHER_AXIS_KNOTS, TIME_KNOTS = 17, 12, 16, 64
OUTSIDE = 5e-4  # share of all samples on either side of the outermost knots
LINEAR_SPEED = 0.1  # half strokes per second: knots are linear in slower, logarithmic in faster
CLASSES = 40  # of a profile
MIN_ROWS = 8  # of a class

WORDS: Mapping[str, str] = {
    "drive": "the drive",
    "displacement": "the displacement, whatever the drive does",
    "reading": "the reading's own value",
    "speed": "the speed and its sign",
    "time": "time",
    "time_since_turn": "the time since the drive last turned",
    "frequency": "time, and repeats",
    "line_phase": "the phase within a period of the grid",
    "distance_travelled": "the distance travelled, and repeats with it",
    "sample_index": "the index of the sample, and repeats with it",
}
NEXT_EXPERIMENTS: Mapping[str, str] = {
    "drive": "Step the drive slowly through that range, up and down, and read the amplifier's "
    "output with a second instrument.",
    "displacement": "Move slowly through that place with a second sensor beside the first: what "
    "both see is the stage's, what one sees is that sensor's.",
    "reading": "Read a second sensor or converter beside the first while the stage moves slowly "
    "through those readings.",
    "speed": "Run triangles of one amplitude at five speeds a factor of three apart.",
    "time": "Record again at another hour with the drive at rest, and write down what else runs.",
    "time_since_turn": "Record turns at several levels, each followed by a ramp of one speed, and "
    "the same ramps after a rest.",
    "frequency": "Record a minute with the drive at rest, then switch off pumps, fans and "
    "neighbouring instruments one after another until the line goes.",
    "line_phase": "Record a minute at rest triggered by the grid, and switch off heaters and "
    "dimmers one after another.",
    "distance_travelled": "Run one slow ramp to and fro over half the range and over all of it.",
    "sample_index": "Record a shorted input at the same rate: what repeats there is the "
    "converter's.",
}
CONTROL_ADVICE = (
    "No controller compensates it, because no model contains it. The loop follows an error of the "
    "reading: find out first whether the stage moves."
)
OTHER_AXIS_EXPERIMENT = (
    "Move the other axis alone, slowly over its range, with this drive at rest."
)

Signals = tuple[Array, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Basis:
    """Columns of a curve along one coordinate.

    coordinate  name
    unit        of ``position``
    position    (samples,) of every track: its coordinate at each sample
    columns     (rows, columns)  at the rows of the view
    curve       (track, coefficients) -> the curve at every sample of a track
    per_unit    periods in one unit of ``position``; 0: the curve is not periodic
    harmonics   number of harmonics of a periodic curve
    """

    coordinate: str
    unit: str
    position: Signals
    columns: Array
    curve: Callable[[int, Array], Array]
    per_unit: float = 0.0
    harmonics: int = 0


def signal_bases(view: View) -> list[Basis]:
    """Return the bases of curves along every signal with a value at each sample."""
    tracks = view.tracks
    drive = tuple(track.drive - view.rest_drive for track in tracks)  # 0 at 0 V
    speed = tuple(
        np.gradient(static) * track.rate_Hz
        for static, track in zip(view.static, tracks, strict=True)
    )
    bases = [
        _spline_basis(view, "drive", "V", drive, KNOTS, view.voltage_V),
        displacement_basis(view),
        _spline_basis(view, "displacement", "m", view.static, FINE_KNOTS, view.half_stroke_m),
        _spline_basis(view, "speed", "m/s", speed, SPEED_KNOTS, view.half_stroke_m, LINEAR_SPEED),
        _turn_basis(view),
    ]
    for axis in sorted({axis for track in tracks for axis in track.other_drives}):
        drives = tuple(
            track.other_drives.get(axis, np.full(len(track.drive), np.nan)) for track in tracks
        )
        coordinate = f"drive of axis {axis}"
        bases.append(_spline_basis(view, coordinate, "half ranges", drives, OTHER_AXIS_KNOTS, 1.0))
    return bases


def displacement_basis(view: View) -> Basis:
    """Return the basis of a curve along the static response."""
    return _spline_basis(view, "displacement", "m", view.static, KNOTS, view.half_stroke_m)


def reading_basis(view: View, residual: Array | None = None) -> Basis:
    """Return the basis of a curve along the measured value.

    residual  (rows,)  a residual: the measured value is the static response plus this residual;
              None: the recorded value, with the zeros of the recordings aligned
    """
    readings = []
    for k, (track, static) in enumerate(zip(view.tracks, view.static, strict=True)):
        if residual is None:
            reading = track.response - float(np.median(track.response - static))
        else:
            reading = static.copy()
            reading[track.rows] += residual[view.track_rows(k)]
        readings.append(reading)
    return _spline_basis(view, "reading", "m", tuple(readings), KNOTS, view.half_stroke_m)


def time_spline(track: Track) -> Array:
    """Return linear splines of time at the rows of one track, (rows, knots)."""
    knots = np.linspace(0, len(track.drive) - 1, TIME_KNOTS)
    return linear_spline_basis(track.rows.astype(np.float64), knots)


def time_basis(view: View) -> Basis:
    """Return the basis of a separate curve in time for each track, without its columns.

    The columns of a track are those of `time_spline`.
    """
    tracks = view.tracks

    def curve(k: int, coefficients: Array) -> Array:
        samples = len(tracks[k].drive)
        knots = np.linspace(0, samples - 1, TIME_KNOTS)
        values = coefficients[k * TIME_KNOTS : (k + 1) * TIME_KNOTS]
        return np.interp(np.arange(samples), knots, values)

    return Basis(
        coordinate="time",
        unit="s",
        position=tuple(track.time_s for track in tracks),
        columns=np.zeros((len(view.response), 0)),
        curve=curve,
    )


def wave_basis(
    view: View, coordinate: str, position: Signals, per_unit: float, unit: str, harmonics: int = 1
) -> Basis:
    """Return the basis of waves along a signal, with separate amplitudes for each track.

    position  (samples,) of every track: the signal
    per_unit  periods in one unit of the signal
    """
    orders, width = range(1, harmonics + 1), 2 * harmonics

    def waves(k: int, samples: Places | slice) -> Array:
        phase = 2.0 * np.pi * per_unit * position[k][samples]
        return np.column_stack([wave(n * phase) for n in orders for wave in (np.cos, np.sin)])

    columns = np.zeros((len(view.response), width * len(view.tracks)))
    for k, track in enumerate(view.tracks):
        columns[view.track_rows(k), k * width : (k + 1) * width] = waves(k, track.rows)
    return Basis(
        coordinate=coordinate,
        unit=unit,
        position=position,
        columns=columns,
        curve=lambda k, c: waves(k, slice(None)) @ c[k * width : (k + 1) * width],
        per_unit=per_unit,
        harmonics=harmonics,
    )


def sample_index_basis(view: View, period: int) -> Basis:
    """Return the basis of one value for every sample of a period, the same in all recordings."""
    cell = np.concatenate([track.rows % period for track in view.tracks])
    columns = np.zeros((len(cell), period))
    columns[np.arange(len(cell)), cell] = 1.0
    cells = tuple(np.arange(len(track.drive)) % period for track in view.tracks)
    return Basis(
        coordinate="sample_index",
        unit=f"samples of {period}",
        position=tuple(index.astype(np.float64) for index in cells),
        columns=columns,
        curve=lambda k, c: c[cells[k]],
        per_unit=1.0 / period,
    )


def linear_spline_basis(x: Array, knots: Array) -> Array:
    """Return linear splines that are 1 at one knot each, (values, knots); 0 where x is NaN."""
    is_finite = np.isfinite(x)
    inside = np.clip(np.where(is_finite, x, knots[0]), knots[0], knots[-1])
    below = np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, len(knots) - 2)
    fraction = (inside - knots[below]) / (knots[below + 1] - knots[below])
    columns, rows = np.zeros((len(x), len(knots))), np.arange(len(x))
    columns[rows, below] = np.where(is_finite, 1.0 - fraction, 0.0)
    columns[rows, below + 1] = np.where(is_finite, fraction, 0.0)
    return columns


def _spline_basis(
    view: View,
    coordinate: str,
    unit: str,
    signals: Signals,
    count: int,
    scale: float,
    linear_below: float = 0.0,
) -> Basis:
    """Return the basis of linear splines along a signal.

    count         number of knots
    scale         value of 1 in ``unit``
    linear_below  knots are evenly spaced up to this value and logarithmically beyond it; 0: all
                  knots are evenly spaced
    """
    x = tuple(np.arcsinh(s / linear_below) for s in signals) if linear_below else signals
    rows = view.rows(x)
    knots = _knots(rows[np.isfinite(rows)], count)

    def curve(k: int, coefficients: Array) -> Array:
        is_finite = np.isfinite(x[k])
        values = np.interp(np.where(is_finite, x[k], 0.0), knots, coefficients)
        return np.where(is_finite, values, 0.0)

    return Basis(
        coordinate=coordinate,
        unit=unit,
        position=tuple(scale * signal for signal in signals),
        columns=linear_spline_basis(rows, knots),
        curve=curve,
    )


def _turn_basis(view: View) -> Basis:
    """Return splines of the logarithm of time since a reversal, even and odd in the direction.

    The curve is the same after all reversals.
    """
    elapsed_s: list[Array] = []
    direction: list[Array] = []  # of the drive since its last reversal
    for track in view.tracks:
        step = np.sign(np.diff(track.drive, prepend=track.drive[:1]))
        index = np.arange(len(step))
        side = step[np.maximum.accumulate(np.where(step != 0.0, index, 0))]
        reversals = np.flatnonzero((side[1:] != side[:-1]) & (side[:-1] != 0.0)) + 1
        last_reversal = np.maximum.accumulate(np.where(np.isin(index, reversals), index, 0))
        elapsed_s.append((index - last_reversal + 1) / track.rate_Hz)
        direction.append(side)
    decades = tuple(np.log10(time_s) for time_s in elapsed_s)
    rows = view.rows(decades)
    knots = _knots(rows, TURN_KNOTS)
    columns = linear_spline_basis(rows, knots)

    def curve(k: int, coefficients: Array) -> Array:
        even = np.interp(decades[k], knots, coefficients[:TURN_KNOTS])
        odd = np.interp(decades[k], knots, coefficients[TURN_KNOTS:])
        return np.asarray(even + direction[k] * odd)

    return Basis(
        coordinate="time_since_turn",
        unit="s",
        position=tuple(elapsed_s),
        columns=np.hstack([columns, columns * view.rows(direction)[:, None]]),
        curve=curve,
    )


def _knots(values: Array, count: int) -> Array:
    if not len(values):
        return np.linspace(0.0, 1.0, count)
    low, high = np.quantile(values, [OUTSIDE, 1.0 - OUTSIDE])
    return np.linspace(low, max(high, low + 1e-9), count)


def coordinate_words(coordinate: str) -> str:
    """Return the words for a coordinate in a sentence."""
    return WORDS.get(coordinate, f"the {coordinate}")


def next_experiment(coordinate: str) -> str:
    """Return the experiment that would identify the cause of structure along a coordinate."""
    return NEXT_EXPERIMENTS.get(coordinate, OTHER_AXIS_EXPERIMENT)


def coordinate_profile(
    position: Array, residual_m: Array, fitted_m: Array, *, unit: str, recording: str = ""
) -> CoordinateProfile:
    """Return quartiles of a residual and the mean of the fitted curve in classes of a coordinate.

    position  (rows,)  in ``unit``; rows with a position that is not finite are left out
    """
    is_finite = np.isfinite(position)
    position, residual_m, fitted_m = (
        values[is_finite] for values in (position, residual_m, fitted_m)
    )
    edges = np.linspace(position.min(), position.max() + 1e-12, CLASSES + 1)
    index = np.clip(np.searchsorted(edges, position, side="right") - 1, 0, CLASSES - 1)
    rows = []
    for k in range(CLASSES):
        inside = index == k
        if np.sum(inside) >= MIN_ROWS:
            quartiles = np.quantile(residual_m[inside], [0.25, 0.5, 0.75]).tolist()
            mean_m = float(np.mean(fitted_m[inside]))
            rows.append([float(np.mean(position[inside])), *quartiles, mean_m])
    centre, low, median, high, mean = (tuple(c) for c in np.array(rows).reshape(-1, 5).T.tolist())
    return CoordinateProfile(
        unit=unit,
        place=centre,
        low_m=low,
        median_m=median,
        high_m=high,
        fitted_m=mean,
        recording=recording,
    )
