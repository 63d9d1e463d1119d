"""Each extension against a law it must obey."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.extensions import (
    CreepLadder,
    GainChange,
    LinearMode,
    MainsLines,
    RateDependence,
    ThermalDrift,
)
from piezoid.identification.extensions.extension import Where
from piezoid.identification.extensions.linear_mode import rows_after_steps
from piezoid.record_json import from_json, to_json
from tests.identification.extensions.samples import RATE_Hz, where


def test_a_mode_rings_at_its_frequency_with_its_quality():
    mode = LinearMode(frequency_Hz=40.0, quality=25.0)
    time_s = where(8000).time_s
    rung = mode.response(np.sin(2 * np.pi * 40.0 * time_s), where(8000))
    # At resonance all passes through with gain Q; eight time constants Q / (pi f) have gone by.
    assert np.abs(rung[-200:]).max() == pytest.approx(25.0, rel=0.01)
    half = LinearMode(frequency_Hz=40.0, quality=25.0, participation=0.5)
    plain = np.sin(2 * np.pi * 40.0 * time_s)
    np.testing.assert_allclose(half.response(plain, where(8000)), (plain + rung) / 2)


def test_small_lags_of_the_walls_are_a_pole_and_large_ones_grow_with_the_logarithm():
    ramp_m, speed, time_s = np.linspace(0.0, 8e-6, 8000), 1e-6, 0.02
    plain = RateDependence(time_s=time_s).irreversible(ramp_m, RATE_Hz)
    assert ramp_m[-1] - plain[-1] == pytest.approx(time_s * speed, rel=1e-3)
    for strain_m in (1e-5, 1e-8):
        slow = RateDependence(time_s=time_s, strain_m=strain_m).irreversible(ramp_m, RATE_Hz)
        # dx/dt = speed is reached at a lag of s asinh(speed tau / s)
        behind_m = strain_m * np.arcsinh(time_s * speed / strain_m)
        assert ramp_m[4000] - slow[4000] == pytest.approx(behind_m, rel=0.06)
    assert behind_m < 0.8 * time_s * speed


def test_drift_begins_at_nothing_and_belongs_to_its_own_piece():
    pieces = [where(6000), where(6000, "b.csv"), where(100, "short.csv")]
    drift = ThermalDrift.of(pieces)
    assert [curve.recording for curve in drift.curves] == ["sweep.csv", "b.csv"]
    count = len(drift.free().value)
    moved = drift.moved_to(np.r_[np.full(count // 2, 1e-7), np.zeros(count // 2)])
    first_m = np.asarray(moved.added(where(6000)))
    assert first_m[0] == 0.0
    assert first_m[-1] == pytest.approx(1e-7)
    assert np.abs(np.diff(first_m, 2)).max() < 1e-12
    assert not np.any(moved.added(where(6000, "b.csv")))
    assert moved.added(where(100, "short.csv")) == 0.0


def test_mains_lines_are_folded_and_left_out_where_two_would_be_one():
    slow = Where(recording="slow", rate_Hz=100.0, samples=400)
    lines = MainsLines.of([slow, where(4000)], 50.0, harmonics=(1, 3))
    assert [hum.harmonic for hum in lines.hums] == [(1,), (1, 3)]
    loud = lines.moved_to(np.full(len(lines.free().value), 1e-8))
    heard_m = np.asarray(loud.added(where(4000)))
    spectrum = np.abs(np.fft.rfft(heard_m))
    found_Hz = np.fft.rfftfreq(4000, 1e-3)[np.argsort(spectrum)[-2:]]
    assert sorted(found_Hz.tolist()) == pytest.approx([50.0, 150.0])
    assert spectrum.max() / 2000 == pytest.approx(np.sqrt(2.0) * 1e-8)
    american = MainsLines.of([slow], 60.0, harmonics=(1,))
    heard_m = np.asarray(american.moved_to(np.full(len(american.free().value), 1e-8)).added(slow))
    assert np.argmax(np.abs(np.fft.rfft(heard_m))) * 100.0 / 400 == pytest.approx(40.0)


def test_the_shares_of_even_creep_move_as_one_and_no_other_creep_is_even():
    even = CreepLadder(time_s=(0.1, 1.0, 10.0), share=(0.01,) * 3, even=True)
    assert len(even.free().value) == 1
    assert even.moved_to(np.array([0.02])).share == (0.02,) * 3
    assert even.moved_to(np.array([0.02])).prior().shape == (0, 1)
    assert from_json(CreepLadder, to_json(even)) == even
    with pytest.raises(ValueError, match="expected equal"):
        replace(even, share=(0.01, 0.02, 0.01))


def test_a_gain_that_changes_multiplies_from_its_instant_on_and_steps_its_zero_once():
    here = where()
    name, instant_s = here.recording, float(here.time_s[here.samples // 2])
    change = GainChange(
        recording=name, instant_s=instant_s, ratio=1.5, offset_m=3e-9, later=("after",)
    )
    late = here.time_s >= instant_s
    moved_m = 1e-6 * np.sin(here.time_s)
    np.testing.assert_allclose(change.response(moved_m, here), moved_m * np.where(late, 1.5, 1.0))
    np.testing.assert_allclose(change.added(here), np.where(late, 3e-9, 0.0))
    for other, ratio in (("after", 1.5), ("before", 1.0)):
        there = replace(here, recording=other)
        np.testing.assert_allclose(change.response(moved_m, there), ratio * moved_m)
        assert change.added(there) == 0.0


STAIRS = np.repeat([0.0, 0.8, -0.4, -0.4, 0.5], 100)  # steps in front of 100, 200 and 400


def test_a_mode_between_the_samples_hides_its_ringing_behind_every_step():
    mode = LinearMode(frequency_Hz=495.0, quality=5.0)  # a time constant is 1.6 samples of 500 Hz
    rows = rows_after_steps(STAIRS, 500.0, (mode,), min_rows=2)
    np.testing.assert_array_equal(rows, [k + n for k in (100, 200, 400) for n in range(13)])
    assert not len(rows_after_steps(STAIRS, 20_000.0, (mode,)))  # those samples resolve it
    least = rows_after_steps(STAIRS, 20_000.0, (mode,), min_rows=2)
    np.testing.assert_array_equal(least, [100, 101, 200, 201, 400, 401])
    sine = np.sin(np.linspace(0.0, 9.0, 500))
    assert not len(rows_after_steps(sine, 500.0, (mode,), min_rows=2))
