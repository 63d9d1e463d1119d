"""Noise level: where the white noise of the readings is not the same everywhere.

What is left may be no curve at all: a sensor that is noisier far out, an amplifier that is louder
while it slews. Nothing of that is in a mean, and no cause explains it. The noise at a sample is
the second difference of what the static response leaves, which hysteresis hardly enters,

    d_i^2 = (e_(i-1) - 2 e_i + e_(i+1))^2 / 6,      log d_i^2 = zero of the track + f(x_i) + xi,

xi the logarithm of chi-squared, of mean -1.27. f along one coordinate at a time is judged as a
remainder is: on blocks left out, against the same logarithms shifted along each recording.

Source: Harvey, Econometrica 44 (1976) on regressions of the logarithm; von Neumann (1941) on
differences.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.coordinate_bases import Basis, along_signals
from piezoid.diagnosis.coordinate_tests import CoordinateScore, Remainder
from piezoid.diagnosis.residual_view import View
from piezoid.numerics.arrays import Array
from piezoid.records.sample_statistics import step_size

MEAN_LOG = -1.2704  # of chi-squared of one degree: the digamma of 1/2, and log 2
LEAST = 1e-3  # of the noise: what rounding may make of a difference
ENDS = (0.02, 0.98)  # quantiles of the level: the quietest and the loudest place
# The loudest over the quietest: at most 1.5 on an outsider's healthy stages, 1.7 with a delay, and
# from 3.7 on where the noise grows by the reading or the speed (docs/how_piezoid_decides.md).
LOUDER = 2.0
MOSTLY = 0.5  # of the power that is left


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseLevel:
    """The level of the noise along the coordinate that tells most of it.

    lives  the curve of its logarithm
    local  (rows,)  the noise at a row, without sign
    level  (rows,)  its rms there, of the curve
    view   whose rows these are
    """

    lives: CoordinateScore
    local: Array
    level: Array
    view: View

    @property
    def range(self) -> tuple[float, float]:
        """Return the level in the quietest place and in the loudest."""
        low, high = np.quantile(self.level, ENDS)
        return float(low), float(high)


def noise_level(view: View, sure: float) -> NoiseLevel | None:
    """Return where the noise lives, None where it is the same everywhere.

    sure  largest p-value of a coordinate

    A reading that stands on a converter's steps has no noise that could be told. Where the static
    response bends by more than the noise from sample to sample, what is wrong with it may as well,
    and such a row counts as one of the middle level. Where most of what is left is no noise, its
    own differences would pass for some.
    """
    if any(step_size(track.response) > view.noise for track in view.tracks):
        return None
    local = np.concatenate([_local(view, k) for k in range(len(view.tracks))])
    if float(np.mean(local**2)) < MOSTLY * view.rms**2:
        return None
    values = np.log(np.maximum(local, LEAST * view.noise) ** 2)
    zeros = np.column_stack(
        [view.of_track(k, np.ones(len(t.place))) for k, t in enumerate(view.tracks)]
    )
    remainder = Remainder(view=view, null=Null(columns=zeros, response=values, block=view.block))
    lives = _best(remainder, along_signals(view))
    mean = values - remainder.left + lives.followed - MEAN_LOG
    louder = np.exp(0.5 * np.diff(np.quantile(lives.followed, ENDS)))
    if lives.gain <= 0.0 or lives.p_value > sure or louder < LOUDER:
        return None
    return NoiseLevel(lives=lives, local=local, level=np.exp(0.5 * mean), view=view)


def _best(remainder: Remainder, bases: list[Basis]) -> CoordinateScore:
    """Return the coordinate along which most of the noise's logarithm goes.

    Time is none of them: logarithms are skew, and chance signs make no null of a course then.
    """
    moved = remainder.shifted(np.random.default_rng(0))
    tried = [remainder.lives_beside(basis, moved) for basis in bases]
    most = np.max([gains for _, gains in tried], axis=0)
    best = max((one for one, _ in tried), key=lambda one: one.gain)
    return replace(best, p_value=(1.0 + float(np.sum(most >= best.gain))) / (1.0 + len(most)))


def _local(view: View, k: int) -> Array:
    """Return the noise at the rows of a track, without sign; the middle one where none is told."""
    track, static = view.tracks[k], view.static[k]
    found = np.full(len(static), np.nan)
    found[1:-1] = np.abs(np.diff(track.response - static, 2)) / sqrt(6.0)
    found[1:-1][np.abs(np.diff(static, 2)) > sqrt(6.0) * view.noise] = np.nan
    for lost in track.bridged.tolist():
        found[max(lost - 1, 0) : lost + 2] = np.nan
    own = found[track.place]
    told = own[np.isfinite(own) & (own > 0.0)]
    middle = float(np.exp(np.mean(np.log(told)))) if len(told) else view.noise
    return np.where(np.isfinite(own), own, middle)


def excess_of(found: NoiseLevel) -> tuple[float, float, float]:
    """Return the rms of the noise beyond its quietest place, with its 95 % interval, scaled.

    Blocks are independent.
    """
    null = found.view.null
    power = np.add.reduceat(found.local**2, null.edges)
    rows, quiet = len(found.local), found.range[0] ** 2
    mean = float(power.sum()) / rows
    spread = 1.96 * float(np.std(power, ddof=1)) * sqrt(len(power)) / rows
    low, value, high = (sqrt(max(mean + way * spread - quiet, 0.0)) for way in (-1.0, 0.0, 1.0))
    return low, value, high
