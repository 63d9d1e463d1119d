"""Slips: instants from which a reading comes a fixed number of samples late or early.

A slip of L samples at sample m of a track adds

    c(t) = x(t - L) - x(t)  for t >= m,   0 before,

x the static response. What it takes of the residual e beside everything else that can be told is

    G(m, L) = (e . c)^2 / |c - P c|^2,    beta = (e . c) / |c - P c|^2,

P the projection on the nuisance class and on all that looks like a delay: one of its own for every
track, the square and the root of speed, acceleration, relaxations. Running sums give all m at
once. A slip that is one has beta near one.

A slip in the fast half of a chirp looks like a delay of all of the chirp: nothing slow can tell.
Where a clock is known to slip, slips by as many samples are a simpler tale than a delay beside
them. Each must leave no more of its track than a delay of the track's own with lags and
relaxations beside it could,

    rms_k(slips) <= A rms_k(nuisance class, all that looks like a delay),

and together they must leave less than the filter that stands there.

Source: Rao (1948) for the score; Page, Biometrika 41 (1954) for the running sums.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.refitted_view import SelectedEffect, with_effects
from piezoid.diagnosis.residual_view import View, with_tracks
from piezoid.diagnosis.segments import Places, Track
from piezoid.diagnosis.signals import answers_of_others
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import relaxed

ENOUGH = 1.1  # times what all that looks like a delay leaves of the track
TAKES = 0.3  # of the track's squared residual: what a slip must take to be tried
ROUNDED = 12.0**-0.5  # samples: the spread of what is a whole number
FARTHEST = 0.1  # of a track: the longest slip
LENGTHS = 16  # tried, early and late
INSTANTS = 120  # of a track, tried
EDGE = 0.03  # of a track at either end, in which no slip can be seen
MOVING = 0.02  # of a track's squared speed that must lie behind a slip
FEWEST = 100  # rows of a track
OWN = 3e-3  # of a column's square that must be left beside all others
RELAXATIONS_s = (3e-4, 3e-3, 3e-2, 0.3, 3.0)
SMOOTH = 8000  # samples of a track for one of the reach of a slope
ROUNDS = 4  # of placing one and fitting the static response again


@dataclass(frozen=True, kw_only=True)
class Slip:
    """One slip.

    track    number of the track
    instant  first sample that is out of step
    samples  by how many, > 0: what follows comes late; the best estimate, which need not be whole
    gain     part of the track's own squared residual that it takes
    """

    track: int
    instant: int
    samples: float
    gain: float


def places_of(slips: Sequence[Slip], tracks: Sequence[Track]) -> tuple[str, ...]:
    """Return from when on which recordings are out of step, for people.

    Of a recording in several parts only its name is told: a part does not know when it began.
    """
    names = [track.name for track in tracks]
    found = []
    for slip in slips:
        track = tracks[slip.track]
        since = f" from {slip.instant / track.rate_Hz:.4g} s on"
        found.append(track.name + (since if names.count(track.name) == 1 else ""))
    return tuple(found)


def longest(samples: int) -> int:
    """Return the longest slip of a track of so many samples."""
    return int(FARTHEST * samples)


def late(static: Array, place: Places, samples: int) -> Array:
    """Return what a delay by some samples changes at some places."""
    return np.asarray(static[np.clip(place - samples, 0, len(static) - 1)] - static[place])


def beside(view: View, *, others: bool = False) -> Null:
    """Return the view's null with everything else that looks like a delay.

    others  with what other axes' drives could add as well
    """
    speed = [
        _slope(static, max(1, len(static) // SMOOTH)) * track.rate_Hz
        for static, track in zip(view.static, view.tracks, strict=True)
    ]
    twice = [_slope(v, 2) * t.rate_Hz for v, t in zip(speed, view.tracks, strict=True)]
    thrice = [_slope(v, 2) * t.rate_Hz for v, t in zip(twice, view.tracks, strict=True)]
    columns = [view.of_track(k, speed[k][track.place]) for k, track in enumerate(view.tracks)]
    columns += [view.rows(twice), view.rows(thrice)]
    columns += [view.rows([np.sign(v) * np.abs(v) ** power for v in speed]) for power in (0.5, 2)]
    columns += [_relaxation(view, time_s) for time_s in RELAXATIONS_s]
    columns += [answers_of_others(view)] if others else []
    return Null(
        columns=np.column_stack([view.null.every, *(c for c in columns if np.any(c))]),
        response=view.response,
        block=view.block,
    )


def _relaxation(view: View, time_s: float) -> Array:
    return view.of(lambda k, t: relaxed(view.static[k], time_s, t.rate_Hz) - view.static[k])


def _slope(signal: Array, reach: int) -> Array:
    """Return the mean change for one sample, over as many to either side."""
    padded = np.pad(signal, reach, mode="edge")
    return np.asarray((padded[2 * reach :] - padded[: -2 * reach]) / (2 * reach))


def strongest(view: View, null: Null) -> list[Slip]:
    """Return the slip of every track that takes most of its residual, largest gain first."""
    slips = [_strongest(view, null, k) for k in range(len(view.tracks))]
    return sorted((s for s in slips if s is not None), key=lambda s: s.gain, reverse=True)


def _strongest(view: View, null: Null, k: int) -> Slip | None:
    place = view.tracks[k].place
    if len(place) < FEWEST:
        return None
    track = Searched.of(view, null, k)
    first = track.instants()
    best = None
    for samples in track.promising(first) if len(first) else ():
        gain, beta = track.score(samples, first)
        # a tangent knows the direction, a slip of one sample must be nearly whole
        least, most = 0.6 if abs(samples) == 1 else 0.2, longest(len(track.static)) / abs(samples)
        gain = np.where((beta > least) & (beta < most), gain, 0.0)
        j = int(np.argmax(gain))
        if gain[j] > (best.gain if best else 0.0):
            best = Slip(
                track=k,
                instant=int(place[first[j]]),
                samples=samples * float(beta[j]),
                gain=float(gain[j]),
            )
    return best


@dataclass(frozen=True, kw_only=True, eq=False)
class Searched:
    """One track against a null: what a slip at any row would take.

    rows    of the track among all rows
    static  (samples,)
    place   (rows,)
    """

    null: Null
    rows: slice
    static: Array
    place: Places

    @classmethod
    def of(cls, view: View, null: Null, k: int) -> "Searched":
        """Return a track of a view."""
        edges = view.nuisance.edges
        return cls(
            null=null,
            rows=slice(int(edges[k]), int(edges[k + 1])),
            static=view.static[k],
            place=view.tracks[k].place,
        )

    @property
    def residual(self) -> Array:
        """Return what the null leaves of the track."""
        return self.null.residual[self.rows]

    def instants(self) -> Places:
        """Return the rows at which a slip is tried."""
        n = len(self.place)
        first = np.unique(np.linspace(EDGE * n, (1.0 - EDGE) * n, INSTANTS).astype(int))
        energy = late(self.static, self.place, 1) ** 2
        return np.asarray(first[_behind(energy, first) > MOVING * energy.sum()])

    def score(self, samples: int, first: Places) -> tuple[Array, Array]:
        """Return gain and beta of slips by some samples from some rows on."""
        c = late(self.static, self.place, samples)
        pull = _behind(self.residual * c, first)
        square, own = self._squares(c, first)
        seen = own > OWN * square + 1e-300
        beta = np.where(seen, pull / np.where(seen, own, 1.0), 0.0)
        whole = float(self.residual @ self.residual) + 1e-300
        return np.asarray(beta * pull / whole), np.asarray(beta)

    def own_share(self, samples: int, first: Places) -> Array:
        """Return which part of the square of such slips nothing else can stand for."""
        square, own = self._squares(late(self.static, self.place, samples), first)
        return np.asarray(own / (square + 1e-300))

    def _squares(self, c: Array, first: Places) -> tuple[Array, Array]:
        """Return the squares of a column from some rows on, and what the null leaves of them."""
        from scipy.linalg import solve_triangular

        square = _behind(c * c, first)
        shared = _behind(self.null.every[self.rows] * c[:, None], first) / self.null.scale
        half = solve_triangular(self.null.factor, shared.T, lower=True)
        return square, np.asarray(square - np.sum(half * half, axis=0))

    def promising(self, first: Places) -> list[int]:
        """Return the lengths that take most where nothing is shared, which is a lower limit."""
        lengths = np.geomspace(1, longest(len(self.static)), LENGTHS)
        lengths = np.unique(np.round(lengths).astype(int)).tolist()
        taken = {}
        for samples in (*lengths, *(-length for length in lengths)):
            c = late(self.static, self.place, samples)
            pull, square = _behind(self.residual * c, first), _behind(c * c, first)
            taken[samples] = float(np.max(np.maximum(pull, 0.0) ** 2 / (square + 1e-300)))
        most = sorted(taken, key=lambda samples: -taken[samples])[:2]
        return list(dict.fromkeys([*most, 1, -1]))


def _behind(values: Array, first: Places) -> Array:
    """Return the sums from each of some rows to the end."""
    parts = np.add.reduceat(values, first, axis=0)
    return np.asarray(np.cumsum(parts[::-1], axis=0)[::-1])


def width_of(samples: int) -> int:
    """Return how far from where it was found the instant of a slip may be."""
    return int(2.5 * samples / INSTANTS) + 2


def placed(
    view: View,
    slip: Slip,
    *,
    again: Callable[[Sequence[Track]], View] | None = None,
    fixed: bool = False,
) -> Slip:
    """Return the slip at the sample and of the whole length that fit best, all samples compared.

    again  fits tracks put right as the view was fitted, where effects are at work in it
    fixed  the length is known, the instant is not

    The static response is fitted again with the slip undone; what tracks have of their own (zero,
    memory) is carried from rows to all samples.
    """
    k, samples = slip.track, round(slip.samples) or int(np.sign(slip.samples))
    slip = replace(slip, samples=samples)
    width = width_of(len(view.tracks[k].drive))
    for _ in range(ROUNDS):
        there = again(undone(view, slip).tracks) if again else undone(view, slip)
        track, static = there.tracks[k], there.static[k]
        here = there.null.residual[slice(*there.nuisance.edges[k : k + 2])]
        own = track.response[track.place] - here - static[track.place]
        place = np.arange(len(static))
        measured = view.tracks[k].response - np.interp(place, track.place, own)
        better = _best(measured, static, slip, width, 0 if fixed else max(2, abs(samples) // 6))
        if better == slip:
            break
        slip = better
    return slip


def _best(measured: Array, static: Array, slip: Slip, width: int, reach: int) -> Slip:
    """Return the neighbour in place, and in length up to a reach, that leaves least squares."""
    n, samples = len(static), int(slip.samples)
    shortest, farthest = max(samples - reach, -longest(n)), min(samples + reach, longest(n))
    place = np.arange(n)
    first, last = max(slip.instant - width, 2), min(slip.instant + width, n - 2)
    before = np.concatenate([[0.0], np.cumsum((measured - static) ** 2)])
    best = (np.inf, slip)
    for length in range(shortest, farthest + 1):
        if length == 0:
            continue
        missed = measured - static - late(static, place, length)
        total = before[first:last] + np.cumsum((missed**2)[::-1])[::-1][first:last]
        j = int(np.argmin(total))
        if total[j] < best[0]:
            best = (float(total[j]), replace(slip, instant=first + j, samples=length))
    return best[1]


def undone(view: View, slip: Slip) -> View:
    """Return the view of tracks in which a slip is put back in step."""
    tracks = list(view.tracks)
    tracks[slip.track] = in_step(tracks[slip.track], slip)
    return with_tracks(view, tracks)


def in_step(track: Track, slip: Slip) -> Track:
    """Put the readings behind an instant back in step; rows that have no reading are left out."""
    samples, count = int(slip.samples), len(track.response)
    place = np.arange(count)
    source = np.where(place >= slip.instant, np.clip(place + samples, 0, count - 1), place)
    reach = 2 + max(-samples, 0)
    lost = (track.place > slip.instant - 3) & (track.place < slip.instant + reach)
    kept = ~lost & (track.place + max(samples, 0) < count)
    return replace(
        track,
        response=track.response[source],
        place=track.place[kept],
        block=track.block[kept],
    )


def slips_in_place(
    clean: View, others: Sequence[SelectedEffect], cause: View, known: Fault
) -> tuple[View, Fault] | None:
    """Return tracks put back in step and the slips as a fault; None where the filter stands.

    others  what was selected but the filter
    cause   the view with the filter at work
    known   what slipped elsewhere
    """
    without = with_effects(clean, others)
    could = _rms_of_tracks(without, beside(without))
    there = clean
    found: list[Slip] = []
    for slip in strongest(without, without.null):
        if slip.gain < TAKES:
            break
        view = with_effects(there, others)
        one = placed(view, slip, again=partial(_again, there, others))
        better = undone(there, one)
        after = with_effects(better, others)
        follows = _rms_of_tracks(after, after.null)[slip.track] < ENOUGH * could[slip.track]
        if follows and after.rms < view.rms:
            there, found = better, [*found, one]
    if not found or with_effects(there, others).rms >= cause.rms:
        return None
    first = max(found, key=lambda slip: slip.gain)
    if abs(first.samples) != abs(known.value):
        return None
    place = without.tracks[first.track].place
    change = late(without.static[first.track], place, int(first.samples))
    column = without.of_track(first.track, np.where(place >= first.instant, change, 0.0))[:, None]
    spread = abs(first.samples) * float(np.sqrt(without.null.clustered_covariance(column)[0, 0]))
    return there, Fault(
        tracks=there.tracks,
        value=first.samples,
        spread=float(np.hypot(spread, ROUNDED)),
        p_value=without.null.cross_validated(column).p_value,
        where=places_of(found, without.tracks),
    )


def _again(clean: View, others: Sequence[SelectedEffect], tracks: Sequence[Track]) -> View:
    return with_effects(with_tracks(clean, tracks), others)


def _rms_of_tracks(view: View, null: Null) -> list[float]:
    parts = [null.residual[a:b] for a, b in pairwise(view.nuisance.edges)]
    return [float(np.sqrt(np.mean(part**2))) for part in parts]
