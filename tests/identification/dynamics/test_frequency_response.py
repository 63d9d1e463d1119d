"""The measured response: true on average, honest about noise, distortion and interference."""

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
    for k, found in enumerate(estimate_response(record(rng, inputs=("x", "y"), noise_m=0.0))):
        exact = all_paths(found.frequency_Hz, axes=2)[:, k, k]
        np.testing.assert_allclose(found.response, exact, rtol=1e-9, atol=1e-18)


def test_the_stated_variance_is_that_of_the_error(rng):
    """Errors over their standard deviation have mean square one: 200 complex values, 4 sigma."""
    found = first_response(record(rng, noise_m=5e-9))
    error = found.response - truth().sampled(RATE_HZ).response(found.frequency_Hz)[:, 0, 0]
    mean_square = np.mean(np.abs(error) ** 2 / found.variance)
    assert abs(mean_square - 1) < 4 / np.sqrt(len(error))


def test_coherence_is_the_share_of_the_power_that_is_no_noise(rng):
    """White noise of rms s has the power s^2 n / r in every line of the mean of r periods."""
    noise_m, data = 2e-8, record(rng, noise_m=2e-8)
    found = first_response(data)
    lines = np.round(found.frequency_Hz * PERIOD / RATE_HZ).astype(int)
    drive = np.fft.rfft(data.voltage_V[:, 0, :, 0], axis=0)[lines]
    gain = truth().sampled(RATE_HZ).response(found.frequency_Hz)[:, 0]
    moved, noise = (np.abs(gain * drive) ** 2).mean(axis=1), noise_m**2 * PERIOD / 4
    assert (noise / moved).max() > 0.05
    np.testing.assert_allclose(found.coherence, moved / (moved + noise), atol=0.03)


def test_mains_on_the_sensor_is_rejected_at_its_line_alone(rng):
    data = record(rng, noise_m=5e-10, realisations=6)
    time_s = np.arange(PERIOD) / RATE_HZ
    phase = rng.uniform(0, 2 * np.pi, 6)
    hum_m = 2e-7 * np.cos(2 * np.pi * 150 * time_s[:, None] + phase)
    disturbed = replace(data, displacement_m=data.displacement_m + hum_m[:, None, :, None])
    found = first_response(disturbed)
    assert found.frequency_Hz[found.is_rejected].tolist() == [150.0]


def test_a_sharp_resonance_is_not_taken_for_interference(rng):
    assert not first_response(record(rng, cubic=0.02)).is_interference.any()


def test_a_chirp_gives_the_response_where_it_has_power_and_rejects_the_rest(rng):
    drive_V = _chirp_V()
    moved_m, _ = truth().sampled(RATE_HZ).run(drive_V)
    found = estimate_response_by_coherence(
        drive_V,
        moved_m + 1e-9 * rng.standard_normal(len(moved_m)),
        sampling_rate_Hz=RATE_HZ,
        segment_samples=8192,
    )
    exact = truth().sampled(RATE_HZ).response(found.frequency_Hz)[:, 0, 0]
    inside = (found.frequency_Hz > 60) & (found.frequency_Hz < 2500)
    above = found.frequency_Hz > 5000
    error = np.abs(found.response - exact)[inside] / np.abs(exact[inside])
    assert np.median(error) < 0.02
    assert not found.is_rejected[inside & (found.frequency_Hz < 500)].any()
    assert found.is_rejected[above].mean() > 0.9


@pytest.mark.parametrize("segment_samples", [32, 512])
def test_coherence_falls_with_noise_as_it_should(rng, segment_samples):
    """Equal powers of signal and noise make a coherence of one half."""
    drive_V = rng.standard_normal(200_000)
    found = estimate_response_by_coherence(
        drive_V,
        drive_V + rng.standard_normal(200_000),
        sampling_rate_Hz=1.0,
        segment_samples=segment_samples,
    )
    assert np.mean(found.coherence) == pytest.approx(0.5, abs=0.02)
    scatter = np.mean(np.abs(found.response - 1) ** 2) / np.mean(found.variance)
    assert scatter == pytest.approx(1.0, abs=0.25)


def test_one_realisation_of_one_period_is_refused(rng):
    with pytest.raises(ExcitationError, match="1 realisations of 1 periods for 1 inputs"):
        first_response(record(rng, realisations=1, periods=1))


def _chirp_V() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    time_s = np.arange(round(10.0 * RATE_HZ)) / RATE_HZ
    return np.asarray(0.5 * chirp(time_s, 20.0, 10.0, 3000.0, method="logarithmic", phi=-90.0))
