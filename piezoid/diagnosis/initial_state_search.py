"""Search for the initial hysteresis state of each track.

The nuisance class is fitted to rows where that is forgotten: before them the drive has covered its
whole range since the track began. Hypotheses about the initial state are then compared by how well
such a class follows a track from its first sample on, each track by itself and all with one, since
a person cycles a stage the same way every time. Nothing else may pass for memory: a hypothesis
must lower the error of all tracks together once everything is refitted.

Source: Krejci (1996) on forgetting; Mayergoyz (1991) on wiping out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.initial_states import Reversals, hypotheses, memory_after, shared_hypotheses
from piezoid.diagnosis.nuisance_columns import (
    REACH,
    SHARED,
    THRESHOLD,
    BoucWenLaw,
    bouc_wen_columns,
    rubbed,
    rubbing,
    shape,
    states_under,
)
from piezoid.diagnosis.residual_view import (
    View,
    cycled,
    with_free_memory,
    with_reversals,
    with_shared_reversals,
)
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import SERIAL, Executor
from piezoid.operators.play import play_columns

COVERED = 0.97  # of the whole range: the initial state is then forgotten
FEWEST = 4  # rows for a column, or all rows are taken
CLEARLY = 0.9  # largest misfit, relative to a cycled track, at which another hypothesis is taken
# A shared hypothesis does as well as individual ones if it leaves at most NEARLY of the power that
# these remove and AS_GOOD of what they leave.
NEARLY = 0.025
AS_GOOD = 1.06
OTHER_INITIAL_STATES = 0.92  # largest relative error at which other initial states are taken
POINTS = 500  # samples of a track that are compared
PARTS = (0.15, 0.05, 0.015)  # of half the range, by which reversals are moved
FARTHEST = 1.2

InitialStates = tuple[View, View]
"""A view with the best shared hypothesis, and with initial states that fit each track best: both
the same whatever initial states the view had."""


def with_shared_initial_state(view: View, executor: Executor = SERIAL) -> View:
    """Return the view with the shared initial state of the smallest error."""
    ways = shared_hypotheses([track.drive for track in view.tracks], view.rest_drive)
    # a view holds columns for all rows: recompute the best instead of keeping all in memory
    errors = executor.map(lambda reversals: with_shared_reversals(view, reversals).rms, ways)
    return with_shared_reversals(view, ways[errors.index(min(errors))])


def with_own_initial_states(view: View, shared: View) -> View:
    """Fit an initial state to each track, with free corrections of the first states.

    shared  the view with the best shared hypothesis, which is one of the candidates
    """
    view = cycled(view)
    weight = _forgetful_weight(view)
    sketches = [_sketch(view, k, weight) for k in range(len(view.tracks))]
    individual = tuple(
        _best_hypothesis(view.nuisance.reversals[k], [s]) for k, s in enumerate(sketches)
    )
    alike = (_best_hypothesis(view.nuisance.reversals[0], sketches),) * len(sketches)
    view = with_free_memory(view)
    ways = (individual, alike, shared.nuisance.reversals)
    view = min(view, *(with_reversals(view, reversals) for reversals in ways), key=_error)
    for k, best in enumerate(individual):
        current = view.nuisance.reversals
        view = min(view, with_reversals(view, (*current[:k], best, *current[k + 1 :])), key=_error)
    return view


def with_shared_where_as_good(view: View) -> View:
    """Return the view with one initial state shared by all tracks.

    A shared hypothesis other than cycling the drive over its range must do as well as initial
    states fitted track by track.
    """
    if not view.nuisance.free:
        return view
    shared = view.cache.get("alike")  # needed for the trials and the null of one effect
    if shared is None:
        first, best = cycled(view), with_shared_initial_state(view)
        shared = best if shared_does_as_well(best, view, first) else first
        view.cache["alike"] = shared
    return shared


def shared_does_as_well(shared: View, individual: View, first: View) -> bool:
    """Tell whether one shared initial state does as well as initial states fitted track by track.

    A wide class fits almost equally well from almost any initial state; only the true one needs no
    correction.

    first  the view with drives that were cycled
    """
    individual_power, excess = individual.rms**2, shared.rms**2 - individual.rms**2
    return excess < min(
        (AS_GOOD - 1.0) * individual_power, NEARLY * (first.rms**2 - individual_power)
    )


def _error(view: View) -> float:
    return view.rms


def _forgetful_weight(view: View) -> Array:
    """Fit the shared coefficients to rows at which the initial state is forgotten."""
    is_forgotten = np.concatenate([_forgotten(t.drive)[t.rows] for t in view.tracks])
    columns = np.hstack([view.nuisance.columns, view.selected])
    if np.count_nonzero(is_forgotten) < FEWEST * columns.shape[1]:
        return view.weight
    null = Null(
        columns=columns[is_forgotten],
        response=view.response[is_forgotten],
        block=view.block[is_forgotten],
    )
    return null.fit(null.response)[: view.nuisance.shared]


def _forgotten(drive: Array) -> Array:
    """Return at which samples the drive has covered the whole range, 2, since the first."""
    span = np.maximum.accumulate(drive) - np.minimum.accumulate(drive)
    return np.asarray(span > COVERED * 2.0)


def _best_hypothesis(first: Reversals, sketches: Sequence["_Sketch"]) -> Reversals:
    """Return the initial state of the smallest misfit, refined reversal by reversal."""

    def misfit(reversals: Reversals) -> float:
        return sum(sketch.misfit(reversals) ** 2 for sketch in sketches)

    best = min(hypotheses(sketches[0].drive), key=misfit)
    for part in PARTS:
        for position in range(len(best)):
            neighbours = [_turned(best, position, sign * part) for sign in (1.0, -1.0)]
            best = min(best, *neighbours, key=misfit)
    return best if misfit(best) < CLEARLY**2 * misfit(first) else first


def _turned(reversals: Reversals, position: int, step: float) -> Reversals:
    reversal = min(max(reversals[position] + step, -FARTHEST), FARTHEST)
    return (*reversals[:position], reversal, *reversals[position + 1 :])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Sketch:
    """A track at few samples and its reversals, on which hypotheses are tried.

    began      (states,)         friction after a drive that was cycled before
    friction   (points, states)  from there
    remembers  (points, states)  the part of its beginning that is not forgotten
    """

    weight: Array
    bouc_wen: BoucWenLaw | None
    drive: Array
    response: Array
    began: Array
    friction: Array
    remembers: Array

    def misfit(self, reversals: Reversals) -> float:
        """Return the standard deviation of the residual under a hypothesis."""
        states, _ = play_columns(self.drive, THRESHOLD, memory_after(self.drive, reversals))
        rubs = self.friction + (rubbed(self.drive, reversals) - self.began) * self.remembers
        model = shape(states, rubs, self.drive, self.weight[:SHARED])
        if self.bouc_wen:
            bent = states_under(self.bouc_wen, reversals, self.drive)
            model = model + bouc_wen_columns(bent, self.drive) @ self.weight[SHARED:]
        return float(np.std(model - self.response))


def _sketch(view: View, k: int, weight: Array) -> _Sketch:
    track = view.tracks[k]
    step = np.sign(np.diff(track.drive))
    reversals = np.flatnonzero(step[1:] * step[:-1] < 0) + 1
    spread = np.linspace(0, len(track.drive) - 1, POINTS).astype(int)
    points = np.unique([*spread, *reversals[:POINTS]])
    began = rubbed(track.drive, hypotheses(track.drive)[0])
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(track.drive)))])
    return _Sketch(
        weight=weight,
        bouc_wen=view.nuisance.bouc_wen,
        drive=np.asarray(track.drive[points]),
        response=np.asarray(track.response[points]),
        began=began,
        friction=rubbing(track.drive, began)[points],
        remembers=np.exp(-travelled[points][:, None] / REACH),
    )
