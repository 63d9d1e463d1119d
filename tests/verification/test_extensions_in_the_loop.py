"""The plant of an extended model answers as the model's own extensions say."""

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
from tests.verification.known_fit import fitted, shipped
from tests.verification.rig import GAIN_m_per_V, RATE_Hz, lateral_parameters, operator, stage

CREEP = CreepLadder(time_s=(0.01, 0.1, 1.0), share=(0.01, 0.02, 0.03))


def axis_with(*extensions):
    """The known axis, as quick as its hysteresis, with a noiseless sensor."""
    known = fitted()["x"]
    return replace(
        known,
        hysteresis=operator(),
        lag=Lag(kind="none", time_s=0.0),
        rig=Rig(),
        quality=replace(known.quality, noise_rms_m=0.0),
        extensions=extensions,
    )


def plant_with(*extensions):
    """The plant of such an axis, de-poled as the controller takes it to be."""
    plant = lateral_plant(axis_with(*extensions), sampling_rate_Hz=RATE_Hz)
    return replace(plant, response=replace(plant.response, history_V=()))


def hold(samples=6000, height_m=1.5e-5):
    return height_m * (np.arange(samples) > 200)


@pytest.mark.parametrize("method", ["none", "mpi", "mpi_dob"])
def test_a_stage_that_crept_begins_where_it_rests(method, rng):
    """What its creep adds at rest is in the first reading; nothing is left to be corrected."""
    plant = plant_with(replace(CREEP, share=tuple(10.0 * s for s in CREEP.share)))
    plant = replace(plant, response=replace(plant.response, history_V=(8.0, -3.0)))
    still = np.full(400, SettledPlant(plant).rest_position)
    found = run_axis(plant, lateral_parameters().for_method(method), still, rng=rng)
    lsb_m = 1.1 * GAIN_m_per_V * 20 / 65536
    assert abs(still[0]) > 100 * lsb_m
    assert np.abs(found.position - still).max() < 2 * lsb_m


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
def test_what_is_linear_follows_a_step_as_the_model_simulates_it(extension, rng):
    parameters = lateral_parameters().for_method("mpi")
    plant = plant_with(extension)
    found = run_axis(plant, parameters, hold(), rng=rng)
    rate_Hz = RATE_Hz * SUBSTEPS
    held_V = np.repeat(found.voltage_V, SUBSTEPS)
    moved, _ = operator().run(held_V, operator().virgin_memory())
    where = Where(recording="r", rate_Hz=rate_Hz, samples=len(moved))
    expected = extension.response(moved, where)[SUBSTEPS - 1 :: SUBSTEPS]
    # Straight between instants here, held there: half an instant, for a few of them.
    late = np.abs(found.position[1:] - expected[:-1])
    assert np.quantile(late, 0.99) < 3e-3 * np.ptp(expected)
    assert late[-2000:].max() < 1e-4 * np.ptp(expected)


@pytest.mark.parametrize(
    "limit", [SlewLimit(limit_V_per_s=400.0), AmplifierLimits(low_V=-1.0, high_V=2.5)]
)
def test_a_limited_drive_is_the_one_the_model_knows(limit, rng):
    found = run_axis(plant_with(limit), lateral_parameters().for_method("mpi"), hold(), rng=rng)
    assert found.voltage_V.max() > 3.0
    held_V = np.repeat(np.concatenate([[0.0], found.voltage_V]), SUBSTEPS)
    driven_V = limit.drive(held_V, RATE_Hz * SUBSTEPS)
    moved, _ = operator().run(driven_V, operator().virgin_memory())
    compared = moved[2 * SUBSTEPS - 1 :: SUBSTEPS][: len(found.position) - 1]
    assert np.abs(found.position[1:] - compared).max() < 1e-12


@pytest.mark.parametrize("strain_m", [0.0, 2e-7])
def test_what_is_irreversible_comes_as_late_as_the_model_simulates_it(strain_m, rng):
    late = RateDependence(time_s=4e-3, strain_m=strain_m)
    found = run_axis(plant_with(late), lateral_parameters().for_method("mpi"), hold(), rng=rng)
    rate_Hz = RATE_Hz * SUBSTEPS
    held_V = np.repeat(np.concatenate([[0.0], found.voltage_V]), SUBSTEPS)
    where = Where(recording="r", rate_Hz=rate_Hz, samples=len(held_V))
    expected = axis_with(late).motion_m(held_V, operator().virgin_memory(), where)
    compared = expected[2 * SUBSTEPS - 1 :: SUBSTEPS][: len(found.position) - 1]
    assert np.abs(found.position[1:] - compared).max() < 2e-3 * np.ptp(expected)


