"""Convex sensitivity shaping over a plant family: R' and S' as free coefficients.

On the nominal plant every stabilising pair is the central one plus a Youla parameter, and all
sensitivities are affine in it. Over a family the closed-loop polynomials P_i differ, and affine
becomes a condition around reference polynomials: with P_d,i stable,

    Re{P_i conj(P_d,i)} > 0 for all w   implies   P_i stable (it cannot wind around zero)

P_d,i are the polynomials of the design so far, and the problem is solved again until it stops
gaining. Each step keeps every member stable and every limit met.        [Landau & Zito 2006]

One convex problem is set up around a closed loop, P_d,i its polynomials,

    |A_i S| <= limit Re{P_i conj(P_d,i)} / |P_d,i|   implies   |A_i S| / |P_i| <= limit

and the left side asks for a cone in the free coefficients of R and S. It is solved on the rows
that decide.                                                       [Karimi & Galdos 2010]
"""

from dataclasses import dataclass
from warnings import catch_warnings

import numpy as np
from numpy.typing import NDArray

from piezoid.design.family_grid import FamilyGrid, family_grid, worst_place
from piezoid.design.plant import Plant, PlantFamily
from piezoid.design.rst import INTEGRATOR, OPEN_AT_NYQUIST, RstController
from piezoid.design.specification import Specification
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import Response, polynomial_response
from piezoid.numerics.polynomial import product

_LEAST_REAL = 0.05
_SLACK_PRICE = 100.0
_TOLERANCE = 1e-7

_RESERVES_dB = (0.05, 0.2, 0.5)
"""The cones are tightened for what happens between grid points: more where less did not do."""
_LEAST_GAIN = 0.01
_TIE = 1e-4
_EVERY = 10


