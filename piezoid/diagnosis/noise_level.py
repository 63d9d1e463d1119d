"""Noise level: find the coordinate on which the white noise of the readings depends.

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
from piezoid.diagnosis.coordinate_bases import signal_bases
from piezoid.diagnosis.coordinate_scores import CoordinateScore, Residual
from piezoid.diagnosis.residual_view import View
from piezoid.numerics.arrays import Array
from piezoid.records.sample_statistics import step_size

MEAN_LOG = -1.2704  # of chi-squared of one degree: the digamma of 1/2, and log 2
MIN_NOISE = 1e-3  # of the noise: smaller differences are rounding
RANGE = (0.02, 0.98)  # quantiles of the noise level that count as its lowest and highest value
# Highest over lowest level: at most 1.5 on an outsider's healthy stages, 1.7 with a delay, and at
# least 3.7 if the noise grows with the reading or the speed (docs/how_piezoid_decides.md).
MIN_RATIO = 2.0
MIN_SHARE = 0.5  # of the residual's power: below it other structure passes for noise


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


def noise_level(view: View, max_p_value: float) -> NoiseLevel | None:
    """Return the noise level along the coordinate on which it depends; None if uniform.

    max_p_value  of the coordinate

    Noise below the resolution of the converter cannot be measured. Noise that is a minor part of
    the residual cannot be separated from other structure. Time is not tested: the distribution of
    the logarithms is skew, so that random signs are no null distribution.
    """
    if any(step_size(track.response) > view.noise for track in view.tracks):
        return None
    local = np.concatenate([_local_noise(view, k) for k in range(len(view.tracks))])
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
    if best.gain <= 0.0 or best.p_value > max_p_value or ratio < MIN_RATIO:
        return None
    return NoiseLevel(score=best, local=local, level=np.exp(0.5 * mean), view=view)


def _local_noise(view: View, k: int) -> Array:
    """Return the magnitude of the noise at the rows of a track.

    Rows at which it cannot be measured have the typical level: next to samples that were not
    recorded, and where the second difference of the static response exceeds the noise.
    """
    track, static = view.tracks[k], view.static[k]
    noise = np.full(len(static), np.nan)
    noise[1:-1] = np.abs(np.diff(track.response - static, 2)) / sqrt(6.0)
    noise[1:-1][np.abs(np.diff(static, 2)) > sqrt(6.0) * view.noise] = np.nan
    for missing in track.bridged.tolist():
        noise[max(missing - 1, 0) : missing + 2] = np.nan
    rows = noise[track.rows]
    measured = rows[np.isfinite(rows) & (rows > 0.0)]
    typical = float(np.exp(np.mean(np.log(measured)))) if len(measured) else view.noise
    return np.where(np.isfinite(rows), rows, typical)


def excess_of(noise: NoiseLevel) -> tuple[float, float, float]:
    """Return the rms of the noise beyond its lowest level, with its 95 % interval, scaled.

    Blocks are independent. The order is lower limit, value, upper limit.
    """
    power = np.add.reduceat(noise.local**2, noise.view.null.edges)
    rows, quietest_power = len(noise.local), noise.range[0] ** 2
    mean = float(power.sum()) / rows
    margin = 1.96 * float(np.std(power, ddof=1)) * sqrt(len(power)) / rows
    low, value, high = (
        sqrt(max(mean + side * margin - quietest_power, 0.0)) for side in (-1.0, 0.0, 1.0)
    )
    return low, value, high
