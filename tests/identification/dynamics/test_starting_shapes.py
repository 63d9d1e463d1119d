"""Poles sorted into a structure: pairs are modes, real poles lags, two of them a broad mode."""

import numpy as np
import pytest

from piezoid.identification.dynamics.fit_dynamics import (
    Declaration,
    _shape_of_poles,
    _trial_delays,
)
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.modal_basis import Structure
from piezoid.identification.dynamics.vector_fitting import weighted_misfit
from piezoid.numerics.arrays import Array

RATE_Hz = 2e4


def measured(frequency_Hz: Array) -> FrequencyResponse:
    """Return what a stage without any dynamics shows at these lines: 1 um/V."""
    size = (len(frequency_Hz), 1, 1)
    return FrequencyResponse(
        inputs=("x",),
        outputs=("x",),
        sampling_rate_Hz=RATE_Hz,
        frequency_Hz=frequency_Hz,
        response=np.full(size, 1e-6 + 0j),
        noise_variance=np.full(size, 1e-18),
        distortion_variance=np.zeros(size),
        coherence=np.ones(size[:2]),
        is_interference=np.zeros(size[:2], dtype=bool),
        is_rejected=np.zeros(size[:2], dtype=bool),
        least_coherence=0.9,
        variance_freedom=8.0,
        drive_rms_V=np.ones(1),
        realisations=1,
        periods=9,
    )


def sorted_into(poles_Hz: list[complex], modes: int, lags: int) -> list[float]:
    structure = Structure(modes=modes, lags=lags)
    return np.exp(_shape_of_poles(np.array(poles_Hz), structure)).tolist()


def test_two_real_poles_are_a_mode_with_their_product_and_sum() -> None:
    frequency_Hz, damping = sorted_into([-100.0 + 0j, -400.0 + 0j], modes=1, lags=0)
    assert frequency_Hz**2 == pytest.approx(100.0 * 400.0)
    assert 2 * damping * frequency_Hz == pytest.approx(100.0 + 400.0)


def test_a_pair_is_a_mode_and_the_slowest_real_pole_the_lag() -> None:
    poles_Hz = [-6 + 8j, -6 - 8j, -50.0 + 0j]
    assert sorted_into(poles_Hz, modes=1, lags=1) == pytest.approx([10.0, 0.6, 50.0])


@pytest.mark.parametrize(
    ("longest_samples", "count"), [(None, 5), (0.2, 1), (7.0, 8), (900.0, 21)]
)
def test_delays_are_tried_sample_by_sample_but_no_more_than_twenty(
    longest_samples: float | None, count: int
) -> None:
    longest_s = None if longest_samples is None else longest_samples / RATE_Hz
    lines = measured(np.arange(1.0, 9.0))
    found = _trial_delays(lines, Declaration(longest_delay_s=longest_s))
    assert len(found) == count
    assert found[0] == 0.0
    if count > 1:
        assert found[-1] == pytest.approx(longest_s or 4.0 / RATE_Hz)
        np.testing.assert_allclose(np.diff(found), found[1])


def test_a_response_made_of_its_poles_is_missed_by_nothing_and_any_other_by_its_square() -> None:
    s, poles = 1j * np.linspace(0.1, 3.0, 40), np.array([-0.1 + 1j, -0.1 - 1j])
    made = (1.0 / (s - poles[0]) + 1.0 / (s - poles[1]) + 0.3)[:, None]
    misfit = [
        weighted_misfit(s, height * made, np.ones((40, 1)), at)
        for height, at in ((1.0, poles), (1.0, 1.3 * poles), (2.0, 1.3 * poles))
    ]
    assert misfit[0] == pytest.approx(0.0, abs=1e-20)
    assert misfit[2] == pytest.approx(4.0 * misfit[1])
