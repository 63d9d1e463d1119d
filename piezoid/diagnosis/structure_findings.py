"""What a person is told of something that has no name: how large it is and where it lives."""

from collections.abc import Mapping
from math import sqrt

import numpy as np

from piezoid.diagnosis.coordinate_tests import CoordinateScore
from piezoid.diagnosis.diagnosis import (
    Finding,
    HeldOut,
    Seen,
    Size,
    Unexplained,
    held_out_gain,
)
from piezoid.diagnosis.noise_level import NoiseLevel, excess_of
from piezoid.diagnosis.residual_structure import NAME, Discovered
from piezoid.diagnosis.residual_view import View
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array

CLASSES = 40  # of the picture
LEAST_ROWS = 8  # of one of them
FULL = 0.5  # of its largest height: where a curve is there

WORDS: Mapping[str, str] = {
    "drive": "the drive",
    "displacement": "the displacement, whatever the drive does",
    "reading": "the reading's own value",
    "speed": "the speed and its sign",
    "time": "time",
    "time_since_turn": "the time since the drive last turned",
    "frequency": "time, and repeats",
    "line_phase": "the phase within a period of the grid",
    "distance_travelled": "the distance travelled, and repeats with it",
    "sample_index": "the index of the sample, and repeats with it",
}
NEXT: Mapping[str, str] = {
    "drive": "Step the drive slowly through that range, up and down, and read the amplifier's "
    "output with a second instrument.",
    "displacement": "Move slowly through that place with a second sensor beside the first: what "
    "both see is the stage's, what one sees is that sensor's.",
    "reading": "Read a second sensor or converter beside the first while the stage moves slowly "
    "through those readings.",
    "speed": "Run triangles of one amplitude at five speeds a factor of three apart.",
    "time": "Record again at another hour with the drive at rest, and write down what else runs.",
    "time_since_turn": "Record turns at several levels, each followed by a ramp of one speed, and "
    "the same ramps after a rest.",
    "frequency": "Record a minute with the drive at rest, then switch off pumps, fans and "
    "neighbouring instruments one after another until the line goes.",
    "line_phase": "Record a minute at rest triggered by the grid, and switch off heaters and "
    "dimmers one after another.",
    "distance_travelled": "Run one slow ramp to and fro over half the range and over all of it.",
    "sample_index": "Record a shorted input at the same rate: what repeats there is the "
    "converter's.",
}
NOISE_NEXT = (
    "Record ten seconds at rest at five levels over the range, then ramps at three speeds over "
    "all of it: noise that stays with the level is the sensor's or its supply's, noise that comes "
    "with the speed the amplifier's, the converter's or the guide's."
)
MEDIAN = 0.6745  # of a normal variable without its sign, in standard deviations
OTHER = "Move the other axis alone, slowly over its range, with this drive at rest."


def words(coordinate: str) -> str:
    """Return a coordinate as a sentence names it."""
    return WORDS.get(coordinate, f"the {coordinate}")


def of_discovered(
    found: Discovered, *, before: HeldOut, after: HeldOut, scale_m: float, middle_m: float
) -> Finding:
    """Return the finding of something that has no name.

    before, after  errors of the simulation on rows left out, without its curve and with it
    scale_m        displacement that 1 of the search stands for beyond
    middle_m       that of 0
    """
    lives, stroke_m = found.lives, found.view.stroke_m
    low_m, value_m, high_m = (stroke_m * rms for rms in _rms_with_doubt(found))
    way = float(np.sign(scale_m))
    seen = _seen(lives, found.view, way * found.left, way * lives.followed, scale_m, middle_m)
    part = f"{100 * found.share:.0f} % of what no cause explains beyond the noise"
    return Finding(
        effect=NAME,
        held_out_gain=held_out_gain(before.rms_m, after.rms_m),
        held_out_rms_before_m=before.rms_m,
        held_out_rms_after_m=after.rms_m,
        p_value=found.chance,
        rms_percent=50.0 * value_m / stroke_m,
        size=Size(value=1e9 * value_m, unit="nm, rms", ci95=(1e9 * low_m, 1e9 * high_m)),
        not_separable_from=(),
        explanation=f"No effect of the catalogue stands for it: {part} lives in "
        f"{words(lives.coordinate)}{_where(found, seen)}. It is {with_unit(value_m, 'm')} rms.",
        next_experiment=NEXT.get(lives.coordinate, OTHER),
        parameters=_parameters(found),
        coordinate=lives.coordinate,
        law=_law(found, scale_m, middle_m),
        seen=seen,
    )


