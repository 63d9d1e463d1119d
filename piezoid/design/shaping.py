"""Sensitivity shaping of R, S, T: by band-stops, and by convex steps from that controller.

``shape`` follows Landau & Zito 2006: dominant pair, auxiliary poles, then pairs of fixed part and
auxiliary pole around the frequency of the worst violation, and the equation is solved again.

``optimise`` has R' and S' as free coefficients. On the nominal plant every stabilising pair is the
central one plus a Youla parameter, and all sensitivities are affine in it. Over a family the
closed-loop polynomials P_i differ, and affine becomes a condition around reference polynomials:
with P_d,i stable,

    Re{P_i conj(P_d,i)} > 0 for all w   implies   P_i stable (it cannot wind around zero)

P_d,i are the polynomials of the previous design, and the problem is solved repeatedly until the
rejection converges. Each step keeps every member stable and every limit met, because

    |A_i S| <= limit Re{P_i conj(P_d,i)} / |P_d,i|   implies   |A_i S| / |P_i| <= limit

where the left side is a second-order cone in the free coefficients of R and S [Landau & Zito 2006;
Karimi & Galdos 2010].
"""

from dataclasses import dataclass
from warnings import catch_warnings

import numpy as np
from numpy.typing import NDArray

from piezoid.design.feasibility import unmet
from piezoid.design.loop_search import (
    FamilyGrid,
    LoopFigures,
    Solution,
    evaluate_loop,
    family_grid,
    search,
)
from piezoid.design.plant import Plant, PlantFamily, Section
from piezoid.design.rst import (
    INTEGRATOR,
    OPEN_AT_NYQUIST,
    RstController,
    closed_loop_target,
    place_poles,
)
from piezoid.design.specification import Specification
from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import Response, polynomial_response, product

_INFEASIBLE = (1e3, 1e3)
_MIN_RATIO, _MAX_RATIO = 0.25, 0.7  # of the dampings of a band-stop
_MIN_TIGHTENING_dB = 0.02
_MIN_IMPROVEMENT = 0.95  # ratio of rejection figures
_DENOMINATOR_DAMPING = 0.8  # of a band-stop

BandStop = tuple[str, float, float]
"""``S`` to lower |Syp| or ``R`` to lower |Sup|; frequency in Hz; damping of the numerator."""


def band_stop_polynomials(
    frequency_Hz: float, damping: float, sampling_rate_Hz: float
) -> tuple[Array, Array]:
    """Return the monic numerator and denominator of a band-stop in q^-1.

        (s^2 + 2 z_n w0 s + w0^2) / (s^2 + 2 z_d w0 s + w0^2),  s = c (1 - q^-1)/(1 + q^-1)

    with c = 2 fs and w0 = c tan(pi f0 / fs): the bilinear map, prewarped so that the attenuation
    z_n / z_d is exactly at f0; z_d is 0.8.                               [Landau & Zito 2006]

    damping  z_n of the numerator
    """
    c = 2.0 * sampling_rate_Hz
    w0 = c * np.tan(np.pi * frequency_Hz / sampling_rate_Hz)

    def mapped(damping: float) -> Array:
        middle, side = 2.0 * w0**2 - 2.0 * c**2, 2.0 * damping * w0 * c
        raw = np.array([c**2 + side + w0**2, middle, c**2 - side + w0**2])
        return np.asarray(raw / raw[0])

    return mapped(damping), mapped(_DENOMINATOR_DAMPING)


