"""An observer with its feedback as one linear controller, S u = T r - R y."""

from dataclasses import dataclass

import numpy as np

from piezoid.design.observer import DisturbanceModel, DisturbanceObserver
from piezoid.numerics.arrays import Array, freeze


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearController:
    """An observer written as S u = T r - R y, for margins that trust nobody.

    R, S, T    coefficients in q^-1, S monic; S(1) = 0 for a constant disturbance model
    """

    R: Array
    S: Array
    T: Array

    def __post_init__(self) -> None:
        freeze(self, "R", "S", "T")


def linear_controller(observer: DisturbanceObserver) -> LinearController:
    """Write the whole observer with its feedback as S u = T r - R y.

    With M = I - L C_e the state matrix is (A_e - B_e K_e) M and
    S its characteristic polynomial; T = N det(I - q^-1 A_e M), the observer's own polynomial.
    """
    R, S = feedback_polynomials(observer)
    A_e, _, C_e, L, _ = _stacked(observer)
    correct = np.eye(len(A_e)) - np.outer(L, C_e)
    T = observer.reference_gain * _characteristic(A_e @ correct)
    return LinearController(R=R, S=S, T=T)


def feedback_polynomials(observer: DisturbanceObserver) -> tuple[Array, Array]:
    """Return R and S alone: all that a search wants to know of its candidates."""
    A_e, B_e, C_e, L, K_e = _stacked(observer)
    correct = np.eye(len(A_e)) - np.outer(L, C_e)
    closed = A_e - np.outer(B_e, K_e)
    transition = closed @ correct
    S = _characteristic(transition)
    impulse = _impulse(transition, closed @ L, -K_e @ correct, -float(K_e @ L), len(S))
    return -np.convolve(impulse, S)[: len(S)], S


def with_oscillators_as_states(observer: DisturbanceObserver) -> DisturbanceObserver:
    """Return the same observer with its oscillators among the states of x.

    A runtime that knows one constant disturbance runs resonant modes this way:

        A' = [A  B c_o; 0 F_o],  B' = [B; 0],  C' = [C 0],  L' = [L; L_o],  K' = [K c_o]
    """
    model = observer.disturbance
    inner = len(model.output) - 1
    if inner == 0:
        return observer
    oscillation = model.transition[1:, 1:]
    return DisturbanceObserver(
        form=observer.form,
        A=np.block(
            [
                [observer.A, np.outer(observer.B, model.output[1:])],
                [np.zeros((inner, len(observer.A))), oscillation],
            ]
        ),
        B=np.concatenate([observer.B, np.zeros(inner)]),
        C=np.concatenate([observer.C, np.zeros(inner)]),
        disturbance=DisturbanceModel(transition=np.ones((1, 1)), output=np.ones(1)),
        state_gain=np.concatenate([observer.state_gain, observer.disturbance_gain[1:]]),
        disturbance_gain=observer.disturbance_gain[:1],
        feedback_gain=np.concatenate([observer.feedback_gain, model.output[1:]]),
        reference_gain=observer.reference_gain,
    )


def _stacked(observer: DisturbanceObserver) -> tuple[Array, Array, Array, Array, Array]:
    model = observer.disturbance
    states = len(model.output)
    A_e = np.block(
        [
            [observer.A, np.outer(observer.B, model.output)],
            [np.zeros((states, len(observer.A))), model.transition],
        ]
    )
    B_e = np.concatenate([observer.B, np.zeros(states)])
    C_e = np.concatenate([observer.C, np.zeros(states)])
    L = np.concatenate([observer.state_gain, observer.disturbance_gain])
    return A_e, B_e, C_e, L, np.concatenate([observer.feedback_gain, model.output])


def _impulse(A: Array, B: Array, C: Array, direct: float, samples: int) -> Array:
    """Return the first samples of the impulse response of C (zI - A)^-1 B + direct.

    Multiplied by the denominator they are the numerator, with the digits that differences of
    characteristic polynomials lose.
    """
    impulse = np.empty(samples)
    impulse[0], state = direct, B
    for k in range(1, samples):
        impulse[k] = C @ state
        state = A @ state
    return impulse


def _characteristic(matrix: Array) -> Array:
    """Return det(I - q^-1 M), monic in q^-1."""
    return np.ascontiguousarray(np.poly(matrix).real, dtype=np.float64)
