"""Faults of the data are located and sized with an interval, and healthy data have none."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.effects import (
    mains_interference,
    outliers,
    quantisation,
    sensor_periodic_error,
    timestamp_fault,
)
from piezoid.diagnosis.residual_view import with_tracks
from piezoid.diagnosis.score_test import score_test

from .bench import view_of_recordings
from .play_stage import (
    NOISE_m,
    STROKE_m,
    clean,
    healthy,
    is_within_interval,
    noisy_reading_m,
    recording,
    stroke_fraction,
    view_with,
)

FAULTS = (timestamp_fault, outliers, quantisation)


@pytest.mark.parametrize("effect", FAULTS, ids=[f.EFFECT.name for f in FAULTS])
def test_healthy_recordings_have_no_fault(effect):
    assert effect.EFFECT.fault.find(healthy()) is None


def test_healthy_recordings_have_no_hum_and_no_periodic_error():
    for effect in (mains_interference.EFFECT, sensor_periodic_error.EFFECT):
        test = score_test(effect, healthy())
        assert test is None or test.cv.gain < 0.03


def test_spikes_are_found_sized_and_bridged():
    reading_m = np.array(clean("walk")[2])
    reading_m[[1200, 4000, 7311]] += np.array([0.012, -0.02, 0.009]) * STROKE_m
    reading_m[5000:5002] -= 0.015 * STROKE_m
    view = view_with(walk=reading_m)
    fault = outliers.EFFECT.fault.find(view)
    assert is_within_interval(fault, 1e9 * 0.02 * STROKE_m)
    assert fault.p_value < 1e-3
    assert fault.locations == ("walk (5)",)
    change = fault.tracks[1].response - healthy().tracks[1].response
    assert np.abs(change - np.median(change)).max() < 0.02


def track_following(drive):
    """Return a track that follows the drive with little noise."""
    noise = 3e-4 * np.random.default_rng(1).normal(size=len(drive))
    return replace(healthy().tracks[0], command=drive, drive=drive, response=drive + noise)


def with_added(track, rows, sizes):
    response = np.array(track.response)
    response[rows] += sizes
    return replace(track, response=response)


def spike_rows(track, static):
    return np.flatnonzero(outliers.spikes(track, static)[0]).tolist()


def test_a_reading_at_a_sharp_turn_is_not_a_spike():
    up = np.arange(-1.0, 1.0, 0.004)
    drive = np.tile(np.concatenate([up, up[::-1]]), 8)
    static = np.array(drive)
    static[len(up)] -= 0.01  # inaccurate model at the turn
    peaked = with_added(track_following(drive), [len(up)], 0.0075)
    assert spike_rows(peaked, static) == []
    assert spike_rows(with_added(peaked, [len(up) + 200], 0.04), static) == [len(up) + 200]


def test_spikes_are_found_despite_fast_motion_elsewhere():
    drive = np.linspace(-0.5, 0.5, 8000)
    drive[3000:3300] += 0.4 * np.sin(np.arange(300) * 0.5)
    spiky = with_added(track_following(drive), [470, 2110, 6330], np.array([0.03, -0.04, 0.035]))
    assert spike_rows(spiky, drive) == [470, 2110, 6330]


def test_a_jump_of_the_drive_is_not_a_spike():
    field = np.array(clean("walk")[1])
    field[3000:3002] += 0.05
    reading_m = noisy_reading_m(field, seed=3)
    recordings = [recording("sweep"), recording("walk", reading_m, field), recording("waves")]
    assert outliers.EFFECT.fault.find(view_of_recordings(recordings)) is None


@pytest.mark.parametrize("period", [16, 23])
def test_the_ends_of_a_recording_on_a_ramp_are_not_spikes(period):
    drive = np.linspace(-0.9, 0.9, 4000)
    noise = 1e-6 * np.random.default_rng(1).normal(size=len(drive))
    for phase in np.linspace(0.0, 2 * np.pi, 8, endpoint=False):
        # A hum has ramps on which the drive hardly moves.
        hum = 0.02 * np.sin(2 * np.pi * np.arange(len(drive)) / period + phase)
        track = replace(track_following(drive), response=drive + hum + noise)
        assert spike_rows(track, drive) == []
        assert spike_rows(with_added(track, [1000], 0.1), drive) == [1000]


def coarse_reading(step_m: float):
    readings_m = {kind: clean(kind)[2] for kind in ("sweep", "walk", "waves")}
    return view_with(**{kind: step_m * np.round(y / step_m) for kind, y in readings_m.items()})


@pytest.mark.parametrize("spikes", ["", "off the lattice", "between two steps"])
def test_a_coarse_reading_is_named_with_its_step_and_is_not_a_periodic_error(spikes):
    """Spikes off the lattice, or repaired ones between two steps, do not hide it."""
    step_m, kinds = 4e-3 * STROKE_m, ("sweep", "walk", "waves")
    readings_m = {kind: step_m * np.round(clean(kind)[2] / step_m) for kind in kinds}
    for k, reading_m in enumerate(readings_m.values() if spikes else ()):
        rows = np.random.default_rng(k).choice(len(reading_m) - 2, 9, replace=False) + 1
        between_m = 0.5 * (reading_m[rows - 1] + reading_m[rows + 1]) + 0.25 * step_m
        is_between = spikes == "between two steps"
        reading_m[rows] = between_m if is_between else reading_m[rows] + 17.3 * step_m
    view = view_with(**readings_m)
    fault = quantisation.EFFECT.fault.find(view)
    assert is_within_interval(fault, 1e9 * step_m)
    assert fault.spread < 0.05 * fault.value
    ripple = score_test(sensor_periodic_error.EFFECT, view)
    assert ripple is None or ripple.cv.gain < 0.05


def test_a_recording_smaller_than_a_step_does_not_hide_a_coarse_reading():
    step_m = 0.05 * STROKE_m
    readings_m = {kind: step_m * np.round(clean(kind)[2] / step_m) for kind in ("sweep", "walk")}
    view = view_with(**readings_m, waves=np.full(9000, step_m))
    assert is_within_interval(quantisation.EFFECT.fault.find(view), 1e9 * step_m)


def test_a_16_bit_converter_is_not_coarse():
    assert quantisation.EFFECT.fault.find(coarse_reading(1.3 * STROKE_m / 2**16)) is None


def test_a_coarse_drive_is_found_with_a_smooth_command():
    step = 0.02
    noise = np.random.default_rng(4).normal(0.0, NOISE_m, 9000)
    readings_m = {
        kind: STROKE_m * stroke_fraction(step * np.round(clean(kind)[1] / step)) + noise
        for kind in ("sweep", "walk", "waves")
    }
    view = view_with(**readings_m)
    fault = quantisation.EFFECT.fault.find(view)
    slope_m = float(np.ptp(clean("sweep")[2])) / 2.0
    assert fault.value == pytest.approx(1e9 * step * slope_m, rel=0.4)
    assert with_tracks(view, fault.tracks).rms < 0.8 * view.rms
    assert outliers.EFFECT.fault.find(view) is None


def test_a_periodic_error_is_found_despite_unknown_phases():
    period_m, rng = 316e-9, np.random.default_rng(6)
    readings_m = {
        kind: (y := clean(kind)[2])
        + 2e-3 * STROKE_m * np.sin(2 * np.pi * y / period_m + rng.uniform(0.0, 6.0))
        for kind in ("sweep", "walk", "waves")
    }
    view = view_with(**readings_m)
    test = score_test(sensor_periodic_error.EFFECT, view)
    periods = 2.0 * view.half_stroke_m / period_m
    assert test.trial.parameters["periods"] == pytest.approx(periods, rel=0.01)
    assert test.cv.gain > 0.2
    size = sensor_periodic_error.EFFECT.size
    amplitude_nm = size(view, test.trial.parameters, test.cv.coefficient)
    assert amplitude_nm == pytest.approx(1e9 * 2e-3 * STROKE_m, rel=0.25)


def test_a_fault_above_its_detection_bound_is_found():
    height = 1.3 * outliers.EFFECT.fault.bound(healthy())
    reading_m = np.array(clean("walk")[2])
    reading_m[4000] += height * 2.0 * healthy().half_stroke_m
    assert outliers.EFFECT.fault.find(view_with(walk=reading_m)) is not None
    step = 1.3 * np.sqrt(12.0) * quantisation.EFFECT.fault.bound(healthy())
    view = coarse_reading(step * 2.0 * healthy().half_stroke_m)
    assert quantisation.EFFECT.fault.find(view) is not None


def test_bridged_samples_are_excluded_and_are_not_quantisation_steps():
    step_m = 4e-3 * STROKE_m
    reading_m = step_m * np.round(clean("sweep")[2] / step_m)
    bridged_rows = np.arange(50, 8950, 67)
    reading_m[bridged_rows] = (reading_m[bridged_rows - 1] + reading_m[bridged_rows + 1]) / 2
    sweep = replace(recording("sweep", reading_m), bridged=tuple(bridged_rows.tolist()))
    view = view_of_recordings([sweep])
    assert not np.isin(view.tracks[0].rows, bridged_rows).any()
    assert is_within_interval(quantisation.EFFECT.fault.find(view), 1e9 * step_m)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_up_to_three_wrong_readings_are_spikes_and_more_are_motion(count):
    track = track_following(np.linspace(-0.9, 0.9, 6000))
    rows = range(2000, 2000 + count)
    assert spike_rows(with_added(track, rows, 0.05), track.drive) == list(rows)
    for sign in (1.0, -1.0):
        dip = with_added(track, range(2000, 2004 + count), sign * 0.05)
        assert spike_rows(dip, track.drive) == []
