"""Tracks: a recording may begin while its drive is running already."""

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from piezoid.diagnosis.segments import tracks_of
from piezoid.identification.hysteresis.pieces import Rig, scales_of

from .play_stage import STROKE_m, drive, moved, recording

POLE_Hz, CUT = 100.0, 700


def behind_pole(signal: np.ndarray, rate_Hz: float) -> np.ndarray:
    """Return a signal behind the pole, straight between samples."""
    ratio = 2.0 * np.pi * POLE_Hz / rate_Hz
    pole = np.exp(-ratio)
    part = (1.0 - pole) / ratio
    return lfilter([1.0 - part, part - pole], [1.0, -pole], signal - signal[0]) + signal[0]


def begun_late():
    """Return waves whose recording begins in the midst of them, and the drive the sensor shows."""
    rate_Hz, field = drive("waves")
    read_m = STROKE_m * behind_pole(moved(field), rate_Hz)
    whole = recording("waves", read_m, field)
    channels = tuple(replace(c, values=c.values[CUT:]) for c in whole.channels)
    return replace(whole, channels=channels), behind_pole(field, rate_Hz)[CUT:]


def test_no_row_is_where_a_declared_pole_still_thinks_that_the_drive_rested() -> None:
    late, shown = begun_late()
    (track,) = tracks_of([late], "x", scales_of([late], "x"), Rig(sensor_bandwidth_Hz=POLE_Hz))
    scale = np.polyfit(track.drive[2000:], shown[2000:], 1)
    missed = np.abs(np.polyval(scale, track.drive) - shown)
    assert missed.max() > 0.015 * np.ptp(shown)
    assert missed[track.rows].max() < 1e-3 * np.ptp(shown)


def test_where_no_pole_is_declared_nothing_of_the_beginning_is_left_out() -> None:
    late, _ = begun_late()
    (track,) = tracks_of([late], "x", scales_of([late], "x"), Rig())
    assert track.rows[0] == 0
