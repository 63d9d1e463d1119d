"""The structural envelope: a wide class of hysteresis that does not know of rate, time or other
axes.

    y = sum_(i, n) c_in z_i^n + (d_i u + e_i u^2) z_i + sum_j f_j(x_j, u) + zero of the track

z_i plays, n = 1 .. 4; x_j friction states that forget exponentially with the way the drive went,

    dx/dt = du/dt - |du/dt| x / r,

f_j their powers and their products with the drive; and, where that beats every effect, one
Bouc-Wen state of free parameters, because its small loops do not close. Plays with powers of their
states are Preisach operators in play form; products with the drive let loops change with bias;
friction states are Dahl's. The class is far wider than any model that ships: what it can follow is
no evidence of a cause, and effects are decided on what it cannot.

Source: Krejci (1996); Dahl (1968); Bouc (1967); a wide class of nulls, Box (1980).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from piezoid.diagnosis.friction import FRICTION, rubbed
from piezoid.diagnosis.tracks import Places, Track
from piezoid.numerics.arrays import Array
from piezoid.operators.bouc_wen import bouc_wen_states
from piezoid.operators.friction import friction_states
from piezoid.operators.play import first_carry, play_columns, play_tangents
from piezoid.operators.polynomials import sum_of_polynomials

PLAYS = 18
POWERS = 4
FORGETTING = 4  # groups of plays whose first states each track may correct
PASTS = 16
ONCE, TWICE = 9, 5  # places of turns to try
CHUNK = 65536

FINE = 6  # plays below TURN_AT, by equal ratios; the others by equal steps
TURN_AT = 0.15
THRESHOLD = np.concatenate(
    [np.geomspace(0.01, TURN_AT, FINE + 1)[:-1], np.linspace(TURN_AT, 0.97, PLAYS - FINE)]
)
SHARED = (PLAYS + 1) * POWERS + 2 * PLAYS + 5 * len(FRICTION)
KNEE_COLUMNS = 5
Knee = tuple[float, float, float]
Turns = tuple[float, ...]


def past(drive: Array, turns: Sequence[float]) -> Array:
    """Return the memory a drive leaves that turned at these values before the first sample."""
    way = np.array([*turns, float(drive[0])])
    return play_columns(way, THRESHOLD, np.zeros(PLAYS))[1]


def pasts(drive: Array) -> tuple[Turns, ...]:
    """Return histories to choose from: cycled over the range first, then what people do instead.

    They come from rest or from one end, and turn once or twice more, or at random.
    """
    low, high = min(-1.0, float(drive.min())), max(1.0, float(drive.max()))
    once = np.linspace(low, high, ONCE + 2)[1:-1].tolist()
    twice = np.linspace(low, high, TWICE + 2)[1:-1].tolist()
    chance = np.random.default_rng(PASTS)
    drawn = [
        (*chance.uniform((-0.3, -1, -0.3, -1, -0.3, -1), (1, 0.3, 1, 0.3, 1, 0.3)).tolist(),)
        for _ in range(PASTS)
    ]
    return (
        (low, high),
        (high, low),
        (0.0,),
        *((end, turn) for end in (low, high, 0.0) for turn in once),
        *((end, a, b) for end in (low, high) for a in twice for b in twice if a != b),
        *drawn,
    )


def shape_columns(states: Array, friction: Array, drive: Array) -> Array:
    """Return all shared columns at some rows: first powers of the drive and of the plays.

    states    (rows, plays)
    friction  (rows, friction states)
    drive     (rows,)
    """
    base = np.column_stack([drive, states / (1.05 - THRESHOLD)])
    parts = [base]
    for _ in range(POWERS - 1):
        parts.append(parts[-1] * base)
    u = drive[:, None]
    x = friction / np.minimum(FRICTION, 1.0)
    parts += [u * base[:, 1:], u**2 * base[:, 1:], x, x**2, x**3, u * x, u**2 * x]
    return np.hstack(parts)


def shape(states: Array, friction: Array, drive: Array, weight: Array) -> Array:
    """Return ``shape_columns(...) @ weight`` without making the columns, (rows,)."""
    plays = PLAYS + 1
    power = weight[: plays * POWERS].reshape(POWERS, plays)
    bias = weight[plays * POWERS :][: 2 * PLAYS].reshape(2, PLAYS)
    rub = weight[plays * POWERS + 2 * PLAYS :].reshape(5, len(FRICTION))
    u = drive
    base = u * (power[0, 0] + u * (power[1, 0] + u * (power[2, 0] + u * power[3, 0])))
    of_plays = sum_of_polynomials(
        states, u, scale=1.0 / (1.05 - THRESHOLD), power=power[:, 1:], bias=bias
    )
    of_friction = sum_of_polynomials(
        friction, u, scale=1.0 / np.minimum(FRICTION, 1.0), power=rub[:3], bias=rub[3:]
    )
    return np.asarray(base + of_plays + of_friction)


def knee_columns(state: Array, drive: Array) -> Array:
    """Return the columns of a Bouc-Wen state: its powers and its products with the drive."""
    return np.column_stack([state, state**2, state**3, drive * state, drive**2 * state])


@dataclass(frozen=True, kw_only=True, eq=False)
class Envelope:
    """The class on some tracks, each with a past.

    tracks  what is followed
    turns   (tracks,)  values at which the drive turned before each track
    knee    beta, gamma and exponent of a Bouc-Wen state beside the others, or none
    free    whether the first states of every track may be corrected
    """

    tracks: tuple[Track, ...]
    turns: tuple[Turns, ...]
    knee: Knee | None = None
    free: bool = False

    @cached_property
    def edges(self) -> Places:
        """Return the first row of each track, and the number of rows."""
        return np.concatenate([[0], np.cumsum([len(track.place) for track in self.tracks])])

    @cached_property
    def shared(self) -> int:
        """Return how many columns all tracks share."""
        return SHARED + (KNEE_COLUMNS if self.knee else 0)

    @property
    def own(self) -> int:
        """Return how many columns belong to one track."""
        return 1 + (FORGETTING if self.free else 0)

    @property
    def memory_columns(self) -> tuple[int, ...]:
        """Return the columns that correct the first states of each track, where these are free."""
        if not self.free:
            return ()
        firsts = [self.shared + self.own * k + 1 for k in range(len(self.tracks))]
        return tuple(first + g for first in firsts for g in range(FORGETTING))

    @property
    def bias_columns(self) -> tuple[int, ...]:
        """Return the columns that are products of a state with the drive."""
        plays = (PLAYS + 1) * POWERS
        friction = plays + 2 * PLAYS + 3 * len(FRICTION)
        return (
            *range(plays, plays + 2 * PLAYS),
            *range(friction, SHARED),
            *range(SHARED, self.shared)[-2:],
        )

    @cached_property
    def columns(self) -> Array:
        """Return the columns at all rows: shared ones, then each track's own."""
        total = self.shared + self.own * len(self.tracks)
        columns = np.zeros((self.edges[-1], total), order="F")
        for k, track in enumerate(self.tracks):
            rows = slice(self.edges[k], self.edges[k + 1])
            memory = first_carry(past(track.drive, self.turns[k]))
            tangents = play_tangents(track.drive, THRESHOLD, memory)
            columns[rows, :SHARED] = shape_columns(
                tangents.state[track.place],
                friction_states(track.drive, FRICTION, rubbed(track.drive, self.turns[k]))[
                    track.place
                ],
                track.drive[track.place],
            )
            first = self.shared + self.own * k
            columns[rows, first] = 1.0
            if not self.free:
                continue
            groups = np.array_split(np.arange(PLAYS // 3, PLAYS), FORGETTING)
            for g, group in enumerate(groups):
                columns[rows, first + 1 + g] = tangents.memory[track.place][:, group].mean(axis=1)
        if self.knee:
            columns[:, SHARED : self.shared] = self.bent_rows
        return columns

    @property
    def bent_rows(self) -> Array:
        """Return the columns of the Bouc-Wen state at all rows."""
        parts = []
        for track, turns in zip(self.tracks, self.turns, strict=True):
            state = self.bent(turns, track.drive)[track.place]
            parts.append(knee_columns(state, track.drive[track.place]))
        return np.concatenate(parts)

    def static(self, k: int, weight: Array) -> Array:
        """Return what the shared columns make of a track's drive, (samples,)."""
        return self.along(self.tracks[k].drive, self.turns[k], weight)

    def along(self, drive: Array, turns: Turns, weight: Array) -> Array:
        """Return what the shared columns make of any drive that turned before, (samples,)."""
        memory = past(drive, turns)
        friction = friction_states(drive, FRICTION, rubbed(drive, turns))
        parts = []
        for first in range(0, len(drive), CHUNK):
            part = np.asarray(drive[first : first + CHUNK])
            states, memory = play_columns(part, THRESHOLD, memory)
            parts.append(shape(states, friction[first : first + CHUNK], part, weight[:SHARED]))
        total = np.concatenate(parts)
        if self.knee:
            total += knee_columns(self.bent(turns, drive), drive) @ weight[SHARED:]
        return np.asarray(total)

    def bent(self, turns: Turns, drive: Array) -> Array:
        """Return the Bouc-Wen state along a drive that turned before, (samples,)."""
        assert self.knee is not None
        way = np.array([*turns, float(drive[0])])
        start = float(bouc_wen_states(way, *self.knee)[-1])
        return bouc_wen_states(drive, *self.knee, start)

    def static_rows(self, k: int, weight: Array, drive: Array) -> Array:
        """Return what the shared columns make of another drive at a track's rows, (rows,)."""
        place = self.tracks[k].place
        states, _ = play_columns(drive, THRESHOLD, past(drive, self.turns[k]))
        friction = friction_states(drive, FRICTION, rubbed(drive, self.turns[k]))
        rows = shape_columns(states[place], friction[place], drive[place]) @ weight[:SHARED]
        if self.knee:
            rows = (
                rows
                + knee_columns(self.bent(self.turns[k], drive)[place], drive[place])
                @ weight[SHARED:]
            )
        return np.asarray(rows)
