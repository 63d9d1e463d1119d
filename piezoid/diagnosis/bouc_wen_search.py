"""Search for the Bouc-Wen state that serves the nuisance class best.

It is structure, not a cause: it is taken in only where it leaves less than any effect does. Other
structure has to beat the class without it, which may then have a Bouc-Wen state of its own.
"""

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.nuisance_columns import BoucWenLaw
from piezoid.diagnosis.residual_view import View, with_bouc_wen
from piezoid.numerics.executor import SERIAL, Executor

BETAS = (0.8, 1.6, 3.2)
RATIOS = (0.0, 0.4)  # gamma over beta
EXPONENTS = (1.0, 1.6)
BENDS = (-0.2, 0.0, 0.2)  # between them lie ridges
PARTS = (1.0, 0.5, 0.25, 0.1)
BETA, EXPONENT = 1.4, 1.35  # factors of a full step
RATIO, BEND = 0.25, 0.25  # steps
RCOND = 1e-9  # of lengths: columns that the others already have
LIMITS = ((0.2, 20.0), (-0.4, 0.9), (1.0, 4.0), (-0.6, 0.6))


Law = tuple[float, float, float, float]  # beta, gamma / beta, exponent, bend
Left = Callable[[Law], float]


def with_best_bouc_wen(view: View, executor: Executor = SERIAL) -> View:
    """Return the view with the Bouc-Wen state that leaves least."""
    bare = with_bouc_wen(view, None)

    def left(law: Law) -> float:
        # the view's own columns are taken out of all
        across = bare.null.without(with_bouc_wen(bare, _law_of(law)).nuisance.bouc_wen_rows)
        found = np.linalg.lstsq(across, bare.null.residual, rcond=RCOND)[0]
        return float(np.sum((bare.null.residual - across @ found) ** 2))

    return with_bouc_wen(view, _best(left, executor=executor))


def with_bouc_wen_of(view: View, against: Callable[[View], Null]) -> View:
    """Return the view with the Bouc-Wen state that serves a smaller class best.

    against  (view) -> the smaller class
    """

    def left(law: Law) -> float:
        return against(with_bouc_wen(view, _law_of(law))).rms

    return with_bouc_wen(view, _best(left, BENDS))


def _best(left: Left, bends: Sequence[float] = (0.0,), executor: Executor = SERIAL) -> BoucWenLaw:
    """Return the state that leaves least: the best of a grid, then one step after another."""
    laws: list[Law] = [*product(BETAS, RATIOS, EXPONENTS, bends)]
    best = min(zip(executor.map(left, laws), laws, strict=True), key=lambda pair: pair[0])
    for part in PARTS:
        for place in range(len(LIMITS)):
            best = _better(left, best, place, part)
    return _law_of(best[1])


def _better(left: Left, best: tuple[float, Law], place: int, part: float) -> tuple[float, Law]:
    for sign in (1.0, -1.0):
        there = _stepped(best[1], place, sign * part)
        rest = left(there)
        if rest < best[0]:
            return rest, there
    return best


def _stepped(law: Law, place: int, part: float) -> Law:
    beta, ratio, exponent, bend = law
    steps = (
        beta * BETA**part,
        ratio + RATIO * part,
        exponent * EXPONENT**part,
        bend + BEND * part,
    )
    low, high = LIMITS[place]
    there = [*law]
    there[place] = min(max(steps[place], low), high)
    return there[0], there[1], there[2], there[3]


def _law_of(law: Law) -> BoucWenLaw:
    beta, ratio, exponent, bend = law
    return beta, ratio * beta, exponent, bend
