"""From recordings to a model: known truths come back, and what cannot be known is said."""

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
    """A kinked curve: 20 % steeper above 3 um, flatter below -4 um."""
    return np.where(h > 3e-6, h + 0.2 * (h - 3e-6), np.where(h < -4e-6, h - 0.15 * (h + 4e-6), h))


def stage(drive: Array, rng: np.random.Generator, lag_s: float = 0.004) -> Array:
    """Plays with an unknown past, kinks, a lag, an offset, noise."""
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


def test_error_on_another_excitation_is_near_the_noise_and_the_lag_is_that_of_the_stage():
    model = fitted()
    assert model.verdict.applies
    assert model.quality.held_out_rms_m < 2 * NOISE_m  # 0.02 % of the stroke
    assert model.quality.noise_rms_m == pytest.approx(NOISE_m, rel=0.15)
    assert model.quality.held_out_kind != IN_SAMPLE
    assert model.lag.time_s == pytest.approx(0.004, abs=2e-4)


def test_loading_curve_lies_within_its_interval_of_the_truth():
    found = fitted().uncertainty
    true_m = psi(np.maximum(found.reach_V[:, None] - THRESHOLD, 0.0) @ WEIGHT)
    inside = np.abs(found.loading_m - true_m) <= found.loading_half_m + 1e-3 * true_m
    assert inside.mean() > 0.9
    assert (found.loading_half_m[1:] < 0.01 * found.loading_m[-1]).all()


def test_certificate_is_not_smaller_than_the_error_to_the_truth():
    model = fitted()
    rng = np.random.default_rng(6)
    u = np.clip(wandering(rng, 40), -4.9, 4.9)
    truth = psi(play_sum(u, THRESHOLD, WEIGHT, np.zeros(5)))
    own, _ = model.hysteresis.run(u, np.zeros(len(model.hysteresis.plays.weight)))
    error = own - truth
    assert np.abs(error - np.median(error)).max() < model.certificate.bound_m
    assert model.certificate.bound_m < 0.1 * model.quality.range_m
    assert (
        0 < model.certificate.found_m < model.certificate.plays_m + model.certificate.dead_zones_m
    )


@pytest.mark.usefixtures("one_order")
def test_a_sensor_that_falls_as_the_drive_rises_only_changes_the_polarity():
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
def test_a_transient_from_before_the_record_is_left_out_and_said():
    rng = np.random.default_rng(9)
    u = np.tile(decaying(2, per_unit=20)[:-1], 12)
    y = stage(u, rng)
    y[:30] -= 8e-6 * np.exp(-np.arange(30) / 6)
    model = fit([recording(u, y)])["x"]
    assert model.starts[0].first > 0
    assert "excluded" in {fact.quantity for fact in fit_statements(model)}
    assert model.quality.held_out_rms_m < 2 * NOISE_m


@pytest.mark.usefixtures("one_order")
def test_slow_motion_of_the_zero_does_not_bend_the_loop():
    u = np.tile(decaying(2, per_unit=40)[:-1], 24)
    drift = 2e-7 * np.linspace(0, 1, len(u)) ** 0.5
    still, moving = (
        fit([recording(u, stage(u, np.random.default_rng(1)) + part)])["x"]
        for part in (0.0 * drift, drift)
    )
    assert "baseline_drift" in {fact.quantity for fact in fit_statements(moving)}
    width = [model.uncertainty.loop_width_m[0] for model in (still, moving)]
    assert abs(width[1] - width[0]) < 0.035 * width[0]  # the drift is 7 % of the width


STILL = recording(np.ones(200), np.linspace(0, 1e-6, 200))
UNREAD = replace(STILL, channels=STILL.channels[:1])


@pytest.mark.parametrize(
    ("unfit", "told"), [(STILL, "never changes"), (UNREAD, "only voltage is recorded")]
)
def test_recordings_that_determine_no_model_are_refused(unfit, told):
    with pytest.raises(ExcitationError, match=told):
        fit([unfit])
