"""Simulated stage with two modes, a delay, an amplifier and a small play."""

import numpy as np

from piezoid.diagnosis.planning.candidate_drives import multisine_period, odd_lines
from piezoid.identification.dynamics.frequency_response import (
    FrequencyResponse,
    PeriodicData,
    estimate_response,
)
from piezoid.identification.dynamics.modal import Declaration, Filter, LinearDynamics, Structure
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.operators.play import play_columns

RATE_HZ = 20_000.0
PERIOD = 2000  # samples: lines are 10 Hz apart
AMPLIFIER = Filter(name="amplifier", frequency_Hz=4000.0)
DECLARATION = Declaration(filters=(AMPLIFIER,))
STRUCTURE = Structure(modes=2)
FREQUENCY_HZ = (630.0, 1810.0)
DAMPING = (0.03, 0.02)
DELAY_S = 83e-6


def truth(output: int = 0, drive: int = 0, axes: int = 1) -> LinearDynamics:
    """Return one path of a stage: all paths share the modes and have different gains."""
    coupling = np.eye(axes) + 0.2 * np.arange(axes * axes).reshape(axes, axes)
    gains = np.array([1e-6 * coupling[output, drive], 0.2e-6 * coupling[drive, output]])
    return LinearDynamics(
        axis="x",
        mode_frequency_Hz=np.array(FREQUENCY_HZ),
        mode_damping=np.array(DAMPING),
        mode_gain_m_per_V=gains,
        lag_frequency_Hz=np.zeros(0),
        lag_gain_m_per_V=np.zeros(0),
        direct_gain_m_per_V=0.0,
        delay_s=DELAY_S,
        declared=(AMPLIFIER,),
        shape_covariance=np.zeros((5, 5)),
        static_gain_std_m_per_V=0.0,
        hold="zero_order",
        sampling_rate_Hz=RATE_HZ,
        band_Hz=(0.0, RATE_HZ / 2),
        drive_rms_V=1.0,
        cost=1.0,
        expected_cost=1.0,
    )


def all_paths(frequency_Hz: Array, axes: int) -> ComplexArray:
    """Return the response of every path behind a hold, (lines, outputs, inputs)."""
    rows = [
        [truth(o, i, axes).response_as_measured(frequency_Hz) for i in range(axes)]
        for o in range(axes)
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def first_response(data: PeriodicData) -> FrequencyResponse:
    """Return the response of the first axis to its own drive."""
    return estimate_response(data)[0]


def lines_between(
    measured: FrequencyResponse, lowest_Hz: float, highest_Hz: float
) -> FrequencyResponse:
    inside = (measured.frequency_Hz >= lowest_Hz) & (measured.frequency_Hz <= highest_Hz)
    return measured.at_lines(np.flatnonzero(inside))


def record(
    rng: np.random.Generator,
    *,
    inputs: tuple[str, ...] = ("x",),
    realisations: int = 4,
    periods: int = 4,
    noise_m: float = 2e-9,
    play_weight: float = 0.0,
    cubic: float = 0.0,
) -> PeriodicData:
    """Record odd multisines of 0.5 V rms up to 4 kHz behind a zero-order hold, in steady state.

    play_weight  weight of a play of half-width 0.1 V in the drive
    cubic        coefficient of a cubic term
    """
    lines = odd_lines(30, 4000, RATE_HZ / PERIOD, left_out_of=0, rng=rng)
    drive_V = 0.5 * np.concatenate(
        [_orthogonal_block(lines, len(inputs), rng) for _ in range(realisations // len(inputs))],
        axis=2,
    )
    distorted_V = np.apply_along_axis(_distorted, 0, drive_V, play_weight, cubic)
    G = all_paths(np.arange(PERIOD // 2 + 1) * RATE_HZ / PERIOD, len(inputs))
    spectrum = np.einsum("koi,kir->kor", G, np.fft.rfft(distorted_V, axis=0))
    steady_m = np.fft.irfft(spectrum, PERIOD, axis=0)[..., None]
    noise = noise_m * rng.standard_normal((*steady_m.shape[:3], periods))
    return PeriodicData(
        sampling_rate_Hz=RATE_HZ,
        inputs=inputs,
        outputs=inputs,
        voltage_V=np.repeat(drive_V[..., None], periods, axis=3),
        displacement_m=steady_m + noise,
    )


def _orthogonal_block(lines: Array, axes: int, rng: np.random.Generator) -> Array:
    """Return multisines of several axes with orthogonal spectra at every line.

    The drive of axis c in realisation r has the phase 2 pi r c / axes; (PERIOD, axes, axes).
    """
    spectra = np.fft.rfft([multisine_period(lines, PERIOD, rng) for _ in range(axes)])
    turn = np.exp(2j * np.pi * np.outer(np.arange(axes), np.arange(axes)) / axes)
    return np.asarray(np.fft.irfft(np.einsum("ck,cr->kcr", spectra, turn), PERIOD, axis=0))


def _distorted(period_V: Array, play_weight: float, cubic: float) -> Array:
    """Return a distorted period with a play in its periodic state."""
    twice, _ = play_columns(np.tile(period_V, 2), np.array([0.1]), np.zeros(1))
    return np.asarray(period_V + play_weight * twice[PERIOD:, 0] + cubic * period_V**3)
