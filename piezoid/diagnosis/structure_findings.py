"""Findings of unexplained structure: of the residual along a coordinate, or of the noise.

A sensor may have more noise at one end of its range, an amplifier while it slews. The mean of the
residual does not show it, and no effect of the catalogue explains it. The noise at a sample is
estimated by the second difference of the error e of the static response, which hysteresis hardly
changes,

    d_i^2 = (e_(i-1) - 2 e_i + e_(i+1))^2 / 6,      log d_i^2 = offset of the track + f(x_i) + xi,

xi the logarithm of chi-squared, of mean -1.27. Curves f along one coordinate are tested as for a
residual: on left-out blocks, against the same logarithms shifted along each recording.

Source: Harvey, Econometrica 44 (1976) on regressions of the logarithm; von Neumann (1941) on
differences.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.coordinate_scores import CoordinateScore, Residual
from piezoid.diagnosis.diagnosis import (
    SOMETHING_ELSE,
    CoordinateProfile,
    Finding,
    Size,
    held_out_gain,
)
from piezoid.diagnosis.residual_coordinates import (
    coordinate_profile,
    coordinate_words,
    next_experiment,
    signal_bases,
)
from piezoid.diagnosis.residual_structure import MAX_P_VALUE, ResidualStructure
from piezoid.diagnosis.residual_view import View
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.records.sample_statistics import step_size

MEAN_LOG = -1.2704  # of chi-squared of one degree: the digamma of 1/2, and log 2
MIN_NOISE = 1e-3  # of the noise: smaller differences are rounding
RANGE = (0.02, 0.98)  # quantiles of the noise level that count as its lowest and highest value
# Highest over lowest level: at most 1.5 on an outsider's healthy stages, 1.7 with a delay, and at
# least 3.7 if the noise grows with the reading or the speed (docs/how_piezoid_decides.md).
MIN_RATIO = 2.0
MIN_SHARE = 0.5  # of the residual's power: below it other structure passes for noise
HALF_HEIGHT = 0.5  # of a curve's largest height: the range that a finding states
MEDIAN = 0.6745  # of the magnitude of a normal variable, in standard deviations
NOISE_EXPERIMENT = (
    "Record ten seconds at rest at five levels over the range, then ramps at three speeds over "
    "all of it: noise that stays with the level is the sensor's or its supply's, noise that comes "
    "with the speed the amplifier's, the converter's or the guide's."
)


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseLevel:
    """Level of the noise along the coordinate that explains most of it.

    score  of the curve of the logarithm of the noise power
    local  (rows,)  magnitude of the noise at each row
    level  (rows,)  rms of the noise by the curve
    view   the view with these rows
    """

    score: CoordinateScore
    local: Array
    level: Array
    view: View

    @property
    def range(self) -> tuple[float, float]:
        """Return the lowest and the highest noise level."""
        low, high = np.quantile(self.level, RANGE)
        return float(low), float(high)


def noise_level(view: View) -> NoiseLevel | None:
    """Return the noise level along the coordinate on which it depends; None if uniform.

    Noise below the resolution of the converter cannot be measured. Noise that is a minor part of
    the residual cannot be separated from other structure. Time is not tested: the distribution of
    the logarithms is skew, so that random signs are no null distribution.

    Rows at which the noise cannot be measured have the typical level: next to samples that were
    not recorded, and where the second difference of the static response exceeds the noise.
    """
    if any(step_size(track.response) > view.noise for track in view.tracks):
        return None
    magnitudes = []
    for track, static in zip(view.tracks, view.static, strict=True):
        noise = np.full(len(static), np.nan)  # where it cannot be measured
        noise[1:-1] = np.abs(np.diff(track.response - static, 2)) / sqrt(6.0)
        noise[1:-1][np.abs(np.diff(static, 2)) > sqrt(6.0) * view.noise] = np.nan
        for missing in track.bridged.tolist():
            noise[max(missing - 1, 0) : missing + 2] = np.nan
        rows = noise[track.rows]
        measured = rows[np.isfinite(rows) & (rows > 0.0)]
        typical = float(np.exp(np.mean(np.log(measured)))) if len(measured) else view.noise
        magnitudes.append(np.where(np.isfinite(rows), rows, typical))
    local = np.concatenate(magnitudes)
    if float(np.mean(local**2)) < MIN_SHARE * view.rms**2:
        return None
    values = np.log(np.maximum(local, MIN_NOISE * view.noise) ** 2)
    offsets = np.column_stack(
        [view.track_column(k, np.ones(len(t.rows))) for k, t in enumerate(view.tracks)]
    )
    residual = Residual(view=view, null=Null(columns=offsets, response=values, block=view.block))
    surrogates = residual.surrogates(np.random.default_rng(0))
    scores, _ = residual.score_all(signal_bases(view), surrogates)
    best = max(scores, key=lambda score: score.gain)
    mean = values - residual.values + best.fitted - MEAN_LOG
    ratio = np.exp(0.5 * np.diff(np.quantile(best.fitted, RANGE)))
    if best.gain <= 0.0 or best.p_value > MAX_P_VALUE or ratio < MIN_RATIO:
        return None
    return NoiseLevel(score=best, local=local, level=np.exp(0.5 * mean), view=view)


def structure_finding(
    structure: ResidualStructure,
    *,
    before_m: float,
    after_m: float,
    scale_m: float,
    middle_m: float,
) -> Finding:
    """Return the finding of structure that the search subtracted from the readings.

    Its size is the rms of the curve, with an interval over blocks. A periodic curve counts in
    full, although hysteresis can follow a part of it. Along another coordinate the curve and
    hysteresis cannot be separated: only the part that no hysteresis follows counts.

    before_m  held-out error of the model without the curve
    after_m   held-out error of the model with the curve
    scale_m   displacement of 1 in scaled units
    middle_m  displacement of 0 in scaled units
    """
    score, view, end, law = structure.score, structure.view, structure.range_end, ""
    power, mean = structure.block_power, structure.mean_power
    margin = 1.96 * float(np.std(power, ddof=1)) * sqrt(len(power)) / len(score.fitted)
    ratio = 1.0
    if score.basis.per_unit > 0.0:
        curve = view.rows(structure.curve)
        ratio = float(np.std(curve)) / max(sqrt(float(np.mean(score.fitted**2))), 1e-300)
    low_m, rms_m, high_m = (
        view.half_stroke_m * (ratio * sqrt(max(mean + change, 0.0)))
        for change in (-margin, 0.0, margin)
    )
    sign = float(np.sign(scale_m))
    profile = _profile(
        score, view, sign * structure.residual, sign * score.fitted, scale_m, middle_m
    )
    parameters, location = _period(structure)
    if not parameters:  # the range of the coordinate with most of the structure
        height = np.abs(profile.fitted_m)
        high = np.flatnonzero(height > HALF_HEIGHT * float(height.max()))
        start, stop = (with_unit(profile.place[int(high[k])], profile.unit) for k in (0, -1))
        recording = f" of {profile.recording}" if profile.recording else ""
        location = f", most of it from {start} to {stop}{recording}"
    share = f"{100 * structure.share:.0f} % of the residual power above the noise"
    if end is not None:  # applies to other recordings
        limit = "min" if end.side * scale_m > 0.0 else "max"
        law = f"reading = {limit}(displacement, {with_unit(middle_m + scale_m * end.level, 'm')})"
    return Finding(
        effect=SOMETHING_ELSE,
        held_out_gain=held_out_gain(before_m, after_m),
        held_out_rms_before_m=before_m,
        held_out_rms_after_m=after_m,
        p_value=structure.healthy_p_value,
        rms_percent=50.0 * rms_m / view.half_stroke_m,
        size=Size.of_rms(rms_m, low_m, high_m),
        not_separable_from=(),
        explanation="Residual that no effect of the catalogue explains: "
        f"{with_unit(rms_m, 'm')} rms along {coordinate_words(score.coordinate)}"
        f"{location}; {share}.",
        next_experiment=next_experiment(score.coordinate),
        parameters=parameters,
        coordinate=score.coordinate,
        law=law,
        seen=profile,
    )


def noise_finding(
    noise: NoiseLevel, *, error_m: float, scale_m: float, middle_m: float
) -> Finding:
    """Return the finding of noise that depends on a coordinate.

    Its size is the rms of the noise beyond its lowest level, with an interval over blocks. The
    level counts, not the magnitudes: a few large ones, as of ringing, exceed the highest level.

    error_m  held-out error of the model, which includes this noise
    """
    score, view, quietest = noise.score, noise.view, noise.range[0]
    power, mean = np.add.reduceat(noise.local**2, view.null.edges), float(np.mean(noise.level**2))
    margin = 1.96 * mean * float(np.std(power, ddof=1) / np.mean(power)) / sqrt(len(power))
    low_m, rms_m, high_m = (
        view.half_stroke_m * sqrt(max(mean + side * margin - quietest**2, 0.0))
        for side in (-1.0, 0.0, 1.0)
    )
    quiet, loud = (with_unit(view.half_stroke_m * rms, "m") for rms in noise.range)
    return Finding(
        effect=SOMETHING_ELSE,
        held_out_gain=0.0,
        held_out_rms_before_m=error_m,
        held_out_rms_after_m=error_m,
        p_value=score.p_value,
        rms_percent=50.0 * rms_m / view.half_stroke_m,
        size=Size.of_rms(rms_m, low_m, high_m),
        not_separable_from=(),
        explanation=f"The noise of the readings changes along {coordinate_words(score.coordinate)}"
        f", from {quiet} rms in the quietest region to {loud} in the loudest: "
        f"{with_unit(rms_m, 'm')} rms above the quietest on average. It is noise, or ringing "
        "of a mode that no recording resolves.",
        next_experiment=NOISE_EXPERIMENT,
        parameters={},
        coordinate=score.coordinate,
        seen=_profile(score, view, noise.local / MEDIAN, noise.level, scale_m, middle_m),
    )


def _period(structure: ResidualStructure) -> tuple[dict[str, float], str]:
    """Return the period of the curve as a parameter and in words; empty if it is not periodic."""
    coordinate, per_unit = structure.score.coordinate, structure.score.basis.per_unit
    if not per_unit:
        return {}, ""
    if coordinate in ("distance_travelled", "reading"):
        period_m = structure.view.half_stroke_m / per_unit
        return {"period_m": period_m}, f", every {with_unit(period_m, 'm')}"
    if coordinate == "sample_index":
        return {"period_samples": 1.0 / per_unit}, f", every {1.0 / per_unit:.0f} samples"
    return {"frequency_Hz": per_unit}, f", at {per_unit:.5g} Hz"


def _profile(
    score: CoordinateScore,
    view: View,
    residual: Array,
    fitted: Array,
    scale_m: float,
    middle_m: float,
) -> CoordinateProfile:
    """Return the profile of the residual along the coordinate of a score.

    The profile of a course in time is that of the recording with the largest power. A periodic
    coordinate is a fraction of the period.

    residual, fitted  (rows,)  in half strokes
    """
    tracks, recording, basis = range(len(view.tracks)), "", score.basis
    if score.coordinate == "time":
        power = [float(np.sum(fitted[view.track_rows(k)] ** 2)) for k in tracks]
        strongest = int(np.argmax(power))
        tracks, recording = range(strongest, strongest + 1), view.tracks[strongest].name
    positions = []
    for k in tracks:
        values = basis.position[k][view.tracks[k].rows]
        if basis.per_unit and basis.harmonics:
            first = k * 2 * basis.harmonics
            cosine, sine = score.coefficients[first : first + 2]
            phase = np.arctan2(sine, cosine) / (2.0 * np.pi)
            values = (values * basis.per_unit - phase) % 1.0
        elif basis.per_unit:
            values = values * basis.per_unit
        positions.append(values)
    position = np.concatenate(positions)
    if score.coordinate in ("displacement", "reading") and not basis.per_unit:
        position = position * np.sign(scale_m) + middle_m
    return coordinate_profile(
        position,
        view.half_stroke_m * np.concatenate([residual[view.track_rows(k)] for k in tracks]),
        view.half_stroke_m * np.concatenate([fitted[view.track_rows(k)] for k in tracks]),
        unit="" if basis.per_unit else basis.unit,
        recording=recording,
    )
