"""Residual and tangent rows of the forward output error, chunk by chunk.

    e = y_off + L Psi(H[u]) - y,     L: lag and declared sensor pole

The static columns go through L like the output. The states are followed at the full rate; rows
may be thinned.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from piezoid.identification.hysteresis.coordinates import Coordinates, Scaled, operator_of
from piezoid.identification.hysteresis.filters import lagged, relaxed
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.numerics.arrays import Array
from piezoid.operators.chain import Chain, FirstOrder, Following, Samples
from piezoid.operators.dead_zone import LINEAR, from_slopes
from piezoid.operators.play import way_to
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

CHUNK = 1024  # rows written together: about what the second cache holds

SPARSE = 3  # samples a row, from which on the way from row to row is shorter
QUICK = 0.5  # samples: a declared pole quicker than this acts as a delay


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """Some rows of one piece.

    sample  (rows,)  which samples of the piece they are
    block   (rows, plays + knots + shared + 1)  derivatives by what ``column_places`` says, and
            the residual, model minus measurement; column-major
    """

    sample: Samples
    block: Array

    @property
    def tangent(self) -> Array:
        """Return the derivatives."""
        return self.block[:, :-1]

    @property
    def residual(self) -> Array:
        """Return model minus measurement."""
        return self.block[:, -1]


def column_places(coordinates: Coordinates, index: int) -> Samples:
    """Return which numbers of the vector the columns of a piece belong to.

    First its memory slopes, which the rows soon forget, then its zero, then what all share.
    """
    memory, offsets = coordinates.memory_slice(index), coordinates.offset_slice(index)
    return np.asarray(np.r_[memory, offsets, 0 : coordinates.shared])


def starting_memory(theta: Array, coordinates: Coordinates, index: int, piece: Piece) -> Array:
    """Return the memory of the moving plays before a piece's first sample, (plays,)."""
    operator = operator_of(theta, coordinates)
    slopes = theta[coordinates.memory_slice(index)]
    return np.asarray(operator.envelope.run(piece.drive[:1]) + np.cumsum(operator.gap * slopes))


def simulate(
    theta: Array,
    coordinates: Coordinates,
    index: int,
    piece: Piece,
    rig_pole: float | None,
    at: Samples | None = None,
) -> Array:
    """Return the model's output over a whole piece, (samples,), without tangents.

    at  (rows,)  samples in rising order that alone are asked for
    """
    operator = operator_of(theta, coordinates)
    lag_s, pole_Hz = _declared(coordinates, operator, piece, rig_pole)
    kind, rate_Hz = coordinates.shape.lag, piece.sampling_rate_Hz
    slopes = theta[coordinates.memory_slice(index)]
    sample = np.arange(len(piece.drive)) if at is None else at
    if kind == "delay" and pole_Hz is None and SPARSE * len(sample) < len(piece.drive):
        whole = int(np.floor(lag_s * rate_Hz))
        part = lag_s * rate_Hz - whole
        drive, place = _way(piece, np.maximum(sample - whole, 0))
        moved = _moved(operator, slopes, drive)
        moved = (1.0 - part) * moved[place] + part * moved[np.maximum(place - 1, 0)]
    else:
        moved = lagged(_moved(operator, slopes, piece.drive), kind, lag_s, rate_Hz)
        if pole_Hz is not None:
            moved = relaxed(moved, 1.0 / (2 * np.pi * pole_Hz), rate_Hz)
        moved = moved[sample]
    return np.asarray(moved + zero_at(sample, piece, theta[coordinates.offset_slice(index)]))


def _moved(operator: Scaled, slopes: Array, drive: Array) -> Array:
    """Return what the hysteresis makes of a drive, (samples,)."""
    bent = _bent(operator, drive)
    memory = np.concatenate([bent[:1], bent[0] + np.cumsum(operator.gap * slopes)])
    plays = PrandtlIshlinskii(
        threshold=np.concatenate([[0.0], operator.threshold]), weight=operator.weight
    )
    h, _ = plays.run(bent, memory)
    return from_slopes(operator.knot, operator.slope).run(h)


def _way(piece: Piece, place: Samples) -> tuple[Array, Samples]:
    """Return the drive where it says all of its way to some samples and to those before them."""
    return way_to(piece.drive, place, before=True, turns=piece.turns)


