"""Discrepancy of the model: as large as the model error, also away from the recordings."""

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

LAWS = ("preisach_lorentzian", "takacs", "maxwell_slip")
CYCLED = np.array([1.0, -1.0, 1.0, -1.0])
TURN = np.linspace(0.0, 1.0, 3000)
SPIRAL = 0.7 * TURN * np.sin(10.0 * np.pi * TURN)
RECORDED = {"full": triangles(6, 300), "shrinking": triangles(8, 300, 0.1)}


@cache
def fitted(law: str, excitation: str) -> tuple[AxisModel, Recording, Array, Array]:
    """Return model, recording, a drive that ends in a spiral, and the true displacement in m."""
    ceramic = next(truth for truth in ZOO if truth.name == law).draw(np.random.default_rng(8))
    field = RECORDED[excitation]
    full_drive = np.concatenate([field, np.linspace(field[-1], 0.0, 100), SPIRAL])
    reading_um = 20.0 * sum(ceramic.respond(full_drive, CYCLED))
    noise_um = 0.008 * np.random.default_rng(1).standard_normal(len(field))
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{excitation}.csv"
        write(path, field, reading_um[: len(field)] + noise_um)
        (recording,) = piezoid.read(path)
        return piezoid.fit(recording).one(), recording, 5.0 * full_drive, 1e-6 * reading_um


def discrepancy_m(shape: Discrepancy, drive_V: Array) -> Array:
    """Return d[u] by its definition, play by play."""
    total_m = np.zeros(len(drive_V))
    for threshold_V, weight_m in zip(shape.threshold_V, shape.weight_m.T, strict=True):
        state, play = 0.0, np.empty(len(drive_V))
        for k, value in enumerate((drive_V - shape.centre_V).tolist()):
            state = min(max(state, value - threshold_V), value + threshold_V)
            play[k] = state / shape.reach_V
        total_m += sum(weight * play**n for n, weight in enumerate(weight_m.tolist(), start=1))
    return total_m


def spiral_errors_m(law: str, excitation: str) -> tuple[float, float]:
    """Return the rms of the model error and of the discrepancy on the spiral, without the mean."""
    model, _, drive_V, truth_m = fitted(law, excitation)
    simulated_m, _ = model.hysteresis.run(drive_V, model.hysteresis.virgin_memory())
    error_m = (truth_m - simulated_m)[-len(SPIRAL) :]
    return float(np.std(error_m)), float(
        np.std(discrepancy_m(model.discrepancy, drive_V)[-len(SPIRAL) :])
    )


def test_the_discrepancy_is_as_large_as_the_model_error_on_unrecorded_loops():
    error_m, stated_m = np.transpose([spiral_errors_m(law, "full") for law in LAWS])
    held_out_m = [fitted(law, "full")[0].quality.held_out_rms_m for law in LAWS]
    assert np.median(error_m / held_out_m) > 5.0  # not visible in the recordings
    assert 0.4 < np.median(stated_m / error_m) < 2.5


def test_recorded_minor_loops_reduce_the_discrepancy():
    _, full_loops_m = spiral_errors_m("takacs", "full")
    error_m, shrinking_loops_m = spiral_errors_m("takacs", "shrinking")
    assert shrinking_loops_m < 0.5 * full_loops_m
    assert shrinking_loops_m > 0.3 * error_m


@pytest.mark.parametrize("law", LAWS[:2])
def test_the_response_stays_monotonic_for_any_discrepancy(law):
    model, recording, _, _ = fitted(law, "full")
    inaccurate = replace(model, quality=replace(model.quality, held_out_rms_m=8e-6))
    shape = with_discrepancy(inaccurate, [recording]).discrepancy
    turns_V = 5.0 * np.random.default_rng(2).uniform(-1.0, 1.0, 60)
    drive_V = np.interp(np.arange(0.0, 59.0, 0.02), np.arange(60), turns_V)
    simulated_m, _ = model.hysteresis.run(drive_V, model.hysteresis.virgin_memory())
    is_moving = np.abs(np.diff(drive_V)) > 0.01
    step_V = np.diff(drive_V)[is_moving]
    slope = np.diff(simulated_m)[is_moving] / step_V
    perturbed_slope = slope + np.diff(discrepancy_m(shape, drive_V))[is_moving] / step_V
    assert np.abs(perturbed_slope - slope).max() > 0.2 * slope.mean()
    assert perturbed_slope.min() > 0.0


def test_a_recording_without_noise_has_a_finite_slope():
    """A simulated recording without noise caused a division by zero."""
    exact = replace(axis_model(), quality=replace(QUALITY, rms_m=0.0, held_out_rms_m=0.0))
    shape = with_discrepancy(exact, [recording(noise_m=0.0)]).discrepancy
    assert np.isfinite(shape.steepest_m_per_V)
    assert 0.0 <= shape.steepest_m_per_V < 1e-12
