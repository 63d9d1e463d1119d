"""Static decoupling of a stage in front of its controllers, and the remaining coupling.

    r' = D r,  y' = D y,   D G(s) = diag(G_0) + L(s),   L(0) = 0
    T_ij = [D G]_ij / [D G]_jj

References and readings pass the same matrix: with the references alone a controller with an
integrator would bring its own reading, coupling and all, to a reference that is not that of the
axis. T_ij is what axis i moves, before its controller corrects it, for each metre of axis j
[Skogestad & Postlethwaite 2005, 3.4].
"""

from dataclasses import dataclass

import numpy as np

from piezoid.errors import DesignError
from piezoid.formatting import with_unit
from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid.numerics.arrays import Array, ComplexArray, freeze

# A displacement that its own drive moves by less, of what the drive moves in all displacements,
# does not belong to it.
LEAST_OWN = 0.01
GRID = 40  # frequencies between the lowest and the bandwidth
LOWEST = 0.01  # of the bandwidth, or the lowest line of the data


@dataclass(frozen=True, kw_only=True, eq=False)
class Decoupling:
    """The matrix, and by how much axes move each other without it and with it.

    axes          in the order of rows and columns
    matrix        (axes, axes)  D, for references and readings alike
    frequency_Hz  up to which the coupling is told: the slowest loop's bandwidth
    before, left  (axes, axes)  largest |T_ij| up to there, without D and with it; row i moves,
                  column j is the one that is to move; 0 on the diagonal
    """

    axes: tuple[str, ...]
    matrix: Array
    frequency_Hz: float
    before: Array
    left: Array

    def __post_init__(self) -> None:
        freeze(self, "matrix", "before", "left", ndim=2)

    @property
    def text(self) -> str:
        """Describe the coupling without the matrix and the remaining coupling."""
        i, j = np.unravel_index(int(self.left.argmax()), self.left.shape)
        return (
            f"Up to {with_unit(self.frequency_Hz, 'Hz')} axes move each other by as much as "
            f"{100 * self.before.max():.3g} % of the motion of one without the matrix and "
            f"{100 * self.left.max():.3g} % behind it, before feedback; most, axis "
            f"{self.axes[i]} when {self.axes[j]} moves."
        )


def decoupling_of(coupled: CoupledStage, bandwidth_Hz: float) -> Decoupling:
    """Return the static decoupling of a stage, and the remaining coupling up to a bandwidth.

    Raises ``DesignError`` where a drive does not move the displacement of its own axis.
    """
    gain = coupled.coupling_m_per_V
    own_share = np.abs(np.diag(gain)) / np.linalg.norm(gain, axis=0)
    for axis, share in zip(coupled.inputs, own_share, strict=True):
        if share < LEAST_OWN:
            raise DesignError(
                f"axis {axis}: its drive moves its own displacement by {100 * share:.2g} % of "
                "what it moves in all",
                needed=f"{100 * LEAST_OWN:g} % or more: a drive belongs to the displacement it "
                "moves",
                remedy="Name the columns in lab.toml so that drive and displacement of one name "
                "belong together.",
            )
    D = coupled.decoupling
    low_Hz = max(coupled.band_Hz[0], LOWEST * bandwidth_Hz)
    f = np.geomspace(min(low_Hz, bandwidth_Hz), bandwidth_Hz, GRID)
    G = coupled.response(f, float(np.sqrt(coupled.levels_V[0] * coupled.levels_V[-1])))
    return Decoupling(
        axes=coupled.outputs,
        matrix=D,
        frequency_Hz=float(bandwidth_Hz),
        before=_transmitted(G),
        left=_transmitted(D @ G),
    )


def _transmitted(response: ComplexArray) -> Array:
    """Return the largest |G_ij / G_jj| over frequencies, (outputs, inputs), 0 on the diagonal."""
    diagonal = np.abs(np.einsum("fjj->fj", response))
    ratio = (np.abs(response) / diagonal[:, None, :]).max(axis=0)
    np.fill_diagonal(ratio, 0.0)
    return np.asarray(ratio)
