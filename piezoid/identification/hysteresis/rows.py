"""Residual and tangent rows of the forward output error, in chunks.

    e = y_off + L Psi(H[u]) - y,     L: lag and declared sensor pole

The static columns go through L like the output. The states are followed at the full rate; rows
may be thinned.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.forward import Forward
from piezoid.identification.hysteresis.coordinates import Coordinates, operator_of
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.numerics.arrays import Array
from piezoid.operators.chain import Chain, Following, Samples
from piezoid.operators.play import thinned_drive

CHUNK = 1024  # rows written together: about the size of the L2 cache

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


def forward_of(
    theta: Array, coordinates: Coordinates, rate_Hz: float, sensor_Hz: float | None
) -> Forward:
    """Return the forward model of a vector for a piece of this rate.

    A declared pole far above the sampling rate is a part of a delay.
    """
    operator, lag = operator_of(theta, coordinates), coordinates.shape.lag
    forward = Forward(operator=operator, lag=lag, lag_s=operator.lag_s, sensor_Hz=sensor_Hz)
    if sensor_Hz is None or lag != "delay":
        return forward
    time_s = 1.0 / (2 * np.pi * sensor_Hz)
    if time_s * rate_Hz < QUICK:
        return replace(forward, lag_s=operator.lag_s + time_s, sensor_Hz=None)
    return forward


def simulate(
    theta: Array,
    coordinates: Coordinates,
    index: int,
    piece: Piece,
    rig_pole: float | None,
    at: Samples | None = None,
) -> Array:
    """Return the model's output over a whole piece, (samples,), without tangents.

    at  (rows,)  samples to return, increasing; None: all
    """
    rate_Hz = piece.sampling_rate_Hz
    forward = forward_of(theta, coordinates, rate_Hz, rig_pole)
    memory = forward.memory(piece.drive[0], theta[coordinates.memory_slice(index)])
    sample = np.arange(len(piece.drive)) if at is None else at
    is_sparse = SPARSE * len(sample) < len(piece.drive)
    if forward.lag == "delay" and forward.sensor_Hz is None and is_sparse:
        whole_samples = int(np.floor(forward.lag_s * rate_Hz))
        part = forward.lag_s * rate_Hz - whole_samples
        drive, nearest = _thinned_drive(piece, np.maximum(sample - whole_samples, 0))
        output, _ = forward.static(drive, memory, rate_Hz)
        output = (1.0 - part) * output[nearest] + part * output[np.maximum(nearest - 1, 0)]
    else:
        output, _ = forward.static(piece.drive, memory, rate_Hz)
        output = forward.filtered(output, rate_Hz)[sample]
    return np.asarray(output + zero_at(sample, piece, theta[coordinates.offset_slice(index)]))


def _thinned_drive(piece: Piece, samples: Samples) -> tuple[Array, Samples]:
    """Return the drive thinned to its turns, some samples and those before, and their rows."""
    return thinned_drive(piece.drive, samples, with_previous=True, turns=piece.turns)


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
        position = np.clip(_knot_place(sample, piece, knots), 0, knots - 1)
        for knot in range(knots):
            np.maximum(1.0 - np.abs(position - knot), 0.0, out=columns[:, knot])
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
    """Yield every ``stride``-th fitted row of a piece, in chunks."""
    chain, delay = chain_of(theta, coordinates, index, piece, sensor_pole)
    following = Following(chain, float(piece.drive[0]))
    sample = piece.counting(stride)
    drive, source = piece.drive, np.maximum(sample - delay, 0)
    if chain.lag is None and chain.sensor is None and SPARSE * len(sample) < len(drive):
        drive, source = _thinned_drive(piece, source)
    knots = theta[coordinates.offset_slice(index)]
    first = start = 0
    while start < len(sample):
        last_source = source[min(start + CHUNK, len(sample)) - 1]
        end = int(np.searchsorted(source, last_source, side="right"))
        block = empty_block(chain, end - start, len(knots))
        following.rows(drive[first : last_source + 1], source[start:end] - first, block)
        measured = piece.response[sample[start:end]]
        yield finished(block, sample[start:end], measured, coordinates, knots, piece)
        first, start = int(last_source) + 1, end


def chain_of(
    theta: Array, coordinates: Coordinates, index: int, piece: Piece, sensor_Hz: float | None
) -> tuple[Chain, int]:
    """Return what stands between drive and reading, and by how many whole samples it is late."""
    rate_Hz = piece.sampling_rate_Hz
    forward = forward_of(theta, coordinates, rate_Hz, sensor_Hz)
    return forward.filtered_chain(theta[coordinates.memory_slice(index)], rate_Hz)


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
