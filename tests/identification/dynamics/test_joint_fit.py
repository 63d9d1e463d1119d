"""Hysteresis and dynamics in one fit: found together, and in the right order."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from piezoid.identification.dynamics.behind_hysteresis import middle_slope_m_per_V
from piezoid.identification.dynamics.hammerstein import (
    SMALL_PLAYS,
    WITHIN,
    Joint,
    _with_small,
    fit_jointly,
)
from piezoid.identification.dynamics.hammerstein_model import (
    HammersteinRows,
    HammersteinShape,
    rows_of,
    simulate_rows,
    start_of,
    tangents,
)
from piezoid.identification.dynamics.hammerstein_record import JointFit
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.model import AxisModel
from piezoid.identification.piece_start import PieceStart
from piezoid.numerics.arrays import Array
from piezoid.operators.linear import fraction, resonance
from piezoid.record_json import from_json, to_json
from piezoid.records.recording import Recording
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


def rough(known: AxisModel) -> LinearDynamics:
    """What a windowed estimate may give: every number a little off."""
    return LinearDynamics(
        inputs=("x",),
        outputs=("x",),
        mode_frequency_Hz=np.array([1.01 * MODE_Hz]),
        mode_damping=np.array([1.2 * DAMPING]),
        mode_gain_m_per_V=np.full((1, 1, 1), middle_slope_m_per_V(known)),
        mode_rate_gain_m_s_per_V=np.zeros((1, 1, 1)),
        lag_frequency_Hz=np.zeros(0),
        lag_gain_m_per_V=np.zeros((0, 1, 1)),
        direct_gain_m_per_V=np.zeros((1, 1)),
        delay_s=50e-6,
        declared=(),
        shape_covariance=np.eye(3),
        static_gain_std_m_per_V=np.zeros((1, 1)),
        hold="zero_order",
        sampling_rate_Hz=RATE_Hz,
        band_Hz=(5.0, 1500.0),
        drive_rms_V=np.ones(1),
        cost=1.0,
        expected_cost=1.0,
    )


def behind(voltage_V: Array, rng: np.random.Generator) -> Recording:
    """The same two parts in the other order: the mode first, then the hysteresis."""
    numerator, denominator = fraction(resonance(MODE_Hz, DAMPING), RATE_Hz)
    level = voltage_V - voltage_V[0]
    through: Array = voltage_V[0] + lfilter(numerator, denominator, level)
    moved_m, _ = HYSTERESIS.run(through, HYSTERESIS.virgin_memory())
    seen = recorded(voltage_V, rng)
    drive, response = seen.channels
    noisy_m = moved_m + 5e-9 * rng.standard_normal(len(moved_m))
    return replace(seen, channels=(drive, replace(response, values=noisy_m)))


@pytest.fixture(scope="module")
def together() -> Joint:
    chirped = recorded(chirp(samples=SAMPLES), np.random.default_rng(41))
    found = fit_jointly(axis(), rough(axis()), chirped, [chirped])
    assert found is not None
    return found


def test_mode_and_damping_are_found_to_a_per_mille_from_a_rough_start(together: Joint) -> None:
    dynamics = together.dynamics
    assert dynamics.mode_frequency_Hz[0] == pytest.approx(MODE_Hz, rel=1e-3)
    assert dynamics.mode_damping[0] == pytest.approx(DAMPING, rel=0.01)
    low, high = dynamics.mode_frequency_interval_Hz()[0]
    assert high - low < 0.01 * MODE_Hz


def test_the_joint_fit_leaves_less_than_both_parts_found_apart(together: Joint) -> None:
    assert together.record.joint_rms_m[0] < 0.2 * together.record.apart_rms_m[0]


def test_memory_before_the_mode_is_told_by_the_phase_of_its_harmonics(together: Joint) -> None:
    structure = together.record.structure
    assert structure.order == "before"
    assert abs(structure.phase_before_deg) < 20.0
    assert structure.agreement_before > structure.agreement_behind + structure.difference_half


def test_memory_behind_the_mode_is_told_as_well() -> None:
    turned = behind(chirp(samples=SAMPLES), np.random.default_rng(43))
    found = fit_jointly(axis(), rough(axis()), turned, [turned])
    assert found is not None
    assert found.record.structure.order == "behind"


def lagging(known: AxisModel) -> LinearDynamics:
    """The same with a third of the gain behind a lag."""
    gain = rough(known).mode_gain_m_per_V
    return replace(
        rough(known),
        mode_gain_m_per_V=2.0 / 3.0 * gain,
        lag_frequency_Hz=np.array([30.0]),
        lag_gain_m_per_V=gain / 3.0,
        shape_covariance=np.eye(4),
    )


def rows_and_start(
    dynamics: LinearDynamics,
) -> tuple[HammersteinRows, HammersteinShape, Array]:
    known, threshold_V = axis(), HYSTERESIS.plays.threshold
    chirped = recorded(chirp(samples=SAMPLES), np.random.default_rng(41))
    (rows,) = rows_of(known, [chirped], threshold_V=threshold_V, dynamics=dynamics)
    return rows, *start_of(known.hysteresis, dynamics, threshold_V)


@pytest.mark.parametrize("dynamics", [rough(axis()), lagging(axis())])
def test_every_derivative_is_that_of_the_simulation(dynamics: LinearDynamics) -> None:
    rows, shape, theta = rows_and_start(dynamics)
    exact = tangents(shape, theta, rows)
    for place in range(shape.size):
        step = np.zeros(shape.size)
        step[place] = (
            1e-9 if place == shape.linear.stop - 1 else 1e-5 * max(abs(theta[place]), 1e-9)
        )
        ahead, back = (simulate_rows(shape, theta + s * step, rows) for s in (1, -1))
        numeric = (ahead - back) / (2.0 * step[place])
        assert np.linalg.norm(numeric - exact[place]) <= 0.02 * np.linalg.norm(numeric)


def test_a_recording_without_a_known_memory_is_not_fitted_jointly() -> None:
    chirped = recorded(chirp(samples=SAMPLES), np.random.default_rng(41), "other.csv")
    assert fit_jointly(axis(), rough(axis()), chirped, [chirped]) is None


def test_the_record_comes_back_number_for_number(together: Joint) -> None:
    assert from_json(JointFit, to_json(together.record)) == together.record


def test_plays_of_small_drives_stand_apart_from_those_there() -> None:
    voltage_V = np.linspace(3.0, 7.0, 401)  # its reach is 2 V about the middle
    small_V = 2.0 * np.array(SMALL_PLAYS)
    near_V = small_V[1] + 0.9 * 2.0 * WITHIN
    found = _with_small(np.array([0.0, near_V, 1.5]), voltage_V)
    expected = np.sort([0.0, small_V[0], near_V, *small_V[2:], 1.5])
    np.testing.assert_allclose(found, expected, rtol=1e-2)
    assert len(_with_small(small_V, voltage_V)) == len(small_V)
