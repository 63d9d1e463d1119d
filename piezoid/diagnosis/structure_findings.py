"""Findings of unexplained structure: size, coordinate and profile."""

from math import sqrt

import numpy as np

from piezoid.diagnosis.coordinate_descriptions import (
    coordinate_profile,
    coordinate_words,
    next_experiment,
)
from piezoid.diagnosis.coordinate_scores import CoordinateScore
from piezoid.diagnosis.diagnosis import (
    SOMETHING_ELSE,
    CoordinateProfile,
    Finding,
    HeldOut,
    Size,
    held_out_gain,
)
from piezoid.diagnosis.noise_level import NoiseLevel, excess_of
from piezoid.diagnosis.residual_structure import ResidualStructure
from piezoid.diagnosis.residual_view import View
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array

HALF_HEIGHT = 0.5  # of a curve's largest height: the range that a finding states
MEDIAN = 0.6745  # of the magnitude of a normal variable, in standard deviations
NOISE_EXPERIMENT = (
    "Record ten seconds at rest at five levels over the range, then ramps at three speeds over "
    "all of it: noise that stays with the level is the sensor's or its supply's, noise that comes "
    "with the speed the amplifier's, the converter's or the guide's."
)


def structure_finding(
    structure: ResidualStructure,
    *,
    without_curve: HeldOut,
    with_curve: HeldOut,
    scale_m: float,
    middle_m: float,
) -> Finding:
    """Return the finding of structure that the search subtracted from the readings.

    without_curve  held-out error of the model without the curve
    with_curve     held-out error of the model with the curve
    scale_m        displacement of 1 in scaled units
    middle_m       displacement of 0 in scaled units
    """
    score, view = structure.score, structure.view
    low_m, rms_m, high_m = (view.half_stroke_m * rms for rms in _rms_with_interval(structure))
    sign = float(np.sign(scale_m))
    profile = _profile(
        score, view, sign * structure.residual, sign * score.fitted, scale_m, middle_m
    )
    share = f"{100 * structure.share:.0f} % of the residual power above the noise"
    return Finding(
        effect=SOMETHING_ELSE,
        held_out_gain=held_out_gain(without_curve.rms_m, with_curve.rms_m),
        held_out_rms_before_m=without_curve.rms_m,
        held_out_rms_after_m=with_curve.rms_m,
        p_value=structure.healthy_p_value,
        rms_percent=50.0 * rms_m / view.half_stroke_m,
        size=_size(low_m, rms_m, high_m),
        not_separable_from=(),
        explanation="Residual that no effect of the catalogue explains: "
        f"{with_unit(rms_m, 'm')} rms along {coordinate_words(score.coordinate)}"
        f"{_location(structure, profile)}; {share}.",
        next_experiment=next_experiment(score.coordinate),
        parameters=_parameters(structure),
        coordinate=score.coordinate,
        law=_law(structure, scale_m, middle_m),
        seen=profile,
    )


def noise_finding(
    noise: NoiseLevel, *, error: HeldOut, scale_m: float, middle_m: float
) -> Finding:
    """Return the finding of noise that depends on a coordinate.

    error  held-out error of the model, which includes this noise
    """
    score, view = noise.score, noise.view
    low_m, rms_m, high_m = (view.half_stroke_m * rms for rms in excess_of(noise))
    quiet, loud = (with_unit(view.half_stroke_m * rms, "m") for rms in noise.range)
    return Finding(
        effect=SOMETHING_ELSE,
        held_out_gain=0.0,
        held_out_rms_before_m=error.rms_m,
        held_out_rms_after_m=error.rms_m,
        p_value=score.p_value,
        rms_percent=50.0 * rms_m / view.half_stroke_m,
        size=_size(low_m, rms_m, high_m),
        not_separable_from=(),
        explanation=f"The noise of the readings changes along {coordinate_words(score.coordinate)}"
        f", from {quiet} rms in the quietest region to {loud} in the loudest: "
        f"{with_unit(rms_m, 'm')} rms above the quietest on average. No model removes it.",
        next_experiment=NOISE_EXPERIMENT,
        parameters={},
        coordinate=score.coordinate,
        seen=_profile(score, view, noise.local / MEDIAN, noise.level, scale_m, middle_m),
    )


def _size(low_m: float, rms_m: float, high_m: float) -> Size:
    return Size(value=1e9 * rms_m, unit="nm, rms", ci95=(1e9 * low_m, 1e9 * high_m))


