"""A deterministic search for the best parameters that meet all limits, without gradients."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.numerics.derivative_free import direct_search

Judge = Callable[[Array], tuple[float, float]]
"""Parameters in; (cost to minimise, excess over the limits in dB) out."""

_PATIENCE = 1e-3
_POLISHING_STEPS = (0.1, 0.05, 0.1, 0.05)
_FLOOR_dB = 1.0


class _LimitsMetError(Exception):
    """Raised to stop the optimiser early; caught in this module."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchResult:
    """The best point found.

    parameters   inside their bounds
    cost         of the judge
    excess_dB    <= 0: every limit is met
    evaluations  how often the judge was asked
    """

    parameters: Array
    cost: float
    excess_dB: float
    evaluations: int


def search(
    judge: Judge,
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
    calls, then again from the best point with smaller steps, as the maximum over members has
    edges it can stop at. The best point ever asked is kept; the same input gives the same output.

    reserve_dB  what the search's grid may overlook between its points
    until_met   stop at the first point that meets every limit: enough to know that one exists
    """
    evaluated: list[tuple[bool, float, float, Array]] = []
    span = upper - lower

    def ask(unit: Array) -> tuple[float, float]:
        parameters = lower + np.clip(unit, 0.0, 1.0) * span
        cost, excess_dB = judge(parameters)
        feasible = excess_dB <= -reserve_dB
        evaluated.append((not feasible, cost if feasible else excess_dB, excess_dB, parameters))
        if feasible and until_met:
            raise _LimitsMetError
        return cost, excess_dB

    with contextlib.suppress(_LimitsMetError):
        for start in starts:
            _descend(ask, (start - lower) / span, 0.15, evaluations, reserve_dB)
        polished = set()
        for step in _POLISHING_STEPS:
            best = min(evaluated, key=lambda item: item[:2])
            if (id(best), step) not in polished:  # it would ask the same once more
                polished.add((id(best), step))
                _descend(ask, (best[3] - lower) / span, step, evaluations, reserve_dB)
    best = min(evaluated, key=lambda item: item[:2])
    cost, _ = judge(best[3])
    return SearchResult(
        parameters=best[3], cost=cost, excess_dB=best[2], evaluations=len(evaluated)
    )


def _descend(ask: Judge, start: Array, step: float, evaluations: int, reserve_dB: float) -> None:
    cache: dict[bytes, tuple[float, float]] = {}

    def remembered(unit: Array) -> tuple[float, float]:
        key = unit.tobytes()
        if key not in cache:
            cache.clear()
            cache[key] = ask(unit)
        return cache[key]

    direct_search(
        lambda unit: remembered(unit)[0],
        np.clip(start, 0.0, 1.0),
        (np.zeros(len(start)), np.ones(len(start))),
        initial_step=step,
        max_evaluations=evaluations,
        constraint=lambda unit: max(remembered(unit)[1], -_FLOOR_dB) + reserve_dB,
        step_tolerance=_PATIENCE,
    )
