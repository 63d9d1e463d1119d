"""Joint fit of hysteresis and dynamics of a known stage."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.dynamics.joint_fit import fit_jointly
from piezoid.identification.dynamics.modal import JointFit, LinearDynamics
from piezoid.identification.hysteresis.pieces import PieceStart
from piezoid.identification.model import AxisModel
from tests.identification.dynamics.stage import truth
from tests.identification.dynamics.test_axis_dynamics import (
    DAMPING,
    MODE_Hz,
    RATE_Hz,
    chirp,
    recorded,
)
from tests.reports.known_stage import HYSTERESIS, axis_model

SAMPLES = 10000  # two seconds


def axis() -> AxisModel:
    start = PieceStart(
        recording="chirp.csv",
        memory_V=HYSTERESIS.virgin_memory(),
        zero_m=np.zeros(2),
        first=0,
        last=SAMPLES,
    )
    return replace(axis_model(), starts=(start,))


def rough_dynamics(axis_model: AxisModel) -> LinearDynamics:
    """Return dynamics with errors typical of a windowed estimate."""
    return replace(
        truth(),
        mode_frequency_Hz=np.array([1.01 * MODE_Hz]),
        mode_damping=np.array([1.2 * DAMPING]),
        mode_gain_m_per_V=np.array([axis_model.hysteresis.middle_slope_m_per_V]),
        delay_s=50e-6,
        declared=(),
        shape_covariance=np.eye(3),
        sampling_rate_Hz=RATE_Hz,
        band_Hz=(5.0, 1500.0),
    )


@pytest.fixture(scope="module")
def joint_fit() -> tuple[LinearDynamics, JointFit]:
    chirped = recorded(chirp(samples=SAMPLES), np.random.default_rng(41))
    joint = fit_jointly(axis(), rough_dynamics(axis()), chirped, [chirped])
    assert joint is not None
    return joint


def test_frequency_and_damping_converge_from_a_rough_start(joint_fit):
    dynamics, _ = joint_fit
    assert dynamics.mode_frequency_Hz[0] == pytest.approx(MODE_Hz, rel=1e-3)
    assert dynamics.mode_damping[0] == pytest.approx(DAMPING, rel=0.01)
    low, high = dynamics.mode_frequency_interval_Hz()[0]
    assert high - low < 0.01 * MODE_Hz


def test_a_joint_fit_has_a_smaller_error_than_separate_fits(joint_fit):
    _, record = joint_fit
    assert record.joint_rms_m[0] < 0.2 * record.separate_rms_m[0]


def test_a_recording_without_a_known_initial_state_is_not_fitted_jointly():
    chirped = recorded(chirp(samples=SAMPLES), np.random.default_rng(41), "other.csv")
    assert fit_jointly(axis(), rough_dynamics(axis()), chirped, [chirped]) is None