def of_residual(
    rest: Unexplained, *, rms_m: float, scatter: float, final: HeldOut, stroke_m: float
) -> Finding:
    """Return the finding of a residual above the noise that no test assigned to a coordinate.

    Args:
        rest: the residual, with the coordinate that explains most of it on left-out blocks.
        rms_m: of the part along this coordinate.
        scatter: relative standard error of the mean square of the residual.
        final: error of the model, which does not change: the residual is not modelled.
        stroke_m: range of the displacement.
    """
    low, high = (sqrt(max(1.0 + side * 1.96 * scatter, 0.0)) for side in (-1.0, 1.0))
    return Finding(
        effect=NAME,
        held_out_gain=0.0,
        held_out_rms_before_m=final.rms_m,
        held_out_rms_after_m=final.rms_m,
        p_value=rest.p_value,
        rms_percent=100.0 * rms_m / stroke_m,
        size=Size(value=1e9 * rms_m, unit="nm, rms", ci95=(1e9 * low * rms_m, 1e9 * high * rms_m)),
        not_separable_from=(),
        explanation=f"The residual exceeds the noise and no effect of the catalogue explains it. "
        f"{words(rest.coordinate).capitalize()} explains {100.0 * rest.gain:.0f} % of its power "
        "on left-out blocks, more than any other coordinate.",
        next_experiment=NEXT.get(rest.coordinate, OTHER),
        parameters={},
        coordinate=rest.coordinate,
    )


def of_noise(found: NoiseLevel, *, error: HeldOut, scale_m: float, middle_m: float) -> Finding:
    """Return the finding of a noise that is not the same everywhere.

    error  of the simulation on rows left out, in which such noise is and stays
    """
    lives, stroke_m = found.lives, found.view.stroke_m
    low_m, value_m, high_m = (stroke_m * rms for rms in excess_of(found))
    quiet_m, loud_m = (stroke_m * rms for rms in found.range)
    seen = _seen(lives, found.view, found.local / MEDIAN, found.level, scale_m, middle_m)
    return Finding(
        effect=NAME,
        held_out_gain=0.0,
        held_out_rms_before_m=error.rms_m,
        held_out_rms_after_m=error.rms_m,
        p_value=lives.p_value,
        rms_percent=50.0 * value_m / stroke_m,
        size=Size(value=1e9 * value_m, unit="nm, rms", ci95=(1e9 * low_m, 1e9 * high_m)),
        not_separable_from=(),
        explanation="No effect of the catalogue stands for it: the noise of the readings is not "
        f"the same everywhere, it lives in {words(lives.coordinate)}. It is "
        f"{with_unit(quiet_m, 'm')} rms in the quietest place and {with_unit(loud_m, 'm')} in the "
        f"loudest, {with_unit(value_m, 'm')} rms beyond the quietest in all. No model can take it "
        "off.",
        next_experiment=NOISE_NEXT,
        parameters={},
        coordinate=lives.coordinate,
        seen=seen,
    )


def _parameters(found: Discovered) -> dict[str, float]:
    per_unit = found.lives.basis.per_unit
    if not per_unit:
        return {}
    if found.lives.coordinate in ("distance_travelled", "reading"):
        return {"period_m": found.view.stroke_m / per_unit}
    if found.lives.coordinate == "sample_index":
        return {"period_samples": 1.0 / per_unit}
    return {"frequency_Hz": per_unit}


def _rms_with_doubt(found: Discovered) -> tuple[float, float, float]:
    """Return rms of what the curve explains with its 95 % interval, blocks being independent.

    What repeats is as large as its own curve; hysteresis of any shape follows a part of it. Along
    another coordinate the two are not to be told apart, and the part that no hysteresis follows is
    what is known.
    """
    null = found.view.null  # its blocks
    followed = found.lives.followed
    power = np.add.reduceat((2.0 * found.left - followed) * followed, null.edges)
    rows, count = len(followed), len(power)
    mean = max(float(power.sum()) / rows, 0.0)
    spread = 1.96 * float(np.std(power, ddof=1)) * sqrt(count) / rows
    whole = 1.0
    if found.lives.basis.per_unit > 0.0:
        curve = found.view.rows(found.curve)
        whole = float(np.std(curve)) / max(sqrt(float(np.mean(followed**2))), 1e-300)
    return whole * sqrt(max(mean - spread, 0.0)), whole * sqrt(mean), whole * sqrt(mean + spread)


