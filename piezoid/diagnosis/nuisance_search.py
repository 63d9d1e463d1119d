"""Search for hysteresis states of the nuisance class: initial states, and a Bouc-Wen state.

Initial states: the nuisance class is fitted to rows that do not depend on the initial state,
because the drive has covered its whole range since the track began. Hypotheses are then compared
by the error of this class from the first sample on: for each track, and for all tracks with one
shared hypothesis, because stages are usually cycled in the same way before every recording. A
hypothesis must also reduce the error of all tracks together after a refit of the nuisance class,
so that no other effect passes for an initial state.

A Bouc-Wen state is structure of the nuisance class and no cause. It is added only if its error is
smaller than that of any effect. Structural effects are compared with a class that does not contain
them, and this class may have a Bouc-Wen state as well.

Source: Krejci (1996) on forgetting; Mayergoyz (1991) on wiping out.
"""

from collections.abc import Callable, Sequence
from functools import cache
from itertools import product
from operator import attrgetter, itemgetter

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.nuisance import Reversals, hypotheses, memory_after, shared_hypotheses
from piezoid.diagnosis.nuisance_columns import (
    REACH,
    SHARED,
    THRESHOLD,
    BoucWenLaw,
    bouc_wen_along,
    bouc_wen_columns,
    friction_along,
    initial_friction,
    shared_response,
)
from piezoid.diagnosis.residual_view import (
    View,
    with_bouc_wen,
    with_cycled_drives,
    with_free_memory,
    with_reversals,
    with_shared_reversals,
)
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import SERIAL, Executor
from piezoid.operators.play import play_columns

COVERED = 0.97  # share of the range after which the initial state no longer matters
MIN_ROWS_PER_COLUMN = 4  # else all rows are fitted
MAX_MISFIT_RATIO = 0.9  # largest misfit of another hypothesis, over that of a cycled drive
# A shared hypothesis is as good as individual ones if its excess of power is at most
# MAX_EXCESS_EXPLAINED of the power that they explain, and its power at most MAX_POWER_RATIO of
# theirs.
MAX_EXCESS_EXPLAINED = 0.025
MAX_POWER_RATIO = 1.06
OTHER_INITIAL_STATES = 0.92  # largest relative error at which other initial states are selected
POINTS = 500  # samples of a track that are compared
STEPS = (0.15, 0.05, 0.015)  # of half the range, by which reversals are changed
MAX_REVERSAL = 1.2  # of half the range

# of a Bouc-Wen state
BETAS = (0.8, 1.6, 3.2)
RATIOS = (0.0, 0.4)  # gamma over beta
EXPONENTS = (1.0, 1.6)
BENDS = (-0.2, 0.0, 0.2)  # separated by ridges of the error
STEP_FRACTIONS = (1.0, 0.5, 0.25, 0.1)
BETA_FACTOR, EXPONENT_FACTOR = 1.4, 1.35  # of a full step
RATIO_STEP, BEND_STEP = 0.25, 0.25
RCOND = 1e-9  # relative length of linearly dependent columns
LAW_LIMITS = ((0.2, 20.0), (-0.4, 0.9), (1.0, 4.0), (-0.6, 0.6))

InitialStates = tuple[View, View]
"""Views with the best shared hypothesis and with the best initial state of each track; neither
depends on the initial states that were assumed before."""
Sketch = tuple[tuple[Reversals, ...], Callable[[Reversals], float]]
"""Hypotheses of a track, and (hypothesis) -> standard deviation of the residual under it."""
Law = tuple[float, float, float, float]  # beta, gamma / beta, exponent, bend


def with_shared_initial_state(view: View, executor: Executor = SERIAL) -> View:
    """Return the view with the shared initial state of the smallest error."""
    candidates = shared_hypotheses([track.drive for track in view.tracks], view.rest_drive)
    # a view holds columns for all rows: recompute the best instead of keeping all in memory
    errors = executor.map(lambda reversals: with_shared_reversals(view, reversals).rms, candidates)
    return with_shared_reversals(view, candidates[errors.index(min(errors))])


def with_individual_initial_states(view: View, shared: View) -> View:
    """Fit an initial state to each track, with free corrections of all initial states.

    shared  the view with the best shared hypothesis, which is one of the candidates
    """
    view, by_rms = with_cycled_drives(view), attrgetter("rms")
    # the shared coefficients, fitted to rows that do not depend on the initial state
    has_covered_range = []
    for track in view.tracks:
        span = np.maximum.accumulate(track.drive) - np.minimum.accumulate(track.drive)
        has_covered_range.append((span > COVERED * 2.0)[track.rows])
    rows = np.concatenate(has_covered_range)
    columns = np.hstack([view.columns, view.selected])
    if np.count_nonzero(rows) < MIN_ROWS_PER_COLUMN * columns.shape[1]:
        weight = view.weight
    else:
        null = Null(columns=columns[rows], response=view.response[rows], block=view.block[rows])
        weight = null.fit(null.response)[: view.nuisance.shared]
    sketches = [_sketch(view, k, weight) for k in range(len(view.tracks))]
    individual = tuple(
        _best_hypothesis(view.nuisance.reversals[k], [s]) for k, s in enumerate(sketches)
    )
    equal = (_best_hypothesis(view.nuisance.reversals[0], sketches),) * len(sketches)
    view = with_free_memory(view)
    candidates = (individual, equal, shared.nuisance.reversals)
    view = min(view, *(with_reversals(view, reversals) for reversals in candidates), key=by_rms)
    for k, best in enumerate(individual):
        current = view.nuisance.reversals
        view = min(
            view,
            with_reversals(view, (*current[:k], best, *current[k + 1 :])),
            key=by_rms,
        )
    return view


