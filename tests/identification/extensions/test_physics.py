"""Extensions obey their physical laws."""

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
    ringing = mode.response(np.sin(2 * np.pi * 40.0 * time_s), where(8000))
    # The gain at resonance is Q; eight time constants Q / (pi f) have passed.
    assert np.abs(ringing[-200:]).max() == pytest.approx(25.0, rel=0.01)
    half = LinearMode(frequency_Hz=40.0, quality=25.0, participation=0.5)
    sine = np.sin(2 * np.pi * 40.0 * time_s)
    np.testing.assert_allclose(half.response(sine, where(8000)), (sine + ringing) / 2)


def test_rate_dependence_is_a_pole_for_small_lags_and_logarithmic_for_large_ones():
    ramp_m, speed, time_s = np.linspace(0.0, 8e-6, 8000), 1e-6, 0.02
    linear = RateDependence(time_s=time_s).irreversible(ramp_m, RATE_Hz)
    assert ramp_m[-1] - linear[-1] == pytest.approx(time_s * speed, rel=1e-3)
    for strain_m in (1e-5, 1e-8):
        nonlinear = RateDependence(time_s=time_s, strain_m=strain_m).irreversible(ramp_m, RATE_Hz)
        # dx/dt = speed at a lag of s asinh(speed tau / s)
        lag_m = strain_m * np.arcsinh(time_s * speed / strain_m)
        assert ramp_m[4000] - nonlinear[4000] == pytest.approx(lag_m, rel=0.06)
    assert lag_m < 0.8 * time_s * speed


def test_drift_begins_at_zero_and_belongs_to_its_piece():
    pieces = [where(6000), where(6000, "b.csv"), where(100, "short.csv")]
    drift = ThermalDrift.of(pieces)
    assert [curve.recording for curve in drift.curves] == ["sweep.csv", "b.csv"]
    count = len(drift.free().value)
    drifting = drift.moved_to(np.r_[np.full(count // 2, 1e-7), np.zeros(count // 2)])
    first_m = np.asarray(drifting.added(where(6000)))
    assert first_m[0] == 0.0
    assert first_m[-1] == pytest.approx(1e-7)
    assert np.abs(np.diff(first_m, 2)).max() < 1e-12
    assert not np.any(drifting.added(where(6000, "b.csv")))
    assert drifting.added(where(100, "short.csv")) == 0.0


def test_mains_lines_alias_and_ambiguous_harmonics_are_omitted():
    slow_piece = Where(recording="slow", rate_Hz=100.0, samples=400)
    lines = MainsLines.of([slow_piece, where(4000)], 50.0, harmonics=(1, 3))
    assert [hum.harmonic for hum in lines.hums] == [(1,), (1, 3)]
    loud_lines = lines.moved_to(np.full(len(lines.free().value), 1e-8))
    hum_m = np.asarray(loud_lines.added(where(4000)))
    spectrum = np.abs(np.fft.rfft(hum_m))
    peaks_Hz = np.fft.rfftfreq(4000, 1e-3)[np.argsort(spectrum)[-2:]]
    assert sorted(peaks_Hz.tolist()) == pytest.approx([50.0, 150.0])
    assert spectrum.max() / 2000 == pytest.approx(np.sqrt(2.0) * 1e-8)
    american = MainsLines.of([slow_piece], 60.0, harmonics=(1,))
    hum_m = np.asarray(
        american.moved_to(np.full(len(american.free().value), 1e-8)).added(slow_piece)
    )
    assert np.argmax(np.abs(np.fft.rfft(hum_m))) * 100.0 / 400 == pytest.approx(40.0)


def test_uniform_creep_has_one_parameter():
    even = CreepLadder(time_s=(0.1, 1.0, 10.0), share=(0.01,) * 3, even=True)
    assert len(even.free().value) == 1
    assert even.moved_to(np.array([0.02])).share == (0.02,) * 3
    assert even.moved_to(np.array([0.02])).prior().shape == (0, 1)
    assert from_json(CreepLadder, to_json(even)) == even
    with pytest.raises(ValueError, match="expected equal"):
        replace(even, share=(0.01, 0.02, 0.01))


def test_a_gain_change_acts_from_its_instant_on_and_steps_the_zero_once():
    piece = where()
    name, instant_s = piece.recording, float(piece.time_s[piece.samples // 2])
    change = GainChange(
        recording=name, instant_s=instant_s, ratio=1.5, offset_m=3e-9, later=("after",)
    )
    is_later = piece.time_s >= instant_s
    displacement_m = 1e-6 * np.sin(piece.time_s)
    np.testing.assert_allclose(
        change.response(displacement_m, piece), displacement_m * np.where(is_later, 1.5, 1.0)
    )
    np.testing.assert_allclose(change.added(piece), np.where(is_later, 3e-9, 0.0))
    for recording, ratio in (("after", 1.5), ("before", 1.0)):
        other_piece = replace(piece, recording=recording)
        np.testing.assert_allclose(
            change.response(displacement_m, other_piece), ratio * displacement_m
        )
        assert change.added(other_piece) == 0.0


STAIRS = np.repeat([0.0, 0.8, -0.4, -0.4, 0.5], 100)  # steps before samples 100, 200 and 400


def test_rows_after_steps_are_excluded_where_samples_do_not_resolve_the_mode():
    mode = LinearMode(frequency_Hz=495.0, quality=5.0)  # time constant of 1.6 samples at 500 Hz
    rows = rows_after_steps(STAIRS, 500.0, (mode,), min_rows=2)
    np.testing.assert_array_equal(rows, [k + n for k in (100, 200, 400) for n in range(13)])
    assert not len(rows_after_steps(STAIRS, 20_000.0, (mode,)))  # resolved
    resolved_rows = rows_after_steps(STAIRS, 20_000.0, (mode,), min_rows=2)
    np.testing.assert_array_equal(resolved_rows, [100, 101, 200, 201, 400, 401])
    sine = np.sin(np.linspace(0.0, 9.0, 500))
    assert not len(rows_after_steps(sine, 500.0, (mode,), min_rows=2))


def test_creep_of_values_between_some_times_is_that_of_every_sample():
    """A signal that is linear between irregular times has the same creep at these times."""
    creep = CreepLadder(time_s=(0.01, 0.3, 20.0), share=(0.02, 0.03, 0.01))
    rng = np.random.default_rng(0)
    samples = np.unique([0, 2999, *rng.integers(0, 3000, 400)])
    values = rng.standard_normal((len(samples), 2)).cumsum(axis=0)
    signal = np.stack([np.interp(np.arange(3000), samples, column) for column in values.T]).T
    response = creep.response(signal, Where(recording="a", rate_Hz=1000.0))
    slow = creep.slow_response(values, samples / 1000.0)
    np.testing.assert_allclose(slow, response[samples], rtol=0.0, atol=1e-12)
