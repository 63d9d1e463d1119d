"""Sample slips: instants after which the readings are some samples late or early.

A slip of L samples at sample m of a track adds

    c(t) = x(t - L) - x(t)  for t >= m,   0 before,

x the static response. Of the residual e it explains

    G(m, L) = (e . c)^2 / |c - P c|^2,    beta = (e . c) / |c - P c|^2,

P the projection on the nuisance class and on all that resembles a delay: a delay of each track,
the square and the root of speed, acceleration, relaxations. Running sums give all m at once. The
beta of a slip is near one.

Source: Rao (1948) for the score; Page, Biometrika 41 (1954) for the running sums.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.residual_view import View, with_tracks
from piezoid.diagnosis.segments import Places, Track
from piezoid.diagnosis.signals import answers_of_others
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import relaxed

MAX_LENGTH = 0.1  # of a track
LENGTHS = 16  # tried, early and late
INSTANTS = 120  # tried in a track
END_SHARE = 0.03  # of a track at either end, in which no slip is detectable
MIN_MOTION = 0.02  # of a track's squared speed, after a slip
MIN_ROWS = 100  # of a track
MIN_UNSHARED = 3e-3  # of the square of a column: smallest part orthogonal to the null
BETA_OF_ONE, BETA_OF_MORE = 0.6, 0.2  # smallest beta of a slip of one sample, and of more
RELAXATIONS_s = (3e-4, 3e-3, 3e-2, 0.3, 3.0)
SAMPLES_PER_REACH = 8000  # of a track, for one sample of reach of a slope
MAX_ROUNDS = 4  # of placing a slip and fitting the static response again


@dataclass(frozen=True, kw_only=True)
class Slip:
    """One slip.

    track    index of the track
    instant  first sample that is out of step
    samples  length, > 0: the readings after it are late; an estimate need not be an integer
    gain     share of the track's squared residual that it explains
    """

    track: int
    instant: int
    samples: float
    gain: float


def slip_places(slips: Sequence[Slip], tracks: Sequence[Track]) -> tuple[str, ...]:
    """State the recording of each slip, and its time if the recording is one track."""
    names = [track.name for track in tracks]
    descriptions = []
    for slip in slips:
        track = tracks[slip.track]
        start = f" from {slip.instant / track.rate_Hz:.4g} s on"
        descriptions.append(track.name + (start if names.count(track.name) == 1 else ""))
    return tuple(descriptions)


def max_slip(samples: int) -> int:
    """Return the length of the longest slip of a track of so many samples."""
    return int(MAX_LENGTH * samples)


def instant_error(samples: int) -> int:
    """Return the largest error of the instant of a slip before it is refined, in samples."""
    return int(2.5 * samples / INSTANTS) + 2


def delay_change(static: Array, rows: Places, samples: int) -> Array:
    """Return the change of a response by a delay of some samples, at some samples."""
    return np.asarray(static[np.clip(rows - samples, 0, len(static) - 1)] - static[rows])


def delay_like_null(view: View, *, other_axes: bool = False) -> Null:
    """Return the view's null with columns of everything else that resembles a delay.

    other_axes  with the responses to the drives of other axes as well
    """
    tracks = view.tracks
    speed = [
        _slope(static, max(1, len(static) // SAMPLES_PER_REACH)) * track.rate_Hz
        for static, track in zip(view.static, tracks, strict=True)
    ]
    second = [_slope(v, 2) * track.rate_Hz for v, track in zip(speed, tracks, strict=True)]
    third = [_slope(v, 2) * track.rate_Hz for v, track in zip(second, tracks, strict=True)]
    columns = [view.of_track(k, speed[k][track.rows]) for k, track in enumerate(tracks)]
    columns += [view.rows(second), view.rows(third)]
    columns += [view.rows([np.sign(v) * np.abs(v) ** power for v in speed]) for power in (0.5, 2)]
    for time_s in RELAXATIONS_s:
        delayed = [
            relaxed(static, time_s, track.rate_Hz) - static
            for static, track in zip(view.static, tracks, strict=True)
        ]
        columns.append(view.rows(delayed))
    columns += [answers_of_others(view)] if other_axes else []
    return Null(
        columns=np.column_stack([view.null.every, *(c for c in columns if np.any(c))]),
        response=view.response,
        block=view.block,
    )


def _slope(signal: Array, reach: int) -> Array:
    """Return the mean change per sample, over a reach to either side."""
    padded = np.pad(signal, reach, mode="edge")
    return np.asarray((padded[2 * reach :] - padded[: -2 * reach]) / (2 * reach))


@dataclass(frozen=True, kw_only=True, eq=False)
class SlipScan:
    """Scores of slips at the rows of one track.

    rows     of the track among all rows
    static   (samples,)
    samples  (rows,)  of these rows
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

    def instants(self) -> Places:
        """Return the rows at which a slip is tried."""
        n = len(self.samples)
        trials = np.linspace(END_SHARE * n, (1.0 - END_SHARE) * n, INSTANTS)
        first = np.unique(trials.astype(int))
        motion = delay_change(self.static, self.samples, 1) ** 2
        return np.asarray(first[_sums_from(motion, first) > MIN_MOTION * motion.sum()])

    def score(self, samples: int, first: Places) -> tuple[Array, Array]:
        """Return gain and beta of slips of one length from some rows on."""
        change = delay_change(self.static, self.samples, samples)
        product = _sums_from(self.residual * change, first)
        square, unshared = self._squares(change, first)
        is_unshared = unshared > MIN_UNSHARED * square + 1e-300
        beta = np.where(is_unshared, product / np.where(is_unshared, unshared, 1.0), 0.0)
        power = float(self.residual @ self.residual) + 1e-300
        return np.asarray(beta * product / power), np.asarray(beta)

    def unshared_part(self, samples: int, first: Places) -> Array:
        """Return the share of the square of such slips that the null cannot follow."""
        square, unshared = self._squares(delay_change(self.static, self.samples, samples), first)
        return np.asarray(unshared / (square + 1e-300))

    def _squares(self, change: Array, first: Places) -> tuple[Array, Array]:
        """Return sums of squares of a column from rows on, and of its part beside the null."""
        from scipy.linalg import solve_triangular

        square = _sums_from(change * change, first)
        shared = _sums_from(self.null.every[self.rows] * change[:, None], first) / self.null.scale
        half = solve_triangular(self.null.factor, shared.T, lower=True)
        return square, np.asarray(square - np.sum(half * half, axis=0))

    def promising_lengths(self, first: Places) -> list[int]:
        """Return the lengths of the largest lower limits of the gain, and one sample."""
        lengths = np.geomspace(1, max_slip(len(self.static)), LENGTHS)
        lengths = np.unique(np.round(lengths).astype(int)).tolist()
        limits = {}
        for samples in (*lengths, *(-length for length in lengths)):
            change = delay_change(self.static, self.samples, samples)
            product = _sums_from(self.residual * change, first)
            square = _sums_from(change * change, first)
            limits[samples] = float(np.max(np.maximum(product, 0.0) ** 2 / (square + 1e-300)))
        best = sorted(limits, key=lambda samples: -limits[samples])[:2]
        return list(dict.fromkeys([*best, 1, -1]))


