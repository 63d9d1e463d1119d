"""The plant a controller is verified against: the model's own, its neighbours, the tip's loop."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.errors import ParameterFileError
from piezoid.identification.model import Lag
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.plant import Hysteresis, lateral_plant
from piezoid.verification.stage import verify_stage
from piezoid.verification.uncertainty import varied_plants
from tests.identification.dynamics.stage import truth
from tests.verification.known_fit import fitted, junction_model, shipped
from tests.verification.rig import RATE_Hz, stage


def test_the_plant_is_the_models_own_simulation():
    """Both follow a slow drive with the same operator; only their hold differs."""
    model = fitted()["x"]
    plant = lateral_plant(model, sampling_rate_Hz=RATE_Hz)
    assert plant.noise_rms == model.quality.noise_rms_m
    assert plant.rest_voltage_V == 5.0
    assert plant.measured is not None
    assert -plant.measured.A[0, 0] == pytest.approx(1.0 / 2.5e-4)
    assert [s.frequency_Hz for s in plant.sensor] == [pytest.approx(8.5e3)]
    late = replace(model, lag=Lag(kind="delay", time_s=3e-5))
    assert lateral_plant(late, sampling_rate_Hz=RATE_Hz).delay_s == 3e-5


def test_drawn_plants_differ_and_stay_near_the_identified_one(rng):
    model = fitted()["x"]
    plant = lateral_plant(model, sampling_rate_Hz=RATE_Hz)
    drawn = varied_plants(plant, model, count=5, rng=rng)
    assert len({p.label for p in drawn}) == 5
    gains = []
    for other in drawn:
        assert isinstance(other.response, Hysteresis)
        moved, _ = other.response.operator.run(
            np.array([5.0, 10.0]), other.response.operator.virgin_memory()
        )
        gains.append(np.ptp(moved))
        factor = other.amplifier[0].frequency_Hz / 4e3
        assert 0.9 <= factor <= 1.1
    assert np.ptp(gains) > 0
    # one percent of each parameter; a handful of them add up
    assert np.allclose(gains, np.mean(gains), rtol=0.1)


def test_a_tip_is_not_verified_against_a_model_that_has_none():
    with pytest.raises(ParameterFileError, match="axis z regulates a current"):
        verify_stage(stage("z"), fitted())


def test_a_tip_is_verified_against_its_identified_loop_and_its_family():
    found = verify_stage(stage("z"), junction_model())
    assert found.passed
    assert {"identified, axis z", "gain x0.8, axis z", "gain x1.25, axis z"} <= set(found.plants)


def test_a_family_member_that_the_loop_cannot_hold_fails():
    found = verify_stage(stage("z"), junction_model(ratios=(1.0, 8.0)))
    failed = {v.scenario for v in found.verdicts if not v.passed}
    assert failed == {"spiral, 10 Hz, plants the recordings allow"}


def test_identified_dynamics_stand_in_the_plant_with_the_operators_gain(rng):
    """What they say of the sensor is behind the position, all else in front of it."""
    known = truth(("x",))
    model = replace(fitted()["x"], dynamics=known)
    plant = lateral_plant(model, sampling_rate_Hz=RATE_Hz)
    frequency_Hz = np.array([1.0, 100.0, 630.0, 2000.0])
    late = np.exp(-2j * np.pi * frequency_Hz * known.delay_s)
    found = plant.measured.response(frequency_Hz)[:, 0, 0] * late
    for section in plant.sensor:
        found = found / (1.0 + 1j * frequency_Hz / section.frequency_Hz)
    relative = known.response(frequency_Hz)[:, 0, 0] / known.static_gain_m_per_V[0, 0]
    named = [f.frequency_Hz for f in known.declared if f.name == "sensor"]
    for pole_Hz in named:
        relative = relative * (1.0 + 1j * frequency_Hz / pole_Hz)
    for section in plant.sensor:
        relative = relative / (1.0 + 1j * frequency_Hz / section.frequency_Hz)
    assert found == pytest.approx(relative)
    assert plant.delay_s == known.delay_s
    settled = run_axis(plant, shipped("none"), np.full(4000, 1e-5), rng=rng)
    moved, _ = model.hysteresis.run(settled.voltage_V[-1:], model.virgin_memory_V)
    assert settled.position[-1] == pytest.approx(moved[0], rel=1e-3)
