"""Inputs of the kernels and the convex programs: a modulated sine and a model of many plays."""

import numpy as np

from benchmarks.speed.solvers import Program
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones, from_slopes
from piezoid.operators.play import play_columns
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii

PLAYS, ZONES = 16, 6  # moving plays; dead zones on each side
NOISE = 0.005  # of the amplitude
LEVELS = 9.0  # radians of the modulation


def drive_V(samples: int) -> Array:
    """Return a sine of 5 V with modulated amplitude, with loops at all levels."""
    t = np.linspace(0.0, 1.0, samples)
    return np.asarray(5 * (0.05 + 0.95 * np.abs(np.cos(LEVELS * t))) * np.sin(400 * t))


def thresholds_V(plays: int = PLAYS) -> Array:
    """Return evenly spread thresholds, none of them 0."""
    return np.asarray(np.arange(1, plays + 1) * (4.8 / plays))


def model(plays: int = PLAYS) -> ModifiedPrandtlIshlinskii:
    """Return an operator with a number of moving plays and twelve dead zones."""
    slopes = np.linspace(0.9, 0.98, ZONES)
    slope = np.concatenate([slopes, [1.0, 1.0], slopes[::-1]])
    return ModifiedPrandtlIshlinskii(
        plays=PrandtlIshlinskii(
            threshold=np.concatenate([[0.0], thresholds_V(plays)]),
            weight=np.concatenate([[2e-6], np.full(plays, 1.6e-6 / plays)]),
        ),
        dead_zones=from_slopes(np.linspace(-12e-6, 12e-6, 2 * ZONES + 1), slope),
    )


def bank(u_V: Array, plays: int = PLAYS) -> Array:
    """Return the states of the plays by the kernel."""
    return play_columns(u_V, thresholds_V(plays), np.zeros(plays))[0]


def noisy_sum(columns: Array) -> Array:
    """Return a sum of plays, a fifth of them without weight, and noise."""
    truth = np.linspace(1.0, 0.1, columns.shape[1])
    truth[::5] = 0.0
    return columns @ truth + 0.01 * np.random.default_rng(1).standard_normal(len(columns))


def piece_of(samples: int, plays: int = PLAYS) -> Piece:
    """Return a scaled recording of the model with noise, as a piece of a fit."""
    u_V, truth = drive_V(samples), model(plays)
    y_m, _ = truth.run(u_V, truth.virgin_memory())
    noise = NOISE * np.random.default_rng(1).standard_normal(samples)
    return Piece(
        name="made",
        recording=0,
        sampling_rate_Hz=1000.0,
        drive=u_V / np.abs(u_V).max(),
        response=y_m / np.abs(y_m).max() + noise,
        centre_m=0.0,
        first=0,
        last=samples,
    )


def program_of(piece: Piece, plays: int = PLAYS) -> Program:
    """Return Kuhnen's program of a piece, a row for each of its samples."""
    threshold = np.arange(plays + 1) / (plays + 1)
    positive = (np.arange(1, ZONES + 1) - 0.5) / ZONES
    zones = np.concatenate([-positive[::-1], [0.0], positive])
    memory = np.full(plays + 1, piece.drive[0])
    states, _ = play_columns(piece.drive, threshold, memory)
    bent = -DeadZones(threshold=zones, weight=np.ones(len(zones))).columns(piece.response)
    rows = np.column_stack([states, bent, np.ones(len(states))])
    return Program(rows=rows, threshold=threshold, zones=zones)
