"""An exponential with an offset, fitted at fixed weights: the decay searched, the rest solved.

    i_j = s ( A_c exp(-k (z_j - z_0)) + o ),   c the piece that point j belongs to

For a given decay ``k`` the amplitudes and the offset are a linear weighted least squares problem
[Golub & Pereyra 1973], so that only one number is searched, over all plausible values: there is
no start value and no local minimum to fall into. Pieces are sweeps, and the parts of a sweep
between tip jumps; all share one decay and one offset.
"""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array

LEAST_DECAY_PER_M = 0.5e9  # 0.0024 eV: no junction
MOST_DECAY_PER_M = 60e9  # 34 eV: no junction either
_GRID = np.geomspace(LEAST_DECAY_PER_M, MOST_DECAY_PER_M, 160)


@dataclass(frozen=True, kw_only=True, eq=False)
class Points:
    """The points of one fit, all sweeps together, the current turned upright.

    height_m   (points,)  above the lowest height of all, so that exponentials stay below one
    current_A  (points,)  times the polarity of the bias
    piece      (points,)  whole numbers from 0: which amplitude applies
    weight     (points,)  1 / variance, 1/A^2
    """

    height_m: Array
    current_A: Array
    piece: Array
    weight: Array

    @property
    def pieces(self) -> int:
        """Number of amplitudes."""
        return int(self.piece.max()) + 1

    def mirrored(self) -> "Points":
        """Return the points with the height reversed, as if it counted extension."""
        return Points(
            height_m=self.height_m.max() - self.height_m,
            current_A=self.current_A,
            piece=self.piece,
            weight=self.weight,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Exponential:
    """What one decay explains.

    decay_per_m  k
    amplitude_A  (pieces,)  current at the lowest height; zero where the data want it negative
    offset_A     upright, of the amplifier
    cost         weighted sum of squared residuals
    """

    decay_per_m: float
    amplitude_A: Array
    offset_A: float
    cost: float

    def mean(self, points: Points) -> Array:
        """Return the modelled current without the offset, (points,) A."""
        decayed = np.exp(-self.decay_per_m * points.height_m)
        mean: Array = self.amplitude_A[points.piece.astype(int)] * decayed
        return mean

    def jacobian(self, points: Points) -> Array:
        """Return d i / d (k, ln A of each piece, o), (points, pieces + 2)."""
        mean = self.mean(points)
        columns = [-points.height_m * mean]
        columns += [mean * (points.piece == piece) for piece in range(points.pieces)]
        return np.column_stack([*columns, np.ones_like(mean)])


def solve_at(points: Points, decay_per_m: float) -> Exponential:
    """Return the best amplitudes and offset for a given decay.

    An amplitude that would be negative is held at zero: the tip does not pump current uphill.
    """
    decayed = np.exp(-decay_per_m * points.height_m)
    root = np.sqrt(points.weight)
    used = np.ones(points.pieces, dtype=bool)
    while True:
        columns = [decayed * (points.piece == piece) for piece in np.flatnonzero(used)]
        design = np.column_stack([*columns, np.ones_like(decayed)])
        solution = np.linalg.lstsq(design * root[:, None], points.current_A * root, rcond=None)[0]
        if (solution[:-1] >= 0.0).all():
            break
        used[np.flatnonzero(used)[solution[:-1] < 0.0]] = False
    amplitude_A = np.zeros(points.pieces)
    amplitude_A[used] = solution[:-1]
    cost = float(np.sum(points.weight * (points.current_A - design @ solution) ** 2))
    return Exponential(
        decay_per_m=decay_per_m,
        amplitude_A=amplitude_A,
        offset_A=float(solution[-1]),
        cost=cost,
    )


def fit_exponential(points: Points) -> Exponential:
    """Return the decay, amplitudes and offset of least weighted residual.

    The decay is searched on a grid over all plausible values, then refined between neighbours.
    """
    from scipy.optimize import minimize_scalar

    costs = [solve_at(points, float(decay)).cost for decay in _GRID]
    best = int(np.argmin(costs))
    around = (float(_GRID[max(best - 1, 0)]), float(_GRID[min(best + 1, len(_GRID) - 1)]))
    refined = minimize_scalar(
        lambda decay: solve_at(points, float(decay)).cost,
        bounds=around,
        method="bounded",
        options={"xatol": 1e-9 * _GRID[best]},
    )
    return solve_at(points, float(refined.x))


def profile_interval(points: Points, fit: Exponential, excess: float) -> tuple[float, float]:
    """Return the decays whose cost exceeds the least by no more than ``excess``.

        { k : cost(k) - cost(k^) <= excess }

    A bound of 0 or infinity says that the data exclude no decay on that side.
    """
    low = _crossing(points, fit, excess, LEAST_DECAY_PER_M)
    high = _crossing(points, fit, excess, MOST_DECAY_PER_M)
    return (0.0 if low is None else low, np.inf if high is None else high)


def _crossing(points: Points, fit: Exponential, excess: float, end: float) -> float | None:
    from scipy.optimize import brentq

    def above(decay: float) -> float:
        return solve_at(points, decay).cost - fit.cost - excess

    toward = np.geomspace(fit.decay_per_m, end, 60)[1:]
    inside = fit.decay_per_m
    for outside in toward:
        if above(float(outside)) > 0.0:
            return float(brentq(above, inside, float(outside), rtol=1e-10))
        inside = float(outside)
    return None