def _sums_from(values: Array, first: Places) -> Array:
    """Return the sums from each of some rows to the end."""
    parts = np.add.reduceat(values, first, axis=0)
    return np.asarray(np.cumsum(parts[::-1], axis=0)[::-1])


def strongest_slips(view: View, null: Null) -> list[Slip]:
    """Return the strongest slip of every track, the largest gain first."""
    slips = [_strongest_slip(view, null, k) for k in range(len(view.tracks))]
    return sorted((s for s in slips if s is not None), key=lambda s: s.gain, reverse=True)


def _strongest_slip(view: View, null: Null, k: int) -> Slip | None:
    rows = view.tracks[k].rows
    if len(rows) < MIN_ROWS:
        return None
    scan = SlipScan.of(view, null, k)
    first = scan.instants()
    best = None
    for samples in scan.promising_lengths(first) if len(first) else ():
        gain, beta = scan.score(samples, first)
        # a tangent has the right sign but may be wrong in length, except of one sample
        low = BETA_OF_ONE if abs(samples) == 1 else BETA_OF_MORE
        high = max_slip(len(scan.static)) / abs(samples)
        gain = np.where((beta > low) & (beta < high), gain, 0.0)
        j = int(np.argmax(gain))
        if gain[j] > (best.gain if best else 0.0):
            best = Slip(
                track=k,
                instant=int(rows[first[j]]),
                samples=samples * float(beta[j]),
                gain=float(gain[j]),
            )
    return best


