"""The plant loop against operators, against formulas, and against the runtime alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.varied_chains import plant_from_chain
from piezoid.errors import ParameterFileError
from piezoid.operators.linear import first_order
from piezoid.runtime.controller import Controller, Status
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.plant import AxisPlant, CustomResponse, Hysteresis
from tests.design.rig import lateral_chain
from tests.verification.rig import (
    AMPLIFIER,
    MODE,
    SENSOR,
    GAIN_m_per_V,
    RATE_Hz,
    lateral,
    lateral_parameters,
    operator,
    swing,
)

ROUNDING_m = 1e-18


def test_a_plant_without_dynamics_follows_its_operator(rng):
    model = operator(offset_V=0.5)
    plant = AxisPlant(
        axis="x",
        label="static",
        sampling_rate_Hz=RATE_Hz,
        response=Hysteresis(operator=model, polarity=-1),
        rest_voltage_V=0.5,
    )
    run = run_axis(plant, lateral_parameters().for_method("mpi"), swing(), rng=rng)
    displacement_m, _ = model.run(run.voltage_V, model.virgin_memory())
    assert np.abs(run.position[1:] + displacement_m[:-1]).max() < ROUNDING_m


def test_the_linear_chain_equals_the_sampled_plant_of_the_design(rng):
    """A linear response replaces the hysteresis, so B/A of the exact sampling gives the answer."""
    plant = lateral(
        response=CustomResponse(begin=lambda _: lambda v: GAIN_m_per_V * v),
        noise_rms=0.0,
        sensor=(),
        delay_s=1.3 / RATE_Hz,
    )
    run = run_axis(plant, lateral_parameters().for_method("none"), swing(), rng=rng)
    chain = lateral_chain(GAIN_m_per_V, 1.3 / RATE_Hz)
    exact = plant_from_chain(replace(chain, sections=(AMPLIFIER, MODE)))
    expected = lfilter(exact.B, exact.A, run.voltage_V)
    # The plant interpolates linearly between four substeps; the exact sampling does not.
    assert np.abs(run.position - expected).max() < 1e-4 * np.abs(expected).max()


def test_a_disturbance_is_added_at_its_sample(rng):
    model = operator()
    plant = lateral(
        response=Hysteresis(operator=model), front=(), measured=None, sensor=(), noise_rms=0.0
    )
    disturbance_m = np.r_[np.zeros(5), np.linspace(0, 1e-7, 1995)]
    parameters = lateral_parameters().for_method("none")
    run = run_axis(plant, parameters, swing(), rng=rng, disturbance=disturbance_m)
    displacement_m, _ = model.run(run.voltage_V, model.virgin_memory())
    assert np.abs(run.position[1:] - displacement_m[:-1] - disturbance_m[1:]).max() < ROUNDING_m


@pytest.mark.parametrize("precision", ["double", "float"])
def test_the_voltages_equal_a_replay_of_the_controller(precision, rng):
    parameters = lateral_parameters()
    reference = swing()
    run = run_axis(lateral(), parameters, reference, rng=rng, precision=precision)
    controller = Controller(parameters.values, precision=precision)
    controller.start(0.0, 0.0)
    replay = controller.run(reference, run.measured)
    assert np.array_equal(replay.voltage_V, run.voltage_V)
    assert np.array_equal(replay.status, run.status)


def test_the_reference_is_advanced_by_the_preview(rng):
    with_preview = lateral_parameters().for_method("none").with_values({"preview_samples": 7})
    without_preview = with_preview.with_values({"preview_samples": 0})
    delayed_V, advanced_V = (
        run_axis(lateral(), p, swing(), rng=rng).voltage_V for p in (without_preview, with_preview)
    )
    assert np.array_equal(advanced_V[:-7], delayed_V[7:])


def test_noise_keeps_all_its_power_when_the_sensor_is_faster_than_the_converter(rng):
    fast = lateral(noise_rms=3e-9, noise_bandwidth_Hz=50e3)
    slow = lateral(noise_rms=3e-9, noise_bandwidth_Hz=500.0)
    for plant in (fast, slow):
        assert plant.noise(200_000, rng).std() == pytest.approx(3e-9, rel=0.03)
    n = slow.noise(200_001, rng)
    assert np.corrcoef(n[1:], n[:-1])[0, 1] == pytest.approx(np.exp(-np.pi / 20), abs=0.01)


def test_a_frozen_sensor_repeats_its_reading_and_a_lost_sensor_reads_nan(rng):
    fault = np.zeros(2000)
    fault[500:600], fault[700:710] = 1.0, np.nan
    run = run_axis(lateral(), lateral_parameters(), swing(), rng=rng, fault=fault)
    assert len(set(run.measured[499:600])) == 1
    assert np.isnan(run.measured[700:710]).all()
    assert np.isfinite(run.voltage_V).all()
    assert run.status[709] & Status.BAD_MEASUREMENT
    assert run.status[599] & Status.STUCK_SENSOR


def test_readings_are_quantised_and_limited_to_their_range(rng):
    plant = lateral(reading_step=1e-7, reading_range=(-1e-5, 1e-5))
    run = run_axis(plant, lateral_parameters().for_method("none"), swing(), rng=rng)
    codes = run.measured / 1e-7
    assert np.abs(codes - np.round(codes)).max() < 1e-9
    assert np.abs(run.measured).max() == pytest.approx(1e-5)


def test_another_sampling_rate_is_refused(rng):
    slow = lateral_parameters().with_values({"sampling_rate_Hz": 10e3})
    with pytest.raises(ParameterFileError, match="10000 Hz"):
        run_axis(lateral(), slow, swing(), rng=rng)


def test_the_sensor_lag_is_in_the_reading_and_not_in_the_position(rng):
    plant = lateral(sensor=2 * (first_order(SENSOR.frequency_Hz),), noise_rms=0.0)
    run = run_axis(plant, lateral_parameters().for_method("none"), swing(), rng=rng)
    lag = 2 / (2 * np.pi * SENSOR.frequency_Hz) * RATE_Hz
    delayed_m = np.interp(np.arange(2000) - lag, np.arange(2000), run.position)
    assert np.abs(run.measured - delayed_m)[10:].max() < 1e-3 * np.abs(run.position).max()
