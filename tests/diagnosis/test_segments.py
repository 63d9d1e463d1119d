"""Tracks: rows behind declared poles, and the staircase of a converter behind these poles."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from piezoid.diagnosis.segments import staircase_response, tracks_of
from piezoid.identification.hysteresis.pieces import Rig, behind_pole, scales_of
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import recorded, view_of_recordings
from .play_stage import STROKE_m, drive, moved, recording

POLE_Hz, CUT = 100.0, 700
RATE_Hz = 20e3


@pytest.mark.parametrize("pole_Hz", [POLE_Hz, None])
def test_no_row_is_where_a_declared_pole_still_thinks_that_the_drive_rested(pole_Hz):
    """The recording begins in the midst of waves."""
    rate_Hz, field = drive("waves")
    shown = behind_pole(field, POLE_Hz, rate_Hz)[CUT:]
    whole = recording("waves", STROKE_m * behind_pole(moved(field), POLE_Hz, rate_Hz), field)
    late = replace(
        whole, channels=tuple(replace(c, values=c.values[CUT:]) for c in whole.channels)
    )
    (track,) = tracks_of([late], "x", scales_of([late], "x"), Rig(sensor_bandwidth_Hz=pole_Hz))
    if pole_Hz is None:
        assert track.rows[0] == 0
        return
    scale = np.polyfit(track.drive[2000:], shown[2000:], 1)
    missed = np.abs(np.polyval(scale, track.drive) - shown)
    assert missed.max() > 0.015 * np.ptp(shown)
    assert missed[track.rows].max() < 1e-3 * np.ptp(shown)


@pytest.mark.parametrize(
    ("poles_Hz", "error"), [((4e3,), 1e-12), ((8.5e3, 300.0), 1e-12), ((2e3, 2e3), 1e-3)]
)
def test_a_held_command_comes_out_as_a_state_space_of_the_same_poles_has_it(poles_Hz, error):
    command = np.random.default_rng(3).uniform(-1.0, 1.0, 400)
    denominator = np.array([1.0])
    for pole_Hz in poles_Hz:
        denominator = np.polymul(denominator, [1.0 / (2.0 * np.pi * pole_Hz), 1.0])
    numerator, denominator, _ = cont2discrete(([1.0], denominator), 1.0 / RATE_Hz, method="zoh")
    expected = lfilter(numerator[0], denominator, command - command[0]) + command[0]
    assert np.allclose(staircase_response(command, poles_Hz, RATE_Hz), expected, atol=error)
    held = staircase_response(command, (None, None), RATE_Hz)
    np.testing.assert_array_equal(held[1:], command[:-1])  # the hold of one sample


def test_a_fast_chirp_of_a_healthy_stage_leaves_the_noise():
    view = view_of_recordings(*recorded(draw_campaign(70055, plans=("sweep", "chirp"))))
    chirp = view.null.residual[slice(*view.nuisance.edges[1:3])]
    assert np.std(chirp) < 1.25 * view.noise
