"""The shipped C against its equations in Python, in every mode and fault."""

import math

import numpy as np
import pytest

from tests.runtime.runtime_parameters import RST_A, RST_B, started, tunnelling
from tests.runtime.tip_reference import BITS, Tip

SET_A, SAMPLES = 1e-9, 6000
GUARDED = {
    "approach_step_V": 7e-4,
    "approach_log_step": 0.11,
    "contact_log": 0.73,
    "contact_samples": 4,
    "retract_samples": 9,
    "retract_step_V": 0.04,
    "retract_voltage_V": -0.5,
    "voltage_minimum_V": -0.6,
    "voltage_maximum_V": 0.06,
    "search_voltage_V": 0.05,
    "trip_limit": 3,
    "trip_samples": 120,
    "stuck_samples": 6,
    "stuck_voltage_V": 2e-3,
    "stuck_current_A": 1e-11,
}
FAULTS = ("sound",) * 6 + ("nan", "frozen", "dead", "reversed", "full")


def campaign(rng):
    """Draw for every sample a sensor fault, a surface height in nepers, and a reset."""
    fault, height, reset = [], [], np.zeros(SAMPLES, dtype=bool)
    while len(fault) < SAMPLES:
        length = int(rng.integers(1, 250))
        fault += [str(rng.choice(FAULTS))] * length
        height += [rng.choice([0.0, 0.5, 2.5, 6.0, -0.5, -2.5, -6.0, -40.0])] * length
    reset[rng.integers(0, SAMPLES, 60)] = True
    return fault[:SAMPLES], np.array(height[:SAMPLES]), reset


def reading(fault, current_A, last_A, noise_A):
    readings = {
        "nan": math.nan,
        "frozen": last_A,
        "dead": noise_A,
        "reversed": -current_A + noise_A,
        "full": 2.5e-8,
    }
    return readings.get(fault, min(current_A, 2.5e-8) + noise_A)


def test_every_voltage_and_status_bit_equals_the_equations():
    assert set(BITS.values()) == set().union(*(compare_with_reference(seed) for seed in range(5)))


@pytest.mark.parametrize(
    "disabled", [("search_voltage_V", "trip_limit"), ("retract_step_V",), ("stuck_samples",)]
)
def test_disabled_guards_equal_the_equations(disabled):
    compare_with_reference(1, **dict.fromkeys(disabled, 0))


def compare_with_reference(seed, **overrides):
    """Run a campaign in both implementations; return the status bits that occurred."""
    rng = np.random.default_rng(seed)
    parameters = tunnelling(**{**GUARDED, **overrides})
    controller, tip = started(parameters, measured=SET_A), Tip(parameters, 0.0, SET_A)
    fault, height, reset = campaign(rng)
    noise_A = rng.normal(0.0, 1e-12, SAMPLES)
    u, y, last_A, seen_bits = np.zeros(4), np.zeros(3), SET_A, 0
    for k in range(SAMPLES):
        current_A = SET_A * math.exp(min(y[0] + height[k], 50.0))
        measured_A = reading(fault[k], current_A, last_A, noise_A[k])
        last_A = last_A if math.isnan(measured_A) else measured_A
        if reset[k]:
            controller.reset()
        volts = controller.step(SET_A, measured_A)
        expected_V, bits = tip.step(SET_A, measured_A, reset[k])
        assert volts == pytest.approx(expected_V, abs=1e-12), k
        assert int(controller.status) == bits, k
        seen_bits |= bits
        u = np.r_[volts, u[:-1]]
        y = np.r_[RST_B[2:] @ u[1:3] - RST_A[1:] @ y[:2], y[:-1]]
    return {bit for bit in BITS.values() if seen_bits & bit}
