"""The joint fit identifies simulated extensions and validates them on held-out rows."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.extended_fit import fit_extended, parts_of
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
from piezoid.identification.hysteresis.coordinates import Structure
from piezoid.identification.hysteresis.pieces import PieceStart
from piezoid.identification.quality import NEVER_OUT
from piezoid.identification.simulation import simulate_recording
from tests.identification.extended_stage import (
    MEMORY_V,
    NOISE_m,
    disturbed,
    known_model,
    recordings_of,
)

TIMES_s = (0.3, 3.0)
PIECES = [part.piece.where for part in parts_of(known_model(), recordings_of())]
COUPLING = CrossAxis(axis="y", centre_V=5.0, gain_m_per_V=2e-8, curvature_m_per_V_per_V=1e-9)
HUM = MainsLines.of(PIECES, 50.0, harmonics=(1,))
DRIFT = ThermalDrift.of(PIECES)

# Simulated extension, initial value, and tolerance relative to the largest parameter.
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
    (COUPLING, COUPLING.moved_to(np.zeros(2)), 0.1),
    (
        PeriodicError(wavelength_m=1e-6, cosine_m=(2e-8,), sine_m=(1e-8,)),
        PeriodicError(wavelength_m=1.0005e-6, cosine_m=(0.0,), sine_m=(0.0,)),
        0.2,
    ),
    (DRIFT.moved_to(1e-7 * np.arange(1.0, 6.0)), DRIFT, 0.1),
    (HUM.moved_to(3e-8 * np.ones(len(HUM.free().value))), HUM, 0.2),
)


@pytest.mark.parametrize(
    ("expected_extension", "initial", "tolerance"),
    CASES,
    ids=lambda case: getattr(case, "kind", ""),
)
def test_a_simulated_extension_is_identified_and_lowers_the_held_out_error(
    expected_extension, initial, tolerance
):
    recordings = recordings_of(expected_extension)
    baseline = fit_extended(known_model(), recordings, structure=Structure(lag=False))
    fit = fit_extended(known_model(), recordings, (initial,))
    assert fit.held_out_rms_m < 0.8 * baseline.held_out_rms_m
    assert fit.held_out_rms_m < 1.6 * NOISE_m
    expected, value = expected_extension.free().value, fit.model.extensions[0].free().value
    assert np.abs(value - expected).max() <= tolerance * np.abs(expected).max()


def test_the_fitted_model_has_the_residual_of_the_fit():
    extensions = (Delay(delay_s=3e-4), CreepLadder(time_s=TIMES_s, share=(0.02, 0.03)))
    recordings = recordings_of(*extensions)
    fit = fit_extended(known_model(), recordings, extensions)
    parts = parts_of(known_model(), recordings)
    errors = [
        (simulate_recording(fit.model, recording) - recording.displacement_m())[part.samples]
        for recording, part in zip(recordings, parts, strict=True)
    ]
    rms_m = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    assert rms_m == pytest.approx(fit.rms_m, rel=1e-6)
    assert fit.model.quality.held_out_rms_m == fit.held_out_rms_m


def test_the_closest_of_several_starts_gives_the_fit():
    delay, model = Delay(delay_s=3e-4), known_model()
    plays = model.hysteresis.plays
    wide = replace(plays, threshold=1.5 * plays.threshold)
    distant = replace(model, hysteresis=replace(model.hysteresis, plays=wide))
    structure = Structure(lag=False)
    recordings, steps = recordings_of(delay), 1
    single_fits = [
        fit_extended(m, recordings, structure=structure, steps=steps) for m in (distant, model)
    ]
    joint_fit = fit_extended(
        distant, recordings, further_starts=(model,), structure=structure, steps=steps
    )
    best_fit = min(single_fits, key=lambda fit: fit.rms_m)
    assert (joint_fit.rms_m, joint_fit.held_out_rms_m) == (best_fit.rms_m, best_fit.held_out_rms_m)
    assert joint_fit.rms_m < max(fit.rms_m for fit in single_fits)


def test_every_piece_has_the_initial_state_of_the_model():
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


def test_an_error_in_held_out_rows_is_not_fitted():
    """A step in the rows of one fold stays in the held-out error at its full height."""
    recordings = recordings_of()
    part = parts_of(known_model(), recordings)[0]
    last_fold_rows = part.samples[part.fold == part.fold[-1]]
    rows = slice(int(last_fold_rows[last_fold_rows > 4000][0]), 5000)
    disturbed_recording = disturbed(recordings[0], rows, 1e-7)
    fit = fit_extended(known_model(), (disturbed_recording, recordings[1]))
    count = sum(len(p.samples) for p in parts_of(known_model(), recordings))
    disturbed_count = np.count_nonzero((part.samples >= rows.start) & (part.fold != NEVER_OUT))
    expected_m = np.sqrt((disturbed_count * 1e-14 + count * NOISE_m**2) / len(fit.held_m))
    assert fit.held_out_rms_m > 0.8 * expected_m
    assert fit.held_out_rms_m > 1.1 * fit.rms_m


def test_extensions_without_effect_are_fitted_as_zero():
    recordings = recordings_of()
    baseline = fit_extended(known_model(), recordings)
    for start in (Delay(delay_s=1e-4), CreepLadder(time_s=TIMES_s, share=(0.01, 0.01))):
        fit = fit_extended(known_model(), recordings, (start,))
        assert fit.held_out_rms_m == pytest.approx(baseline.held_out_rms_m, rel=0.02)
        assert np.abs(fit.model.extensions[0].free().value).max() < 2e-3


def test_an_initial_state_that_is_not_fitted_is_that_of_a_cycled_drive():
    fit = fit_extended(known_model(), recordings_of(), structure=Structure(memory=False))
    plays = fit.model.hysteresis.plays
    low_V, high_V = np.array(fit.model.voltage_V) - fit.model.hysteresis.voltage_offset_V
    path_V = np.array([0.0, low_V, high_V, -4.5])  # both recordings begin half a volt above low_V
    _, cycled_V = plays.run(path_V, plays.virgin_memory())
    for start in fit.model.starts:
        np.testing.assert_allclose(start.memory_V, cycled_V, atol=1e-9)


def test_new_recordings_are_fitted_from_rest():
    unknown = replace(known_model(), starts=())
    fit = fit_extended(unknown, recordings_of())
    assert fit.held_out_rms_m < 1.3 * NOISE_m
    assert {start.recording for start in fit.model.starts} == {"slow.csv", "fast.csv"}


def test_an_extension_active_in_one_fold_does_not_change_the_held_out_error():
    recordings = recordings_of()
    changes = tuple(
        GainChange(recording="slow.csv", instant_s=share * recordings[0].duration_s, ratio=1.0)
        for share in (0.9, 0.901)
    )
    assert fit_extended(known_model(), recordings, changes).held_out_rms_m < 1.1 * NOISE_m