def test_a_cyclic_error_is_in_the_reading_and_not_in_the_position(rng):
    wrong = PeriodicError(wavelength_m=6e-7, cosine_m=(2e-9,), sine_m=(1e-9,))
    found = run_axis(plant_with(wrong), lateral_parameters().for_method("mpi"), hold(), rng=rng)
    here = Where(recording="", rate_Hz=1.0)
    np.testing.assert_allclose(found.measured, wrong.reading(found.position, here), atol=1e-15)


@pytest.mark.parametrize("extension", one_of_each(), ids=lambda extension: extension.kind)
def test_every_extension_is_in_the_plants_of_design_certificate_and_verification(extension):
    """One alone is in none of them: a declared hold belongs to the recordings."""
    plain, extended = plain_answers(), answers((extension,))
    reaches_loop = not isinstance(extension, ConverterHold)
    assert (plain[0] != extended[0]) == reaches_loop
    assert (not np.array_equal(plain[1], extended[1])) == reaches_loop


@cache
def plain_answers():
    return answers(())


def answers(extensions):
    """Return what is designed for an axis, and the readings of its plant."""
    axis = replace(fitted()["x"], extensions=extensions)
    plant = lateral_plant(axis, sampling_rate_Hz=RATE_Hz)
    run = run_axis(
        plant,
        shipped("mpi"),
        1.2e-5 + 6e-6 * np.sin(2.0 * np.pi * 40.0 * np.arange(4000) / RATE_Hz),
        rng=np.random.default_rng(1),
        disturbance=plant.motion_m(4000, np.sin(np.arange(4000) / 200.0)),
    )
    return _of_design(lateral_task(axis, RATE_Hz, forms=("inverse",))), run.measured


def _of_design(task):
    """Return what design and certificate are computed from, in a form that can be compared."""
    family, asked = task.families["inverse"], task.specification
    fractions = tuple((*m.B.tolist(), *m.A.tolist()) for m in family.members)
    limits = (asked.voltage_min_V, asked.voltage_max_V, asked.voltage_slew_V_per_s)
    return fractions, limits, task.disturbances


def test_a_changed_gain_holds_now(rng):
    change = GainChange(recording="a", instant_s=1.0, ratio=1.04)
    parameters = lateral_parameters().for_method("mpi")
    before = run_axis(plant_with(), parameters, hold(), rng=rng)
    after = run_axis(plant_with(change), parameters, hold(), rng=rng)
    assert after.position[-1] == pytest.approx(1.04 * before.position[-1])


def test_the_shipped_controller_compensates_the_creep_of_the_model(rng):
    plant = plant_with(CREEP)
    plain = lateral_parameters().for_method("mpi")
    knowing = replace(
        plain, values=complete({**plain.values, **creep_values(axis_with(CREEP), RATE_Hz)})
    )
    wanted = hold(20_000)
    errors = [
        run_axis(plant, given, wanted, rng=rng).position[300:] - wanted[300:]
        for given in (plain, knowing)
    ]
    rms = [float(np.sqrt(np.mean(error**2))) for error in errors]
    assert rms[1] < 0.05 * rms[0]


def test_of_a_long_ladder_the_largest_shares_ship():
    time_s = tuple(np.geomspace(0.01, 100.0, 12).tolist())
    share = (*(0.01,) * MAX_RELAXATIONS, *(1e-4,) * 3, 0.0)
    values = creep_values(axis_with(CreepLadder(time_s=time_s, share=share)), RATE_Hz)
    assert values["relaxation_count"] == MAX_RELAXATIONS
    np.testing.assert_allclose(values["relaxation_share"], 0.01)
    assert (np.diff(values["relaxation_rate"]) < 0.0).all()
    assert creep_values(axis_with(), RATE_Hz) == {}


def test_what_another_axis_adds_is_in_the_figures_of_the_verification():
    """A micron to and fro, which only feedback takes away."""
    coupled = CrossAxis(
        axis="y", centre_V=5.0, reach_V=4.0, gain_m_per_V=2.5e-7, curvature_m_per_V_per_V=0.0
    )
    within = {"reference_minimum_m": -7e-6, "reference_maximum_m": 1.1e-5}
    file = replace(stage("x"), axes=(shipped("mpi").with_values(within),))
    slow = tuple(s for s in SCENARIOS if s.name == "spiral, 1 Hz")
    known = fitted()["x"]
    rms_m = []
    for axis in (known, replace(known, extensions=(coupled,))):
        plant = lateral_plant(axis, sampling_rate_Hz=RATE_Hz)
        (row,) = verify(file, [plant], scenarios=slow).comparison
        rms_m.append(row.rms_m)
    assert rms_m[1] > rms_m[0] + 1e-7
