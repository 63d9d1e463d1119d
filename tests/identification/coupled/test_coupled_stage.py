"""Two piezos, two displacements, modes that soften with the level: all known."""

from dataclasses import replace

import numpy as np
import pytest

import piezoid
from piezoid.errors import ExcitationError, IdentificationError

RATE_HZ, SAMPLES, REALISATIONS = 1000.0, 2048, 5
LINES = np.arange(1, 820)
LOW_V, HIGH_V = 0.1, 0.3
MODE_HZ, DAMPING = np.array([60.0, 140.0, 230.0]), np.array([0.02, 0.015, 0.02])
SOFTER = np.array([-0.012, 0.0, -0.006])  # from 0.1 to 0.3 V
GAIN = 1e-6 * np.array([[[2, 1], [1, 2]], [[2, -1], [-2, 1]], [[0.5, 0.4], [0.4, -0.6]]])
NOISE_M = 2e-9


def shift(level_V: float) -> np.ndarray:
    """Half the change at the ends, a straight line in the logarithm between."""
    return SOFTER * np.log(level_V / np.sqrt(LOW_V * HIGH_V)) / np.log(HIGH_V / LOW_V)


def displacement(drive: np.ndarray, level_V: float) -> np.ndarray:
    f = np.arange(SAMPLES // 2 + 1) * RATE_HZ / SAMPLES
    s, w = 2j * np.pi * f[:, None], 2 * np.pi * MODE_HZ * np.exp(shift(level_V))
    modes = w**2 / (s**2 + 2 * DAMPING * w * s + w**2)
    response = (
        np.einsum("fm,moi->foi", modes, GAIN) * np.exp(-2j * np.pi * f * 2e-4)[:, None, None]
    )
    spectrum = np.fft.rfft(drive, axis=0)
    return np.fft.irfft(np.einsum("foi,fi->fo", response, spectrum), SAMPLES, axis=0)


def multisine(level_V: float, rng: np.random.Generator) -> np.ndarray:
    spectrum = np.zeros((SAMPLES // 2 + 1, 2), dtype=complex)
    spectrum[LINES] = np.exp(2j * np.pi * rng.random((len(LINES), 2)))
    drive = np.fft.irfft(spectrum, SAMPLES, axis=0)
    return drive * level_V / drive.std()


def record(level_V: float, seed: int, realisations: int = REALISATIONS) -> piezoid.PeriodicData:
    rng = np.random.default_rng(seed)
    drives = np.stack([multisine(level_V, rng) for _ in range(realisations)], axis=2)
    moved = np.stack([displacement(drives[:, :, r], level_V) for r in range(realisations)], axis=2)
    noisy = moved[..., None] + NOISE_M * rng.standard_normal((*moved.shape, 2))
    return piezoid.PeriodicData(
        sampling_rate_Hz=RATE_HZ,
        inputs=("a", "b"),
        outputs=("x", "y"),
        voltage_V=np.repeat(drives[..., None], 2, axis=3),
        displacement_m=noisy,
    )


def error(model: piezoid.CoupledStage, data: piezoid.PeriodicData) -> float:
    left, size = 0.0, 0.0
    for r in range(data.voltage_V.shape[2]):
        found = model.simulate(data.voltage_V[:, :, r, 0], periodic=True)
        moved = data.displacement_m[:, :, r].mean(axis=2)
        left += np.sum((moved - moved.mean(axis=0) - found) ** 2)
        size += np.sum(moved**2)
    return float(np.sqrt(left / size))


@pytest.fixture(scope="module")
def levels() -> list[piezoid.PeriodicData]:
    return [record(LOW_V, 1), record(HIGH_V, 2)]


@pytest.fixture(scope="module")
def model(levels: list[piezoid.PeriodicData]) -> piezoid.CoupledStage:
    return piezoid.fit_coupled(levels, modes=3)


def test_modes_and_how_they_move_with_the_level_are_found_within_finite_intervals(model):
    near = [int(np.argmin(np.abs(model.mode_frequency_Hz(0.17) - f))) for f in MODE_HZ]
    true_Hz = MODE_HZ * np.exp(shift(LOW_V))
    np.testing.assert_allclose(model.mode_frequency_Hz(LOW_V)[near], true_Hz, rtol=2e-3)
    np.testing.assert_allclose(model.mode_damping(HIGH_V)[near], DAMPING, rtol=0.05)
    change = model.frequency_change()[near]
    np.testing.assert_allclose(change[:, 0], np.expm1(SOFTER), atol=1.5e-3)
    low_Hz, high_Hz = model.mode_frequency_interval_Hz(HIGH_V).T
    assert (
        (low_Hz < model.mode_frequency_Hz(HIGH_V)) & (model.mode_frequency_Hz(HIGH_V) < high_Hz)
    ).all()
    assert (high_Hz < 1.05 * low_Hz).any()


def test_drives_of_any_level_within_the_data_are_followed_from_the_drive_alone(model):
    for level_V, seed in ((LOW_V, 11), (0.2, 13), (HIGH_V, 12)):
        assert error(model, record(level_V, seed, realisations=2)) < 0.003


def test_one_level_alone_can_be_fitted(levels):
    alone = piezoid.fit_coupled(levels[1:], modes=3, intervals=False)
    assert error(alone, record(HIGH_V, 14, realisations=1)) < 0.003
    assert np.isinf(alone.frequency_change()[:, 2]).all()


def test_from_rest_the_answer_settles_into_the_steady_one(model):
    drive = multisine(HIGH_V, np.random.default_rng(5))
    steady = model.simulate(drive, periodic=True)
    began = model.simulate(np.tile(drive, (4, 1)))[3 * SAMPLES :]
    assert np.std(began - steady) < 0.02 * np.std(steady)


def test_the_same_records_give_the_same_model(levels, model):
    again = piezoid.fit_coupled(levels[::-1], modes=3, intervals=False)
    np.testing.assert_array_equal(again.residue_m_per_V, model.residue_m_per_V)


def test_drives_of_other_levels_and_widths_are_refused(model):
    with pytest.raises(
        IdentificationError, match=r"a drive of 0\.5 V rms. Needed: one from 0\.1 to 0\.3"
    ):
        model.response([10.0], 0.5)
    with pytest.raises(IdentificationError, match="0\\.0333"):
        model.simulate(multisine(LOW_V / 3, np.random.default_rng(1)), periodic=True)
    with pytest.raises(IdentificationError, match="2, one for each of a, b"):
        model.simulate(np.ones((100, 3)))


def test_records_that_cannot_answer_are_refused(levels):
    with pytest.raises(ExcitationError, match="2 realisations for 2 drives"):
        piezoid.fit_coupled([levels[0].select([0, 1])])
    other = replace(levels[0], sampling_rate_Hz=2 * RATE_HZ)
    with pytest.raises(ExcitationError, match="the same drives, sensors, rate"):
        piezoid.fit_coupled([levels[0], other])
    with pytest.raises(ExcitationError, match="no record"):
        piezoid.fit_coupled([])
