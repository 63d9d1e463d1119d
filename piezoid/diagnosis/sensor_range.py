"""Detect the end of the sensor range: the reading is constant while the stage moves on.

    y = min(x, L)   or   y = max(x, L)

A limit of the amplifier causes a plateau as well, but with equal drives at its start and end; at a
limit of the sensor the loop is open there. The hysteresis is therefore fitted without the readings
on the plateau, and predicts the displacement there.

Source: Tobin (1958) on censored readings.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.coordinate_bases import Signals
from piezoid.diagnosis.refitted_view import SelectedEffect, with_effects
from piezoid.diagnosis.residual_view import View, with_tracks
from piezoid.diagnosis.segments import Track

PLATEAU_WIDTH = 5.0  # noise standard deviations on either side of the plateau's median
MIN_ROWS = 20  # on the plateau, of one recording
MIN_EXCESS = 8.0  # noise standard deviations of the predicted displacement beyond the plateau
MIN_DRIVE_RANGE = 20.0  # of noise, in half ranges; at a turning point it is 2 * PLATEAU_WIDTH
MAX_SHARE = 0.4  # of the rows


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorRangeEnd:
    """An end of the range of the sensor.

    error  (samples,) of every track: reading minus predicted displacement
    level  reading at the end, in half strokes from 0 of the static response
    side   1 at the top, -1 at the bottom
    """

    error: Signals
    level: float
    side: int


def find_sensor_range_end(view: View, effects: Sequence[SelectedEffect]) -> SensorRangeEnd | None:
    """Return the end of the sensor range with the largest missing motion, or None.

    effects  selected effects other than a limit of the amplifier
    """
    candidates = [_end_on_side(view, effects, side) for side in (1, -1)]
    return max(
        (end for end in candidates if end is not None),
        key=lambda end: float(sum(np.sum(error**2) for error in end.error)),
        default=None,
    )


def _end_on_side(
    view: View, effects: Sequence[SelectedEffect], side: int
) -> SensorRangeEnd | None:
    on_plateau = [
        side * track.response > _plateau_start(track, side, view.noise) for track in view.tracks
    ]
    rows = [is_on[track.rows] for is_on, track in zip(on_plateau, view.tracks, strict=True)]
    count = sum(int(is_on.sum()) for is_on in rows)
    if not 0 < count < MAX_SHARE * sum(map(len, rows)):
        return None
    tracks = tuple(
        replace(track, rows=track.rows[~is_on], block=track.block[~is_on])
        for track, is_on in zip(view.tracks, rows, strict=True)
    )
    fitted = with_effects(with_tracks(view, tracks), effects)
    errors, levels = [], []
    for k, (track, is_on) in enumerate(zip(view.tracks, on_plateau, strict=True)):
        error = np.zeros(len(track.response))
        if is_on.any():
            offset, level = _offset(fitted, k), float(np.median(track.response[is_on]))
            displacement = fitted.static[k] + offset
            excess = np.where(is_on, side * np.minimum(side * (level - displacement), 0.0), 0.0)
            if float(np.abs(excess).max()) > MIN_EXCESS * view.noise:
                error = excess
                levels.append(level - offset)
        errors.append(error)
    if not levels:
        return None
    return SensorRangeEnd(error=tuple(errors), level=float(np.median(levels)), side=side)


def _plateau_start(track: Track, side: int, noise: float) -> float:
    """Return the reading, times its side, at which a plateau starts; infinite without one.

    The drive must move while the reading does not: at constant drive the stage rests as well.
    """
    readings = side * track.response
    top = float(np.quantile(readings, 1.0 - 20.0 / max(len(readings), 200)))
    is_near = readings > top - PLATEAU_WIDTH * noise
    if (
        int(np.sum(is_near[track.rows])) < MIN_ROWS
        or np.ptp(readings[is_near]) > 2.0 * PLATEAU_WIDTH * noise
        or np.ptp(track.drive[is_near]) < MIN_DRIVE_RANGE * noise
    ):
        return np.inf
    return float(np.median(readings[is_near])) - PLATEAU_WIDTH * noise


def _offset(view: View, k: int) -> float:
    """Return the fitted constant of one track."""
    nuisance = view.nuisance
    return float(view.null.coefficients[nuisance.shared + nuisance.columns_per_track * k])
