"""Residual and tangent rows of the forward output error, chunk by chunk.

    e = y_off + L Psi(H[u]) - y,     L: lag and declared sensor pole

The static columns go through L like the output. The states are followed at the full rate; rows
may be thinned.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.hysteresis.coordinates import Coordinates, Scaled, operator_of
from piezoid.identification.hysteresis.filters import Lag, filter_columns, first_order, lag_of
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.static import Static
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.play import PlayTangents, first_carry, play_tangents
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

CHUNK = 8192
THIN = 3  # from this stride on, computing two rows for each that counts is cheaper than all

QUICK = 0.5  # samples: a declared pole quicker than this acts as a delay

Samples = NDArray[np.int_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """Some rows of one piece.

    sample    (rows,)  which samples of the piece they are
    tangent   (rows, shared + local)  derivatives by the shared and then the piece's own numbers
    residual  (rows,)                 model minus measurement
    """

    sample: Samples
    tangent: Array
    residual: Array


def starting_memory(theta: Array, coordinates: Coordinates, index: int, piece: Piece) -> Array:
    """Return the memory of the moving plays before a piece's first sample, (plays,)."""
    operator = operator_of(theta, coordinates)
    slopes = theta[coordinates.memory_slice(index)]
    return np.asarray(operator.envelope.run(piece.drive[:1]) + np.cumsum(operator.gap * slopes))


def simulate(
    theta: Array, coordinates: Coordinates, index: int, piece: Piece, rig_pole: float | None
) -> Array:
    """Return the model's output over a whole piece, (samples,), without tangents."""
    operator = operator_of(theta, coordinates)
    drive = operator.envelope.run(piece.drive)
    memory = np.concatenate([drive[:1], starting_memory(theta, coordinates, index, piece)])
    plays = PrandtlIshlinskii(
        threshold=np.concatenate([[0.0], operator.threshold]), weight=operator.weight
    )
    h, _ = plays.run(drive, memory)
    output = from_slopes(operator.knot, operator.slope).run(h)[:, None]
    lag_s, pole_Hz = _declared(coordinates, operator, piece, rig_pole)
    lagged, _ = lag_of(coordinates.shape.lag, lag_s, piece.sampling_rate_Hz).run(output)
    sensed = lagged if pole_Hz is None else _sense(lagged, pole_Hz, piece, None)[0]
    knots = theta[coordinates.offset_slice(index)]
    zero = offset_columns(np.arange(len(piece.drive)), piece, len(knots)) @ knots
    return np.asarray(sensed[:, 0] + zero)


def _declared(
    coordinates: Coordinates, operator: Scaled, piece: Piece, pole_Hz: float | None
) -> tuple[float, float | None]:
    """Return the lag and the declared pole; a pole far above the sampling rate is a delay."""
    if pole_Hz is None or coordinates.shape.lag != "delay":
        return operator.lag_s, pole_Hz
    time_s = 1.0 / (2 * np.pi * pole_Hz)
    if time_s * piece.sampling_rate_Hz < QUICK:
        return operator.lag_s + time_s, None
    return operator.lag_s, pole_Hz


def offset_columns(sample: Samples, piece: Piece, knots: int) -> Array:
    """Return the hat functions of a piece's zero at these samples, (samples, knots).

    The knots are spread over the rows that count; before the first and behind the last of them
    the zero stays where it was there.
    """
    if knots == 1:
        return np.ones((len(sample), 1))
    place = (sample - piece.first) / max(piece.rows - 1, 1) * (knots - 1)
    distance = np.abs(np.clip(place, 0, knots - 1)[:, None] - np.arange(knots))
    return np.asarray(np.maximum(1.0 - distance, 0.0))


def rows_of(
    theta: Array,
    coordinates: Coordinates,
    index: int,
    piece: Piece,
    *,
    sensor_pole: float | None,
    stride: int = 1,
) -> Iterator[Rows]:
    """Yield the rows of a piece that count, chunk by chunk, every ``stride``-th of them."""
    operator = operator_of(theta, coordinates)
    slopes = theta[coordinates.memory_slice(index)]
    knots = theta[coordinates.offset_slice(index)]
    carry = first_carry(starting_memory(theta, coordinates, index, piece))
    static = Static(operator=operator, slopes=slopes, first=float(piece.drive[0]))
    further = behind(coordinates, static, piece, stride, sensor_pole)
    for first in range(0, piece.last, CHUNK):
        u = piece.drive[first : min(first + CHUNK, piece.last)]
        tangents = play_tangents(operator.envelope.run(u), operator.threshold, carry)
        carry = tangents.carry
        kept, sample = further.run(first, u, tangents)
        yield _assemble(kept, sample, coordinates, knots, piece)


