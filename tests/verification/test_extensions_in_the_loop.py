"""The verification plant of an extended model contains the extensions of that model."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid.design.lateral_task import lateral_task
from piezoid.export.export_stage import creep_values
from piezoid.identification.extensions import (
    AmplifierLimits,
    ConverterHold,
    CreepLadder,
    CrossAxis,
    Delay,
    FirstOrderLag,
    GainChange,
    LinearMode,
    PeriodicError,
    RateDependence,
    SlewLimit,
)
from piezoid.identification.extensions.extension import Where
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import Lag
from piezoid.runtime.library import complete
from piezoid.runtime.schema import MAX_RELAXATIONS
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.loop_plant import SUBSTEPS, SettledPlant
from piezoid.verification.plant import lateral_plant
from piezoid.verification.scenarios import SCENARIOS
from piezoid.verification.verify import verify
from tests.identification.extensions.samples import one_of_each
from tests.plays_alone import design_briefly
from tests.verification.known_fit import fitted, shipped
from tests.verification.rig import GAIN_m_per_V, RATE_Hz, lateral_parameters, operator, stage

CREEP = CreepLadder(time_s=(0.01, 0.1, 1.0), share=(0.01, 0.02, 0.03))


def axis_with(*extensions):
    """Return the known axis with extensions and hysteresis, but without dynamics and noise."""
    axis = fitted()["x"]
    return replace(
        axis,
        hysteresis=operator(),
        lag=Lag(kind="none", time_s=0.0),
        rig=Rig(),
        quality=replace(axis.quality, noise_rms_m=0.0),
        extensions=extensions,
    )


def plant_with(*extensions):
    """Return the plant of that axis in the virgin state that the controller assumes."""
    plant = lateral_plant(axis_with(*extensions), sampling_rate_Hz=RATE_Hz)
    return replace(plant, response=replace(plant.response, history_V=()))


def hold(samples=6000, height_m=1.5e-5):
    return height_m * (np.arange(samples) > 200)


@pytest.mark.parametrize("method", ["none", "mpi", "mpi_dob"])
def test_a_loop_starts_at_the_rest_position_after_creep(method, rng):
    """The first reading contains the creep at rest, so the controller corrects nothing."""
    plant = plant_with(replace(CREEP, share=tuple(10.0 * s for s in CREEP.share)))
    plant = replace(plant, response=replace(plant.response, history_V=(8.0, -3.0)))
    reference_m = np.full(400, SettledPlant(plant).rest_position)
    run = run_axis(plant, lateral_parameters().for_method(method), reference_m, rng=rng)
    lsb_m = 1.1 * GAIN_m_per_V * 20 / 65536
    assert abs(reference_m[0]) > 100 * lsb_m
    assert np.abs(run.position - reference_m).max() < 2 * lsb_m


@pytest.mark.parametrize(
    "extension",
    [
        CREEP,
        LinearMode(frequency_Hz=300.0, quality=10.0, participation=0.6),
        FirstOrderLag(lag_s=2e-3),
        Delay(delay_s=3.4e-4),
    ],
    ids=lambda extension: extension.kind,
)
def test_linear_extensions_answer_a_step_as_the_model_does(extension, rng):
    parameters = lateral_parameters().for_method("mpi")
    plant = plant_with(extension)
    run = run_axis(plant, parameters, hold(), rng=rng)
    rate_Hz = RATE_Hz * SUBSTEPS
    held_V = np.repeat(run.voltage_V, SUBSTEPS)
    displacement_m, _ = operator().run(held_V, operator().virgin_memory())
    where = Where(recording="r", rate_Hz=rate_Hz, samples=len(displacement_m))
    expected = extension.response(displacement_m, where)[SUBSTEPS - 1 :: SUBSTEPS]
    # The model interpolates between substeps and the plant holds: half a substep at the step.
    error_m = np.abs(run.position[1:] - expected[:-1])
    assert np.quantile(error_m, 0.99) < 3e-3 * np.ptp(expected)
    assert error_m[-2000:].max() < 1e-4 * np.ptp(expected)


@pytest.mark.parametrize(
    "limit", [SlewLimit(limit_V_per_s=400.0), AmplifierLimits(low_V=-1.0, high_V=2.5)]
)
def test_a_limited_drive_equals_the_drive_of_the_model(limit, rng):
    run = run_axis(plant_with(limit), lateral_parameters().for_method("mpi"), hold(), rng=rng)
    assert run.voltage_V.max() > 3.0
    held_V = np.repeat(np.concatenate([[0.0], run.voltage_V]), SUBSTEPS)
    driven_V = limit.drive(held_V, RATE_Hz * SUBSTEPS)
    displacement_m, _ = operator().run(driven_V, operator().virgin_memory())
    expected_m = displacement_m[2 * SUBSTEPS - 1 :: SUBSTEPS][: len(run.position) - 1]
    assert np.abs(run.position[1:] - expected_m).max() < 1e-12


@pytest.mark.parametrize("strain_m", [0.0, 2e-7])
def test_rate_dependent_hysteresis_lags_as_in_the_model(strain_m, rng):
    extension = RateDependence(time_s=4e-3, strain_m=strain_m)
    run = run_axis(plant_with(extension), lateral_parameters().for_method("mpi"), hold(), rng=rng)
    rate_Hz = RATE_Hz * SUBSTEPS
    held_V = np.repeat(np.concatenate([[0.0], run.voltage_V]), SUBSTEPS)
    where = Where(recording="r", rate_Hz=rate_Hz, samples=len(held_V))
    motion_m = axis_with(extension).motion_m(held_V, operator().virgin_memory(), where)
    expected_m = motion_m[2 * SUBSTEPS - 1 :: SUBSTEPS][: len(run.position) - 1]
    assert np.abs(run.position[1:] - expected_m).max() < 2e-3 * np.ptp(motion_m)


def test_a_cyclic_error_is_in_the_reading_and_not_in_the_position(rng):
    error = PeriodicError(wavelength_m=6e-7, cosine_m=(2e-9,), sine_m=(1e-9,))
    run = run_axis(plant_with(error), lateral_parameters().for_method("mpi"), hold(), rng=rng)
    where = Where(recording="", rate_Hz=1.0)
    np.testing.assert_allclose(run.measured, error.reading(run.position, where), atol=1e-15)


@pytest.mark.parametrize("extension", one_of_each(), ids=lambda extension: extension.kind)
def test_every_extension_is_in_the_plants_of_design_certificate_and_verification(
    extension, monkeypatch
):
    """The exception is a declared converter hold, which belongs to the recordings."""
    design_briefly(monkeypatch)
    unextended, extended = unextended_answers(), answers((extension,))
    reaches_loop = not isinstance(extension, ConverterHold)
    assert (unextended[0] != extended[0]) == reaches_loop
    assert (not np.array_equal(unextended[1], extended[1])) == reaches_loop


@cache
def unextended_answers():
    return answers(())


def answers(extensions):
    """Return the design inputs of an axis and the readings of its plant."""
    axis = replace(fitted()["x"], extensions=extensions)
    plant = lateral_plant(axis, sampling_rate_Hz=RATE_Hz)
    run = run_axis(
        plant,
        shipped("mpi"),
        1.2e-5 + 6e-6 * np.sin(2.0 * np.pi * 40.0 * np.arange(1000) / RATE_Hz),
        rng=np.random.default_rng(1),
        disturbance=plant.motion_m(1000, np.sin(np.arange(1000) / 200.0)),
    )
    return design_inputs(lateral_task(axis, RATE_Hz, forms=("inverse",))), run.measured


def design_inputs(task):
    """Return the inputs of design and certificate in a form that can be compared."""
    family, limits = task.families["inverse"], task.specification
    fractions = tuple((*m.B.tolist(), *m.A.tolist()) for m in family.members)
    voltage_limits = (limits.voltage_min_V, limits.voltage_max_V, limits.voltage_slew_V_per_s)
    return fractions, voltage_limits, task.disturbances


def test_the_plant_has_the_gain_after_a_gain_change(rng):
    change = GainChange(recording="a", instant_s=1.0, ratio=1.04)
    parameters = lateral_parameters().for_method("mpi")
    original = run_axis(plant_with(), parameters, hold(), rng=rng)
    changed = run_axis(plant_with(change), parameters, hold(), rng=rng)
    assert changed.position[-1] == pytest.approx(1.04 * original.position[-1])


def test_the_shipped_controller_compensates_the_creep_of_the_model(rng):
    plant = plant_with(CREEP)
    without_creep = lateral_parameters().for_method("mpi")
    with_creep = replace(
        without_creep,
        values=complete({**without_creep.values, **creep_values(axis_with(CREEP), RATE_Hz)}),
    )
    reference_m = hold(20_000)
    errors = [
        run_axis(plant, parameters, reference_m, rng=rng).position[300:] - reference_m[300:]
        for parameters in (without_creep, with_creep)
    ]
    rms = [float(np.sqrt(np.mean(error**2))) for error in errors]
    assert rms[1] < 0.05 * rms[0]


def test_the_largest_shares_of_a_long_creep_ladder_ship():
    time_s = tuple(np.geomspace(0.01, 100.0, 12).tolist())
    share = (*(0.01,) * MAX_RELAXATIONS, *(1e-4,) * 3, 0.0)
    values = creep_values(axis_with(CreepLadder(time_s=time_s, share=share)), RATE_Hz)
    assert values["relaxation_count"] == MAX_RELAXATIONS
    np.testing.assert_allclose(values["relaxation_share"], 0.01)
    assert (np.diff(values["relaxation_rate"]) < 0.0).all()
    assert creep_values(axis_with(), RATE_Hz) == {}


def test_the_verification_includes_coupling_from_another_axis():
    """A coupled motion of 1 um, which only feedback rejects."""
    coupled = CrossAxis(
        axis="y", centre_V=5.0, reach_V=4.0, gain_m_per_V=2.5e-7, curvature_m_per_V_per_V=0.0
    )
    within = {"reference_minimum_m": -7e-6, "reference_maximum_m": 1.1e-5}
    file = replace(stage("x"), axes=(shipped("mpi").with_values(within),))
    scenarios = tuple(s for s in SCENARIOS if s.name == "spiral, 1 Hz")
    uncoupled = fitted()["x"]
    rms_m = []
    for axis in (uncoupled, replace(uncoupled, extensions=(coupled,))):
        plant = lateral_plant(axis, sampling_rate_Hz=RATE_Hz)
        (row,) = verify(file, [plant], scenarios=scenarios).comparison
        rms_m.append(row.rms_m)
    assert rms_m[1] > rms_m[0] + 1e-7
