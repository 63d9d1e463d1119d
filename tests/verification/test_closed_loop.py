"""The plant loop against operators, against formulas, and against the runtime alone."""

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.varied_chains import Chain, plant_from_chain
from piezoid.errors import ParameterFileError
from piezoid.operators.linear import first_order
from piezoid.runtime.controller import Controller, Status
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.plant import AxisPlant, CustomResponse, Hysteresis
from tests.verification.rig import (
    AMPLIFIER,
    MODE,
    SENSOR,
    GAIN_m_per_V,
    RATE_Hz,
    lateral,
    lateral_parameters,
    operator,
)

ROUNDING_m = 1e-18


def swing(samples=2000, amplitude_m=2e-5, frequency_Hz=20.0):
    k = np.arange(samples)
    return amplitude_m * np.sin(2 * np.pi * frequency_Hz * k / RATE_Hz) * k / samples


def test_without_dynamics_the_position_is_the_operators_own(rng):
    model = operator(offset_V=0.5)
    plant = AxisPlant(
        axis="x",
        label="static",
        sampling_rate_Hz=RATE_Hz,
        response=Hysteresis(operator=model, polarity=-1),
        rest_voltage_V=0.5,
    )
    found = run_axis(plant, lateral_parameters().for_method("mpi"), swing(), rng=rng)
    moved, _ = model.run(found.voltage_V, model.virgin_memory())
    assert np.abs(found.position[1:] + moved[:-1]).max() < ROUNDING_m


def test_the_linear_chain_is_the_one_margins_are_computed_from(rng):
    """A plugged line makes the axis linear: B/A of the design's exact sampling must answer."""
    plant = lateral(
        response=CustomResponse(begin=lambda _: lambda v: GAIN_m_per_V * v),
        noise_rms=0.0,
        sensor=(),
        delay_s=1.3 / RATE_Hz,
    )
    found = run_axis(plant, lateral_parameters().for_method("none"), swing(), rng=rng)
    chain = Chain(
        label="same",
        sampling_rate_Hz=RATE_Hz,
        gain=GAIN_m_per_V,
        output_unit="m",
        sections=(AMPLIFIER, MODE),
        delay_s=1.3 / RATE_Hz,
    )
    exact = plant_from_chain(chain)
    expected = lfilter(exact.B, exact.A, found.voltage_V)
    # straight lines between four substeps instead of the amplifier's exponentials
    assert np.abs(found.position - expected).max() < 1e-4 * np.abs(expected).max()


def test_a_disturbance_is_added_at_its_own_instant(rng):
    model = operator()
    plant = lateral(
        response=Hysteresis(operator=model), front=(), measured=None, sensor=(), noise_rms=0.0
    )
    added = np.r_[np.zeros(5), np.linspace(0, 1e-7, 1995)]
    parameters = lateral_parameters().for_method("none")
    found = run_axis(plant, parameters, swing(), rng=rng, disturbance=added)
    moved, _ = model.run(found.voltage_V, model.virgin_memory())
    assert np.abs(found.position[1:] - moved[:-1] - added[1:]).max() < ROUNDING_m


@pytest.mark.parametrize("precision", ["double", "float"])
def test_the_voltages_are_the_shipped_controllers_answers(precision, rng):
    parameters = lateral_parameters()
    reference = swing()
    found = run_axis(lateral(), parameters, reference, rng=rng, precision=precision)
    alone = Controller(parameters.values, precision=precision)
    alone.start(0.0, 0.0)
    again = alone.run(reference, found.measured)
    assert np.array_equal(again.voltage_V, found.voltage_V)
    assert np.array_equal(again.status, found.status)


def test_the_reference_is_given_as_much_ahead_as_the_parameters_preview(rng):
    ahead = lateral_parameters().for_method("none").with_values({"preview_samples": 7})
    now = ahead.with_values({"preview_samples": 0})
    late, early = (run_axis(lateral(), p, swing(), rng=rng).voltage_V for p in (now, ahead))
    assert np.array_equal(early[:-7], late[7:])


def test_noise_keeps_all_its_power_when_the_sensor_is_faster_than_the_converter(rng):
    fast = lateral(noise_rms=3e-9, noise_bandwidth_Hz=50e3)
    slow = lateral(noise_rms=3e-9, noise_bandwidth_Hz=500.0)
    for plant in (fast, slow):
        assert plant.noise(200_000, rng).std() == pytest.approx(3e-9, rel=0.03)
    n = slow.noise(200_001, rng)
    assert np.corrcoef(n[1:], n[:-1])[0, 1] == pytest.approx(np.exp(-np.pi / 20), abs=0.01)


def test_a_frozen_sensor_shows_the_same_number_and_a_lost_one_none(rng):
    fault = np.zeros(2000)
    fault[500:600], fault[700:710] = 1.0, np.nan
    found = run_axis(lateral(), lateral_parameters(), swing(), rng=rng, fault=fault)
    assert len(set(found.measured[499:600])) == 1
    assert np.isnan(found.measured[700:710]).all()
    assert np.isfinite(found.voltage_V).all()
    assert found.status[709] & Status.BAD_MEASUREMENT
    assert found.status[599] & Status.STUCK_SENSOR


def test_readings_are_whole_steps_within_their_range(rng):
    plant = lateral(reading_step=1e-7, reading_range=(-1e-5, 1e-5))
    found = run_axis(plant, lateral_parameters().for_method("none"), swing(), rng=rng)
    codes = found.measured / 1e-7
    assert np.abs(codes - np.round(codes)).max() < 1e-9
    assert np.abs(found.measured).max() == pytest.approx(1e-5)


def test_another_sampling_rate_is_refused(rng):
    slow = lateral_parameters().with_values({"sampling_rate_Hz": 10e3})
    with pytest.raises(ParameterFileError, match="10000 Hz"):
        run_axis(lateral(), slow, swing(), rng=rng)


def test_the_chain_has_the_sensor_behind_the_position(rng):
    behind = lateral(sensor=2 * (first_order(SENSOR.frequency_Hz),), noise_rms=0.0)
    found = run_axis(behind, lateral_parameters().for_method("none"), swing(), rng=rng)
    lag = 2 / (2 * np.pi * SENSOR.frequency_Hz) * RATE_Hz
    late = np.interp(np.arange(2000) - lag, np.arange(2000), found.position)
    assert np.abs(found.measured - late)[10:].max() < 1e-3 * np.abs(found.position).max()
