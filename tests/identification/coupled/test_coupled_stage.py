"""A stage of two coupled piezos with known modes whose frequencies depend on the level."""

from dataclasses import replace

import numpy as np
import pytest

import piezoid
from piezoid.errors import ExcitationError, IdentificationError

RATE_HZ, SAMPLES, REALISATIONS = 1000.0, 2048, 5
LINES = np.arange(1, 820)
LOW_V, HIGH_V = 0.1, 0.3
MODE_HZ, DAMPING = np.array([60.0, 140.0, 230.0]), np.array([0.02, 0.015, 0.02])
SOFTENING = np.array([-0.012, 0.0, -0.006])  # from 0.1 to 0.3 V
GAIN = 1e-6 * np.array([[[2, 1], [1, 2]], [[2, -1], [-2, 1]], [[0.5, 0.4], [0.4, -0.6]]])
NOISE_M = 2e-9


def shift(level_V: float) -> np.ndarray:
    """Return the logarithmic change of the frequencies, linear in the logarithm of the level."""
    return SOFTENING * np.log(level_V / np.sqrt(LOW_V * HIGH_V)) / np.log(HIGH_V / LOW_V)


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
    displacements_m = np.stack(
        [displacement(drives[:, :, r], level_V) for r in range(realisations)], axis=2
    )
    readings_m = displacements_m[..., None] + NOISE_M * rng.standard_normal(
        (*displacements_m.shape, 2)
    )
    return piezoid.PeriodicData(
        sampling_rate_Hz=RATE_HZ,
        inputs=("a", "b"),
        outputs=("x", "y"),
        voltage_V=np.repeat(drives[..., None], 2, axis=3),
        displacement_m=readings_m,
    )


def error(model: piezoid.CoupledStage, data: piezoid.PeriodicData) -> float:
    residual_power, power = 0.0, 0.0
    for r in range(data.voltage_V.shape[2]):
        simulated_m = model.simulate(data.voltage_V[:, :, r, 0], periodic=True)
        displacement_m = data.displacement_m[:, :, r].mean(axis=2)
        residual_power += np.sum((displacement_m - displacement_m.mean(axis=0) - simulated_m) ** 2)
        power += np.sum(displacement_m**2)
    return float(np.sqrt(residual_power / power))


@pytest.fixture(scope="module")
def levels() -> list[piezoid.PeriodicData]:
    return [record(LOW_V, 1), record(HIGH_V, 2)]


@pytest.fixture(scope="module")
def model(levels: list[piezoid.PeriodicData]) -> piezoid.CoupledStage:
    return piezoid.fit_coupled(levels, modes=3)


def test_modes_and_their_level_dependence_are_identified_with_finite_intervals(model):
    indices = [int(np.argmin(np.abs(model.mode_frequency_Hz(0.17) - f))) for f in MODE_HZ]
    expected_Hz = MODE_HZ * np.exp(shift(LOW_V))
    np.testing.assert_allclose(model.mode_frequency_Hz(LOW_V)[indices], expected_Hz, rtol=2e-3)
    np.testing.assert_allclose(model.mode_damping(HIGH_V)[indices], DAMPING, rtol=0.05)
    change = model.frequency_change()[indices]
    np.testing.assert_allclose(change[:, 0], np.expm1(SOFTENING), atol=1.5e-3)
    low_Hz, high_Hz = model.mode_frequency_interval_Hz(HIGH_V).T
    assert (
        (low_Hz < model.mode_frequency_Hz(HIGH_V)) & (model.mode_frequency_Hz(HIGH_V) < high_Hz)
    ).all()
    assert (high_Hz < 1.05 * low_Hz).any()


def test_a_new_drive_of_any_level_within_the_data_is_predicted(model):
    for level_V, seed in ((LOW_V, 11), (0.2, 13), (HIGH_V, 12)):
        assert error(model, record(level_V, seed, realisations=2)) < 0.003


def test_a_single_level_can_be_fitted(levels):
    single_level = piezoid.fit_coupled(levels[1:], modes=3, intervals=False)
    assert error(single_level, record(HIGH_V, 14, realisations=1)) < 0.003
    assert np.isinf(single_level.frequency_change()[:, 2]).all()


def test_the_response_from_rest_settles_to_the_steady_state(model):
    drive = multisine(HIGH_V, np.random.default_rng(5))
    steady = model.simulate(drive, periodic=True)
    settled = model.simulate(np.tile(drive, (4, 1)))[3 * SAMPLES :]
    assert np.std(settled - steady) < 0.02 * np.std(steady)


def test_the_same_records_give_the_same_model(levels, model):
    refit = piezoid.fit_coupled(levels[::-1], modes=3, intervals=False)
    np.testing.assert_array_equal(refit.residue_m_per_V, model.residue_m_per_V)


def test_drives_of_other_levels_and_widths_are_refused(model):
    with pytest.raises(
        IdentificationError, match=r"a drive of 0\.5 V rms. Needed: one from 0\.1 to 0\.3"
    ):
        model.response([10.0], 0.5)
    with pytest.raises(IdentificationError, match="0\\.0333"):
        model.simulate(multisine(LOW_V / 3, np.random.default_rng(1)), periodic=True)
    with pytest.raises(IdentificationError, match="2, one for each of a, b"):
        model.simulate(np.ones((100, 3)))


def test_insufficient_records_are_refused(levels):
    with pytest.raises(ExcitationError, match="2 realisations for 2 drives"):
        piezoid.fit_coupled([levels[0].select([0, 1])])
    other_rate = replace(levels[0], sampling_rate_Hz=2 * RATE_HZ)
    with pytest.raises(ExcitationError, match="the same drives, sensors, rate"):
        piezoid.fit_coupled([levels[0], other_rate])
    with pytest.raises(ExcitationError, match="no record"):
        piezoid.fit_coupled([])
