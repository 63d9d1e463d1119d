"""Parameter sets and started controllers of the runtime tests."""

import numpy as np

from piezoid.runtime.controller import Controller

WIDE = {
    "voltage_minimum_V": -1000.0,
    "voltage_maximum_V": 1000.0,
    "reference_minimum_m": -1000.0,
    "reference_maximum_m": 1000.0,
    "displacement_minimum_m": -1000.0,
    "displacement_maximum_m": 1000.0,
    "gain_m_per_V": 1.0,
}

WORKED = {
    "r": np.array([0.0, 1, 2, 3]),
    "w": np.array([0.5, 0.25, 0.15, 0.10]),
    "z": np.zeros(4),
    "knot": np.array([-2.0, -1, 0, 1, 2]),
    "weight": np.array([-0.1, -0.2, 1, 0.3, -0.25]),
    "last": 0.0,
}

CREEP = {
    "relaxation_count": 2,
    "relaxation_rate": np.array([0.02, 0.003]),
    "relaxation_share": np.array([0.015, 0.01]),
}


def started(parameters, volts=0.0, measured=0.0, precision="double"):
    """Return a controller that started from a voltage and a reading."""
    controller = Controller(parameters, precision=precision)
    controller.start(volts, measured)
    return controller


def hysteresis(model, **overrides):
    """Return the parameters of a model of ``runtime_reference.random_model``."""
    return {
        **WIDE,
        "method": "mpi",
        "play_count": len(model["r"]),
        "play_threshold_V": model["r"],
        "play_weight_m_per_V": model["w"],
        "play_memory_V": model["z"],
        "knot_count": len(model["knot"]),
        "knot_m": model["knot"],
        "knot_weight": model["weight"],
        **overrides,
    }


RST_A = np.array([1, -0.3278234616, 0.0122990935])
RST_B = np.array([0.0, 0.0, 102.2579562477, 23.9785156002])
RST_S = np.array([1, -1.5654912179, 0.6523716392, -0.0792887741, -0.0075916473])
RST_R = np.array([2.692602e-4, 1.856397e-4, -7.97265e-5, 3.8939e-6])


def tunnelling(**overrides):
    """Return the polynomial controller of a tunnelling gap of 1 nA, retracting to -9 V."""
    return {
        "method": "rst",
        "voltage_minimum_V": -10.0,
        "voltage_maximum_V": 10.0,
        "current_reference_A": 1e-9,
        "current_floor_A": 1e-11,
        "current_ceiling_A": 2e-8,
        "retract_voltage_V": -9.0,
        "retract_samples": 100,
        "bad_samples": 5,
        "contact_samples": 10,
        "approach_step_V": 1e-3,
        "approach_log_step": 0.15,
        "contact_log": 2.0,
        "schedule_limit": 4.0,
        "rst_T_count": 1,
        "rst_T_V": RST_R.sum(keepdims=True),
        "rst_R_count": 4,
        "rst_R_V": RST_R,
        "rst_S_count": 4,
        "rst_S": np.cumsum(RST_S)[:4],
        "rst_A0_count": 1,
        "rst_A0": np.ones(1),
        **overrides,
    }
