"""Sample slips: instants from which on the readings are some samples late or early.

A slip of L samples at sample m of a track adds

    c(t) = x(t - L) - x(t)  for t >= m,   0 before,

x the static response. Of the residual e it explains

    G(m, L) = (e . c)^2 / |c - P c|^2,    beta = (e . c) / |c - P c|^2,

P the projection on the nuisance class and on columns that resemble a delay: a delay of each track,
the square and the root of speed, acceleration, relaxations. Running sums give all m at once. The
beta of a slip is near one.

Source: Rao (1948) for the score; Page, Biometrika 41 (1954) for the running sums.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.segments import Places, Track
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import relaxed

MAX_LENGTH = 0.1  # of a track
LENGTHS = 16  # of trial slips, both early and late
INSTANTS = 120  # of trial slips in a track
END_SHARE = 0.03  # of a track at either end, in which no slip is detectable
MIN_MOTION = 0.02  # of a track's squared speed, after a slip
MIN_ROWS = 100  # of a track
MIN_ORTHOGONAL = 3e-3  # of the square of a column: smallest part orthogonal to the null
MIN_BETA_OF_ONE, MIN_BETA = 0.6, 0.2  # smallest beta of a slip of one sample, and of longer slips
RELAXATIONS_s = (3e-4, 3e-3, 3e-2, 0.3, 3.0)
SAMPLES_PER_REACH = 8000  # of a track, for one sample of reach of a slope
MAX_ROUNDS = 4  # of placing a slip and fitting the static response again

Refit = Callable[[Sequence[Track]], View]


@dataclass(frozen=True, kw_only=True)
class Slip:
    """A slip of the readings against the drive.

    track    index of the track
    instant  first sample after the slip
    samples  length, > 0: the readings after it are late; an estimate need not be an integer
    gain     share of the track's squared residual that it explains
    """

    track: int
    instant: int
    samples: float
    gain: float


def slip_locations(slips: Sequence[Slip], tracks: Sequence[Track]) -> tuple[str, ...]:
    """State the recording of each slip, and its time if the recording is one track."""
    names = [track.name for track in tracks]
    descriptions = []
    for slip in slips:
        track = tracks[slip.track]
        start = f" from {slip.instant / track.rate_Hz:.4g} s on"
        descriptions.append(track.name + (start if names.count(track.name) == 1 else ""))
    return tuple(descriptions)


def max_slip(samples: int) -> int:
    """Return the length of the longest slip of a track with this number of samples."""
    return int(MAX_LENGTH * samples)


def instant_error(samples: int) -> int:
    """Return the largest error of the instant of a slip before it is refined, in samples."""
    return int(2.5 * samples / INSTANTS) + 2


def delay_change(static: Array, rows: Places, samples: int) -> Array:
    """Return the change of a static response by a delay of some samples, at the rows."""
    return np.asarray(static[np.clip(rows - samples, 0, len(static) - 1)] - static[rows])


def delay_like_null(view: View, *further_columns: Array) -> Null:
    """Return the null of a view, extended by columns that resemble a delay.

    further_columns  (rows, columns) of other causes, with which to extend it as well
    """
    tracks = view.tracks
    speed = [
        _slope(static, max(1, len(static) // SAMPLES_PER_REACH)) * track.rate_Hz
        for static, track in zip(view.static, tracks, strict=True)
    ]
    second = [_slope(v, 2) * track.rate_Hz for v, track in zip(speed, tracks, strict=True)]
    third = [_slope(v, 2) * track.rate_Hz for v, track in zip(second, tracks, strict=True)]
    columns = [view.track_column(k, speed[k][track.rows]) for k, track in enumerate(tracks)]
    columns += [view.rows(second), view.rows(third)]
    columns += [view.rows([np.sign(v) * np.abs(v) ** power for v in speed]) for power in (0.5, 2)]
    for time_s in RELAXATIONS_s:
        delayed = [
            relaxed(static, time_s, track.rate_Hz) - static
            for static, track in zip(view.static, tracks, strict=True)
        ]
        columns.append(view.rows(delayed))
    columns += further_columns
    return Null(
        columns=np.column_stack([view.null.all_columns, *(c for c in columns if np.any(c))]),
        response=view.response,
        block=view.block,
    )


def _slope(signal: Array, reach: int) -> Array:
    """Return the mean change per sample over a number of samples on either side."""
    padded = np.pad(signal, reach, mode="edge")
    return np.asarray((padded[2 * reach :] - padded[: -2 * reach]) / (2 * reach))


@dataclass(frozen=True, kw_only=True, eq=False)
class SlipScan:
    """Scores of slips at the rows of one track.

    null     with columns that resemble a delay
    rows     rows of the track among those of all tracks
    static   (samples,)  static response of the track
    samples  (rows,)     samples of the rows
    """

    null: Null
    rows: slice
    static: Array
    samples: Places

    @classmethod
    def of(cls, view: View, null: Null, k: int) -> "SlipScan":
        """Return the scan of one track of a view."""
        return cls(
            null=null,
            rows=view.track_rows(k),
            static=view.static[k],
            samples=view.tracks[k].rows,
        )

    @property
    def residual(self) -> Array:
        """Return the residual of the track."""
        return self.null.residual[self.rows]

    def change(self, samples: int) -> Array:
        """Return the column of a slip of one length at every row."""
        return delay_change(self.static, self.samples, samples)

    def instants(self) -> Places:
        """Return the rows at which a slip is tried; a track with few rows has none."""
        n = len(self.samples)
        if n < MIN_ROWS:
            return np.zeros(0, dtype=int)
        trials = np.linspace(END_SHARE * n, (1.0 - END_SHARE) * n, INSTANTS)
        first = np.unique(trials.astype(int))
        motion = self.change(1) ** 2
        return np.asarray(first[_sums_from(motion, first) > MIN_MOTION * motion.sum()])

    def score(self, samples: int, first: Places) -> tuple[Array, Array]:
        """Return gain and beta of slips of one length that start at some rows."""
        change = self.change(samples)
        product = _sums_from(self.residual * change, first)
        square, orthogonal = self.squares(samples, first)
        is_orthogonal = orthogonal > MIN_ORTHOGONAL * square + 1e-300
        beta = np.where(is_orthogonal, product / np.where(is_orthogonal, orthogonal, 1.0), 0.0)
        power = float(self.residual @ self.residual) + 1e-300
        return np.asarray(beta * product / power), np.asarray(beta)

    def squares(self, samples: int, first: Places) -> tuple[Array, Array]:
        """Return the squares of the columns of such slips, whole and orthogonal to the null."""
        from scipy.linalg import solve_triangular

        change = self.change(samples)
        square = _sums_from(change * change, first)
        products = self.null.all_columns[self.rows] * change[:, None]
        shared = _sums_from(products, first) / self.null.scale
        half = solve_triangular(self.null.factor, shared.T, lower=True)
        return square, np.asarray(square - np.sum(half * half, axis=0))

    def promising_lengths(self, first: Places) -> list[int]:
        """Return the lengths of the largest lower limits of the gain, and one sample."""
        lengths = np.geomspace(1, max_slip(len(self.static)), LENGTHS)
        lengths = np.unique(np.round(lengths).astype(int)).tolist()
        limits = {}
        for samples in (*lengths, *(-length for length in lengths)):
            change = self.change(samples)
            product = _sums_from(self.residual * change, first)
            square = _sums_from(change * change, first)
            limits[samples] = float(np.max(np.maximum(product, 0.0) ** 2 / (square + 1e-300)))
        best = sorted(limits, key=lambda samples: -limits[samples])[:2]
        return list(dict.fromkeys([*best, 1, -1]))


def _sums_from(values: Array, first: Places) -> Array:
    """Return the sums from each of these rows to the end."""
    parts = np.add.reduceat(values, first, axis=0)
    return np.asarray(np.cumsum(parts[::-1], axis=0)[::-1])


def strongest_slips(view: View, null: Null) -> list[Slip]:
    """Return the strongest slip of every track, the largest gain first."""
    slips = []
    for k, track in enumerate(view.tracks):
        scan, best = SlipScan.of(view, null, k), None
        first = scan.instants()
        for samples in scan.promising_lengths(first) if len(first) else ():
            gain, beta = scan.score(samples, first)
            # a tangent has the right sign but may be wrong in length, except of one sample
            low = MIN_BETA_OF_ONE if abs(samples) == 1 else MIN_BETA
            high = max_slip(len(scan.static)) / abs(samples)
            gain = np.where((beta > low) & (beta < high), gain, 0.0)
            j = int(np.argmax(gain))
            if gain[j] > (best.gain if best else 0.0):
                best = Slip(
                    track=k,
                    instant=int(track.rows[first[j]]),
                    samples=samples * float(beta[j]),
                    gain=float(gain[j]),
                )
        if best is not None:
            slips.append(best)
    return sorted(slips, key=lambda slip: slip.gain, reverse=True)


def refine_slip(
    view: View,
    slip: Slip,
    *,
    refit: Refit,
    has_length: bool = False,
) -> Slip:
    """Refine the instant of a slip to a sample and its length to an integer.

    refit       refits repaired tracks with the effects of the view
    has_length  whether the length is fixed and only the instant is refined

    The static response is refitted with the slip undone, for every trial of the length: a response
    that was fitted with a wrong length absorbs a part of the rest. For its instant the
    contribution of the zero and of the initial state is interpolated from rows to all samples.
    """
    slip = replace(slip, samples=round(slip.samples) or int(np.sign(slip.samples)))
    longest = max_slip(len(view.tracks[slip.track].drive))

    def repaired(trial: Slip) -> View:
        return refit(without_slips(view.tracks, trial))

    for _ in range(MAX_ROUNDS):
        refined = _best_instant(view, repaired(slip), slip)
        if not has_length:
            rms = repaired(refined).rms
            step = max(1, int(abs(slip.samples)) // 6)
            while step:
                trials = [
                    (repaired(trial).rms, trial)
                    for change in (step, -step)
                    if 0 < np.sign(slip.samples) * (refined.samples + change) <= longest
                    and (trial := replace(refined, samples=refined.samples + change))
                ]
                best_rms, best = min(trials, key=itemgetter(0), default=(np.inf, refined))
                if best_rms < rms:
                    rms, refined = best_rms, best
                else:
                    step //= 2
        if refined == slip:
            break
        slip = refined
    return slip


def _best_instant(view: View, repaired: View, slip: Slip) -> Slip:
    """Return the slip at the instant with the smallest error, near its own.

    repaired  the view with the slip undone
    """
    k = slip.track
    track, static, n = repaired.tracks[k], repaired.static[k], len(repaired.static[k])
    residual = repaired.null.residual[repaired.track_rows(k)]
    offsets = track.response[track.rows] - residual - static[track.rows]
    error = view.tracks[k].response - np.interp(np.arange(n), track.rows, offsets) - static
    later_error = error - delay_change(static, np.arange(n), int(slip.samples))
    power_before = np.concatenate([[0.0], np.cumsum(error**2)])
    power_after = np.cumsum((later_error**2)[::-1])[::-1]
    width = instant_error(len(view.tracks[k].drive))
    first, stop = max(slip.instant - width, 2), min(slip.instant + width, n - 2)
    return replace(
        slip, instant=first + int(np.argmin((power_before[:-1] + power_after)[first:stop]))
    )


def without_slips(tracks: Sequence[Track], *slips: Slip) -> list[Track]:
    """Undo slips one after the other: shift the readings after each back, and drop lost rows."""
    repaired = list(tracks)
    for slip in slips:
        track = repaired[slip.track]
        samples, count = int(slip.samples), len(track.response)
        index = np.arange(count)
        source = np.where(index >= slip.instant, np.clip(index + samples, 0, count - 1), index)
        end = slip.instant + 2 + max(-samples, 0)
        is_missing = (track.rows > slip.instant - 3) & (track.rows < end)
        has_reading = ~is_missing & (track.rows + max(samples, 0) < count)
        repaired[slip.track] = replace(
            track,
            response=track.response[source],
            rows=track.rows[has_reading],
            block=track.block[has_reading],
        )
    return repaired