def shape(
    family: PlantFamily, specification: Specification, *, max_band_stops: int = 3
) -> Solution:
    """Search P_D and P_F for the smallest rejection figure under all limits, and add band-stops.

    A band-stop is tried at the frequency that is worst relative to its limit. Its attenuation is
    the excess there, from 3 to 12 dB. It is kept if it reduces the excess, or the rejection by 5 %
    at the same excess; the first band-stop that is not kept ends the search.
    """
    grid = family_grid(family, specification)
    stops: tuple[BandStop, ...] = ()
    controller, parameters, figures = _best_placement(family.nominal, grid, stops)
    for _ in range(max_band_stops):
        ratio = 10.0 ** (-max(figures.excess_dB, 3.0) / 20.0)
        damping = float(np.clip(ratio, _MIN_RATIO, _MAX_RATIO)) * _DENOMINATOR_DAMPING
        part = "R" if figures.function == "Sup" else "S"
        more_stops = (*stops, (part, figures.frequency_Hz, damping))
        candidate = _best_placement(family.nominal, grid, more_stops)
        tightened = candidate[-1]
        # The band-stop must justify two more coefficients in R, S and P.
        tightened_dB = max(figures.excess_dB, 0.0) - max(tightened.excess_dB, 0.0)
        is_better = tightened_dB > 0.0
        if abs(tightened_dB) <= _MIN_TIGHTENING_dB:
            is_better = tightened.rejection < _MIN_IMPROVEMENT * figures.rejection
        if not is_better:
            break
        stops, (controller, parameters, figures) = more_stops, candidate
    return Solution(
        name="band-stop",
        controller=controller,
        parameters=parameters,
        figure=figures.rejection,
        violations=unmet(family.members, controller.R, controller.S, specification),
    )


def _best_placement(
    plant: Plant, grid: FamilyGrid, band_stops: tuple[BandStop, ...]
) -> tuple[RstController, dict[str, float], LoopFigures]:
    """Search log f0 and zeta of the dominant pair and the auxiliary root for fixed band-stops.

        P = P_D P_F,   P_F = (1 - alpha q^-1)^n,   R and S contain 1 + q^-1, 1 - q^-1 and the stops

    The range of f0 follows from the plant's delay.
    """
    rate_Hz = plant.sampling_rate_Hz
    fixed_r, fixed_s, denominators = OPEN_AT_NYQUIST, INTEGRATOR, np.ones(1)
    for part, frequency_Hz, damping in band_stops:
        numerator, denominator = band_stop_polynomials(frequency_Hz, damping, rate_Hz)
        denominators = product(denominators, denominator)
        if part == "S":
            fixed_s = product(fixed_s, numerator)
        else:
            fixed_r = product(fixed_r, numerator)
    free = len(plant.A) + len(plant.B) - 3
    reach_Hz = min(0.1 / plant.rest_delay_s, 0.2 * rate_Hz)
    lower = np.array([np.log(0.02 * reach_Hz), 0.5, 0.02])
    upper = np.array([np.log(min(5.0 * reach_Hz, 0.3 * rate_Hz)), 1.5, 0.8])
    starts = [
        np.array([np.log(share * reach_Hz), 0.9, root])
        for share, root in ((1.0, 0.2), (0.3, 0.2), (0.1, 0.4))
    ]

    def place(x: Array) -> RstController:
        dominant = Section(frequency_Hz=float(np.exp(x[0])), damping=float(x[1]))
        target = closed_loop_target(
            dominant, rate_Hz, auxiliary_root=float(x[2]), auxiliary_count=free
        )
        return place_poles(plant, product(target, denominators), H_R=fixed_r, H_S=fixed_s)

    def cost(x: Array) -> tuple[float, float]:
        try:
            controller = place(x)
        except DesignError:
            return _INFEASIBLE
        figures = evaluate_loop(grid, controller.R, controller.S)
        return float(np.log(figures.rejection)), figures.excess_dB

    x = search(cost, lower, upper, starts)
    controller = place(x)
    parameters = {
        "dominant_Hz": float(np.exp(x[0])),
        "dominant_damping": float(x[1]),
        "auxiliary_root": float(x[2]),
        **{f"stop_{k}_Hz": frequency_Hz for k, (_, frequency_Hz, _) in enumerate(band_stops)},
    }
    return controller, parameters, evaluate_loop(grid, controller.R, controller.S)


_MIN_REAL = 0.05
_SLACK_WEIGHT = 100.0
_TOLERANCE = 1e-7

