"""Dead, clipped and coarse channels, and the noise of a smooth one."""

import numpy as np
import pytest

from piezoid.records.faults import clipped_share, noise_rms, step_size

PHASE = 2 * np.pi * np.arange(20000) / 4000
SINE = np.sin(PHASE)


@pytest.mark.parametrize("noise", [1e-5, 1e-3, 1e-2])
def test_noise_on_a_smooth_signal_is_measured(noise: float, rng: np.random.Generator) -> None:
    assert noise_rms(SINE + rng.normal(0, noise, len(SINE))) == pytest.approx(noise, rel=0.05)


def test_spikes_do_not_count_as_noise(rng: np.random.Generator) -> None:
    values = SINE + rng.normal(0, 1e-3, len(SINE))
    values[::500] += 1
    assert noise_rms(values) == pytest.approx(1e-3, rel=0.05)


@pytest.mark.parametrize("step", [1 / 128, 0.02])
def test_a_converter_step_is_found(step: float) -> None:
    assert step_size(step * np.round(SINE / step)) == pytest.approx(step, rel=1e-6)


def test_a_continuous_signal_has_no_step(rng: np.random.Generator) -> None:
    assert step_size(SINE + rng.normal(0, 1e-3, len(SINE))) == 0


def test_a_clipped_channel_is_told_with_its_share(rng: np.random.Generator) -> None:
    noisy = SINE + rng.normal(0, 1e-4, len(SINE))
    clipped = np.clip(noisy, -0.9, 0.9)
    assert clipped_share(clipped) == pytest.approx(np.mean(np.abs(noisy) >= 0.9), rel=0.02)


@pytest.mark.parametrize(
    "values",
    [
        SINE,
        np.round(SINE, 2),
        np.round(SINE, 4),
        np.concatenate([np.maximum(SINE, 0)[:6000], np.zeros(3000)]),
        np.repeat([0.0, 1, 2, 3, 2, 1, 0], 500),
        np.repeat([0.0, 1, 0, 1], 500),
        np.abs(np.arange(-5000, 5000) % 2000 - 1000) / 1000,
        np.zeros(100),
    ],
    ids=[
        "sine",
        "coarse sine",
        "fine sine",
        "bursts from rest",
        "staircase",
        "steps",
        "triangle",
        "dead",
    ],
)
def test_drives_that_rest_where_they_should_are_not_clipped(values: np.ndarray) -> None:
    assert clipped_share(values, rest=0.0) == 0