def _bent(operator: Scaled, drive: Array) -> Array:
    return drive if operator.envelope is LINEAR else operator.envelope.run(drive)


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


def zero_at(sample: Samples, piece: Piece, knots: Array) -> Array:
    """Return a piece's zero at these samples, straight between its knots, (samples,) or a number.

    The knots are spread over the rows that count; before the first and behind the last of them
    the zero stays where it was there.
    """
    if len(knots) == 1:
        return knots
    return np.asarray(np.interp(_knot_place(sample, piece, len(knots)), range(len(knots)), knots))


def _knot_place(sample: Samples, piece: Piece, knots: int) -> Array:
    return np.asarray((sample - piece.first) / max(piece.rows - 1, 1) * (knots - 1))


def offset_columns(sample: Samples, piece: Piece, knots: int) -> Array:
    """Return the hat functions of a piece's zero at these samples, (samples, knots)."""
    columns = np.ones((len(sample), knots), order="F")
    if knots > 1:
        place = np.clip(_knot_place(sample, piece, knots), 0, knots - 1)
        for knot in range(knots):
            np.maximum(1.0 - np.abs(place - knot), 0.0, out=columns[:, knot])
    return columns


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
    chain, late = chain_of(theta, coordinates, index, piece, sensor_pole)
    following = Following(chain, float(piece.drive[0]))
    sample = piece.counting(stride)
    drive, source = piece.drive, np.maximum(sample - late, 0)
    if chain.lag is None and chain.sensor is None and SPARSE * len(sample) < len(drive):
        drive, source = _way(piece, source)
    knots = theta[coordinates.offset_slice(index)]
    before = done = 0
    while done < len(sample):
        last = source[min(done + CHUNK, len(sample)) - 1]
        end = int(np.searchsorted(source, last, side="right"))
        block = empty_block(chain, end - done, len(knots))
        following.rows(drive[before : last + 1], source[done:end] - before, block)
        measured = piece.response[sample[done:end]]
        yield finished(block, sample[done:end], measured, coordinates, knots, piece)
        before, done = int(last) + 1, end


def chain_of(
    theta: Array, coordinates: Coordinates, index: int, piece: Piece, sensor_Hz: float | None
) -> tuple[Chain, int]:
    """Return what stands between drive and reading, and by how many whole samples it is late."""
    operator, rate_Hz = operator_of(theta, coordinates), piece.sampling_rate_Hz
    lag_s, pole_Hz = _declared(coordinates, operator, piece, sensor_Hz)
    kind = coordinates.shape.lag
    late = int(np.floor(lag_s * rate_Hz)) if kind == "delay" else 0
    chain = Chain(
        gap=operator.gap,
        weight=operator.weight,
        memory_slope=theta[coordinates.memory_slice(index)],
        zones=from_slopes(operator.knot, operator.slope),
        envelope=operator.envelope,
        share=lag_s * rate_Hz - late if kind == "delay" else None,
        lag=FirstOrder(time_s=lag_s, rate_Hz=rate_Hz) if kind == "first_order" else None,
        sensor=None if pole_Hz is None else _pole(pole_Hz, rate_Hz),
        rate_Hz=rate_Hz,
    )
    return chain, late


def _pole(frequency_Hz: float, rate_Hz: float) -> FirstOrder:
    return FirstOrder(time_s=1.0 / (2 * np.pi * frequency_Hz), rate_Hz=rate_Hz)


def empty_block(chain: Chain, rows: int, knots: int) -> Array:
    """Return where the rows of a piece with so many knots are to be written."""
    return np.empty((rows, chain.plays + knots + chain.columns), order="F")


def finished(
    block: Array,
    sample: Samples,
    measured: Array,
    coordinates: Coordinates,
    knots: Array,
    piece: Piece,
) -> Rows:
    """Add the zero, and put the residual behind everything by which it is derived."""
    plays = coordinates.shape.plays
    end = plays + len(knots) + coordinates.shared
    block[:, end] = block[:, -1] + zero_at(sample, piece, knots) - measured
    block[:, plays : plays + len(knots)] = offset_columns(sample, piece, len(knots))
    return Rows(sample=sample, block=block[:, : end + 1])
