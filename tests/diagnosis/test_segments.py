"""Tracks exclude transients of declared poles and pass a held command through these poles."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from piezoid.diagnosis.segments import staircase_response, tracks_of
from piezoid.identification.hysteresis.pieces import Rig, behind_pole, scales_of
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import read_campaign, view_of_recordings
from .play_stage import STROKE_m, drive, recording, stroke_fraction

POLE_Hz, CUT = 100.0, 700
RATE_Hz = 20e3


@pytest.mark.parametrize("pole_Hz", [POLE_Hz, None])
def test_rows_exclude_the_transient_of_a_declared_pole(pole_Hz):
    """The recording begins within the waves."""
    rate_Hz, field = drive("waves")
    expected = behind_pole(field, POLE_Hz, rate_Hz)[CUT:]
    recorded_waves = recording(
        "waves", STROKE_m * behind_pole(stroke_fraction(field), POLE_Hz, rate_Hz), field
    )
    truncated = replace(
        recorded_waves,
        channels=tuple(replace(c, values=c.values[CUT:]) for c in recorded_waves.channels),
    )
    (track,) = tracks_of(
        [truncated], "x", scales_of([truncated], "x"), Rig(sensor_bandwidth_Hz=pole_Hz)
    )
    if pole_Hz is None:
        assert track.rows[0] == 0
        return
    scale = np.polyfit(track.drive[2000:], expected[2000:], 1)
    error = np.abs(np.polyval(scale, track.drive) - expected)
    assert error.max() > 0.015 * np.ptp(expected)
    assert error[track.rows].max() < 1e-3 * np.ptp(expected)


@pytest.mark.parametrize(
    ("poles_Hz", "error"), [((4e3,), 1e-12), ((8.5e3, 300.0), 1e-12), ((2e3, 2e3), 1e-3)]
)
def test_the_response_to_a_held_command_agrees_with_the_state_space_model(poles_Hz, error):
    command = np.random.default_rng(3).uniform(-1.0, 1.0, 400)
    denominator = np.array([1.0])
    for pole_Hz in poles_Hz:
        denominator = np.polymul(denominator, [1.0 / (2.0 * np.pi * pole_Hz), 1.0])
    numerator, denominator, _ = cont2discrete(([1.0], denominator), 1.0 / RATE_Hz, method="zoh")
    expected = lfilter(numerator[0], denominator, command - command[0]) + command[0]
    assert np.allclose(staircase_response(command, poles_Hz, RATE_Hz), expected, atol=error)
    held_command = staircase_response(command, (None, None), RATE_Hz)
    np.testing.assert_array_equal(held_command[1:], command[:-1])  # hold of one sample


def test_a_fast_chirp_of_a_healthy_stage_leaves_the_noise_only():
    view = view_of_recordings(*read_campaign(draw_campaign(70055, plans=("sweep", "chirp"))))
    chirp = view.null.residual[slice(*view.nuisance.edges[1:3])]
    assert np.std(chirp) < 1.25 * view.noise
