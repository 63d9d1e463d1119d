"""Knee: the Bouc-Wen state that would serve the envelope best.

It is structure, not a cause: it is taken in only where it leaves less than any effect does.
"""

from piezoid.diagnosis.view import View, with_knee

BETAS = (0.8, 1.6, 3.2)
RATIOS = (0.0, 0.4)  # gamma over beta
EXPONENTS = (1.0, 1.6)
PARTS = (1.0, 0.5, 0.25, 0.1)
FACTORS = (1.4, 1.0, 1.35)  # of beta and exponent by a full step
STEP = 0.25  # of the ratio
LIMITS = ((0.2, 20.0), (-0.4, 0.9), (1.0, 4.0))


Law = tuple[float, float, float]  # beta, gamma / beta, exponent


def with_best_knee(view: View) -> View:
    """Return the view with the Bouc-Wen state that leaves least."""
    laws: list[Law] = [(b, r, n) for b in BETAS for r in RATIOS for n in EXPONENTS]
    best, law = min(((_with(view, law), law) for law in laws), key=lambda pair: pair[0].rms)
    for part in PARTS:
        for place in range(len(law)):
            best, law = _better(view, best, law, place, part)
    return best


def _better(view: View, best: View, law: Law, place: int, part: float) -> tuple[View, Law]:
    for sign in (1.0, -1.0):
        there = _stepped(law, place, sign * part)
        other = _with(view, there)
        if other.rms < best.rms:
            return other, there
    return best, law


def _stepped(law: Law, place: int, part: float) -> Law:
    beta, ratio, exponent = law
    steps = (beta * FACTORS[0] ** part, ratio + STEP * part, exponent * FACTORS[2] ** part)
    low, high = LIMITS[place]
    there = [*law]
    there[place] = min(max(steps[place], low), high)
    return there[0], there[1], there[2]


def _with(view: View, law: Law) -> View:
    beta, ratio, exponent = law
    return with_knee(view, (beta, ratio * beta, exponent))
