"""Plants of the verification: the identified plant, its variations, and the loop of a tip."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid.design.design_stage import design_stage
from piezoid.errors import ParameterFileError
from piezoid.export.export_stage import export_stage
from piezoid.export.parameter_file import ParameterFile
from piezoid.identification.model import Lag
from piezoid.identification.tunnelling.junction_plant import DriveMode
from piezoid.operators.preisach_plays import PreisachPlays
from piezoid.records.lab import Lab, Tunnelling
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.plant import (
    CustomResponse,
    Hysteresis,
    junction_axis_plant,
    lateral_plant,
)
from piezoid.verification.verify_stage import varied_plants, verify_stage
from tests.design.junction_lab import LAB
from tests.identification.dynamics.stage import truth
from tests.verification.known_fit import fitted, junction_model, shipped
from tests.verification.rig import RATE_Hz, stage

DIGEST = "sha256:" + "0" * 64


def test_the_plant_has_the_noise_rest_poles_and_delay_of_the_model():
    model = fitted()["x"]
    plant = lateral_plant(model, sampling_rate_Hz=RATE_Hz)
    assert plant.noise_rms == model.quality.noise_rms_m
    assert plant.rest_voltage_V == 5.0
    assert plant.measured is not None
    assert -plant.measured.A[0, 0] == pytest.approx(1.0 / 2.5e-4)
    assert [-s.A[0, 0] for s in plant.sensor] == [pytest.approx(2.0 * np.pi * 8.5e3)]
    delayed = replace(model, lag=Lag(kind="delay", time_s=3e-5))
    assert lateral_plant(delayed, sampling_rate_Hz=RATE_Hz).delay_s == 3e-5


def test_plays_behind_functions_answer_in_the_plant_as_their_operator_does(rng):
    """The path turns and passes the outermost edges; a custom response is the reference."""
    edge_V = np.linspace(-6.0, 6.0, 7)
    straight = PreisachPlays(step_V=1.0, edge_V=edge_V, value_m=np.tile(1e-6 * edge_V, (6, 1)))
    operator = straight.with_rises(rng.uniform(1e-7, 2e-6, (6, 6)))
    history_V = (8.0, -7.0, 3.0)

    def begin(rest_V):
        _, memory_V = operator.run(np.array([*history_V, rest_V]), operator.virgin_memory())

        def respond(voltage_V):
            moved_m, memory_V[:] = operator.run(np.array([voltage_V]), memory_V)
            return float(moved_m[0])

        return respond

    noiseless = replace(lateral_plant(fitted()["x"], sampling_rate_Hz=RATE_Hz), noise_rms=0.0)
    path = 3e-5 * np.cumsum(rng.standard_normal(2000)) / 20.0
    runs = [
        run_axis(
            replace(noiseless, response=response),
            stage("x").axis("x").for_method("none"),
            path,
            rng=np.random.default_rng(0),
        )
        for response in (
            Hysteresis(operator=operator, history_V=history_V),
            CustomResponse(begin=begin),
        )
    ]
    assert np.ptp(runs[0].voltage_V) > 8.0
    np.testing.assert_allclose(runs[0].position, runs[1].position, rtol=0.0, atol=1e-18)


def test_varied_plants_differ_and_stay_near_the_identified_plant(rng):
    model = fitted()["x"]
    plant = lateral_plant(model, sampling_rate_Hz=RATE_Hz)
    plants = varied_plants(plant, model, count=5, rng=rng)
    assert len({p.label for p in plants}) == 5
    gains = []
    for variation in plants:
        assert isinstance(variation.response, Hysteresis)
        displacement_m, _ = variation.response.operator.run(
            np.array([5.0, 10.0]), variation.response.operator.virgin_memory()
        )
        gains.append(np.ptp(displacement_m))
        factor = -variation.front[0].A[0, 0] / (2.0 * np.pi * 4e3)
        assert 0.9 <= factor <= 1.1
    assert np.ptp(gains) > 0
    # one percent of each parameter; a handful of them add up
    assert np.allclose(gains, np.mean(gains), rtol=0.1)


def test_a_tip_is_not_verified_against_a_model_that_has_none():
    with pytest.raises(ParameterFileError, match="axis z regulates a current"):
        verify_stage(stage("z"), fitted())


def test_the_plant_has_the_identified_dynamics_and_the_gain_of_its_operator(rng):
    """The sensor poles act behind the position, all other dynamics in front of it."""
    dynamics = truth()
    model = replace(fitted()["x"], dynamics=dynamics)
    plant = lateral_plant(model, sampling_rate_Hz=RATE_Hz)
    frequency_Hz = np.array([1.0, 100.0, 630.0, 2000.0])
    delay = np.exp(-2j * np.pi * frequency_Hz * dynamics.delay_s)
    response = plant.measured.response(frequency_Hz)[:, 0, 0] * delay
    for sensor in plant.sensor:
        response = response * sensor.response(frequency_Hz)[:, 0, 0]
    expected = dynamics.response(frequency_Hz) / dynamics.static_gain_m_per_V
    poles_Hz = [f.frequency_Hz for f in dynamics.declared if f.name == "sensor"]
    for pole_Hz in poles_Hz:
        expected = expected * (1.0 + 1j * frequency_Hz / pole_Hz)
    for sensor in plant.sensor:
        expected = expected * sensor.response(frequency_Hz)[:, 0, 0]
    assert response == pytest.approx(expected)
    assert plant.delay_s == dynamics.delay_s
    depoled = replace(plant, response=replace(plant.response, history_V=()))
    settled = run_axis(depoled, shipped("none"), np.full(4000, 1e-5), rng=rng)
    displacement_m, _ = model.hysteresis.run(settled.voltage_V[-1:], model.virgin_memory_V)
    assert settled.position[-1] == pytest.approx(displacement_m[0], rel=1e-3)


RINGS = DriveMode(frequency_Hz=3e3, quality=30.0, share=0.8)
ONE_BARRIER = Lab(
    acquisition=LAB.acquisition,
    tunnelling=Tunnelling(set_point_A=1e-9, floor_A=1e-11, ceiling_A=9e-9, feedback_ohm=1e9),
)


@cache
def ringing(*modes):
    """Return the known junction with modes in its drive, without a lateral axis."""
    model = replace(junction_model(), axes={})
    loop = replace(model.tunnelling.loop_plant, modes=modes)
    return replace(model, tunnelling=replace(model.tunnelling, loop_plant=loop))


@cache
def controller_for(*modes):
    model = ringing(*modes)
    design = design_stage(model, model_digest=DIGEST, sampling_rate_Hz=RATE_Hz, lab=ONE_BARRIER)
    return export_stage(model, design, design_digest=DIGEST, lab=ONE_BARRIER).axis("z")


def log_current_std(axis, rng):
    """Return the standard deviation of ln i with a ringing drive, over the last 0.1 s."""
    loop = ringing(RINGS).tunnelling.loop_plant
    plant = junction_axis_plant(
        loop.plant, set_point_A=1e-9, decay_per_m=1e10, noise_rms_A=1e-12, modes=loop.modes
    )
    run = run_axis(plant, axis, np.full(6000, 1e-9), rng=rng)
    return float(np.std(np.log(np.maximum(run.position[-2000:], 1e-15) / 1e-9)))


def test_only_the_loop_designed_with_the_drive_mode_is_quiet_and_passes(rng):
    assert log_current_std(controller_for(RINGS), rng) < 0.05
    assert log_current_std(controller_for(), rng) > 0.2
    axis = controller_for()
    file = ParameterFile(name="tip", axes=(axis,))
    assert verify_stage(file, ringing(), lab=ONE_BARRIER).passed
    assert not verify_stage(file, ringing(RINGS), lab=ONE_BARRIER).passed
