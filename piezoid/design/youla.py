"""Convex sensitivity shaping over a plant family: R' and S' as free coefficients.

On the nominal plant every stabilising pair is the central one plus a Youla parameter, and all
sensitivities are affine in it. Over a family the closed-loop polynomials P_i differ, and affine
becomes a condition around reference polynomials: with P_d,i stable,

    Re{P_i conj(P_d,i)} > 0 for all w   implies   P_i stable (it cannot wind around zero)

so that limits on |A_i S| / |P_i| are implied by second-order cones. P_d,i are the polynomials of
the design so far, and the problem is solved again until it stops gaining. Each step keeps every
member stable and every limit met.      [Landau & Zito 2006; Karimi & Galdos 2010, for the family]
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.design.cones import solve
from piezoid.design.family_grid import FamilyGrid, family_grid, worst_place
from piezoid.design.plant import Plant, PlantFamily
from piezoid.design.rst import INTEGRATOR, OPEN_AT_NYQUIST, RstController
from piezoid.design.specification import Specification
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import product, total

_RESERVES_dB = (0.05, 0.2, 0.5)
"""The cones are tightened for what happens between grid points: more where less did not do."""
_LEAST_GAIN = 0.01
_TIE = 1e-4
_EVERY = 10


@dataclass(frozen=True, kw_only=True, eq=False)
class ConvexController:
    """A controller by convex optimisation over a family.

    controller   R, S, T; its P is the nominal closed-loop polynomial that resulted
    taps         free coefficients of R' and of S'
    rejection    max over members and f <= bandwidth of |Syp| bandwidth / f, on the fine grid
    excess_dB    <= 0: every member meets every limit on the fine grid
    iterations   convex problems solved
    history      (iterations + 1,)  the rejection after each
    """

    controller: RstController
    taps: int
    rejection: float
    excess_dB: float
    iterations: int
    history: tuple[float, ...]


def optimise(
    family: PlantFamily,
    specification: Specification,
    start: RstController,
    *,
    taps: int = 10,
    most_iterations: int = 8,
) -> ConvexController:
    """Minimise the rejection figure over R' and S' from a start that stabilises every member.

        minimise    gamma
        subject to  |A_i S| <= gamma (f / bandwidth) |P_d,i|,  Re_i >= |P_d,i|    f <= bandwidth
                    |A_i S| <= Syp_max Re_i,  |A_i R| <= Sup_max Re_i,  |B_i R| <= Syb_max Re_i
        with        Re_i = Re{P_i conj(P_d,i)} / |P_d,i|,  S = H_S S',  R = H_R R',  s'_0 = 1

    Limits that the start exceeds are relaxed together, as little as possible. Each step is
    checked on a grid ten times finer, and solved again with more reserve where it fails there.
    """
    count = max(taps, len(start.S) - len(INTEGRATOR) + 1, len(start.R) - len(OPEN_AT_NYQUIST) + 1)
    coarse = family_grid(family, specification, count=20 * count)
    fine = family_grid(family, specification, count=200 * count)
    deciding = np.arange(coarse.A.size) % _EVERY == 0
    best, R, S = worst_place(fine, start.R, start.S), start.R, start.S
    history = [best.rejection]
    while len(history) <= most_iterations:
        step = _checked_step(coarse, fine, family.nominal, (R, S), count, deciding)
        if step is None:
            break
        reached = worst_place(fine, *step)
        tightened = max(best.excess_dB, 0.0) - max(reached.excess_dB, 0.0)
        gained = history[-1] - reached.rejection
        if tightened <= _TIE and gained <= _LEAST_GAIN * history[-1]:
            break
        (R, S), best = step, reached
        history.append(reached.rejection)
    return ConvexController(
        controller=_controller(family.nominal, R, S, start),
        taps=count,
        rejection=best.rejection,
        excess_dB=best.excess_dB,
        iterations=len(history) - 1,
        history=tuple(history),
    )


def _checked_step(
    coarse: FamilyGrid,
    fine: FamilyGrid,
    plant: Plant,
    present: tuple[Array, Array],
    count: int,
    deciding: NDArray[np.bool_],
) -> tuple[Array, Array] | None:
    """Return the solution that passes the finer grid as well as the present one does."""
    allowed_dB = max(worst_place(fine, *present).excess_dB, 0.0) + _TIE
    for reserve_dB in _RESERVES_dB:
        reserve = 10.0 ** (-reserve_dB / 20.0)
        solution = solve(coarse, plant, *present, count, reserve, deciding)
        if solution is not None and worst_place(fine, *solution).excess_dB <= allowed_dB:
            return solution
    return None


def _controller(plant: Plant, R: Array, S: Array, start: RstController) -> RstController:
    return RstController(
        R=R,
        S=S,
        T=np.array([R.sum()]),
        H_R=OPEN_AT_NYQUIST,
        H_S=INTEGRATOR,
        P=total(product(plant.A, S), product(plant.B, R)),
        residual=start.residual,
    )
