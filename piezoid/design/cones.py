"""One convex problem around a closed loop: second-order cones, solved on the rows that decide.

With P_d,i the closed-loop polynomials of the loop it is set up around,

    |A_i S| <= limit Re{P_i conj(P_d,i)} / |P_d,i|   implies   |A_i S| / |P_i| <= limit

and the left side asks for a cone in the free coefficients of R and S.    [Karimi & Galdos 2010]
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.design.family_grid import FamilyGrid
from piezoid.design.plant import Plant
from piezoid.design.rst import INTEGRATOR, OPEN_AT_NYQUIST
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import Response, polynomial_response
from piezoid.numerics.polynomial import product

_LEAST_REAL = 0.05
_SLACK_PRICE = 100.0
_TOLERANCE = 1e-7


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
        """What has limits, in their order."""
        return self.A_S, self.A_R, self.B_R

    def at(self, rows: NDArray[np.bool_]) -> "Cones":
        """Return the problem on some rows only."""
        return Cones(
            A_S=(self.A_S[0][rows], self.A_S[1][rows]),
            A_R=(self.A_R[0][rows], self.A_R[1][rows]),
            B_R=(self.B_R[0][rows], self.B_R[1][rows]),
            real=(self.real[0][rows], self.real[1][rows]),
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
    """Solve one convex problem around the closed loops of R, S; None where the solver fails.

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
        found = _solved(cones.at(deciding), count, reserve)
        if found is None:
            return None
        missed = _peaks(_excess(cones, found, reserve)) & ~deciding
        if not missed.any():
            break
        deciding |= missed
    s_free = np.concatenate([[1.0], found.x[: count - 1]])
    r_free = found.x[count - 1 :] / scale
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


def _excess(cones: Cones, found: Reached, reserve: float) -> Array:
    """Return by how much a solution misses what every row asks, over the closed loop's size."""
    real = (cones.real[0] @ found.x + cones.real[1]) / cones.reference
    room = reserve * (real + found.slack)
    excess = _LEAST_REAL - real
    for (rows, constant), limit in zip(cones.limited, cones.limits[:3], strict=True):
        size = np.abs(rows @ found.x + constant) / cones.reference
        excess = np.maximum(excess, size / limit - room)
    size = np.abs(cones.A_S[0] @ found.x + cones.A_S[1]) / cones.reference
    in_band = np.maximum(size / cones.slope - found.gamma, 1.0 - real)
    return np.asarray(np.fmax(excess, in_band))  # above the band nothing is asked of the slope


def _peaks(excess: Array) -> NDArray[np.bool_]:
    """Return the rows of a real excess that are no better than both their neighbours."""
    before, after = np.append(-np.inf, excess[:-1]), np.append(excess[1:], -np.inf)
    return (excess > _TOLERANCE) & (excess >= before) & (excess >= after)


def _solved(cones: Cones, count: int, reserve: float) -> Reached | None:
    """Solve the program on some rows; None where the solver fails.

        min gamma + price slack   over z = (x, gamma, slack),   b - A z in a product of cones

    A slack on all limits together, at a high price, lets a start that exceeds them come back.
    """
    import clarabel
    from scipy.sparse import csc_matrix

    linear, sizes = _linear(cones), _sizes(cones, reserve)
    rows = -np.vstack([linear[0], sizes[0].reshape(-1, 2 * count + 1)])
    price = np.zeros(2 * count + 1)
    price[-2:] = 1.0, _SLACK_PRICE
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    kinds = [clarabel.NonnegativeConeT(len(linear[0]))]
    kinds += [clarabel.SecondOrderConeT(3)] * len(sizes[0])
    none = csc_matrix((len(price), len(price)))
    offsets = np.concatenate([linear[1], sizes[1].ravel()])
    found = clarabel.DefaultSolver(none, price, csc_matrix(rows), offsets, kinds, settings).solve()
    # An inaccurate answer is judged on the finer grid like any other.
    if str(found.status) not in ("Solved", "AlmostSolved"):
        return None
    *x, gamma, slack = found.x
    return Reached(x=np.array(x), gamma=gamma, slack=slack)


def _linear(cones: Cones) -> tuple[Array, Array]:
    """Return rows and constants that are to be >= 0: real parts, those in the band, the slack."""
    (rows, constant), reference = cones.real, cones.reference
    band = np.isfinite(cones.slope)
    real = np.pad(np.vstack([rows, rows[band]]), ((0, 1), (0, 2)))
    real[-1, -1] = 1.0
    above = [constant - _LEAST_REAL * reference, (constant - reference)[band]]
    return real, np.append(np.concatenate(above), 0.0)


def _sizes(cones: Cones, reserve: float) -> tuple[Array, Array]:
    """Return bound, real and imaginary part of every limited size, (sizes, 3, unknowns)."""
    rows, constants = [], []
    real = np.column_stack([cones.real[0], np.zeros(len(cones.reference)), cones.reference])
    for (size, offset), limit in zip(cones.limited, cones.limits[:3], strict=True):
        held = np.isfinite(limit)
        share = reserve * limit[held]
        rows.append(_cone(share[:, None] * real[held], size[held]))
        constants.append(_cone(share * cones.real[1][held], offset[held]))
    band = np.isfinite(cones.slope)
    gamma = np.zeros((int(band.sum()), real.shape[1]))
    gamma[:, -2] = (cones.slope * cones.reference)[band]
    rows.append(_cone(gamma, cones.A_S[0][band]))
    constants.append(_cone(np.zeros(len(gamma)), cones.A_S[1][band]))
    return np.concatenate(rows), np.concatenate(constants)


def _cone(bound: Array, size: Response) -> Array:
    """Return bound, real and imaginary part of every row, with no part of gamma and slack."""
    wider = size if size.ndim == 1 else np.pad(size, ((0, 0), (0, 2)))
    return np.stack([bound, wider.real, wider.imag], axis=1)
