"""The measured frequency response is unbiased; noise, distortion and interference are stated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import chirp

from piezoid.errors import ExcitationError
from piezoid.identification.dynamics.behind_hysteresis import estimate_response_by_coherence
from piezoid.identification.dynamics.frequency_response import estimate_response
from tests.identification.dynamics.stage import (
    PERIOD,
    RATE_HZ,
    all_paths,
    first_response,
    record,
    truth,
)


def test_without_noise_the_responses_of_two_axes_are_exact(rng):
    for k, estimate in enumerate(estimate_response(record(rng, inputs=("x", "y"), noise_m=0.0))):
        exact = all_paths(estimate.frequency_Hz, axes=2)[:, k, k]
        np.testing.assert_allclose(estimate.response, exact, rtol=1e-9, atol=1e-18)


def test_the_stated_variance_agrees_with_the_scatter(rng):
    """Normalised errors have a mean square of one: 200 complex values, 4 sigma."""
    estimate = first_response(record(rng, noise_m=5e-9))
    error = estimate.response - truth().sampled(RATE_HZ).response(estimate.frequency_Hz)[:, 0, 0]
    mean_square = np.mean(np.abs(error) ** 2 / estimate.variance)
    assert abs(mean_square - 1) < 4 / np.sqrt(len(error))


def test_coherence_is_the_signal_fraction_of_the_power(rng):
    """White noise of rms s has the power s^2 n / r in every line of the mean of r periods."""
    noise_m, data = 2e-8, record(rng, noise_m=2e-8)
    estimate = first_response(data)
    lines = np.round(estimate.frequency_Hz * PERIOD / RATE_HZ).astype(int)
    drive = np.fft.rfft(data.voltage_V[:, 0, :, 0], axis=0)[lines]
    gain = truth().sampled(RATE_HZ).response(estimate.frequency_Hz)[:, 0]
    signal, noise = (np.abs(gain * drive) ** 2).mean(axis=1), noise_m**2 * PERIOD / 4
    assert (noise / signal).max() > 0.05
    np.testing.assert_allclose(estimate.coherence, signal / (signal + noise), atol=0.03)


def test_mains_interference_is_rejected_at_its_line_only(rng):
    data = record(rng, noise_m=5e-10, realisations=6)
    time_s = np.arange(PERIOD) / RATE_HZ
    phase = rng.uniform(0, 2 * np.pi, 6)
    hum_m = 2e-7 * np.cos(2 * np.pi * 150 * time_s[:, None] + phase)
    disturbed = replace(data, displacement_m=data.displacement_m + hum_m[:, None, :, None])
    estimate = first_response(disturbed)
    assert estimate.frequency_Hz[estimate.is_rejected].tolist() == [150.0]


def test_a_sharp_resonance_is_not_interference(rng):
    assert not first_response(record(rng, cubic=0.02)).is_interference.any()


def test_a_chirp_gives_the_response_within_its_band(rng):
    drive_V = _chirp_V()
    displacement_m, _ = truth().sampled(RATE_HZ).run(drive_V)
    estimate = estimate_response_by_coherence(
        drive_V,
        displacement_m + 1e-9 * rng.standard_normal(len(displacement_m)),
        sampling_rate_Hz=RATE_HZ,
        segment_samples=8192,
    )
    exact = truth().sampled(RATE_HZ).response(estimate.frequency_Hz)[:, 0, 0]
    inside = (estimate.frequency_Hz > 60) & (estimate.frequency_Hz < 2500)
    above = estimate.frequency_Hz > 5000
    error = np.abs(estimate.response - exact)[inside] / np.abs(exact[inside])
    assert np.median(error) < 0.02
    assert not estimate.is_rejected[inside & (estimate.frequency_Hz < 500)].any()
    assert estimate.is_rejected[above].mean() > 0.9


@pytest.mark.parametrize("segment_samples", [32, 512])
def test_coherence_of_equal_signal_and_noise_is_one_half(rng, segment_samples):
    """The scatter agrees with the stated variance."""
    drive_V = rng.standard_normal(200_000)
    estimate = estimate_response_by_coherence(
        drive_V,
        drive_V + rng.standard_normal(200_000),
        sampling_rate_Hz=1.0,
        segment_samples=segment_samples,
    )
    assert np.mean(estimate.coherence) == pytest.approx(0.5, abs=0.02)
    scatter = np.mean(np.abs(estimate.response - 1) ** 2) / np.mean(estimate.variance)
    assert scatter == pytest.approx(1.0, abs=0.25)


def test_one_realisation_of_one_period_is_refused(rng):
    with pytest.raises(ExcitationError, match="1 realisations of 1 periods for 1 inputs"):
        first_response(record(rng, realisations=1, periods=1))


def _chirp_V() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    time_s = np.arange(round(10.0 * RATE_HZ)) / RATE_HZ
    return np.asarray(0.5 * chirp(time_s, 20.0, 10.0, 3000.0, method="logarithmic", phi=-90.0))
