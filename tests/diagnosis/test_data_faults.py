"""Faults of the data are named where they are, sized with an interval, and nowhere else.

The stage is a sum of plays; the faults are put in here, by no code of the library.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.effects import (
    mains_interference,
    outliers,
    quantisation,
    sensor_periodic_error,
    timestamp_fault,
)
from piezoid.diagnosis.screening import screen
from piezoid.diagnosis.search import Outcome
from piezoid.diagnosis.slip_evidence import judged_of
from piezoid.diagnosis.slips import beside, strongest
from piezoid.diagnosis.stamps import with_stamps
from piezoid.diagnosis.view import with_tracks
from piezoid.numerics.arrays import Array
from piezoid.records.lab import Lab
from piezoid.records.recording import Channel, Problem, Quantity, Recording

STROKE_m = 30e-6
NOISE_m = 5e-4 * STROKE_m
FAULTS = (timestamp_fault, outliers, quantisation)


def drive(kind: str) -> tuple[float, Array]:
    rate_Hz = {"sweep": 1000.0, "walk": 500.0, "waves": 4000.0}[kind]
    time_s = np.arange(9000) / rate_Hz
    if kind == "sweep":
        turn = np.arcsin(np.sin(2 * np.pi * (1.1 * time_s - 0.25)))
        return rate_Hz, np.linspace(1.0, 0.3, 9000) * 2 / np.pi * turn
    if kind == "walk":
        levels = np.random.default_rng(5).uniform(-0.9, 0.9, 31)
        place = np.linspace(0, 29.999, 9000)
        part = 0.5 - 0.5 * np.cos(np.pi * (place % 1.0))
        at = place.astype(int)
        return rate_Hz, levels[at] + (levels[at + 1] - levels[at]) * part
    return rate_Hz, 0.6 * np.sin(2 * np.pi * 2.7 * time_s) + 0.3 * np.sin(2 * np.pi * 17 * time_s)


def moved(field: Array) -> Array:
    """Return the displacement over the stroke, of plays and a little Bouc-Wen."""
    state, rub, out = np.zeros(6), 0.0, np.empty(len(field))
    width = np.linspace(0.05, 0.6, 6)
    for i, (u, step) in enumerate(zip(field, np.diff(field, prepend=field[0]), strict=True)):
        state = np.clip(state, u - width, u + width)
        rub += 0.8 * step - 2.0 * abs(step) * rub
        out[i] = 0.3 * u + 0.025 * state.sum() + 0.1 * rub + 0.01 * u * u
    return out


@cache
def clean(kind: str) -> tuple[float, Array, Array]:
    rate_Hz, field = drive(kind)
    noise = np.random.default_rng(len(kind)).normal(0.0, NOISE_m, len(field))
    return rate_Hz, field, STROKE_m * moved(field) + noise


def recording(kind: str, reading_m: Array | None = None, field: Array | None = None) -> Recording:
    rate_Hz, own, measured_m = clean(kind)
    values = {
        Quantity.VOLTAGE: 50.0 + 40.0 * (own if field is None else field),
        Quantity.DISPLACEMENT: measured_m if reading_m is None else reading_m,
    }
    channels = tuple(
        Channel(quantity=quantity, axis="x", values=signal, label=quantity.name)
        for quantity, signal in values.items()
    )
    return Recording(name=kind, digest="", axis="x", sampling_rate_Hz=rate_Hz, channels=channels)


def view_with(**readings_m: Array):
    kinds = ("sweep", "walk", "waves")
    recordings = [recording(kind, readings_m.get(kind)) for kind in kinds]
    return view_on(recordings, axis="x", lab=Lab())


@cache
def healthy():
    return view_with()


def slipped(reading_m: Array, at: int, samples: int) -> Array:
    """Return readings that come so many samples late from a place on, or early where negative."""
    place = np.arange(len(reading_m))
    source = np.where(place >= at, np.maximum(place - samples, at if samples > 0 else 0), place)
    return reading_m[np.minimum(source, len(reading_m) - 1)]


def within(fault, value: float) -> bool:
    return abs(fault.value - value) <= 1.96 * fault.spread


@pytest.mark.parametrize("effect", FAULTS, ids=[f.EFFECT.name for f in FAULTS])
def test_healthy_recordings_have_no_fault(effect):
    assert effect.EFFECT.fault(healthy()) is None


def test_no_hum_and_no_ripple_is_seen_in_healthy_recordings():
    for effect in (mains_interference.EFFECT, sensor_periodic_error.EFFECT):
        found = screen(effect, healthy())
        assert found is None or found.held.gain < 0.03


@pytest.mark.parametrize(("kind", "samples"), [("sweep", 4), ("walk", -3), ("waves", 60)])
def test_a_slip_is_found_sized_and_undone(kind, samples):
    view = view_with(**{kind: slipped(clean(kind)[2], 4100, samples)})
    fault = timestamp_fault.EFFECT.fault(view)
    assert fault is not None
    assert within(fault, samples)
    assert fault.p_value < 0.01
    again = with_tracks(view, fault.tracks)
    assert again.rms < min(1.6 * healthy().rms, 0.9 * view.rms)
    assert timestamp_fault.EFFECT.fault(again) is None


def test_two_recordings_may_slip_each_by_its_own():
    view = view_with(
        sweep=slipped(clean("sweep")[2], 3500, 5), walk=slipped(clean("walk")[2], 5000, -4)
    )
    fault = timestamp_fault.EFFECT.fault(view)
    again = with_tracks(view, fault.tracks)
    assert again.rms < 1.3 * healthy().rms
    assert fault.value in (5, -4)


def test_a_delay_of_all_of_a_recording_is_no_slip():
    view = view_with(sweep=slipped(clean("sweep")[2], 0, 4))
    assert timestamp_fault.EFFECT.fault(view) is None


def test_a_delay_that_only_fast_stretches_have_is_no_slip():
    # slow triangles first, fast ones after: a lag of the fast ones begins at one instant
    rate_Hz, field = 4000.0, np.empty(9000)
    time_s = np.arange(9000) / rate_Hz
    phase = np.where(time_s < 1.25, 1.6 * time_s, 2.0 + 20.0 * (time_s - 1.25))
    field = 2 / np.pi * np.arcsin(np.sin(2 * np.pi * (phase - 0.25)))
    whole_m = STROKE_m * moved(field)
    late_m = np.where(time_s < 1.25, whole_m, slipped(whole_m, 5000, 1))
    late_m = late_m + np.random.default_rng(8).normal(0.0, NOISE_m, 9000)
    recordings = [recording("sweep"), recording("walk"), recording("waves", late_m, field)]
    view = view_on(recordings, axis="x", lab=Lab())
    null = beside(view)
    for slip in strongest(view, null):
        judged = judged_of(view, null, replace(slip, samples=round(slip.samples) or 1))
        assert judged is None or not judged.equal or not judged.speaks(again=False)


def test_spikes_are_found_sized_and_bridged():
    reading_m = np.array(clean("walk")[2])
    reading_m[[1200, 4000, 7311]] += np.array([0.012, -0.02, 0.009]) * STROKE_m
    reading_m[5000:5002] -= 0.015 * STROKE_m
    view = view_with(walk=reading_m)
    fault = outliers.EFFECT.fault(view)
    assert within(fault, 1e9 * 0.02 * STROKE_m)
    assert fault.p_value < 1e-3
    left = fault.tracks[1].response - healthy().tracks[1].response
    assert np.abs(left - np.median(left)).max() < 0.02


def test_a_jump_of_the_drive_is_no_spike():
    field = np.array(clean("walk")[1])
    field[3000:3002] += 0.05
    reading_m = STROKE_m * moved(field) + np.random.default_rng(3).normal(0.0, NOISE_m, 9000)
    recordings = [recording("sweep"), recording("walk", reading_m, field), recording("waves")]
    assert outliers.EFFECT.fault(view_on(recordings, axis="x", lab=Lab())) is None


def coarse_reading(step_m: float):
    readings_m = {kind: clean(kind)[2] for kind in ("sweep", "walk", "waves")}
    return view_with(**{kind: step_m * np.round(y / step_m) for kind, y in readings_m.items()})


def test_a_coarse_reading_is_named_with_its_step_and_its_saw_is_no_periodic_error():
    step_m = 4e-3 * STROKE_m
    view = coarse_reading(step_m)
    assert within(quantisation.EFFECT.fault(view), 1e9 * step_m)
    ripple = screen(sensor_periodic_error.EFFECT, view)
    assert ripple is None or ripple.held.gain < 0.05


def test_a_converter_of_sixteen_bits_is_not_coarse():
    assert quantisation.EFFECT.fault(coarse_reading(1.3 * STROKE_m / 2**16)) is None


def test_a_coarse_drive_is_found_where_the_file_has_the_smooth_one():
    step = 0.02
    noise = np.random.default_rng(4).normal(0.0, NOISE_m, 9000)
    readings_m = {
        kind: STROKE_m * moved(step * np.round(clean(kind)[1] / step)) + noise
        for kind in ("sweep", "walk", "waves")
    }
    view = view_with(**readings_m)
    fault = quantisation.EFFECT.fault(view)
    slope_m = float(np.ptp(clean("sweep")[2])) / 2.0
    assert fault.value == pytest.approx(1e9 * step * slope_m, rel=0.4)
    assert with_tracks(view, fault.tracks).rms < 0.8 * view.rms
    assert outliers.EFFECT.fault(view) is None


def test_hum_a_little_off_its_nominal_frequency_is_found_at_its_own():
    readings_m = {}
    for kind in ("sweep", "walk", "waves"):
        rate_Hz, _, y = clean(kind)
        turn = 2 * np.pi * 49.91 * np.arange(len(y)) / rate_Hz
        readings_m[kind] = y + 2e-3 * STROKE_m * (0.4 * np.sin(turn) + np.sin(3 * turn + 1.0))
    found = screen(mains_interference.EFFECT, view_with(**readings_m))
    assert found.trial.parameters["frequency_Hz"] == pytest.approx(49.91, abs=0.05)
    assert found.held.gain > 0.1


def test_a_fine_ripple_is_found_though_every_recording_counts_from_its_own_zero():
    period_m, rng = 316e-9, np.random.default_rng(6)
    readings_m = {
        kind: (y := clean(kind)[2])
        + 2e-3 * STROKE_m * np.sin(2 * np.pi * y / period_m + rng.uniform(0.0, 6.0))
        for kind in ("sweep", "walk", "waves")
    }
    view = view_with(**readings_m)
    found = screen(sensor_periodic_error.EFFECT, view)
    periods = 2.0 * view.stroke_m / period_m
    assert found.trial.parameters["periods"] == pytest.approx(periods, rel=0.01)
    assert found.held.gain > 0.2
    size = sensor_periodic_error.EFFECT.size
    amplitude_nm = size(view, found.trial.parameters, found.held.coefficient)
    assert amplitude_nm == pytest.approx(1e9 * 2e-3 * STROKE_m, rel=0.25)


def test_what_is_larger_than_a_fault_that_could_hide_is_found():
    height = 1.3 * outliers.EFFECT.bound(healthy())
    reading_m = np.array(clean("walk")[2])
    reading_m[4000] += height * 2.0 * healthy().stroke_m
    assert outliers.EFFECT.fault(view_with(walk=reading_m)) is not None
    step = 1.3 * np.sqrt(12.0) * quantisation.EFFECT.bound(healthy())
    assert quantisation.EFFECT.fault(coarse_reading(step * 2.0 * healthy().stroke_m)) is not None


def test_a_slip_well_above_one_that_could_hide_is_found():
    share = timestamp_fault.EFFECT.bound(healthy())
    late_m = [slipped(clean("waves")[2], 4100, n) - clean("waves")[2] for n in range(1, 60)]
    rms = np.array([np.sqrt(np.mean(change_m**2)) for change_m in late_m])
    samples = 1 + int(np.argmax(rms > 1.5 * share * 2.0 * healthy().stroke_m))
    view = view_with(waves=slipped(clean("waves")[2], 4100, samples))
    assert within(timestamp_fault.EFFECT.fault(view), samples)


def test_a_fault_found_in_several_goes_has_the_larger_size_and_the_surer_p():
    first = Fault(tracks=healthy().tracks, value=-5.0, spread=0.5, p_value=0.01)
    second = Fault(tracks=(), value=2.0, spread=0.1, p_value=0.001)
    both = second.after(first)
    assert (both.value, both.spread, both.p_value) == (-5.0, 0.5, 0.001)
    assert both.tracks == ()


def test_what_the_stamps_tell_is_a_timestamp_fault_of_so_many_samples():
    whole = recording("sweep")
    problems = (
        Problem(kind="gap", place="line 5", text="", samples=40),
        Problem(kind="duplicate_time", place="line 9", text="", samples=3),
        Problem(kind="jitter", place="the time column", text=""),
    )
    slip = Fault(tracks=healthy().tracks, value=-5.0, spread=0.4, p_value=0.001)
    found = Outcome(
        first=healthy(),
        clean=healthy(),
        final=healthy(),
        faults={"timestamp_fault": slip},
        causes=(),
        rivals={},
        screened={},
    )
    assert with_stamps(found, [whole]) is found
    told = [whole, replace(whole, name="b", problems=problems)]
    fault = with_stamps(found, told).faults["timestamp_fault"]
    assert fault.value == 48.0
    assert fault.p_value < 1e-6
    assert with_stamps(replace(found, faults={}), told).faults["timestamp_fault"].value == 43.0


def test_bridged_samples_are_neither_compared_nor_steps_of_a_converter():
    step_m = 4e-3 * STROKE_m
    reading_m = step_m * np.round(clean("sweep")[2] / step_m)
    lost = np.arange(50, 8950, 67)
    reading_m[lost] = (reading_m[lost - 1] + reading_m[lost + 1]) / 2
    view = view_on(
        [replace(recording("sweep", reading_m), bridged=tuple(lost.tolist()))],
        axis="x",
        lab=Lab(),
    )
    assert not np.isin(view.tracks[0].place, lost).any()
    assert within(quantisation.EFFECT.fault(view), 1e9 * step_m)
