"""Duration of a controller step with 16 plays, 9 dead zones and an observer of order 4.

`make benchmark` prints minimum and median of a run of STEPS steps, whose loop is in C. A step
called from Python adds the call through ctypes.
"""

import numpy as np
import pytest

from piezoid.runtime.controller import Controller

STEPS = 100_000
PLAYS = 16

HYSTERESIS = {
    "play_count": PLAYS,
    "play_threshold_V": np.arange(PLAYS) * 0.3,
    "play_weight_m_per_V": np.r_[2e-6, np.full(PLAYS - 1, 1e-7)],
    "knot_count": 9,
    "knot_m": np.linspace(-8e-6, 8e-6, 9),
    "knot_weight": np.r_[np.full(4, 0.01), 1.0, np.full(4, 0.01)],
}
# Four lags of pole p in series with unit gain: all states rest at one.
POLE = 0.7
OBSERVER = {
    "observer_order": 4,
    "observer_A": POLE * np.eye(4) + (1 - POLE) * np.eye(4, k=-1),
    "observer_B": 3.5e-6 * (1 - POLE) * np.eye(4)[0],
    "observer_C": np.eye(4)[3],
    "observer_L": np.full(4, 0.3),
    "observer_disturbance_L_V_per_m": 1e4,
    "observer_rest": np.full(4, 3.5e-6),
    "feedback_K_V": np.zeros(4),
    "feedback_N_V_per_m": 1 / 3.5e-6,
    "gain_m_per_V": 3.5e-6,
}
LIMITS = {
    "voltage_minimum_V": -10.0,
    "voltage_maximum_V": 10.0,
    "lsb_V": 20 / 65536,
    "reference_minimum_m": -3e-5,
    "reference_maximum_m": 3e-5,
    "displacement_minimum_m": -5e-5,
    "displacement_maximum_m": 5e-5,
}


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("method", ["mpi", "dob", "mpi_dob"])
def test_steps(benchmark, method, precision):
    """STEPS steps of the shipped source."""
    values = {**LIMITS, **HYSTERESIS, **OBSERVER, "method": method}
    controller = Controller(values, precision=precision)
    reference = 1e-5 * np.sin(np.arange(STEPS) * 2 * np.pi / 2000)
    measured = 1e-5 * np.sin(np.arange(STEPS) * 2 * np.pi / 2000 - 0.05)
    controller.start(0.0, 0.0)
    run = benchmark(controller.run, reference, measured)
    assert np.abs(run.voltage_V).max() > 1
    benchmark.extra_info["steps"] = STEPS


def test_one_step_from_python(benchmark):
    """One step, called through ctypes."""
    controller = Controller({**LIMITS, **HYSTERESIS, **OBSERVER, "method": "mpi_dob"})
    controller.start(0.0, 0.0)
    benchmark(controller.step, 1e-6, 1.1e-6)
