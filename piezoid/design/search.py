"""Deterministic constrained minimisation without gradients, from several starts."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.numerics.derivative_free import direct_search

Evaluate = Callable[[Array], tuple[float, float]]
"""Function of the parameters; returns (cost to minimise, excess over the limits in dB)."""

_STEP_TOLERANCE = 1e-3
_POLISHING_STEPS = (0.1, 0.05, 0.1, 0.05)
_MAX_RESERVE_dB = 1.0  # beyond which the constraint is constant


class _LimitsMetError(Exception):
    """Stops the optimiser at the first feasible point; caught in this module."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchResult:
    """Result of a search: its best point.

    parameters   inside their bounds
    cost         at these parameters
    excess_dB    <= 0: every limit is met
    evaluations  number of evaluations
    """

    parameters: Array
    cost: float
    excess_dB: float
    evaluations: int


def search(
    evaluate: Evaluate,
    lower: Array,
    upper: Array,
    starts: Sequence[Array],
    *,
    evaluations: int = 250,
    reserve_dB: float = 0.1,
    until_met: bool = False,
) -> SearchResult:
    """Minimise the cost where the excess is at most -reserve_dB; else minimise the excess.

    From each start COBYLA [Powell 1994] descends in the unit cube for at most ``evaluations``
    calls. It is restarted from the best point with smaller steps, because it can stop at an edge
    of the maximum over members. The best of all evaluated points is returned.

    reserve_dB  allowance for peaks between the points of the search's grid
    until_met   stop at the first point that meets every limit, to decide feasibility
    """
    evaluated: list[tuple[bool, float, float, Array]] = []
    span = upper - lower

    def evaluate_unit(unit: Array) -> tuple[float, float]:
        parameters = lower + np.clip(unit, 0.0, 1.0) * span
        cost, excess_dB = evaluate(parameters)
        is_feasible = excess_dB <= -reserve_dB
        rank = cost if is_feasible else excess_dB
        evaluated.append((not is_feasible, rank, excess_dB, parameters))
        if is_feasible and until_met:
            raise _LimitsMetError
        return cost, excess_dB

    with contextlib.suppress(_LimitsMetError):
        for start in starts:
            _descend(evaluate_unit, (start - lower) / span, 0.15, evaluations, reserve_dB)
        polished = set()
        for step in _POLISHING_STEPS:
            best = min(evaluated, key=lambda item: item[:2])
            if (id(best), step) not in polished:  # else the same evaluations would repeat
                polished.add((id(best), step))
                _descend(evaluate_unit, (best[3] - lower) / span, step, evaluations, reserve_dB)
    best = min(evaluated, key=lambda item: item[:2])
    cost, _ = evaluate(best[3])
    return SearchResult(
        parameters=best[3], cost=cost, excess_dB=best[2], evaluations=len(evaluated)
    )


def _descend(
    evaluate: Evaluate, start: Array, step: float, evaluations: int, reserve_dB: float
) -> None:
    cache: dict[bytes, tuple[float, float]] = {}

    def cached(unit: Array) -> tuple[float, float]:
        """Evaluate cost and constraint of one point together."""
        key = unit.tobytes()
        if key not in cache:
            cache.clear()
            cache[key] = evaluate(unit)
        return cache[key]

    direct_search(
        lambda unit: cached(unit)[0],
        np.clip(start, 0.0, 1.0),
        (np.zeros(len(start)), np.ones(len(start))),
        initial_step=step,
        max_evaluations=evaluations,
        constraint=lambda unit: max(cached(unit)[1], -_MAX_RESERVE_dB) + reserve_dB,
        step_tolerance=_STEP_TOLERANCE,
    )