# The cones are tightened for peaks between grid points, by the first reserve that suffices.
_RESERVES_dB = (0.05, 0.2, 0.5)
_MIN_STEP_IMPROVEMENT = 0.01  # of the rejection figure, by one convex step
_TIE = 1e-4
_TAPS = 10  # free coefficients of R' and of S', at least
_EVERY = 10  # rows of the grid, of which one is active at first; violated rows are added


@dataclass(frozen=True, kw_only=True, eq=False)
class Cones:
    """Coefficients of one convex problem; rows run over members and frequencies together.

    numerators     A S, A R and B R: (rows, unknowns) complex, and constants (rows,)
    real           (rows, unknowns), (rows,)  Re{P_i conj(P_d,i)} / |P_d,i|
    reference      (rows,)  |P_d,i|
    limits         (functions, rows), in the order of the numerators
    slope          (rows,)  f / bandwidth, nan above the bandwidth
    """

    numerators: tuple[tuple[Response, Response], ...]
    real: tuple[Array, Array]
    reference: Array
    limits: Array
    slope: Array

    def at(self, rows: NDArray[np.bool_]) -> "Cones":
        """Return the problem on some rows only."""
        return Cones(
            numerators=tuple((free[rows], constant[rows]) for free, constant in self.numerators),
            real=(self.real[0][rows], self.real[1][rows]),
            reference=self.reference[rows],
            limits=self.limits[:, rows],
            slope=self.slope[rows],
        )


def solve(
    grid: FamilyGrid,
    plant: Plant,
    R: Array,
    S: Array,
    count: int,
    reserve: float,
    active: NDArray[np.bool_],
) -> tuple[Array, Array] | None:
    """Return R and S that solve one convex problem around a previous loop; None if it fails.

    grid     of members and frequencies, with the limits; its rows are the rows of the problem
    plant    nominal, for the scale of R
    R, S     of the previous loop
    count    free coefficients of R' and of S'
    reserve  <= 1: share of every limit that may be used
    active   (rows,)  rows of the problem that are solved; rows are added in place, for the next
             problem

    A few hundred rows determine the solution. The problem is solved on these, then on these and
    the peaks of the violation by its solution, until there is no violation (Remez exchange).
    """
    scale = abs(plant.gain)
    cones = cones_around(grid, scale, R, S, count)
    while True:
        solution = _solve_program(cones.at(active), count, reserve)
        if solution is None:
            return None
        x, gamma, slack = solution
        # the violation of each row, relative to the closed loop, and its local maxima
        real = (cones.real[0] @ x + cones.real[1]) / cones.reference
        allowed, excess = reserve * (real + slack), _MIN_REAL - real
        sizes = [
            np.abs(rows @ x + constant) / cones.reference for rows, constant in cones.numerators
        ]
        for size, limit in zip(sizes, cones.limits[:3], strict=True):
            excess = np.maximum(excess, size / limit - allowed)
        in_band = np.maximum(sizes[0] / cones.slope - gamma, 1.0 - real)
        excess = np.fmax(excess, in_band)  # the slope is nan above the band
        preceding, following = np.append(-np.inf, excess[:-1]), np.append(excess[1:], -np.inf)
        peaks = (excess > _TOLERANCE) & (excess >= preceding) & (excess >= following)
        added = peaks & ~active
        if not added.any():
            break
        active |= added
    s_free = np.concatenate([[1.0], x[: count - 1]])
    r_free = x[count - 1 :] / scale
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
        numerators=((A * s_rows, constant), (A * r_rows, none), (B * r_rows, none)),
        real=((turn[:, None] * (A * s_rows + B * r_rows)).real, (turn * constant).real),
        reference=np.abs(desired),
        limits=np.tile(grid.limits, members),
        slope=np.tile(slope, members),
    )


