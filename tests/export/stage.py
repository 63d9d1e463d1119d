"""A stage of three axes for the export tests, with numbers that are hard to print."""

import numpy as np

from piezoid.export.parameter_file import AxisParameters, ParameterFile
from tests.runtime.observer_design import observer_parameters
from tests.runtime.runtime_parameters import tunnelling

GAIN_m_per_V = 3.525e-6
PLAYS = 6


def lateral(method):
    weight = GAIN_m_per_V * np.r_[0.7, np.full(PLAYS - 1, 0.3 / (PLAYS - 1))]
    return {
        "method": method,
        "voltage_minimum_V": -10.0,
        "voltage_maximum_V": 32767 * 20 / 65536,
        "lsb_V": 20 / 65536,
        "reference_minimum_m": -3e-5,
        "reference_maximum_m": 3e-5,
        "displacement_minimum_m": -4e-5,
        "displacement_maximum_m": 4e-5,
        "play_count": PLAYS,
        "play_threshold_V": np.arange(PLAYS) * (10 / 7),
        "play_weight_m_per_V": weight * (1 + 1e-13),
        "knot_count": 3,
        "knot_m": [-1e-5, 0.0, 1e-5 / 3],
        "knot_weight": [-0.02, 1.0, 0.0123456789012345678],
        "relaxation_count": 2,
        "relaxation_rate": 1 - np.exp(-1 / (20e3 * np.array([0.1, 1.0]))),
        "relaxation_share": [0.005, 0.005],
        **observer_parameters(GAIN_m_per_V),
    }


def stage(name="stage 42"):
    return ParameterFile(
        name=name,
        axes=(
            AxisParameters(
                axis="x", values=lateral("mpi_dob"), alternatives=(lateral("mpi"), lateral("none"))
            ),
            AxisParameters(axis="y", values=lateral("dob")),
            AxisParameters(axis="z", values=tunnelling(lsb_V=20 / 65536)),
        ),
        sources={"model": "sha256:" + "0" * 64},
    )
