"""Recordings of known stages, simulated independently of piezoid."""

import itertools

import numpy as np

from piezoid.identification.hysteresis.pieces import Piece, Rig, pieces_of, scales_of
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Channel, Quantity, Recording

RATE_Hz = 500.0


def through(levels: list[float], per_unit: int = 60) -> Array:
    """Return straight lines from level to level."""
    segments = [np.array(levels[:1])]
    for a, b in itertools.pairwise(levels):
        segments.append(np.linspace(a, b, max(3, int(per_unit * abs(b - a))) + 1)[1:])
    return np.concatenate(segments)


def decaying(count: int = 25, top: float = 5.0, per_unit: int = 60) -> Array:
    sizes = np.linspace(top, 0.1, count)
    return through([0.0, -top, *(sizes * (-1.0) ** np.arange(count)).tolist()], per_unit)


def wandering(rng: np.random.Generator, count: int = 25, top: float = 5.0) -> Array:
    return through([0.0, *rng.uniform(-top, top, count).tolist()])


def play_sum(drive: Array, threshold: Array, weight: Array, memory: Array) -> Array:
    """Return a sum of plays by its definition, sample by sample."""
    z = np.array(memory)
    out = np.empty_like(drive)
    for k, u in enumerate(drive):
        z = np.maximum(u - threshold, np.minimum(u + threshold, z))
        out[k] = weight @ z
    return out


def first_order_lag(signal: Array, time_s: float, rate_Hz: float, oversampling: int = 50) -> Array:
    """Return a first-order lag integrated in small steps between the samples."""
    fine = np.interp(
        np.arange(0, len(signal) - 1 + 1e-9, 1 / oversampling), np.arange(len(signal)), signal
    )
    share = 1.0 - np.exp(-1.0 / (time_s * rate_Hz * oversampling))
    out, y = np.empty_like(fine), fine[0]
    for k in range(len(fine)):
        y += share * ((fine[k] + fine[max(k - 1, 0)]) / 2 - y)
        out[k] = y
    return out[::oversampling]


def recording(
    drive_V: Array, response_m: Array, name: str = "made.csv", rate_Hz: float = RATE_Hz
) -> Recording:
    return Recording(
        name=name,
        digest="sha256:made",
        axis="x",
        sampling_rate_Hz=rate_Hz,
        channels=(
            Channel(quantity=Quantity.VOLTAGE, axis="x", values=drive_V, label="u"),
            Channel(quantity=Quantity.DISPLACEMENT, axis="x", values=response_m, label="y"),
        ),
    )


def piece_of(recording: Recording) -> tuple[Piece, float]:
    """Return the only piece of a recording, and the displacement of one scaled unit, m."""
    scales = scales_of((recording,), "x")
    (piece,) = pieces_of((recording,), "x", scales, Rig())
    return piece, scales.displacement_m
