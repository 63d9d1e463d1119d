"""Poles sorted into a structure: pairs are modes, real poles lags, two of them a broad mode."""

from types import SimpleNamespace

import numpy as np
import pytest

from piezoid.identification.dynamics.fit_dynamics import _shape_of_poles
from piezoid.identification.dynamics.modal_basis import _direct


def sorted_into(poles_Hz: list[complex], modes: int, lags: int) -> list[float]:
    structure = SimpleNamespace(modes=modes, lags=lags)
    return np.exp(_shape_of_poles(np.array(poles_Hz), structure)).tolist()  # type: ignore[arg-type]


def test_two_real_poles_are_a_mode_with_their_product_and_sum() -> None:
    frequency_Hz, damping = sorted_into([-100.0 + 0j, -400.0 + 0j], modes=1, lags=0)
    assert frequency_Hz**2 == pytest.approx(100.0 * 400.0)
    assert 2 * damping * frequency_Hz == pytest.approx(100.0 + 400.0)


def test_a_pair_is_a_mode_and_the_slowest_real_pole_the_lag() -> None:
    poles_Hz = [-6 + 8j, -6 - 8j, -50.0 + 0j]
    assert sorted_into(poles_Hz, modes=1, lags=1) == pytest.approx([10.0, 0.6, 50.0])


def test_what_passes_directly_is_one_input_on_one_output_without_a_state() -> None:
    system = _direct(np.zeros(0))
    assert (system.A.shape, system.B.shape, system.C.shape) == ((0, 0), (0, 1), (1, 0))
    assert system.D.tolist() == [[1.0]]