@dataclass(frozen=True, kw_only=True, eq=False)
class Cones:
    """One convex problem in numbers; rows run over members and frequencies together.

    A_S, A_R, B_R  (rows, unknowns) complex, with constants (rows,): the loops' numerators
    real           (rows, unknowns), (rows,)  Re{P_i conj(P_d,i)} / |P_d,i|
    reference      (rows,)  |P_d,i|
    limits         (functions, rows)
    slope          (rows,)  f / bandwidth, nan above the bandwidth
    """

    A_S: tuple[Response, Response]
    A_R: tuple[Response, Response]
    B_R: tuple[Response, Response]
    real: tuple[Array, Array]
    reference: Array
    limits: Array
    slope: Array

    @property
    def limited(self) -> tuple[tuple[Response, Response], ...]:
        """Responses with limits, in the order of the limits."""
        return self.A_S, self.A_R, self.B_R

    def at(self, rows: NDArray[np.bool_]) -> "Cones":
        """Return the problem on some rows only."""
        pairs = ("A_S", "A_R", "B_R", "real")
        return Cones(
            **{name: tuple(part[rows] for part in getattr(self, name)) for name in pairs},
            reference=self.reference[rows],
            limits=self.limits[:, rows],
            slope=self.slope[rows],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Reached:
    """A solution: the unknowns, the rejection they reach, and the slack they needed."""

    x: Array
    gamma: float
    slack: float


def solve(
    grid: FamilyGrid,
    plant: Plant,
    R: Array,
    S: Array,
    count: int,
    reserve: float,
    deciding: NDArray[np.bool_],
) -> tuple[Array, Array] | None:
    """Solve one convex problem around the closed loops of R, S; None if the solver fails.

    grid      of members and frequencies, with the limits; its rows are those of the problem
    plant     the nominal one, for the scale of R
    R, S      of the loop it is set up around
    count     free coefficients of R' and of S'
    reserve   <= 1: share of every limit that may be used
    deciding  (rows,)  which rows are asked; one problem hands them on to the next
    returned  R and S

    A few hundred of the rows decide. The problem is solved on those, and again with the peaks of
    what its solution misses, until it misses none (the exchange of Remez).
    """
    scale = abs(plant.gain)
    cones = cones_around(grid, scale, R, S, count)
    while True:
        solution = _solved(cones.at(deciding), count, reserve)
        if solution is None:
            return None
        # rows of a real excess that are no better than both their neighbours
        excess = _excess(cones, solution, reserve)
        preceding, following = np.append(-np.inf, excess[:-1]), np.append(excess[1:], -np.inf)
        peaks = (excess > _TOLERANCE) & (excess >= preceding) & (excess >= following)
        missed = peaks & ~deciding
        if not missed.any():
            break
        deciding |= missed
    s_free = np.concatenate([[1.0], solution.x[: count - 1]])
    r_free = solution.x[count - 1 :] / scale
    return product(OPEN_AT_NYQUIST, r_free), product(INTEGRATOR, s_free)


def cones_around(grid: FamilyGrid, scale: float, R: Array, S: Array, count: int) -> Cones:
    """Set up the problem around the closed loops of R, S. Unknowns: s'_1.., then scale r'_0.. ."""
    members = len(grid.A)
    q = np.tile(grid.q, members)
    A, B = grid.A.ravel()[:, None], grid.B.ravel()[:, None]
    powers = q[:, None] ** np.arange(count)
    fixed_s = polynomial_response(INTEGRATOR, q)[:, None]
    fixed_r = polynomial_response(OPEN_AT_NYQUIST, q)[:, None] / scale
    s_rows = np.hstack([fixed_s * powers[:, 1:], np.zeros((len(q), count))])
    r_rows = np.hstack([np.zeros((len(q), count - 1)), fixed_r * powers])
    desired = A[:, 0] * polynomial_response(S, q) + B[:, 0] * polynomial_response(R, q)
    turn = np.conj(desired) / np.abs(desired)
    constant = A[:, 0] * fixed_s[:, 0]
    f, bandwidth_Hz = grid.frequency_Hz, grid.specification.bandwidth_Hz
    slope = np.where(f <= bandwidth_Hz * (1.0 + 1e-12), f / bandwidth_Hz, np.nan)
    none = np.zeros(len(q), dtype=np.complex128)
    return Cones(
        A_S=(A * s_rows, constant),
        A_R=(A * r_rows, none),
        B_R=(B * r_rows, none),
        real=((turn[:, None] * (A * s_rows + B * r_rows)).real, (turn * constant).real),
        reference=np.abs(desired),
        limits=np.tile(grid.limits, members),
        slope=np.tile(slope, members),
    )


def _excess(cones: Cones, solution: Reached, reserve: float) -> Array:
    """Return the violation of each row by a solution, relative to the closed loop."""
    real = (cones.real[0] @ solution.x + cones.real[1]) / cones.reference
    room = reserve * (real + solution.slack)
    excess = _LEAST_REAL - real
    for (rows, constant), limit in zip(cones.limited, cones.limits[:3], strict=True):
        size = np.abs(rows @ solution.x + constant) / cones.reference
        excess = np.maximum(excess, size / limit - room)
    size = np.abs(cones.A_S[0] @ solution.x + cones.A_S[1]) / cones.reference
    in_band = np.maximum(size / cones.slope - solution.gamma, 1.0 - real)
    return np.asarray(np.fmax(excess, in_band))  # above the band nothing is asked of the slope


def _solved(cones: Cones, count: int, reserve: float) -> Reached | None:
    """Solve the program on some rows; None if the solver fails.

        minimise    gamma + price slack
        subject to  real >= least |P_d|,   |size| <= reserve limit (real + slack |P_d|)
                    real >= |P_d|,   |A_i S| <= gamma slope |P_d|     in the band

    A slack on all limits together, at a high price, lets a start that exceeds them come back.
    """
    import cvxpy as cp

    x, gamma, slack = cp.Variable(2 * count - 1), cp.Variable(), cp.Variable(nonneg=True)
    reference, band = cones.reference, np.isfinite(cones.slope)
    real = cones.real[0] @ x + cones.real[1]
    constraints = [real >= _LEAST_REAL * reference]

    def limit(
        size: tuple[Response, Response], is_limited: NDArray[np.bool_], bound: object
    ) -> None:
        if is_limited.any():
            rows, constant = size[0][is_limited], size[1][is_limited]
            parts = [rows.real @ x + constant.real, rows.imag @ x + constant.imag]
            constraints.append(cp.SOC(bound, cp.vstack(parts)))

    room = real + slack * reference
    for size, upper in zip(cones.limited, cones.limits[:3], strict=True):
        is_limited = np.isfinite(upper)
        limit(size, is_limited, cp.multiply(reserve * upper[is_limited], room[is_limited]))
    limit(cones.A_S, band, gamma * (cones.slope * reference)[band])
    if band.any():
        constraints.append(real[band] >= reference[band])
    program = cp.Problem(cp.Minimize(gamma + _SLACK_PRICE * slack), constraints)
    try:
        with catch_warnings(action="ignore", category=UserWarning):
            # An inaccurate answer is judged on the finer grid like any other.
            program.solve(cp.CLARABEL)
    except cp.SolverError:
        return None
    if program.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        return None
    return Reached(x=np.array(x.value), gamma=float(gamma.value), slack=float(slack.value))


@dataclass(frozen=True, kw_only=True, eq=False)
class ConvexController:
    """A controller by convex optimisation over a family.

    controller   R, S, T
    taps         free coefficients of R' and of S'
    rejection    max over members and f <= bandwidth of |Syp| bandwidth / f, on the fine grid
    excess_dB    <= 0: every member meets every limit on the fine grid
    history      (iterations + 1,)  the rejection at the start and after each convex problem
    """

    controller: RstController
    taps: int
    rejection: float
    excess_dB: float
    history: tuple[float, ...]

    @property
    def parameters(self) -> dict[str, float]:
        """The size of the problem and of its solution, by name."""
        return {"taps": float(self.taps), "iterations": float(len(self.history) - 1)}


def optimise(
    family: PlantFamily,
    specification: Specification,
    start: RstController,
    *,
    taps: int = 10,
    most_iterations: int = 8,
    every: int = _EVERY,
) -> ConvexController:
    """Minimise the rejection figure over R' and S' from a start that stabilises every member.

        minimise    gamma
        subject to  |A_i S| <= gamma (f / bandwidth) |P_d,i|,  Re_i >= |P_d,i|    f <= bandwidth
                    |A_i S| <= Syp_max Re_i,  |A_i R| <= Sup_max Re_i,  |B_i R| <= Syb_max Re_i
        with        Re_i = Re{P_i conj(P_d,i)} / |P_d,i|,  S = H_S S',  R = H_R R',  s'_0 = 1

    every  so many-th row of the grid is asked at first, and others where the answer breaks them

    Limits that the start exceeds are relaxed together, as little as possible. Each step is
    checked on a grid ten times finer, and solved again with more reserve where it fails there.
    """
    count = max(taps, len(start.S) - len(INTEGRATOR) + 1, len(start.R) - len(OPEN_AT_NYQUIST) + 1)
    coarse = family_grid(family, specification, count=20 * count)
    fine = family_grid(family, specification, count=200 * count)
    deciding = np.arange(coarse.A.size) % every == 0
    best, R, S = worst_place(fine, start.R, start.S), start.R, start.S
    history = [best.rejection]
    while len(history) <= most_iterations:
        allowed_dB = max(best.excess_dB, 0.0) + _TIE
        for reserve_dB in _RESERVES_dB:
            reserve = 10.0 ** (-reserve_dB / 20.0)
            step = solve(coarse, family.nominal, R, S, count, reserve, deciding)
            if step is not None:
                reached = worst_place(fine, *step)
                if reached.excess_dB <= allowed_dB:
                    break
        else:
            break
        tightened = max(best.excess_dB, 0.0) - max(reached.excess_dB, 0.0)
        gained = history[-1] - reached.rejection
        if tightened <= _TIE and gained <= _LEAST_GAIN * history[-1]:
            break
        (R, S), best = step, reached
        history.append(reached.rejection)
    return ConvexController(
        controller=RstController(R=R, S=S, T=np.array([R.sum()])),
        taps=count,
        rejection=best.rejection,
        excess_dB=best.excess_dB,
        history=tuple(history),
    )