def with_shared_state_if_as_good(view: View) -> View:
    """Return the view with the best shared hypothesis, or with cycled drives.

    The shared hypothesis must be as good as initial states fitted track by track.
    """
    if not view.nuisance.free:
        return view
    shared = view.cache.get("shared")  # needed for the trials and the null of one effect
    if shared is None:
        cycled, best = with_cycled_drives(view), with_shared_initial_state(view)
        shared = best if is_shared_state_as_good(best, view, cycled) else cycled
        view.cache["shared"] = shared
    return shared


def is_shared_state_as_good(shared: View, individual: View, cycled: View) -> bool:
    """Tell whether one shared initial state is as good as initial states fitted track by track.

    A wide class fits almost equally well from almost any initial state; only the true one needs no
    correction.

    cycled  the view with initial states of cycled drives
    """
    individual_power, excess = individual.rms**2, shared.rms**2 - individual.rms**2
    return excess < min(
        (MAX_POWER_RATIO - 1.0) * individual_power,
        MAX_EXCESS_EXPLAINED * (cycled.rms**2 - individual_power),
    )


def _best_hypothesis(first: Reversals, sketches: Sequence[Sketch]) -> Reversals:
    """Return the initial state with the smallest misfit, refined reversal by reversal.

    first  initial state of a cycled drive, returned unless another one is clearly better
    """

    def misfit(reversals: Reversals) -> float:
        return sum(deviation(reversals) ** 2 for _, deviation in sketches)

    best = min(sketches[0][0], key=misfit)
    for step in STEPS:
        for k in range(len(best)):
            neighbours = [
                (*best[:k], min(max(level, -MAX_REVERSAL), MAX_REVERSAL), *best[k + 1 :])
                for level in (best[k] + step, best[k] - step)
            ]
            best = min(best, *neighbours, key=misfit)
    return best if misfit(best) < MAX_MISFIT_RATIO**2 * misfit(first) else first


def _sketch(view: View, k: int, weight: Array) -> Sketch:
    """Return the hypotheses of a track, and their deviation at some samples and its reversals."""
    track, bouc_wen = view.tracks[k], view.nuisance.bouc_wen
    step = np.sign(np.diff(track.drive))
    reversals = np.flatnonzero(step[1:] * step[:-1] < 0) + 1
    spread = np.linspace(0, len(track.drive) - 1, POINTS).astype(int)
    points = np.unique([*spread, *reversals[:POINTS]])
    drive, response = np.asarray(track.drive[points]), np.asarray(track.response[points])
    # friction states along the track after a cycled drive, and the share of a change that remains
    first_friction = initial_friction(track.drive, hypotheses(track.drive)[0])
    first_course = friction_along(track.drive, first_friction)[points]
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(track.drive)))])
    decay = np.exp(-travelled[points][:, None] / REACH)

    def deviation(hypothesis: Reversals) -> float:
        states, _ = play_columns(drive, THRESHOLD, memory_after(drive, hypothesis))
        friction = first_course + (initial_friction(drive, hypothesis) - first_friction) * decay
        model = shared_response(states, friction, drive, weight[:SHARED])
        if bouc_wen:
            state = bouc_wen_along(bouc_wen, hypothesis, drive)
            model = model + bouc_wen_columns(state, drive) @ weight[SHARED:]
        return float(np.std(model - response))

    # a hypothesis is compared with its neighbours, for the track alone and for all tracks
    return hypotheses(drive), cache(deviation)


def with_best_bouc_wen(view: View) -> View:
    """Return the view with the Bouc-Wen state that has the smallest residual."""
    without_state = with_bouc_wen(view, None)

    def residual_energy(law: BoucWenLaw) -> float:
        # the columns of the view are projected out of the trial columns
        orthogonal = without_state.null.project_out(
            with_bouc_wen(without_state, law).nuisance.bouc_wen_rows
        )
        coefficients = np.linalg.lstsq(orthogonal, without_state.null.residual, rcond=RCOND)[0]
        return float(np.sum((without_state.null.residual - orthogonal @ coefficients) ** 2))

    return with_bouc_wen(view, _best_law(residual_energy))


def with_bouc_wen_of(view: View, null_of: Callable[[View], Null]) -> View:
    """Return the view with the Bouc-Wen state that is best in a smaller class.

    null_of  (view) -> null of the smaller class
    """
    best_law = _best_law(lambda law: null_of(with_bouc_wen(view, law)).rms, BENDS)
    return with_bouc_wen(view, best_law)


def _best_law(
    criterion: Callable[[BoucWenLaw], float], bends: Sequence[float] = (0.0,)
) -> BoucWenLaw:
    """Minimise the criterion over a grid, then by coordinate search with shrinking steps."""
    laws: list[Law] = [*product(BETAS, RATIOS, EXPONENTS, bends)]
    errors = [criterion(_law_of(law)) for law in laws]
    smallest, best = min(zip(errors, laws, strict=True), key=itemgetter(0))
    for fraction, parameter in product(STEP_FRACTIONS, range(len(LAW_LIMITS))):
        for step in (fraction, -fraction):
            beta, ratio, exponent, bend = best
            stepped = (
                beta * BETA_FACTOR**step,
                ratio + RATIO_STEP * step,
                exponent * EXPONENT_FACTOR**step,
                bend + BEND_STEP * step,
            )
            low, high = LAW_LIMITS[parameter]
            values = [*best]
            values[parameter] = min(max(stepped[parameter], low), high)
            candidate = (values[0], values[1], values[2], values[3])
            error = criterion(_law_of(candidate))
            if error < smallest:
                smallest, best = error, candidate
                break
    return _law_of(best)


def _law_of(law: Law) -> BoucWenLaw:
    beta, ratio, exponent, bend = law
    return beta, ratio * beta, exponent, bend