def _where(found: Discovered, seen: Seen) -> str:
    """Return at which of the coordinate's values it is."""
    parameters = _parameters(found)
    if "frequency_Hz" in parameters:
        return f", at {parameters['frequency_Hz']:.5g} Hz"
    if "period_m" in parameters:
        return f", every {with_unit(parameters['period_m'], 'm')}"
    if "period_samples" in parameters:
        return f", every {parameters['period_samples']:.0f} samples"
    height = np.abs(seen.fitted_m)
    there = np.flatnonzero(height > FULL * float(height.max()))
    low, high = seen.place[int(there[0])], seen.place[int(there[-1])]
    recording = f" of {seen.recording}" if seen.recording else ""
    return (
        f", most of it from {with_unit(low, seen.unit)} to {with_unit(high, seen.unit)}{recording}"
    )


def _law(found: Discovered, scale_m: float, middle_m: float) -> str:
    """Return the formula of a range that ends; it holds on readings that no fit has seen."""
    if found.end is None:
        return ""
    way = "min" if found.end.side * scale_m > 0.0 else "max"
    return f"reading = {way}(displacement, {with_unit(middle_m + scale_m * found.end.level, 'm')})"


def _seen(
    lives: CoordinateScore,
    view: View,
    left: Array,
    followed: Array,
    scale_m: float,
    middle_m: float,
) -> Seen:
    """Return what is left in classes of the coordinate, with what the curve makes of it.

    left, followed  (rows,)  in half strokes
    """
    shown, recording = range(len(view.tracks)), ""
    if lives.coordinate == "time":
        power = [float(np.sum(followed[_rows(view, k)] ** 2)) for k in shown]
        shown = range(int(np.argmax(power)), int(np.argmax(power)) + 1)
        recording = view.tracks[shown[0]].name
    place = np.concatenate([_place(lives, view, k) for k in shown])
    if lives.coordinate in ("displacement", "reading") and not lives.basis.per_unit:
        place = place * np.sign(scale_m) + middle_m
    return seen_in_classes(
        place,
        view.stroke_m * np.concatenate([left[_rows(view, k)] for k in shown]),
        view.stroke_m * np.concatenate([followed[_rows(view, k)] for k in shown]),
        unit="" if lives.basis.per_unit else lives.basis.unit,
        recording=recording,
    )


def _rows(view: View, k: int) -> slice:
    edges = view.nuisance.edges
    return slice(int(edges[k]), int(edges[k + 1]))


def _place(lives: CoordinateScore, view: View, k: int) -> Array:
    """Return where the rows of a track stand; of what repeats, in which part of a period."""
    basis = lives.basis
    place = basis.place[k][view.tracks[k].place]
    if not basis.per_unit:
        return place
    if not basis.harmonics:
        return place * basis.per_unit
    wide = 2 * basis.harmonics
    own = lives.coefficient[k * wide : k * wide + 2]
    return np.asarray((place * basis.per_unit - np.arctan2(own[1], own[0]) / (2.0 * np.pi)) % 1.0)


def seen_in_classes(
    place: Array, left_m: Array, followed_m: Array, *, unit: str, recording: str = ""
) -> Seen:
    """Return quartiles of a remainder and the mean of its curve, class by class of its place."""
    there = np.isfinite(place)
    place, left_m, followed_m = place[there], left_m[there], followed_m[there]
    edges = np.linspace(place.min(), place.max() + 1e-12, CLASSES + 1)
    kind = np.clip(np.searchsorted(edges, place, side="right") - 1, 0, CLASSES - 1)
    rows = []
    for k in range(CLASSES):
        inside = kind == k
        if np.sum(inside) >= LEAST_ROWS:
            quartiles = np.quantile(left_m[inside], [0.25, 0.5, 0.75]).tolist()
            curve_m = float(np.mean(followed_m[inside]))
            rows.append([float(np.mean(place[inside])), *quartiles, curve_m])
    middle, low, median, high, fitted = (
        tuple(c) for c in np.array(rows).reshape(-1, 5).T.tolist()
    )
    return Seen(
        unit=unit,
        place=middle,
        low_m=low,
        median_m=median,
        high_m=high,
        fitted_m=fitted,
        recording=recording,
    )
