"""Describe the coordinate of a systematic residual: words, next experiment and profile."""

from collections.abc import Mapping

import numpy as np

from piezoid.diagnosis.diagnosis import CoordinateProfile
from piezoid.numerics.arrays import Array

CLASSES = 40
MIN_ROWS = 8  # of a class

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
NEXT_EXPERIMENTS: Mapping[str, str] = {
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
CONTROL_ADVICE = (
    "No controller compensates it, because no model contains it. The loop follows an error of the "
    "reading: find out first whether the stage moves."
)
OTHER_AXIS_EXPERIMENT = (
    "Move the other axis alone, slowly over its range, with this drive at rest."
)


def coordinate_words(coordinate: str) -> str:
    """Return the words for a coordinate in a sentence."""
    return WORDS.get(coordinate, f"the {coordinate}")


def next_experiment(coordinate: str) -> str:
    """Return the experiment that would identify the cause of structure along a coordinate."""
    return NEXT_EXPERIMENTS.get(coordinate, OTHER_AXIS_EXPERIMENT)


def coordinate_profile(
    position: Array, residual_m: Array, fitted_m: Array, *, unit: str, recording: str = ""
) -> CoordinateProfile:
    """Return quartiles of a residual and the mean of the fitted curve in classes of a coordinate.

    position  (rows,)  in ``unit``; rows with a position that is not finite are left out
    """
    is_finite = np.isfinite(position)
    position, residual_m, fitted_m = (
        values[is_finite] for values in (position, residual_m, fitted_m)
    )
    edges = np.linspace(position.min(), position.max() + 1e-12, CLASSES + 1)
    index = np.clip(np.searchsorted(edges, position, side="right") - 1, 0, CLASSES - 1)
    rows = []
    for k in range(CLASSES):
        inside = index == k
        if np.sum(inside) >= MIN_ROWS:
            quartiles = np.quantile(residual_m[inside], [0.25, 0.5, 0.75]).tolist()
            mean_m = float(np.mean(fitted_m[inside]))
            rows.append([float(np.mean(position[inside])), *quartiles, mean_m])
    centre, low, median, high, mean = (tuple(c) for c in np.array(rows).reshape(-1, 5).T.tolist())
    return CoordinateProfile(
        unit=unit,
        place=centre,
        low_m=low,
        median_m=median,
        high_m=high,
        fitted_m=mean,
        recording=recording,
    )