def behind(
    coordinates: Coordinates, static: Static, piece: Piece, stride: int, sensor_Hz: float | None
) -> "Behind":
    """Return the cheapest way from static columns to the rows that count."""
    kind = coordinates.shape.lag
    lag_s, pole_Hz = _declared(coordinates, static.operator, piece, sensor_Hz)
    if kind != "first_order" and pole_Hz is None and stride >= THIN:
        return ThinnedDelay(static, piece, stride, lag_s, has_lag=kind == "delay")
    return EveryRow(static, piece, stride, lag_of(kind, lag_s, piece.sampling_rate_Hz), pole_Hz)


class Behind(Protocol):
    """From the static columns of a chunk to its filtered and thinned rows."""

    def run(self, first: int, u: Array, tangents: PlayTangents) -> tuple[Array, Samples]:
        """Return [y | tangents | d/d lag] and the samples these rows belong to."""


@dataclass
class EveryRow:
    """Any filter: all rows are computed, filtered, and then thinned."""

    static: Static
    piece: Piece
    stride: int
    lag: Lag
    sensor_Hz: float | None
    state: Array | None = None

    def run(self, first: int, u: Array, tangents: PlayTangents) -> tuple[Array, Samples]:
        """Return [y | tangents | d/d lag] and the samples these rows belong to."""
        columns, by_lag = self.lag.run(self.static.columns(u, tangents))
        if by_lag.shape[1]:
            columns = np.hstack([columns, by_lag])
        if self.sensor_Hz is not None:
            columns, self.state = _sense(columns, self.sensor_Hz, self.piece, self.state)
        sample = np.arange(first, first + len(u))
        counts = (sample >= self.piece.first) & ((sample - self.piece.first) % self.stride == 0)
        return columns[counts], sample[counts]


@dataclass
class ThinnedDelay:
    """A pure delay needs two static rows for each row that counts, and no others."""

    static: Static
    piece: Piece
    stride: int
    lag_s: float
    has_lag: bool
    before: tuple[Array, PlayTangents] | None = None

    def run(self, first: int, u: Array, tangents: PlayTangents) -> tuple[Array, Samples]:
        """Return [y | tangents | d/d lag] and the samples these rows belong to."""
        rate_Hz = self.piece.sampling_rate_Hz
        whole = int(np.floor(self.lag_s * rate_Hz))
        part = self.lag_s * rate_Hz - whole
        source = np.arange(first, first + len(u))
        sample = source + whole
        counts = (sample >= self.piece.first) & (sample < self.piece.last)
        counts &= (sample - self.piece.first) % self.stride == 0
        place = np.flatnonzero(counts)
        newer = self.static.columns(u[place], _take(tangents, place, None))
        if not self.has_lag:
            return newer, sample[place]
        last = self.before if self.before is not None else (u[:1], _take(tangents, [0], None))
        earlier = np.where(place > 0, u[place - 1], last[0][0])
        older = self.static.columns(earlier, _take(tangents, place - 1, last[1]))
        self.before = (u[-1:], _take(tangents, [len(u) - 1], None))
        by_lag = (older[:, :1] - newer[:, :1]) * rate_Hz
        return np.hstack([(1.0 - part) * newer + part * older, by_lag]), sample[place]


def _take(
    tangents: PlayTangents, place: Samples | list[int], before: PlayTangents | None
) -> PlayTangents:
    """Return some rows of the tangents; row -1 is the last row of the chunk before."""
    parts = {}
    for name in ("state", "threshold", "memory"):
        rows = getattr(tangents, name)[place]
        if before is not None and len(rows) and place[0] < 0:
            rows[0] = getattr(before, name)[0]
        parts[name] = rows
    return PlayTangents(carry=tangents.carry, **parts)


def _sense(
    columns: Array, pole_Hz: float, piece: Piece, state: Array | None
) -> tuple[Array, Array]:
    """Pass all columns through the declared pole of the sensor, steady before the first row."""
    if state is None:
        state = np.repeat(columns[:1], 2, axis=0)
    time_s = 1.0 / (2 * np.pi * pole_Hz)
    return filter_columns(columns, first_order(time_s, piece.sampling_rate_Hz), state), state


def _assemble(
    columns: Array, sample: Samples, coordinates: Coordinates, knots: Array, piece: Piece
) -> Rows:
    """Order the columns as the vector is ordered: shared, offsets, memory slopes."""
    plays = coordinates.shape.plays
    zero = offset_columns(sample, piece, len(knots))
    static = coordinates.slices["lag"].start
    shared, offsets = coordinates.shared, coordinates.shared + len(knots)
    tangent = np.empty((len(sample), offsets + plays), order="F")
    tangent[:, :static] = columns[:, 1 : 1 + static]
    tangent[:, static:shared] = columns[:, 1 + static + plays :]
    tangent[:, shared:offsets] = zero
    tangent[:, offsets:] = columns[:, 1 + static : 1 + static + plays]
    measured = piece.response[sample]
    return Rows(sample=sample, tangent=tangent, residual=columns[:, 0] + zero @ knots - measured)