def _solve_program(cones: Cones, count: int, reserve: float) -> tuple[Array, float, float] | None:
    """Solve the second-order cone program on some rows; None if the solver fails.

        minimise    gamma + weight slack
        subject to  real >= min |P_d|,   |size| <= reserve limit (real + slack |P_d|)
                    real >= |P_d|,   |A_i S| <= gamma slope |P_d|     in the band

    One slack of all limits, with a large weight, allows for a start that exceeds them. Returns x,
    gamma and the slack.
    """
    import cvxpy as cp

    x, gamma, slack = cp.Variable(2 * count - 1), cp.Variable(), cp.Variable(nonneg=True)
    reference, band = cones.reference, np.isfinite(cones.slope)
    real = cones.real[0] @ x + cones.real[1]
    constraints = [real >= _MIN_REAL * reference]

    def limit(
        size: tuple[Response, Response], is_limited: NDArray[np.bool_], bound: object
    ) -> None:
        if is_limited.any():
            rows, constant = size[0][is_limited], size[1][is_limited]
            parts = [rows.real @ x + constant.real, rows.imag @ x + constant.imag]
            constraints.append(cp.SOC(bound, cp.vstack(parts)))

    relaxed = real + slack * reference
    for size, upper in zip(cones.numerators, cones.limits[:3], strict=True):
        is_limited = np.isfinite(upper)
        limit(size, is_limited, cp.multiply(reserve * upper[is_limited], relaxed[is_limited]))
    limit(cones.numerators[0], band, gamma * (cones.slope * reference)[band])
    if band.any():
        constraints.append(real[band] >= reference[band])
    program = cp.Problem(cp.Minimize(gamma + _SLACK_WEIGHT * slack), constraints)
    try:
        with catch_warnings(action="ignore", category=UserWarning):
            # An inaccurate solution is checked on the finer grid like any other.
            program.solve(cp.CLARABEL)
    except cp.SolverError:
        return None
    if program.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        return None
    return np.array(x.value), float(gamma.value), float(slack.value)


def optimise(
    family: PlantFamily,
    specification: Specification,
    start: RstController,
    *,
    max_iterations: int = 8,
) -> Solution:
    """Minimise the rejection figure over R' and S', from a start that stabilises every member.

        minimise    gamma
        subject to  |A_i S| <= gamma (f / bandwidth) |P_d,i|,  Re_i >= |P_d,i|    f <= bandwidth
                    |A_i S| <= Syp_max Re_i,  |A_i R| <= Sup_max Re_i,  |B_i R| <= Syb_max Re_i
        with        Re_i = Re{P_i conj(P_d,i)} / |P_d,i|,  S = H_S S',  R = H_R R',  s'_0 = 1

    Limits that the start exceeds are relaxed together, as little as possible. Each step is
    checked on a grid ten times finer, and solved again with more reserve if it fails there. The
    figures of the result are those on the fine grid.
    """
    count = max(_TAPS, len(start.S) - len(INTEGRATOR) + 1, len(start.R) - len(OPEN_AT_NYQUIST) + 1)
    coarse = family_grid(family, specification, count=20 * count)
    fine = family_grid(family, specification, count=200 * count)
    active = np.arange(coarse.A.size) % _EVERY == 0
    best, R, S = evaluate_loop(fine, start.R, start.S), start.R, start.S
    iterations = 0
    while iterations < max_iterations:
        allowed_dB = max(best.excess_dB, 0.0) + _TIE
        for reserve_dB in _RESERVES_dB:
            reserve = 10.0 ** (-reserve_dB / 20.0)
            step = solve(coarse, family.nominal, R, S, count, reserve, active)
            if step is not None:
                worst = evaluate_loop(fine, *step)
                if worst.excess_dB <= allowed_dB:
                    break
        else:
            break
        tightened_dB = max(best.excess_dB, 0.0) - max(worst.excess_dB, 0.0)
        improvement = best.rejection - worst.rejection
        if tightened_dB <= _TIE and improvement <= _MIN_STEP_IMPROVEMENT * best.rejection:
            break
        (R, S), best, iterations = step, worst, iterations + 1
    return Solution(
        name="convex",
        controller=RstController(R=R, S=S, T=np.array([R.sum()])),
        parameters={"taps": float(count), "iterations": float(iterations)},
        figure=best.rejection,
        violations=unmet(family.members, R, S, specification),
    )
