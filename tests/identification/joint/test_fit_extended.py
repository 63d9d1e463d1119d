"""The joint fit finds what was put in, and judges it on what it did not see."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.extensions import (
    AmplifierLimits,
    CreepLadder,
    CrossAxis,
    Delay,
    FirstOrderLag,
    GainChange,
    LinearMode,
    MainsLines,
    PeriodicError,
    RateDependence,
    SlewLimit,
    ThermalDrift,
)
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.hysteresis.pieces import PieceStart
from piezoid.identification.joint.fit_extended import fit_extended
from piezoid.identification.joint.vector import Structure, parts_of
from piezoid.identification.quality import NEVER_OUT
from piezoid.identification.simulation import simulate_recording
from tests.identification.joint.stage import (
    MEMORY_V,
    NOISE_m,
    disturbed,
    known_model,
    recordings_of,
)

TIMES_s = (0.3, 3.0)
PIECES = [part.piece.where for part in parts_of(known_model(), recordings_of())]
ANSWER = CrossAxis(axis="y", centre_V=5.0, gain_m_per_V=2e-8, curvature_m_per_V_per_V=1e-9)
HUM = MainsLines.of(PIECES, 50.0, harmonics=(1,))
DRIFT = ThermalDrift.of(PIECES)

# What is put in, where the fit begins, and how close it must come, in parts of the truth.
CASES: tuple[tuple[Extension, Extension, float], ...] = (
    (
        CreepLadder(time_s=TIMES_s, share=(0.02, 0.03)),
        CreepLadder(time_s=TIMES_s, share=(0.005,) * 2),
        0.15,
    ),
    (Delay(delay_s=3e-4), Delay(delay_s=1e-4), 0.05),
    (FirstOrderLag(lag_s=1e-3), FirstOrderLag(lag_s=4e-4), 0.05),
    (
        LinearMode(frequency_Hz=150.0, quality=20.0, participation=0.5),
        LinearMode(frequency_Hz=153.0, quality=15.0, participation=0.3),
        0.15,
    ),
    (RateDependence(time_s=2e-3), RateDependence(time_s=1e-3), 0.15),
    (RateDependence(time_s=2e-2, strain_m=2e-8), RateDependence(time_s=1e-2, strain_m=1e-8), 0.15),
    (AmplifierLimits(high_V=9.6), AmplifierLimits(high_V=9.5), 0.005),
    (SlewLimit(limit_V_per_s=80.0), SlewLimit(limit_V_per_s=77.0), 0.02),
    (
        GainChange(recording="slow.csv", instant_s=12.0, ratio=1.02, later=("fast.csv",)),
        GainChange(recording="slow.csv", instant_s=12.0, ratio=1.01, later=("fast.csv",)),
        0.003,
    ),
    (ANSWER, ANSWER.moved_to(np.zeros(2)), 0.1),
    (
        PeriodicError(wavelength_m=1e-6, cosine_m=(2e-8,), sine_m=(1e-8,)),
        PeriodicError(wavelength_m=1.0005e-6, cosine_m=(0.0,), sine_m=(0.0,)),
        0.2,
    ),
    (DRIFT.moved_to(1e-7 * np.arange(1.0, 6.0)), DRIFT, 0.1),
    (HUM.moved_to(3e-8 * np.ones(len(HUM.free().value))), HUM, 0.2),
)


@pytest.mark.parametrize(
    ("true", "start", "within"), CASES, ids=lambda case: getattr(case, "kind", "")
)
def test_what_was_put_in_is_found_and_lowers_the_error_on_rows_left_out(true, start, within):
    recordings = recordings_of(true)
    bare = fit_extended(known_model(), recordings, structure=Structure(lag=False))
    found = fit_extended(known_model(), recordings, (start,))
    assert found.held_out_rms_m < 0.8 * bare.held_out_rms_m
    assert found.held_out_rms_m < 1.6 * NOISE_m
    expected, value = true.free().value, found.model.extensions[0].free().value
    assert np.abs(value - expected).max() <= within * np.abs(expected).max()


def test_the_model_that_comes_back_simulates_the_residual_the_fit_reports():
    true = (Delay(delay_s=3e-4), CreepLadder(time_s=TIMES_s, share=(0.02, 0.03)))
    recordings = recordings_of(*true)
    found = fit_extended(known_model(), recordings, true)
    parts = parts_of(known_model(), recordings)
    errors = [
        (simulate_recording(found.model, recording) - recording.displacement_m())[part.samples]
        for recording, part in zip(recordings, parts, strict=True)
    ]
    rms_m = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    assert rms_m == pytest.approx(found.rms_m, rel=1e-6)
    assert found.model.quality.held_out_rms_m == found.held_out_rms_m


def test_of_several_starts_the_closest_fit_is_taken_as_if_it_were_alone():
    true, near = Delay(delay_s=3e-4), known_model()
    plays = near.hysteresis.plays
    wide = replace(plays, threshold=1.5 * plays.threshold)
    far = replace(near, hysteresis=replace(near.hysteresis, plays=wide))
    held = Structure(lag=False)
    recordings, steps = recordings_of(true), 1
    alone = [fit_extended(m, recordings, structure=held, steps=steps) for m in (far, near)]
    found = fit_extended(far, recordings, further_starts=(near,), structure=held, steps=steps)
    best = min(alone, key=lambda fit: fit.rms_m)
    assert (found.rms_m, found.held_out_rms_m) == (best.rms_m, best.held_out_rms_m)
    assert found.rms_m < max(fit.rms_m for fit in alone)


def test_every_piece_of_an_interrupted_recording_begins_as_the_model_says():
    recording, _ = recordings_of()
    starts = [
        PieceStart(
            recording=recording.name,
            memory_V=MEMORY_V,
            zero_m=np.array([zero_m]),
            first=0,
            last=2500,
        )
        for zero_m in (1e-6, 2e-6)
    ]
    model = replace(known_model(), starts=tuple(starts))
    parts = parts_of(model, [replace(recording, breaks=(2500,))])
    assert [part.start for part in parts] == starts


def test_an_error_of_the_measurement_that_only_the_rows_left_out_hold_is_not_fitted_away():
    """A fold must not have seen its rows: a step in them stays in the error at full height."""
    recordings = recordings_of()
    part = parts_of(known_model(), recordings)[0]
    last = part.samples[part.fold == part.fold[-1]]
    rows = slice(int(last[last > 4000][0]), 5000)
    wrong = disturbed(recordings[0], rows, 1e-7)
    found = fit_extended(known_model(), (wrong, recordings[1]))
    count = sum(len(p.samples) for p in parts_of(known_model(), recordings))
    inside = np.count_nonzero((part.samples >= rows.start) & (part.fold != NEVER_OUT))
    expected_m = np.sqrt((inside * 1e-14 + count * NOISE_m**2) / len(found.held_m))
    assert found.held_out_rms_m > 0.8 * expected_m
    assert found.held_out_rms_m > 1.1 * found.rms_m


def test_nothing_is_found_where_nothing_is():
    recordings = recordings_of()
    bare = fit_extended(known_model(), recordings)
    for start in (Delay(delay_s=1e-4), CreepLadder(time_s=TIMES_s, share=(0.01, 0.01))):
        found = fit_extended(known_model(), recordings, (start,))
        assert found.held_out_rms_m == pytest.approx(bare.held_out_rms_m, rel=0.02)
        assert np.abs(found.model.extensions[0].free().value).max() < 2e-3


def test_a_memory_that_is_not_fitted_is_what_a_cycled_drive_leaves():
    found = fit_extended(known_model(), recordings_of(), structure=Structure(memory=False))
    plays = found.model.hysteresis.plays
    low_V, high_V = np.array(found.model.voltage_V) - found.model.hysteresis.voltage_offset_V
    way_V = np.array([0.0, low_V, high_V, -4.5])  # both recordings begin half a volt above
    _, cycled_V = plays.run(way_V, plays.virgin_memory())
    for start in found.model.starts:
        np.testing.assert_allclose(start.memory_V, cycled_V, atol=1e-9)


def test_recordings_the_model_does_not_know_are_fitted_from_rest():
    unknown = replace(known_model(), starts=())
    found = fit_extended(unknown, recordings_of())
    assert found.held_out_rms_m < 1.3 * NOISE_m
    assert {start.recording for start in found.model.starts} == {"slow.csv", "fast.csv"}


def test_an_extension_that_acts_in_one_fold_alone_leaves_the_held_out_error_as_it_is():
    recordings = recordings_of()
    changes = tuple(
        GainChange(recording="slow.csv", instant_s=share * recordings[0].duration_s, ratio=1.0)
        for share in (0.9, 0.901)
    )
    assert fit_extended(known_model(), recordings, changes).held_out_rms_m < 1.1 * NOISE_m
