"""The plant of an extended model answers as the model's own extensions say."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from piezoid.export.runtime_names import creep_values
from piezoid.identification.extensions import (
    AmplifierLimits,
    CreepLadder,
    Delay,
    FirstOrderLag,
    GainChange,
    LinearMode,
    SlewLimit,
)
from piezoid.identification.extensions.extension import Where
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.limits import slewed
from piezoid.runtime.schema import MAX_RELAXATIONS
from piezoid.runtime.values import complete
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.extended_plant import extended_plant, saturated
from piezoid.verification.loop_plant import SUBSTEPS
from piezoid.verification.plant import AxisPlant, Hysteresis
from tests.verification.rig import RATE_Hz, lateral_parameters, operator

CREEP = CreepLadder(time_s=(0.01, 0.1, 1.0), share=(0.01, 0.02, 0.03))
STATIC = AxisPlant(
    axis="x", label="static", sampling_rate_Hz=RATE_Hz, response=Hysteresis(operator=operator())
)


def axis_with(*extensions):
    return SimpleNamespace(extensions=extensions, dynamics=None)


def hold(samples=6000, height_m=1.5e-5):
    return height_m * (np.arange(samples) > 200)


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
    plant = extended_plant(STATIC, axis_with(extension))
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


def test_the_voltage_of_a_slow_amplifier_is_the_one_the_model_knows(rng):
    limit = SlewLimit(limit_V_per_s=400.0)
    plant = extended_plant(STATIC, axis_with(limit))
    found = run_axis(plant, lateral_parameters().for_method("mpi"), hold(), rng=rng)
    held_V = np.repeat(found.voltage_V, SUBSTEPS)
    driven_V = slewed(np.concatenate([[0.0], held_V]), 400.0 / (RATE_Hz * SUBSTEPS))[1:]
    moved, _ = operator().run(driven_V, operator().virgin_memory())
    assert np.abs(found.position[1:] - moved[SUBSTEPS - 1 :: SUBSTEPS][:-1]).max() < 1e-12


def test_a_saturated_envelope_is_the_envelope_of_the_clipped_drive():
    bent = from_slopes(np.array([-2.0, 0.0, 2.0]), np.array([0.8, 1.0, 1.0, 1.3]))
    limits = AmplifierLimits(low_V=2.5, high_V=9.0)
    drive_V = np.linspace(-5.0, 5.0, 401)
    clipped = limits.drive(drive_V + 5.0, RATE_Hz) - 5.0
    np.testing.assert_allclose(
        saturated(bent, limits, 5.0).run(drive_V), bent.run(clipped), atol=1e-8
    )


def test_a_changed_gain_holds_now(rng):
    change = GainChange(recording="a", instant_s=1.0, ratio=1.04)
    parameters = lateral_parameters().for_method("mpi")
    before = run_axis(STATIC, parameters, hold(), rng=rng)
    after = run_axis(extended_plant(STATIC, axis_with(change)), parameters, hold(), rng=rng)
    assert after.position[-1] == pytest.approx(1.04 * before.position[-1])


def test_the_shipped_controller_compensates_the_creep_of_the_model(rng):
    plant = extended_plant(STATIC, axis_with(CREEP))
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
