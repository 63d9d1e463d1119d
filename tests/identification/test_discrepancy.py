"""What the model class does not follow is as large as what it misses, also where nobody looked."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

import piezoid
from piezoid.identification.discrepancy import with_discrepancy
from piezoid.identification.model import AxisModel, Discrepancy
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.truths import ZOO
from tests.laws import triangles, write
from tests.reports.known_stage import QUALITY, axis_model, recording

pytestmark = pytest.mark.usefixtures("plays_alone")

LAWS = ("preisach_lorentzian", "takacs", "wall_pinning", "duhem", "maxwell_slip")
CYCLED = np.array([1.0, -1.0, 1.0, -1.0])
TURN = np.linspace(0.0, 1.0, 3000)
SPIRAL = 0.7 * TURN * np.sin(10.0 * np.pi * TURN)
RECORDED = {"full": triangles(6, 300), "shrinking": triangles(8, 300, 0.1)}


@cache
def fitted(law: str, recorded: str) -> tuple[AxisModel, Recording, Array, Array]:
    """Return a model, its recording, a drive that ends in a spiral, and the true motion in m."""
    ceramic = next(one for one in ZOO if one.name == law).draw(np.random.default_rng(8))
    field = RECORDED[recorded]
    whole = np.concatenate([field, np.linspace(field[-1], 0.0, 100), SPIRAL])
    reading_um = 20.0 * sum(ceramic.respond(whole, CYCLED))
    noise_um = 0.008 * np.random.default_rng(1).standard_normal(len(field))
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{recorded}.csv"
        write(path, field, reading_um[: len(field)] + noise_um)
        (recording,) = piezoid.read(path)
        return piezoid.fit(recording).one(), recording, 5.0 * whole, 1e-6 * reading_um


def second(shape: Discrepancy, drive_V: Array) -> Array:
    """Return d[u] by its formula, one play after the other."""
    moved_m = np.zeros(len(drive_V))
    for threshold_V, weight_m in zip(shape.threshold_V, shape.weight_m.T, strict=True):
        state, held = 0.0, np.empty(len(drive_V))
        for k, value in enumerate((drive_V - shape.centre_V).tolist()):
            state = min(max(state, value - threshold_V), value + threshold_V)
            held[k] = state / shape.reach_V
        moved_m += sum(weight * held**n for n, weight in enumerate(weight_m.tolist(), start=1))
    return moved_m


def on_spiral(law: str, recorded: str) -> tuple[float, float]:
    """Return rms on the spiral, without the mean: of what the model misses, and of d."""
    model, _, drive_V, truth_m = fitted(law, recorded)
    followed_m, _ = model.hysteresis.run(drive_V, model.hysteresis.virgin_memory())
    missed = (truth_m - followed_m)[-len(SPIRAL) :]
    return float(np.std(missed)), float(np.std(second(model.discrepancy, drive_V)[-len(SPIRAL) :]))


def test_of_loops_that_nobody_recorded_it_is_as_large_as_what_the_model_misses():
    missed_m, stated_m = np.transpose([on_spiral(law, "full") for law in LAWS])
    held_out_m = [fitted(law, "full")[0].quality.held_out_rms_m for law in LAWS]
    assert np.median(missed_m / held_out_m) > 5.0  # which the recordings do not show
    assert 0.4 < np.median(stated_m / missed_m) < 2.5


def test_recorded_loops_make_it_smaller():
    _, of_full_m = on_spiral("takacs", "full")
    missed_m, of_all_m = on_spiral("takacs", "shrinking")
    assert of_all_m < 0.5 * of_full_m
    assert of_all_m > 0.3 * missed_m


@pytest.mark.parametrize("law", LAWS[:2])
def test_however_much_is_missed_the_response_still_rises(law):
    model, recording, _, _ = fitted(law, "full")
    missed = replace(model, quality=replace(model.quality, held_out_rms_m=8e-6))
    shape = with_discrepancy(missed, [recording]).discrepancy
    turns_V = 5.0 * np.random.default_rng(2).uniform(-1.0, 1.0, 60)
    drive_V = np.interp(np.arange(0.0, 59.0, 0.02), np.arange(60), turns_V)
    followed_m, _ = model.hysteresis.run(drive_V, model.hysteresis.virgin_memory())
    moving = np.abs(np.diff(drive_V)) > 0.01
    step_V = np.diff(drive_V)[moving]
    alone = np.diff(followed_m)[moving] / step_V
    both = alone + np.diff(second(shape, drive_V))[moving] / step_V
    assert np.abs(both - alone).max() > 0.2 * alone.mean()
    assert both.min() > 0.0


def test_readings_that_are_followed_to_the_last_bit_have_a_finite_slope():
    """A recording without noise, as a simulator writes it, was a division by zero."""
    exact = replace(axis_model(), quality=replace(QUALITY, rms_m=0.0, held_out_rms_m=0.0))
    shape = with_discrepancy(exact, [recording(noise_m=0.0)]).discrepancy
    assert shape is not None
    assert np.isfinite(shape.steepest_m_per_V)
    assert 0.0 <= shape.steepest_m_per_V < 1e-12