def refine_slip(
    view: View,
    slip: Slip,
    *,
    refit: Callable[[Sequence[Track]], View] | None = None,
    has_length: bool = False,
) -> Slip:
    """Refine the instant of a slip to a sample and its length to an integer.

    refit       refits repaired tracks with the effects of the view; None: it has none
    has_length  whether the length is fixed and only the instant is refined

    The static response is fitted again with the slip undone; the constants and initial states of
    the tracks are interpolated from rows to all samples.
    """
    k, samples = slip.track, round(slip.samples) or int(np.sign(slip.samples))
    slip = replace(slip, samples=samples)
    width = instant_error(len(view.tracks[k].drive))
    reach = 0 if has_length else max(2, abs(samples) // 6)
    for _ in range(MAX_ROUNDS):
        repaired = undo_slip(view, slip)
        if refit is not None:
            repaired = refit(repaired.tracks)
        track, static = repaired.tracks[k], repaired.static[k]
        residual = repaired.null.residual[repaired.track_rows(k)]
        constants = track.response[track.rows] - residual - static[track.rows]
        samples_of_track = np.arange(len(static))
        measured = view.tracks[k].response - np.interp(samples_of_track, track.rows, constants)
        refined = _best_neighbour(measured, static, slip, width, reach)
        if refined == slip:
            break
        slip = refined
    return slip


def _best_neighbour(measured: Array, static: Array, slip: Slip, width: int, reach: int) -> Slip:
    """Return the slip of the smallest error within a width of its instant and a reach."""
    n, samples = len(static), int(slip.samples)
    shortest, longest = max(samples - reach, -max_slip(n)), min(samples + reach, max_slip(n))
    first, stop = max(slip.instant - width, 2), min(slip.instant + width, n - 2)
    cumulative = np.concatenate([[0.0], np.cumsum((measured - static) ** 2)])
    smallest, best = np.inf, slip
    for length in range(shortest, longest + 1):
        if length == 0:
            continue
        error = measured - static - delay_change(static, np.arange(n), length)
        total = cumulative[first:stop] + np.cumsum((error**2)[::-1])[::-1][first:stop]
        j = int(np.argmin(total))
        if total[j] < smallest:
            smallest, best = float(total[j]), replace(slip, instant=first + j, samples=length)
    return best


def undo_slip(view: View, slip: Slip) -> View:
    """Return the view of tracks with one slip undone."""
    tracks = list(view.tracks)
    tracks[slip.track] = in_step(tracks[slip.track], slip)
    return with_tracks(view, tracks)


def in_step(track: Track, slip: Slip) -> Track:
    """Shift the readings after a slip back, and drop rows without a reading."""
    samples, count = int(slip.samples), len(track.response)
    samples_of_track = np.arange(count)
    source = np.where(
        samples_of_track >= slip.instant,
        np.clip(samples_of_track + samples, 0, count - 1),
        samples_of_track,
    )
    end = slip.instant + 2 + max(-samples, 0)
    is_missing = (track.rows > slip.instant - 3) & (track.rows < end)
    has_reading = ~is_missing & (track.rows + max(samples, 0) < count)
    return replace(
        track,
        response=track.response[source],
        rows=track.rows[has_reading],
        block=track.block[has_reading],
    )
