"""Pole placement by state feedback for one input, without forming a characteristic polynomial."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import hessenberg, matrix_balance

from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array

_UNREACHABLE = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacementForm:
    """A system as pole placement needs it: the same for whatever poles are wanted.

    form     (n, n)  Hessenberg, beginning at the input
    links    (n,)    |b|, h_21, h_32, ...
    Q        (n, n)  from ``form`` to the reflected states
    reflect  (n, n)  orthogonal, its first column along the balanced input
    basis    (n,)    powers of two by which the states were balanced
    """

    form: Array
    links: Array
    Q: Array
    reflect: Array
    basis: Array

    def gain(self, poles: ArrayLike) -> Array:
        """Return K such that A - B K has the wanted eigenvalues; repeated ones are welcome.

        poles  (n,)  values of z, complex ones in pairs
        """
        order = len(self.form)
        row = np.zeros(order, dtype=np.complex128)
        row[-1] = 1.0
        for k, pole in enumerate(np.asarray(poles, dtype=np.complex128)):
            row = (row @ self.form - pole * row) / self.links[order - 1 - k]
        return np.asarray((row.real @ self.Q.T @ self.reflect.T) / self.basis)


def placement_form(A: Array, B: Array) -> PlacementForm:
    """Return a system in the Hessenberg basis that starts at B, in which poles are placed by

        K = e_n' (H - p_1 I) ... (H - p_n I) Q' / (b h_21 h_32 ... )

    Ackermann's formula there: the powers of A and the controllability matrix, which cost all
    digits at order eight, are never formed.

    A  (n, n)
    B  (n,)

    Raises ``DesignError`` where a part of the state cannot be reached from B.
    """
    # Powers of two that make rows and columns alike: states in m and in V differ by 1e6.
    balanced, (basis, _) = matrix_balance(A, permute=False, separate=True)
    reflect, size = _reflector(np.asarray(B, dtype=np.float64) / basis)
    form, Q = hessenberg(reflect.T @ balanced @ reflect, calc_q=True)
    links = np.concatenate([[size], np.diag(form, -1)])
    if not np.abs(links).min() > _UNREACHABLE * max(1.0, float(np.abs(links).max())):
        raise DesignError(
            f"a part of the state cannot be moved: link {int(np.abs(links).argmin())} of the "
            f"chain from the input is {np.abs(links).min():.1e}",
            needed="states that all answer the input and are all seen in the output",
            remedy="Reduce the model's order; two poles or a pole and a zero nearly coincide.",
        )
    return PlacementForm(form=form, links=links, Q=Q, reflect=reflect, basis=basis)


def _reflector(B: Array) -> tuple[Array, float]:
    """Return an orthogonal matrix whose first column is along B, and the length of B along it."""
    Q, upper = np.linalg.qr(B[:, None], mode="complete")
    return Q, float(upper[0, 0])