def _rms_with_interval(structure: ResidualStructure) -> tuple[float, float, float]:
    """Return lower limit, value and upper limit (95 %) of the rms of the curve, over blocks.

    A periodic curve counts in full, although hysteresis can follow a part of it. Along another
    coordinate the curve and hysteresis cannot be separated: only the part that no hysteresis
    follows counts.
    """
    fitted, power, mean = structure.score.fitted, structure.block_power, structure.mean_power
    rows, count = len(fitted), len(power)
    margin = 1.96 * float(np.std(power, ddof=1)) * sqrt(count) / rows
    ratio = 1.0
    if structure.score.basis.per_unit > 0.0:
        curve = structure.view.rows(structure.curve)
        ratio = float(np.std(curve)) / max(sqrt(float(np.mean(fitted**2))), 1e-300)
    return ratio * sqrt(max(mean - margin, 0.0)), ratio * sqrt(mean), ratio * sqrt(mean + margin)


def _parameters(structure: ResidualStructure) -> dict[str, float]:
    score = structure.score
    per_unit = score.basis.per_unit
    if not per_unit:
        return {}
    if score.coordinate in ("distance_travelled", "reading"):
        return {"period_m": structure.view.half_stroke_m / per_unit}
    if score.coordinate == "sample_index":
        return {"period_samples": 1.0 / per_unit}
    return {"frequency_Hz": per_unit}


def _location(structure: ResidualStructure, profile: CoordinateProfile) -> str:
    """State the range of the coordinate with most of the structure, or its period."""
    parameters = _parameters(structure)
    if "frequency_Hz" in parameters:
        return f", at {parameters['frequency_Hz']:.5g} Hz"
    if "period_m" in parameters:
        return f", every {with_unit(parameters['period_m'], 'm')}"
    if "period_samples" in parameters:
        return f", every {parameters['period_samples']:.0f} samples"
    height = np.abs(profile.fitted_m)
    high = np.flatnonzero(height > HALF_HEIGHT * float(height.max()))
    start, stop = (with_unit(profile.place[int(high[k])], profile.unit) for k in (0, -1))
    recording = f" of {profile.recording}" if profile.recording else ""
    return f", most of it from {start} to {stop}{recording}"


def _law(structure: ResidualStructure, scale_m: float, middle_m: float) -> str:
    """Return the formula of the end of a sensor's range, which applies to other recordings."""
    end = structure.range_end
    if end is None:
        return ""
    limit = "min" if end.side * scale_m > 0.0 else "max"
    return f"reading = {limit}(displacement, {with_unit(middle_m + scale_m * end.level, 'm')})"


def _profile(
    score: CoordinateScore,
    view: View,
    residual: Array,
    fitted: Array,
    scale_m: float,
    middle_m: float,
) -> CoordinateProfile:
    """Return the profile of the residual along the coordinate of a score.

    The profile of a course in time is that of the recording with the largest power.

    residual, fitted  (rows,)  in half strokes
    """
    tracks, recording = range(len(view.tracks)), ""
    if score.coordinate == "time":
        power = [float(np.sum(fitted[view.track_rows(k)] ** 2)) for k in tracks]
        strongest = int(np.argmax(power))
        tracks, recording = range(strongest, strongest + 1), view.tracks[strongest].name
    is_periodic = score.basis.per_unit > 0.0
    position = np.concatenate([_position(score, view, k) for k in tracks])
    if score.coordinate in ("displacement", "reading") and not is_periodic:
        position = position * np.sign(scale_m) + middle_m
    return coordinate_profile(
        position,
        view.half_stroke_m * np.concatenate([residual[view.track_rows(k)] for k in tracks]),
        view.half_stroke_m * np.concatenate([fitted[view.track_rows(k)] for k in tracks]),
        unit="" if is_periodic else score.basis.unit,
        recording=recording,
    )


def _position(score: CoordinateScore, view: View, k: int) -> Array:
    """Return the coordinate of a track's rows; if periodic, as a fraction of the period."""
    basis = score.basis
    position = basis.position[k][view.tracks[k].rows]
    if not basis.per_unit:
        return position
    if not basis.harmonics:
        return position * basis.per_unit
    first = k * 2 * basis.harmonics
    cosine, sine = score.coefficients[first : first + 2]
    phase = np.arctan2(sine, cosine) / (2.0 * np.pi)
    return np.asarray((position * basis.per_unit - phase) % 1.0)
