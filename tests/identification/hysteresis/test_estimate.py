"""Known stages are recovered from recordings, and insufficient data are refused."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid.errors import ExcitationError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.fit import fit
from piezoid.identification.fit_statements import fit_statements
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import IN_SAMPLE
from piezoid.identification.store import read_model, write_model
from piezoid.numerics.arrays import Array
from tests.identification.hysteresis.stages import (
    RATE_Hz,
    decaying,
    first_order_lag,
    play_sum,
    recording,
    wandering,
)

pytestmark = pytest.mark.usefixtures("plays_alone")

THRESHOLD = np.array([0.0, 0.7, 1.5, 2.6, 3.9])
WEIGHT = np.array([2.0, 0.5, 0.3, 0.2, 0.2]) * 1e-6
NOISE_m = 3e-9


def psi(h: Array) -> Array:
    """Return a curve that is 20 % steeper above 3 um and 15 % flatter below -4 um."""
    return np.where(h > 3e-6, h + 0.2 * (h - 3e-6), np.where(h < -4e-6, h - 0.15 * (h + 4e-6), h))


def stage(drive: Array, rng: np.random.Generator, lag_s: float = 0.004) -> Array:
    """Return the reading of plays of unknown initial state, with kinks, lag, offset and noise."""
    memory = np.clip(rng.normal(0, 1, 5), drive[0] - THRESHOLD, drive[0] + THRESHOLD)
    static = psi(play_sum(drive, THRESHOLD, WEIGHT, memory))
    lagged = first_order_lag(static, lag_s, RATE_Hz)
    return lagged + rng.normal(0, 1e-6) + rng.normal(0, NOISE_m, len(drive))


@cache
def fitted() -> AxisModel:
    rng = np.random.default_rng(4)
    drives = {"decaying.csv": decaying(per_unit=30), "wandering.csv": wandering(rng)[::2]}
    recordings = [recording(u, stage(u, rng), name) for name, u in drives.items()]
    return fit(recordings)["x"]


def test_the_error_on_another_excitation_is_near_the_noise_and_the_lag_is_identified():
    model = fitted()
    assert model.verdict.applies
    assert model.quality.held_out_rms_m < 2 * NOISE_m  # 0.02 % of the stroke
    assert model.quality.noise_rms_m == pytest.approx(NOISE_m, rel=0.15)
    assert model.quality.held_out_kind != IN_SAMPLE
    assert model.lag.time_s == pytest.approx(0.004, abs=2e-4)


def test_the_loading_curve_agrees_with_the_truth_within_its_interval():
    uncertainty = fitted().uncertainty
    expected_m = psi(np.maximum(uncertainty.reach_V[:, None] - THRESHOLD, 0.0) @ WEIGHT)
    inside = (
        np.abs(uncertainty.loading_m - expected_m)
        <= uncertainty.loading_half_m + 1e-3 * expected_m
    )
    assert inside.mean() > 0.9
    assert (uncertainty.loading_half_m[1:] < 0.01 * uncertainty.loading_m[-1]).all()


def test_the_certificate_bounds_the_error_to_the_truth():
    model = fitted()
    rng = np.random.default_rng(6)
    u = np.clip(wandering(rng, 40), -4.9, 4.9)
    truth = psi(play_sum(u, THRESHOLD, WEIGHT, np.zeros(5)))
    simulated, _ = model.hysteresis.run(u, np.zeros(len(model.hysteresis.plays.weight)))
    error = simulated - truth
    assert np.abs(error - np.median(error)).max() < model.certificate.bound_m
    assert model.certificate.bound_m < 0.1 * model.quality.range_m
    assert (
        0 < model.certificate.found_m < model.certificate.plays_m + model.certificate.dead_zones_m
    )


@pytest.mark.usefixtures("one_order")
def test_an_inverted_sensor_changes_the_polarity_only():
    rng = np.random.default_rng(7)
    u = decaying(15, per_unit=30)
    y = stage(u, rng)
    rising, falling = fit([recording(u, y)])["x"], fit([recording(u, -y)])["x"]
    assert (rising.polarity, falling.polarity) == (1, -1)
    stored = ActuatorModel(stage="s", axes={"x": falling}, sources={})
    assert read_model(write_model(stored))["x"].polarity == -1
    np.testing.assert_allclose(
        falling.hysteresis.plays.weight, rising.hysteresis.plays.weight, rtol=1e-6
    )
    drive = decaying(8)
    memory = rising.virgin_memory_V
    np.testing.assert_allclose(
        falling.simulate(drive, RATE_Hz, memory),
        -rising.simulate(drive, RATE_Hz, memory),
        atol=1e-12,
    )


@pytest.mark.usefixtures("one_order")
def test_an_initial_transient_is_excluded_and_stated():
    rng = np.random.default_rng(9)
    u = np.tile(decaying(2, per_unit=20)[:-1], 12)
    y = stage(u, rng)
    y[:30] -= 8e-6 * np.exp(-np.arange(30) / 6)
    model = fit([recording(u, y)])["x"]
    assert model.starts[0].first > 0
    assert "excluded" in {fact.quantity for fact in fit_statements(model)}
    assert model.quality.held_out_rms_m < 3 * NOISE_m


@pytest.mark.usefixtures("one_order")
def test_a_drift_of_the_zero_does_not_change_the_loop_width():
    u = np.tile(decaying(2, per_unit=15)[:-1], 24)
    drift = 2e-7 * np.linspace(0, 1, len(u)) ** 0.5
    constant, drifting = (
        fit([recording(u, stage(u, np.random.default_rng(1)) + zero)])["x"]
        for zero in (0.0 * drift, drift)
    )
    assert "baseline_drift" in {fact.quantity for fact in fit_statements(drifting)}
    width = [model.uncertainty.loop_width_m[0] for model in (constant, drifting)]
    assert abs(width[1] - width[0]) < 0.035 * width[0]  # the drift is 7 % of the width


CONSTANT = recording(np.ones(200), np.linspace(0, 1e-6, 200))
WITHOUT_READING = replace(CONSTANT, channels=CONSTANT.channels[:1])


@pytest.mark.parametrize(
    ("insufficient", "reason"),
    [(CONSTANT, "never changes"), (WITHOUT_READING, "only voltage is recorded")],
)
def test_recordings_that_determine_no_model_are_refused(insufficient, reason):
    with pytest.raises(ExcitationError, match=reason):
        fit([insufficient])
