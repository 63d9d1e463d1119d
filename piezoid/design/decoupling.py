"""Static decoupling of a stage in front of its controllers, and the remaining coupling.

    r' = D r,  y' = D y,   D G(s) = diag(G_0) + L(s),   L(0) = 0
    T_ij = [D G]_ij / [D G]_jj

D multiplies the references and the readings. If it multiplied only the references, an integrating
controller would bring its coupled reading to the decoupled reference. T_ij is the motion of axis i
per motion of axis j, before the controller of axis i corrects it [Skogestad & Postlethwaite 2005,
3.4].
"""

from dataclasses import dataclass

import numpy as np

from piezoid.errors import DesignError
from piezoid.formatting import with_unit
from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid.numerics.arrays import Array, ComplexArray, freeze

_MIN_SHARE = 0.01  # of a drive's total motion that must be in the displacement of its own axis
_GRID = 40  # frequencies up to the bandwidth
_LOWEST = 0.01  # of the bandwidth; at least the lowest line of the data


@dataclass(frozen=True, kw_only=True, eq=False)
class Decoupling:
    """Decoupling matrix, and the coupling between axes without it and with it.

    axes          in the order of rows and columns
    matrix        (axes, axes)  D, for references and readings
    frequency_Hz  bandwidth of the slowest loop
    before, left  (axes, axes)  largest |T_ij| up to that frequency, without D and with it; column
                  j is driven, row i responds; 0 on the diagonal
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
        """Largest coupling without the matrix and with it, as a sentence."""
        i, j = np.unravel_index(int(self.left.argmax()), self.left.shape)
        return (
            f"Up to {with_unit(self.frequency_Hz, 'Hz')} axes move each other by as much as "
            f"{100 * self.before.max():.3g} % of the motion of one without the matrix and "
            f"{100 * self.left.max():.3g} % behind it, before feedback; most, axis "
            f"{self.axes[i]} when {self.axes[j]} moves."
        )


def decoupling_of(coupled: CoupledStage, bandwidth_Hz: float) -> Decoupling:
    """Return the static decoupling of a stage, and the remaining coupling up to a bandwidth.

    Raises ``DesignError`` if a drive does not move the displacement of its own axis.
    """
    gain = coupled.coupling_m_per_V
    self_share = np.abs(np.diag(gain)) / np.linalg.norm(gain, axis=0)
    for axis, share in zip(coupled.inputs, self_share, strict=True):
        if share < _MIN_SHARE:
            raise DesignError(
                f"axis {axis}: {100 * share:.2g} % of the motion by its drive is in its own "
                "displacement",
                needed=f"{100 * _MIN_SHARE:g} % or more",
                remedy="Name the columns in lab.toml so that drive and displacement of one name "
                "belong together.",
            )
    D = coupled.decoupling
    low_Hz = max(coupled.band_Hz[0], _LOWEST * bandwidth_Hz)
    f = np.geomspace(min(low_Hz, bandwidth_Hz), bandwidth_Hz, _GRID)
    G = coupled.response(f, float(np.sqrt(coupled.levels_V[0] * coupled.levels_V[-1])))
    return Decoupling(
        axes=coupled.outputs,
        matrix=D,
        frequency_Hz=float(bandwidth_Hz),
        before=_largest_transmission(G),
        left=_largest_transmission(D @ G),
    )


def _largest_transmission(response: ComplexArray) -> Array:
    """Return the largest |G_ij / G_jj| over frequencies, (outputs, inputs), 0 on the diagonal."""
    diagonal = np.abs(np.einsum("fjj->fj", response))
    ratio = (np.abs(response) / diagonal[:, None, :]).max(axis=0)
    np.fill_diagonal(ratio, 0.0)
    return np.asarray(ratio)
