"""Parametric fit: modes, damping and delay are recovered within their intervals."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.errors import IdentificationError
from piezoid.identification.dynamics.fit_dynamics import fit_dynamics, resolved_modes
from piezoid.identification.dynamics.modal import Declaration, Filter, LinearDynamics, Structure
from tests.identification.dynamics.stage import (
    DAMPING,
    DECLARATION,
    DELAY_S,
    FREQUENCY_HZ,
    STRUCTURE,
    first_response,
    lines_between,
    record,
    truth,
)

EXACT = 1e-6  # relative: convergence without noise


def test_without_noise_the_truth_is_recovered(rng):
    model = fit_dynamics(first_response(record(rng, noise_m=0.0)), STRUCTURE, DECLARATION)
    np.testing.assert_allclose(model.mode_frequency_Hz, FREQUENCY_HZ, rtol=EXACT)
    np.testing.assert_allclose(model.mode_damping, DAMPING, rtol=100 * EXACT)
    assert model.delay_s == pytest.approx(DELAY_S, rel=100 * EXACT)
    np.testing.assert_allclose(model.mode_gain_m_per_V, truth().mode_gain_m_per_V, rtol=1e-4)


def test_a_superfluous_mode_is_not_resolved(rng):
    measured = first_response(record(rng, noise_m=1e-8))
    assert resolved_modes(fit_dynamics(measured, STRUCTURE, DECLARATION)).all()
    too_many = fit_dynamics(measured, Structure(modes=3), DECLARATION)
    indices = [np.argmin(np.abs(too_many.mode_frequency_Hz - f)) for f in FREQUENCY_HZ]
    assert resolved_modes(too_many)[indices].all()
    assert not np.delete(resolved_modes(too_many), indices).any()


def test_stated_intervals_have_their_coverage(rng):
    """At least 93 % of five parameters in 100 draws, none below 90, with noise, play and cubic.

    A small play of 2 % of the drive also delays by 0.2 us, which no linear model distinguishes
    from a delay.
    """
    exact = np.array([*FREQUENCY_HZ, *DAMPING, DELAY_S])
    inside = np.zeros(len(exact))
    for _ in range(100):
        data = record(rng, noise_m=2e-8, play_weight=5e-4, cubic=4e-3)
        model = fit_dynamics(first_response(data), STRUCTURE, DECLARATION)
        inside += (_intervals(model)[:, 0] <= exact) & (exact <= _intervals(model)[:, 1])
    assert inside.mean() >= 93
    assert inside.min() >= 90


def test_the_realisation_has_the_response_of_the_model(rng):
    frequency_Hz = np.linspace(5, 20_000, 77)
    model = replace(
        truth(),
        lag_frequency_Hz=np.array([200.0]),
        lag_gain_m_per_V=1e-7 * rng.standard_normal(1),
        direct_gain_m_per_V=1e-8 * rng.standard_normal(),
        shape_covariance=np.zeros((6, 6)),
    )
    expected = model.response(frequency_Hz)
    response = model.realised().response(frequency_Hz)[:, 0, 0]
    np.testing.assert_allclose(response, expected, rtol=1e-8, atol=1e-20)


def test_a_first_order_stage_is_identified_as_a_lag(rng):
    measured = first_response(record(rng, noise_m=1e-10))
    lag = 2 * np.pi * 630 / (2j * np.pi * measured.frequency_Hz + 2 * np.pi * 630)
    first_order_response = type(measured)(**{**vars(measured), "response": 1e-6 * lag})
    model = fit_dynamics(
        first_order_response, Structure(modes=0, lags=1), Declaration(hold="band_limited")
    )
    np.testing.assert_allclose(model.lag_frequency_Hz, 630, rtol=1e-6)
    assert model.delay_s < 1e-9


def test_more_parameters_than_values_are_refused(rng):
    narrow = lines_between(first_response(record(rng)), 600, 700)
    with pytest.raises(IdentificationError, match="usable real values"):
        fit_dynamics(narrow, Structure(modes=6, direct=True), DECLARATION)


def test_a_declared_filter_does_not_count_as_delay(rng):
    measured = first_response(record(rng, noise_m=1e-10))
    undeclared = fit_dynamics(measured, STRUCTURE, Declaration())
    declared = fit_dynamics(measured, STRUCTURE, DECLARATION)
    added = undeclared.delay_s - declared.delay_s
    assert added == pytest.approx(1 / (2 * np.pi * 4000), rel=0.25)
    assert undeclared.cost_ratio > 10 * declared.cost_ratio
    assert declared.declared == (Filter(name="amplifier", frequency_Hz=4000.0),)


def _intervals(model: LinearDynamics) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.concatenate(
        [
            model.mode_frequency_interval_Hz(),
            model.mode_damping_interval(),
            model.delay_interval_s()[None],
        ]
    )
