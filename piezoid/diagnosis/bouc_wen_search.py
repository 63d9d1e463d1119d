"""Search for the Bouc-Wen state with the smallest residual in the nuisance class.

A Bouc-Wen state is structure of the nuisance class and no cause. It is added only if its error is
smaller than that of any effect. Structural effects are compared with a class that does not contain
them, and this class may have a Bouc-Wen state as well.
"""

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.nuisance_columns import BoucWenLaw
from piezoid.diagnosis.residual_view import View, with_bouc_wen

BETAS = (0.8, 1.6, 3.2)
RATIOS = (0.0, 0.4)  # gamma over beta
EXPONENTS = (1.0, 1.6)
BENDS = (-0.2, 0.0, 0.2)  # separated by ridges of the error
STEP_FRACTIONS = (1.0, 0.5, 0.25, 0.1)
BETA_FACTOR, EXPONENT_FACTOR = 1.4, 1.35  # of a full step
RATIO_STEP, BEND_STEP = 0.25, 0.25
RCOND = 1e-9  # relative length of linearly dependent columns
LIMITS = ((0.2, 20.0), (-0.4, 0.9), (1.0, 4.0), (-0.6, 0.6))

Law = tuple[float, float, float, float]  # beta, gamma / beta, exponent, bend
Criterion = Callable[[Law], float]


def with_best_bouc_wen(view: View) -> View:
    """Return the view with the Bouc-Wen state that has the smallest residual."""
    without_state = with_bouc_wen(view, None)

    def residual_energy(law: Law) -> float:
        # the columns of the view are projected out of the trial columns
        orthogonal = without_state.null.project_out(
            with_bouc_wen(without_state, _law_of(law)).nuisance.bouc_wen_rows
        )
        coefficients = np.linalg.lstsq(orthogonal, without_state.null.residual, rcond=RCOND)[0]
        return float(np.sum((without_state.null.residual - orthogonal @ coefficients) ** 2))

    return with_bouc_wen(view, _best(residual_energy))


def with_bouc_wen_of(view: View, null_of: Callable[[View], Null]) -> View:
    """Return the view with the Bouc-Wen state that is best in a smaller class.

    null_of  (view) -> null of the smaller class
    """

    def class_rms(law: Law) -> float:
        return null_of(with_bouc_wen(view, _law_of(law))).rms

    return with_bouc_wen(view, _best(class_rms, BENDS))


def _best(criterion: Criterion, bends: Sequence[float] = (0.0,)) -> BoucWenLaw:
    """Minimise the criterion over a grid, then by coordinate search with shrinking steps."""
    laws: list[Law] = [*product(BETAS, RATIOS, EXPONENTS, bends)]
    smallest, best = min(((criterion(law), law) for law in laws), key=lambda pair: pair[0])
    for fraction, parameter in product(STEP_FRACTIONS, range(len(LIMITS))):
        for step in (fraction, -fraction):
            beta, ratio, exponent, bend = best
            stepped = (
                beta * BETA_FACTOR**step,
                ratio + RATIO_STEP * step,
                exponent * EXPONENT_FACTOR**step,
                bend + BEND_STEP * step,
            )
            low, high = LIMITS[parameter]
            values = [*best]
            values[parameter] = min(max(stepped[parameter], low), high)
            candidate = (values[0], values[1], values[2], values[3])
            error = criterion(candidate)
            if error < smallest:
                smallest, best = error, candidate
                break
    return _law_of(best)


def _law_of(law: Law) -> BoucWenLaw:
    beta, ratio, exponent, bend = law
    return beta, ratio * beta, exponent, bend
