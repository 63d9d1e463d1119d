"""Search for the Bouc-Wen state of the smallest residual in the nuisance class.

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
RCOND = 1e-9  # relative length of linearly dependent columns
LIMITS = ((0.2, 20.0), (-0.4, 0.9), (1.0, 4.0), (-0.6, 0.6))


Law = tuple[float, float, float, float]  # beta, gamma / beta, exponent, bend
Left = Callable[[Law], float]


def with_best_bouc_wen(view: View, executor: Executor = SERIAL) -> View:
    """Return the view with the Bouc-Wen state of the smallest residual."""
    without_state = with_bouc_wen(view, None)

    def residual_energy(law: Law) -> float:
        # the columns of the view are projected out of the trial columns
        across = without_state.null.without(
            with_bouc_wen(without_state, _law_of(law)).nuisance.bouc_wen_rows
        )
        coefficients = np.linalg.lstsq(across, without_state.null.residual, rcond=RCOND)[0]
        return float(np.sum((without_state.null.residual - across @ coefficients) ** 2))

    return with_bouc_wen(view, _best(residual_energy, executor=executor))


def with_bouc_wen_of(view: View, against: Callable[[View], Null]) -> View:
    """Return the view with the Bouc-Wen state of the smallest residual in a smaller class.

    against  (view) -> null of the smaller class
    """

    def class_rms(law: Law) -> float:
        return against(with_bouc_wen(view, _law_of(law))).rms

    return with_bouc_wen(view, _best(class_rms, BENDS))


def _best(
    criterion: Left, bends: Sequence[float] = (0.0,), executor: Executor = SERIAL
) -> BoucWenLaw:
    """Minimise the criterion over a grid, then by coordinate search with shrinking steps."""
    laws: list[Law] = [*product(BETAS, RATIOS, EXPONENTS, bends)]
    best = min(zip(executor.map(criterion, laws), laws, strict=True), key=lambda pair: pair[0])
    for part in PARTS:
        for parameter in range(len(LIMITS)):
            best = _improve(criterion, best, parameter, part)
    return _law_of(best[1])


def _improve(
    criterion: Left, best: tuple[float, Law], parameter: int, part: float
) -> tuple[float, Law]:
    for sign in (1.0, -1.0):
        candidate = _stepped(best[1], parameter, sign * part)
        error = criterion(candidate)
        if error < best[0]:
            return error, candidate
    return best


def _stepped(law: Law, parameter: int, part: float) -> Law:
    beta, ratio, exponent, bend = law
    steps = (
        beta * BETA**part,
        ratio + RATIO * part,
        exponent * EXPONENT**part,
        bend + BEND * part,
    )
    low, high = LIMITS[parameter]
    changed = [*law]
    changed[parameter] = min(max(steps[parameter], low), high)
    return changed[0], changed[1], changed[2], changed[3]


def _law_of(law: Law) -> BoucWenLaw:
    beta, ratio, exponent, bend = law
    return beta, ratio * beta, exponent, bend
