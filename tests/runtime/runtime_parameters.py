"""Parameter sets the runtime tests start from."""

import numpy as np

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


def hysteresis(model, **others):
    """Parameters of a model as ``runtime_reference.random_model`` makes it."""
    return {
        **WIDE,
        "method": "mpi",
        "play_count": len(model["r"]),
        "play_threshold_V": model["r"],
        "play_weight_m_per_V": model["w"],
        "play_memory_V": model["z"],
        "knot_count": len(model["knot"]),
        "knot_zero": int(np.flatnonzero(model["knot"] == 0)[0]),
        "knot_m": model["knot"],
        "knot_weight": model["weight"],
        **others,
    }
