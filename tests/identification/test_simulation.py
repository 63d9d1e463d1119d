"""Simulation of a whole recording, piece by piece, each from its initial state."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.errors import IdentificationError
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig, where_of
from piezoid.identification.simulation import (
    simulate_fitted_rows,
    simulate_recording,
    zero_of,
)
from piezoid.records.recording import Quantity
from tests.reports.known_stage import BREAK, axis_model, recording, starts

ROUNDING_m = 1e-17


def test_a_recording_without_noise_is_reproduced_to_rounding():
    exact = recording(noise_m=0.0)
    simulated_m = simulate_recording(axis_model(), exact)
    np.testing.assert_allclose(simulated_m, exact.displacement_m(), atol=ROUNDING_m, rtol=1e-14)


def test_pieces_too_short_to_fit_are_nan():
    uninterrupted = recording(noise_m=0.0)
    interrupted = replace(uninterrupted, breaks=(BREAK, 2 * BREAK - 5))
    simulated_m = simulate_recording(axis_model(), interrupted)
    assert np.isnan(simulated_m[-5:]).all()
    assert np.isfinite(simulated_m[:-5]).all()


def test_rows_excluded_from_the_fit_are_nan():
    exact, model = recording(noise_m=0.0), axis_model()
    second = starts(exact.name)[1]
    partly_fitted = replace(model, starts=(starts(exact.name)[0], replace(second, first=100)))
    fitted_m, simulated_m = (
        simulate_fitted_rows(partly_fitted, exact),
        simulate_recording(partly_fitted, exact),
    )
    is_left_out = np.isnan(fitted_m)
    assert is_left_out[BREAK : BREAK + 100].all()
    assert not is_left_out[BREAK + 100 : BREAK + second.last].any()
    np.testing.assert_array_equal(fitted_m[~is_left_out], simulated_m[~is_left_out])


def test_rows_in_which_a_mode_rings_after_a_step_of_the_drive_are_nan():
    exact = recording(noise_m=0.0)
    jump, frequency_Hz, quality = BREAK // 2, 0.2 * exact.sampling_rate_Hz, 5.0
    voltage_V = exact.voltage_V("x").copy()
    voltage_V[jump:] = voltage_V[jump] - 0.5 * np.ptp(voltage_V)
    channels = tuple(
        replace(c, values=voltage_V) if c.quantity is Quantity.VOLTAGE else c
        for c in exact.channels
    )
    ringing = replace(exact, channels=channels)
    mode = LinearMode(frequency_Hz=frequency_Hz, quality=quality)
    is_left_out = np.isnan(
        simulate_fitted_rows(replace(axis_model(), extensions=(mode,)), ringing)
    )
    decay_samples = quality / (np.pi * frequency_Hz) * exact.sampling_rate_Hz
    assert is_left_out[jump : jump + round(5.0 * decay_samples)].all()
    assert not is_left_out[jump + round(12.0 * decay_samples) : BREAK].any()
    assert not np.isnan(simulate_fitted_rows(axis_model(), ringing))[jump:BREAK].any()


def test_the_zero_is_constant_outside_the_fitted_rows():
    start = replace(starts("a.csv")[0], first=100, last=301, zero_m=np.array([1e-6, 3e-6]))
    zero_m = zero_of(start, 400)
    assert (zero_m[:101] == 1e-6).all()
    assert (zero_m[300:] == 3e-6).all()
    assert zero_m[200] == pytest.approx(2e-6)


def test_a_recording_unknown_to_the_model_is_refused_by_name():
    with pytest.raises(IdentificationError, match=r"other\.csv: 2 uninterrupted pieces"):
        simulate_recording(axis_model(), recording("other.csv"))
    assert axis_model().starts_of(recording("other.csv")) == ()


def test_a_simulated_fitted_recording_has_the_residual_of_the_fit():
    fitted_recording = recording()
    model = estimate_axis((fitted_recording,), "x", Rig(), orders=((2, 2),))
    residual_m = fitted_recording.displacement_m() - simulate_recording(model, fitted_recording)
    fitted_residual_m = np.concatenate(
        [
            residual_m[piece.start + start.first : piece.start + start.last]
            for piece, start in zip(fitted_recording.pieces, model.starts, strict=True)
        ]
    )
    # The fit reports the rms of the fitted rows.
    rms_m = float(np.sqrt(np.mean(fitted_residual_m**2)))
    assert rms_m == pytest.approx(model.quality.rms_m, rel=1e-6)


def test_an_extension_receives_only_the_other_axes_that_move():
    single_axis = recording()
    drive = next(c for c in single_axis.channels if c.quantity is Quantity.VOLTAGE)
    constant = replace(drive, axis="y", label="y", values=np.full(single_axis.samples, 3.0))
    moving = replace(drive, axis="z", label="z", values=np.arange(float(single_axis.samples)))
    three_axes = replace(single_axis, channels=(*single_axis.channels, constant, moving))
    where = where_of(three_axes, "x", slice(5, 9))
    assert (where.first, where.samples) == (5, 4)
    assert list(where.others_V) == ["z"]
    np.testing.assert_array_equal(where.others_V["z"], [5.0, 6.0, 7.0, 8.0])
