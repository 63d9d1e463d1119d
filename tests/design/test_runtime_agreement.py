"""The shipped C with the gains of a design is the controller of the computed margins."""

import numpy as np
import pytest

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.feedforward import filter_sections, fit_reference_path
from piezoid.design.observer import disturbance_model, linear_controller
from piezoid.design.rst import place_poles
from piezoid.export.export_stage import observer_values
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import product
from tests.design.placed import place_observer
from tests.design.rig import (
    LATERAL_m_per_V,
    lateral_chain,
    poles,
    printed_observer_poles,
    vertical_chain,
)
from tests.runtime.runtime_parameters import started, tunnelling

LIMITS = {
    "voltage_minimum_V": -10.0,
    "voltage_maximum_V": 10.0,
    "reference_minimum_m": -3e-5,
    "reference_maximum_m": 3e-5,
    "displacement_minimum_m": -5e-5,
    "displacement_maximum_m": 5e-5,
}
SAMPLES = 300
EXACT = 1e-8
CLUSTERED = 1e-5  # five roots of S within 0.04 of z = 1 cost coefficients a third of their digits


def polynomial_controller(
    R: Array, S: Array, T: Array, reference: Array, measured: Array
) -> Array:
    """Return u of S u = T r - R y, for any r and y."""
    u = np.zeros(len(reference))
    for k in range(len(u)):
        for p, s, sign in ((T, reference, 1.0), (R, measured, -1.0)):
            u[k] += sign * sum(p[j] * s[k - j] for j in range(min(k + 1, len(p))))
        u[k] -= sum(S[j] * u[k - j] for j in range(1, min(k, len(S) - 1) + 1))
    return u


@pytest.mark.parametrize("delay_s", [0.0, 30e-6, 100e-6])
@pytest.mark.parametrize("oscillation_Hz", [(), (40.0, 120.0)])
def test_the_observer_of_the_runtime_is_the_designed_controller(delay_s, oscillation_Hz, rng):
    plant = plant_from_chain(lateral_chain(LATERAL_m_per_V, delay_s))
    feedback, observer = printed_observer_poles()
    pairs = [poles((f, 0.7)) for f in oscillation_Hz]
    placed = place_observer(
        plant,
        feedback_poles=feedback,
        observer_poles=np.concatenate([observer, *pairs]),
        disturbance=disturbance_model(20e3, oscillation_Hz),
    )
    c = linear_controller(placed)
    path = fit_reference_path([plant], c.R, c.S, c.T, band_Hz=100.0)
    sections = filter_sections(path.filter)
    parameters = {**LIMITS, **observer_values(placed), "method": "dob"}
    parameters |= {"reference_section_count": len(sections), "reference_section": sections}
    reference, measured = 1e-7 * rng.normal(size=(2, SAMPLES))
    measured[0] = reference[0] = 0.0
    shipped = started(parameters).run(reference, measured).voltage_V
    designed = polynomial_controller(c.R, c.S, product(c.T, path.filter), reference, measured)
    assert np.abs(designed).max() < 10.0  # below the limits
    digits = EXACT if not oscillation_Hz else CLUSTERED
    np.testing.assert_allclose(shipped, designed, rtol=0, atol=digits * np.abs(designed).max())


def test_the_polynomials_of_the_runtime_are_the_designed_controller(rng):
    plant = plant_from_chain(vertical_chain())
    target = np.real(np.poly([0.72, 0.71, 0.3, 0.2, 0.1]))
    c = place_poles(plant, target, H_R=[1.0, 1.0])
    without_integrator = np.cumsum(c.S)[:-1]
    current_A = 1e-9 * np.exp(0.2 * rng.normal(size=SAMPLES))
    reference_A = 1e-9 * np.exp(0.2 * rng.normal(size=SAMPLES))
    current_A[0] = reference_A[0] = 1e-9
    parameters = tunnelling(
        current_floor_A=1e-12,
        current_ceiling_A=1e-7,
        rst_T_count=len(c.T),
        rst_T_V=c.T,
        rst_R_count=len(c.R),
        rst_R_V=c.R,
        rst_S_count=len(without_integrator),
        rst_S=without_integrator,
    )
    shipped = started(parameters, measured=1e-9).run(reference_A, current_A).voltage_V
    designed = polynomial_controller(
        c.R, c.S, c.T, np.log(reference_A / 1e-9), np.log(current_A / 1e-9)
    )
    np.testing.assert_allclose(shipped, designed, atol=1e-9 * np.abs(designed).max())
