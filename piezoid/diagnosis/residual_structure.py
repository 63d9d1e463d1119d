"""Structure of the residual that no effect of the catalogue explains, after a search for effects.

The structure is a curve along one coordinate, or an end of the sensor's range. A curve that
explains clearly more than a selected effect replaces it, because a wrong name is worse than none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.candidate import Outcome
from piezoid.diagnosis.coordinate_scores import (
    SURROGATES,
    CoordinateScore,
    Residual,
    fit_time_course,
    mains_frequency_Hz,
    score_coordinates,
)
from piezoid.diagnosis.diagnosis import Unexplained
from piezoid.diagnosis.null_distribution import rank_p_value, structure_p_value
from piezoid.diagnosis.refinement import SelectedEffect, with_effects
from piezoid.diagnosis.residual_coordinates import Signals, displacement_basis
from piezoid.diagnosis.residual_view import View, with_tracks
from piezoid.diagnosis.segments import Track
from piezoid.numerics.arrays import Array

PLATEAU_WIDTH = 5.0  # noise standard deviations on either side of the plateau's median
MIN_ROWS = 20  # on the plateau, of one recording
MIN_EXCESS = 8.0  # noise standard deviations of the predicted displacement beyond the plateau
MIN_DRIVE_RANGE = 20.0  # of noise, in half ranges; at a turning point it is 2 * PLATEAU_WIDTH
MAX_SHARE = 0.4  # of the rows
MAINS, AMPLIFIER_LIMIT = "mains_interference", "amplifier_saturation"
READING = "reading"
MAINS_COORDINATES = ("frequency", "line_phase")
MIN_NOISE_RATIO = 1.1  # residual/noise; below it a limit of the amplifier explains a plateau
MAX_P_VALUE = 0.02  # of one coordinate, by surrogates: the second of 99
MAX_HEALTHY_P_VALUE = 0.05  # of a residual as systematic in a healthy stage
MAX_CURVE_RATIO = 0.9  # largest error with a curve instead of an effect, over that with the effect
# Relative difference of a period of the reading and the step of a converter, if one causes the
# other: on one stage they were 443.9 and 443.3 nm
STEP_ERROR = 0.05


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

    A limit of the amplifier causes a plateau as well, but with equal drives at its start and end;
    at a limit of the sensor the loop is open there. The hysteresis is therefore fitted without the
    readings on the plateau, and predicts the displacement there [Tobin (1958), censored data].

        y = min(x, L)   or   y = max(x, L)

    effects  selected effects other than a limit of the amplifier
    """
    best, largest = None, -1.0
    for side in (1, -1):
        on_plateau = [
            side * track.response > _plateau_start(track, side, view.noise)
            for track in view.tracks
        ]
        rows = [is_on[track.rows] for is_on, track in zip(on_plateau, view.tracks, strict=True)]
        if not 0 < sum(int(is_on.sum()) for is_on in rows) < MAX_SHARE * sum(map(len, rows)):
            continue
        tracks = tuple(
            replace(track, rows=track.rows[~is_on], block=track.block[~is_on])
            for track, is_on in zip(view.tracks, rows, strict=True)
        )
        fitted = with_effects(with_tracks(view, tracks), effects)
        shared, per_track = fitted.nuisance.shared, fitted.nuisance.columns_per_track
        errors, levels = [], []
        for k, (track, is_on) in enumerate(zip(view.tracks, on_plateau, strict=True)):
            error = np.zeros(len(track.response))
            if is_on.any():
                offset = float(fitted.null.coefficients[shared + per_track * k])
                level = float(np.median(track.response[is_on]))
                distance = side * (level - (fitted.static[k] + offset))
                excess = np.where(is_on, side * np.minimum(distance, 0.0), 0.0)
                if float(np.abs(excess).max()) > MIN_EXCESS * view.noise:
                    error = excess
                    levels.append(level - offset)
            errors.append(error)
        power = float(sum(np.sum(error**2) for error in errors))
        if levels and power > largest:
            level, largest = float(np.median(levels)), power
            best = SensorRangeEnd(error=tuple(errors), level=level, side=side)
    return best


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


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualStructure:
    """Structure of the residual along one coordinate.

    score            of the curve
    curve            (samples,) of every track
    share            of the residual's power above the noise
    residual         (rows,)
    view             the view with this residual
    healthy_p_value  probability of a residual as systematic in a healthy stage
    range_end        end of the sensor's range, if the structure is one
    """

    score: CoordinateScore
    curve: Signals
    share: float
    residual: Array
    view: View
    healthy_p_value: float
    range_end: SensorRangeEnd | None = None

    @property
    def block_power(self) -> Array:
        """Return the residual power that the curve explains in each block, (blocks,)."""
        fitted = self.score.fitted
        power = (2.0 * self.residual - fitted) * fitted
        return np.asarray(np.add.reduceat(power, self.view.null.edges))

    @property
    def mean_power(self) -> float:
        """Return the residual power that the curve explains, averaged over the rows."""
        return max(float(self.block_power.sum()) / len(self.score.fitted), 0.0)

    def is_beyond_range(self, k: int) -> NDArray[np.bool_]:
        """Tell which samples of a track lie beyond the range of the sensor."""
        if self.range_end is None:
            return np.zeros(len(self.curve[k]), dtype=bool)
        return np.asarray(self.curve[k] != 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchResult:
    """Result of a search for effects, and the structure that was subtracted before it.

    raw                the view of the unrepaired recordings
    outcome            of the search; its first view is without the structure
    unexplained        residual of the named effects, before any structure is subtracted
    structure          None if the residual is not systematic along one coordinate
    without_structure  result of the search with nothing subtracted, if there is structure
    """

    raw: View
    outcome: Outcome
    unexplained: Unexplained
    structure: ResidualStructure | None = None
    without_structure: "SearchResult | None" = None


def locate_structure(outcome: Outcome) -> tuple[Unexplained, list[ResidualStructure]]:
    """Return the size of the residual, and the structure that may be subtracted from readings.

    An end of the sensor's range comes first, then a curve along one coordinate.
    """
    residual = Residual.of(outcome.final, _unselected_tangents(outcome, outcome.final))
    scores = score_coordinates(residual)
    curve = _structure_replacing_effect(outcome) or _first_significant(residual, scores, outcome)
    structures = (_sensor_range_structure(outcome), curve)
    return _unexplained(outcome, scores), [s for s in structures if s is not None]


def locate_residual(view: View, outcome: Outcome) -> SearchResult:
    """Locate the residual without naming it; used where the model class is rejected."""
    scores = score_coordinates(Residual.of(outcome.final))
    return SearchResult(raw=view, outcome=outcome, unexplained=_unexplained(outcome, scores))


def add_structure(view: View, structure: ResidualStructure) -> tuple[Track, ...]:
    """Return the tracks of a view with a subtracted structure and its rows restored."""
    tracks = []
    for k, (track, raw) in enumerate(zip(view.tracks, structure.view.tracks, strict=True)):
        unmeasured = raw.rows[structure.is_beyond_range(k)[raw.rows]]
        rows = np.union1d(track.rows, unmeasured)
        block = np.interp(rows, raw.rows, raw.block).astype(int)
        response = track.response + structure.curve[k]
        tracks.append(replace(track, response=response, rows=rows, block=block))
    return tuple(tracks)


def _unexplained(outcome: Outcome, scores: Sequence[CoordinateScore]) -> Unexplained:
    final, best = outcome.final, scores[0]
    significant_gain = max((s.gain for s in scores if s.p_value <= MAX_P_VALUE), default=0.0)
    power = _power_above_noise(final.rms**2, final.noise**2, min(significant_gain, 1.0))
    return Unexplained(
        rms_m=sqrt(power) * final.half_stroke_m,
        share=power / max(final.rms**2, 1e-300),
        p_value=structure_p_value(best.gain, final.rms, final.noise),
        coordinate=best.coordinate,
        gain=float(np.clip(best.gain, 0.0, 1.0)),
    )


def _power_above_noise(power: float, noise_power: float, gain: float) -> float:
    """Return the power above the noise, which is at most the unexplained power."""
    return max(power - min(noise_power, (1.0 - gain) * power), 0.0)


def _share(residual: Residual, gain: float) -> float:
    """Return the explained share of the power above the noise."""
    power = residual.null.rms**2
    above = _power_above_noise(power, residual.view.noise**2, gain)
    return float(np.clip(gain * power / max(above, 1e-300), 0.0, 1.0))


def _unselected_tangents(outcome: Outcome, view: View, selected: str = "") -> list[Array]:
    """Return the tangents of tested effects but one, at the rows of a view.

    A tangent that explains no more than its placebo is no explanation. With all tangents, a tone
    of 2.83 periods in a period of the drive was located by its frequency on one of nine stages,
    with these on all nine.
    """
    return [
        test.trial.columns
        for name, test in outcome.score_tests.items()
        if name != selected
        and len(test.trial.columns) == len(view.response)
        and (test.placebo is None or test.cv.gain > test.placebo.cv.gain)
    ]


def _structure_replacing_effect(outcome: Outcome) -> ResidualStructure | None:
    """Return a curve with a clearly smaller error than the effect it replaces."""
    best, smallest_ratio = None, MAX_CURVE_RATIO
    for cause in outcome.causes:
        if cause.effect.structural is not None or cause.selected.from_jumps:
            continue
        tangents = _unselected_tangents(outcome, cause.without, cause.effect.name)
        residual = Residual.of(cause.without, tangents)
        structure = _first_significant(residual, score_coordinates(residual), outcome)
        if structure is None:
            continue
        rms = residual.null.rms * sqrt(max(1.0 - structure.score.gain, 0.0))
        if rms / cause.cv.rms < smallest_ratio:
            best, smallest_ratio = structure, rms / cause.cv.rms
    return best


def _first_significant(
    residual: Residual, scores: Sequence[CoordinateScore], outcome: Outcome
) -> ResidualStructure | None:
    """Return the structure with the largest gain that is rare in surrogates and healthy stages.

    Its curve is refitted without tangents of effects, which would absorb a part of it.
    """
    has_mains, view = MAINS in {cause.effect.name for cause in outcome.causes}, residual.view
    coarse = outcome.coarse_readings
    step = 0.0 if coarse is None else 1e-9 * coarse.value / view.half_stroke_m
    for score in scores:
        is_line = score.coordinate in MAINS_COORDINATES
        if has_mains and is_line and mains_frequency_Hz(score.basis.per_unit):
            continue  # interference with other harmonics or a faster phase change than modelled
        if score.coordinate == READING and abs(step * score.basis.per_unit - 1.0) < STEP_ERROR:
            continue  # the error of a converter is a sawtooth of the reading
        healthy_p_value = structure_p_value(score.gain, residual.null.rms, view.noise)
        if score.p_value > MAX_P_VALUE or healthy_p_value > MAX_HEALTHY_P_VALUE:
            continue
        beside_model = Residual.of(view)
        if score.coordinate == "time":
            fitted = fit_time_course(beside_model, score)
        else:
            fitted = beside_model.score(score.basis, score.p_value)
        tracks, coefficients = range(len(view.tracks)), fitted.coefficients
        return ResidualStructure(
            score=fitted,
            curve=tuple(fitted.basis.curve(k, coefficients) for k in tracks),
            share=_share(residual, score.gain),
            residual=beside_model.values,
            view=view,
            healthy_p_value=healthy_p_value,
        )
    return None


def _sensor_range_structure(outcome: Outcome) -> ResidualStructure | None:
    """Return an end of the sensor's range, if the residual exceeds the noise."""
    if outcome.final.rms < MIN_NOISE_RATIO * outcome.final.noise:
        return None
    effects = [
        cause.selected
        for cause in outcome.causes
        if cause.effect.name != AMPLIFIER_LIMIT and cause.effect.structural is None
    ]
    end = find_sensor_range_end(outcome.clean, effects)
    if end is None:
        return None
    view = with_effects(outcome.clean, effects)
    error = view.rows(end.error)
    values = replace(view.null, response=view.response - error).residual + error
    residual = Residual(view=view, null=replace(view.null, response=values))
    # share of power that the error explains of the residual, and of its shifts
    power = max(float(np.sum(values**2)), 1e-300)
    gain, *surrogate_gains = (
        float(np.sum((2.0 * np.roll(values, shift) - error) * error)) / power
        for shift in np.linspace(0, len(values), SURROGATES + 1, endpoint=False).astype(int)
    )
    p_value = rank_p_value(gain, surrogate_gains)
    rms = float(np.sqrt(np.mean(values**2)))
    healthy_p_value = structure_p_value(gain, rms, view.noise)
    if p_value > MAX_P_VALUE or healthy_p_value > MAX_HEALTHY_P_VALUE:
        return None
    return ResidualStructure(
        score=CoordinateScore(
            basis=replace(displacement_basis(view), coordinate=READING),
            gain=gain,
            p_value=p_value,
            coefficients=np.zeros(0),
            fitted=error,
        ),
        curve=end.error,
        share=_share(residual, gain),
        residual=values,
        view=view,
        healthy_p_value=healthy_p_value,
        range_end=end,
    )
