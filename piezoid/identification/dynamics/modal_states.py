"""Plain state space of a mode, a lag, a filter bank: what a realisation is put together from."""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.linear import ContinuousSystem


def mode_states(w: float, zeta: float, g: Array, h: Array) -> tuple[Array, Array, Array]:
    """Return A, B, C of one mode: two states for each independent combination of its inputs.

    w     scalar             rad/s
    zeta  scalar
    g, h  (outputs, inputs)  its gain, and its gain for the rate
    """
    both = np.concatenate([g, h * w])
    left, strength, right = np.linalg.svd(both, full_matrices=False)
    rank = max(int((strength > 1e-13 * strength[0]).sum()), 1)
    shape = left[:, :rank] * strength[:rank]
    single = np.array([[0.0, w], [-w, -2 * zeta * w]])
    drive = np.array([[0.0], [w]])
    outputs = len(g)
    return (
        np.kron(np.eye(rank), single),
        np.kron(np.eye(rank), drive) @ right[:rank],
        np.stack([shape[:outputs], shape[outputs:]], axis=2).reshape(outputs, 2 * rank),
    )


def lag_states(w: float, g: Array) -> tuple[Array, Array, Array]:
    """Return A, B, C of one first-order pole: a state for each input."""
    inputs = g.shape[1]
    return -w * np.eye(inputs), w * np.eye(inputs), g


def for_each(system: ContinuousSystem, inputs: int) -> ContinuousSystem:
    """Return the same filter in every input."""
    each = np.eye(inputs)
    A, B, C, D = (np.kron(each, getattr(system, name)) for name in "ABCD")
    return ContinuousSystem(A=A, B=B, C=C, D=D)
