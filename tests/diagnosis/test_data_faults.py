"""Faults of the data are named where they are, sized with an interval, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.effects import (
    mains_interference,
    outliers,
    quantisation,
    sensor_periodic_error,
    timestamp_fault,
)
from piezoid.diagnosis.residual_view import with_tracks
from piezoid.diagnosis.score_test import score_test
from piezoid.records.lab import Lab

from .play_stage import NOISE_m, STROKE_m, clean, healthy, moved, recording, view_with, within

FAULTS = (timestamp_fault, outliers, quantisation)


@pytest.mark.parametrize("effect", FAULTS, ids=[f.EFFECT.name for f in FAULTS])
def test_healthy_recordings_have_no_fault(effect):
    assert effect.EFFECT.fault.find(healthy()) is None


def test_no_hum_and_no_ripple_is_seen_in_healthy_recordings():
    for effect in (mains_interference.EFFECT, sensor_periodic_error.EFFECT):
        found = score_test(effect, healthy())
        assert found is None or found.cv.gain < 0.03


def test_spikes_are_found_sized_and_bridged():
    reading_m = np.array(clean("walk")[2])
    reading_m[[1200, 4000, 7311]] += np.array([0.012, -0.02, 0.009]) * STROKE_m
    reading_m[5000:5002] -= 0.015 * STROKE_m
    view = view_with(walk=reading_m)
    fault = outliers.EFFECT.fault.find(view)
    assert within(fault, 1e9 * 0.02 * STROKE_m)
    assert fault.p_value < 1e-3
    assert fault.locations == ("walk (5)",)
    left = fault.tracks[1].response - healthy().tracks[1].response
    assert np.abs(left - np.median(left)).max() < 0.02


def driven(drive):
    """A track that follows a drive but for noise."""
    noise = 3e-4 * np.random.default_rng(1).normal(size=len(drive))
    return replace(healthy().tracks[0], command=drive, drive=drive, response=drive + noise)


def with_added(track, places, sizes):
    response = np.array(track.response)
    response[places] += sizes
    return replace(track, response=response)


def found_in(track, static):
    return np.flatnonzero(outliers.spikes(track, static)[0]).tolist()


def test_a_reading_at_a_sharp_turn_is_no_spike():
    up = np.arange(-1.0, 1.0, 0.004)
    drive = np.tile(np.concatenate([up, up[::-1]]), 8)
    static = np.array(drive)
    static[len(up)] -= 0.01  # a model that does not quite know the turn
    peaked = with_added(driven(drive), [len(up)], 0.0075)
    assert found_in(peaked, static) == []
    assert found_in(with_added(peaked, [len(up) + 200], 0.04), static) == [len(up) + 200]


def test_spikes_are_found_beside_motion_that_goes_much_farther_from_sample_to_sample():
    drive = np.linspace(-0.5, 0.5, 8000)
    drive[3000:3300] += 0.4 * np.sin(np.arange(300) * 0.5)
    spiky = with_added(driven(drive), [470, 2110, 6330], np.array([0.03, -0.04, 0.035]))
    assert found_in(spiky, drive) == [470, 2110, 6330]


def test_a_jump_of_the_drive_is_no_spike():
    field = np.array(clean("walk")[1])
    field[3000:3002] += 0.05
    reading_m = STROKE_m * moved(field) + np.random.default_rng(3).normal(0.0, NOISE_m, 9000)
    recordings = [recording("sweep"), recording("walk", reading_m, field), recording("waves")]
    assert outliers.EFFECT.fault.find(view_on(recordings, axis="x", lab=Lab())) is None


@pytest.mark.parametrize("period", [16, 23])
def test_a_recording_that_begins_and_ends_in_the_midst_of_a_ramp_has_no_spikes(period):
    drive = np.linspace(-0.9, 0.9, 4000)
    quiet = 1e-6 * np.random.default_rng(1).normal(size=len(drive))
    for phase in np.linspace(0.0, 2 * np.pi, 8, endpoint=False):
        # ramps of a hum, on which the drive hardly moves
        hum = 0.02 * np.sin(2 * np.pi * np.arange(len(drive)) / period + phase)
        track = replace(driven(drive), response=drive + hum + quiet)
        assert found_in(track, drive) == []
        assert found_in(with_added(track, [1000], 0.1), drive) == [1000]


def coarse_reading(step_m: float):
    readings_m = {kind: clean(kind)[2] for kind in ("sweep", "walk", "waves")}
    return view_with(**{kind: step_m * np.round(y / step_m) for kind, y in readings_m.items()})


@pytest.mark.parametrize("spikes", ["", "beside the steps", "between two of them"])
def test_a_coarse_reading_is_named_with_its_step_and_its_saw_is_no_periodic_error(spikes):
    """Spikes off the lattice do not hide it, nor do those that were repaired."""
    step_m, kinds = 4e-3 * STROKE_m, ("sweep", "walk", "waves")
    readings_m = {kind: step_m * np.round(clean(kind)[2] / step_m) for kind in kinds}
    for k, reading_m in enumerate(readings_m.values() if spikes else ()):
        where = np.random.default_rng(k).choice(len(reading_m) - 2, 9, replace=False) + 1
        between_m = 0.5 * (reading_m[where - 1] + reading_m[where + 1]) + 0.25 * step_m
        is_between = spikes == "between two of them"
        reading_m[where] = between_m if is_between else reading_m[where] + 17.3 * step_m
    view = view_with(**readings_m)
    fault = quantisation.EFFECT.fault.find(view)
    assert within(fault, 1e9 * step_m)
    assert fault.spread < 0.05 * fault.value
    ripple = score_test(sensor_periodic_error.EFFECT, view)
    assert ripple is None or ripple.cv.gain < 0.05


def test_a_converter_of_sixteen_bits_is_not_coarse():
    assert quantisation.EFFECT.fault.find(coarse_reading(1.3 * STROKE_m / 2**16)) is None


def test_a_coarse_drive_is_found_where_the_file_has_the_smooth_one():
    step = 0.02
    noise = np.random.default_rng(4).normal(0.0, NOISE_m, 9000)
    readings_m = {
        kind: STROKE_m * moved(step * np.round(clean(kind)[1] / step)) + noise
        for kind in ("sweep", "walk", "waves")
    }
    view = view_with(**readings_m)
    fault = quantisation.EFFECT.fault.find(view)
    slope_m = float(np.ptp(clean("sweep")[2])) / 2.0
    assert fault.value == pytest.approx(1e9 * step * slope_m, rel=0.4)
    assert with_tracks(view, fault.tracks).rms < 0.8 * view.rms
    assert outliers.EFFECT.fault.find(view) is None


def test_a_fine_ripple_is_found_though_every_recording_counts_from_its_own_zero():
    period_m, rng = 316e-9, np.random.default_rng(6)
    readings_m = {
        kind: (y := clean(kind)[2])
        + 2e-3 * STROKE_m * np.sin(2 * np.pi * y / period_m + rng.uniform(0.0, 6.0))
        for kind in ("sweep", "walk", "waves")
    }
    view = view_with(**readings_m)
    found = score_test(sensor_periodic_error.EFFECT, view)
    periods = 2.0 * view.half_stroke_m / period_m
    assert found.trial.parameters["periods"] == pytest.approx(periods, rel=0.01)
    assert found.cv.gain > 0.2
    size = sensor_periodic_error.EFFECT.size
    amplitude_nm = size(view, found.trial.parameters, found.cv.coefficient)
    assert amplitude_nm == pytest.approx(1e9 * 2e-3 * STROKE_m, rel=0.25)


def test_what_is_larger_than_a_fault_that_could_hide_is_found():
    height = 1.3 * outliers.EFFECT.fault.bound(healthy())
    reading_m = np.array(clean("walk")[2])
    reading_m[4000] += height * 2.0 * healthy().half_stroke_m
    assert outliers.EFFECT.fault.find(view_with(walk=reading_m)) is not None
    step = 1.3 * np.sqrt(12.0) * quantisation.EFFECT.fault.bound(healthy())
    view = coarse_reading(step * 2.0 * healthy().half_stroke_m)
    assert quantisation.EFFECT.fault.find(view) is not None


def test_bridged_samples_are_neither_compared_nor_steps_of_a_converter():
    step_m = 4e-3 * STROKE_m
    reading_m = step_m * np.round(clean("sweep")[2] / step_m)
    lost = np.arange(50, 8950, 67)
    reading_m[lost] = (reading_m[lost - 1] + reading_m[lost + 1]) / 2
    view = view_on(
        [replace(recording("sweep", reading_m), bridged=tuple(lost.tolist()))], axis="x", lab=Lab()
    )
    assert not np.isin(view.tracks[0].rows, lost).any()
    assert within(quantisation.EFFECT.fault.find(view), 1e9 * step_m)


@pytest.mark.parametrize("long", [1, 2, 3])
def test_a_few_wrong_readings_are_spikes_and_more_side_by_side_are_none(long):
    spiky = with_added(driven(np.linspace(-0.9, 0.9, 6000)), range(2000, 2000 + long), 0.05)
    assert found_in(spiky, spiky.drive) == list(range(2000, 2000 + long))
    for sign in (1.0, -1.0):
        places = range(2000, 2004 + long)
        dip = with_added(driven(np.linspace(-0.9, 0.9, 6000)), places, sign * 0.05)
        assert found_in(dip, dip.drive) == []
