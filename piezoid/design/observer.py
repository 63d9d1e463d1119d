"""Disturbance observer: an estimator of state and input-equivalent disturbance, with feedback.

    x[k+1] = A x[k] + B (u[k] + d[k]),   d = c w,   w[k+1] = F w[k],   y = C x

Both forms share these equations. In the affine form u is the drive itself, and d contains the
difference between the hysteresis and an affine map. In the inverse form u is the linearised
command v, the drive is the exact inverse of the hysteresis model at v, and d contains only the
error of that model.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, hessenberg, matrix_balance

from piezoid.design.plant import Plant
from piezoid.design.rst import RstController
from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array, freeze

_UNREACHABLE = 1e-12
# The sampled pole of a sensor at 2.5 sampling rates is 1.5e-7, and no gain moves it. Poles below
# this magnitude are not placed if the link to them is weak.
_NEAR_ZERO, _WEAK = 1e-4, 1e-9
_ROUNDING = 1e-14  # of the largest entry; entries in m/V are larger


def placement(A: Array, B: Array) -> Callable[[ArrayLike], Array]:
    """Return the placement of the poles of a system, as a function of the desired poles.

    Poles are placed in the Hessenberg basis that starts at B, by Ackermann's formula

        K = e_n' (H - p_1 I) ... (H - p_n I) Q' / (b h_21 h_32 ... )

    without the powers of A and the controllability matrix, which lose all digits at order eight.

    A  (n, n)
    B  (n,)

    The function takes (n,) values of z, complex ones in pairs and possibly repeated, and returns
    the K with which A - B K has these eigenvalues. Of n poles the r farthest from 0 are placed:
    poles at 0 that are not controllable stay there. Raises ``DesignError`` if other poles are not
    controllable.
    """
    # Powers of two balance rows and columns: states in m and in V differ by 1e6. The sampled pole
    # of an instantaneous lag is rounding, which balancing would scale up to the size of its row.
    rounded = np.where(np.abs(A) > _ROUNDING * np.abs(A).max(), A, 0.0)
    balanced, (basis, _) = matrix_balance(rounded, permute=False, separate=True)
    input_column = (np.asarray(B, dtype=np.float64) / basis)[:, None]
    reflect, upper = np.linalg.qr(input_column, mode="complete")  # first column along the input
    form, Q = hessenberg(reflect.T @ balanced @ reflect, calc_q=True)
    links = np.concatenate([[float(upper[0, 0])], np.diag(form, -1)])
    for k in np.flatnonzero(np.abs(links) <= _WEAK * max(1.0, float(np.abs(links).max()))):
        if k and np.abs(np.linalg.eigvals(form[k:, k:])).max() < _NEAR_ZERO:
            form, Q, links = form[:k, :k], Q[:, :k], links[:k]
            break
    if not np.abs(links).min() > _UNREACHABLE * max(1.0, float(np.abs(links).max())):
        raise DesignError(
            f"a part of the state is not controllable: link {int(np.abs(links).argmin())} of the "
            f"chain from the input is {np.abs(links).min():.1e}",
            needed="states that are all controllable from the input and observable in the output",
            remedy="Reduce the model's order; two poles or a pole and a zero nearly coincide.",
        )
    order = len(form)

    def gain(poles: ArrayLike) -> Array:
        row = np.zeros(order, dtype=np.complex128)
        row[-1] = 1.0
        z = np.asarray(poles, dtype=np.complex128)
        for k, pole in enumerate(z[np.sort(np.argsort(-np.abs(z), kind="stable")[:order])]):
            row = (row @ form - pole * row) / links[order - 1 - k]
        return np.asarray((row.real @ Q.T @ reflect.T) / basis)

    return gain


@dataclass(frozen=True, kw_only=True, eq=False)
class DisturbanceModel:
    """Model of the disturbance; its components are rejected without steady-state error.

        w[k+1] = F w[k],   d[k] = c w[k]

    transition  F  (w, w)  eigenvalues on the unit circle
    output      c  (w,)
    """

    transition: Array
    output: Array

    def __post_init__(self) -> None:
        freeze(self, "transition", ndim=2)
        freeze(self, "output")


@dataclass(frozen=True, kw_only=True, eq=False)
class DisturbanceObserver:
    """Gains of the disturbance observer and state feedback of one axis.

    form                 ``affine`` or ``inverse``
    A, B, C              (n, n), (n,), (n,)  design model; past inputs are its last states
    disturbance          the disturbance model, w states
    state_gain           (n,)  L: correction of the state per output unit of innovation
    disturbance_gain     (w,)  V per output unit of innovation
    feedback_gain        (n,)  K: V per unit of state
    reference_gain       N: V per output unit, makes y = r at rest

    At each sample (current form):

        nu = y - C x_;  x = x_ + L nu;  w = w_ + L_d nu;  v = N r - K x - c w
        x_ = A x + B (v_applied + c w);  w_ = F w
    """

    form: str
    A: Array
    B: Array
    C: Array
    disturbance: DisturbanceModel
    state_gain: Array
    disturbance_gain: Array
    feedback_gain: Array
    reference_gain: float

    def __post_init__(self) -> None:
        freeze(self, "A", ndim=2)
        freeze(self, "B", "C", "state_gain", "disturbance_gain", "feedback_gain")


def disturbance_model(
    sampling_rate_Hz: float, oscillation_Hz: tuple[float, ...] = ()
) -> DisturbanceModel:
    """Return the model of a constant, and of an undamped oscillator at each given frequency.

    The rejection by an observer of a constant alone falls by 20 dB/decade towards the scan
    frequency. An oscillator there restores it, at the expense of the margins.
    """
    blocks, outputs = [np.ones((1, 1))], [1.0]
    for f in oscillation_Hz:
        angle = 2.0 * np.pi * f / sampling_rate_Hz
        cosine, sine = np.cos(angle), np.sin(angle)
        blocks.append(np.array([[cosine, sine], [-sine, cosine]]))
        outputs += [1.0, 0.0]
    return DisturbanceModel(transition=block_diag(*blocks), output=np.array(outputs))


class ObserverFrame:
    """Plant, disturbance and form of an observer, with the factorisations that its gains need.

    A search computes the gains of thousands of observers from one frame.

    form  ``affine`` or ``inverse``
    """

    def __init__(self, *, plant: Plant, disturbance: DisturbanceModel, form: str) -> None:
        self.plant, self.disturbance, self.form = plant, disturbance, form
        self._realised = A, B, _ = plant.realised()
        self._past_outputs = _past_outputs(disturbance, len(A) - len(plant.state_matrix))
        self._feedback = placement(A, B)
        # State at rest under one volt: N = (1 + K x) / (C x), x = (I - A)^-1 B makes y = r. The
        # runtime checks N by the same formula. 1 / (C (I - A + B K)^-1 B) is the same number, but
        # states in metres and in volts make that matrix so ill-conditioned that its rounding
        # exceeds the tolerance of the check.
        self._rest_state = np.asarray(np.linalg.solve(np.eye(len(A)) - A, B), dtype=np.float64)

    @cached_property
    def _correction(self) -> Callable[[ArrayLike], Array]:
        A_e, C_e = extended(self.plant, self.disturbance)
        return placement(A_e.T, C_e @ A_e)

    def placed(
        self, *, feedback_poles: ArrayLike, observer_poles: ArrayLike
    ) -> DisturbanceObserver:
        """Place the poles of state feedback and observer.

            eig(A - B K) = feedback_poles and zeros
            eig(A_e - A_e L C_e) = observer_poles and zeros

        feedback_poles  (n,)      values of z; n states of the plant without its delays
        observer_poles  (n + w,)  values of z
        zeros           one for each past input among the plant's states

        Past inputs are known exactly, so the observer has no poles for them; see ``extended``.
        """
        gain = self._correction(observer_poles)
        return self.with_gain(gain, feedback_poles=feedback_poles)

    def with_gain(self, gain: Array, *, feedback_poles: ArrayLike) -> DisturbanceObserver:
        """Return the observer with a correction gain, (n + w,), and with placed feedback poles."""
        order = len(self.plant.state_matrix)
        A, B, C = self._realised
        delay_poles = np.zeros(len(A) - order)
        poles = np.concatenate([np.asarray(feedback_poles, dtype=np.complex128), delay_poles])
        K = self._feedback(poles)
        state_gain, disturbance_gain = gain[:order], gain[order:]
        return DisturbanceObserver(
            form=self.form,
            A=A,
            B=B,
            C=C,
            disturbance=self.disturbance,
            state_gain=np.concatenate([state_gain, self._past_outputs @ disturbance_gain]),
            disturbance_gain=disturbance_gain,
            feedback_gain=K,
            reference_gain=float((1.0 + K @ self._rest_state) / (C @ self._rest_state)),
        )


def extended(plant: Plant, disturbance: DisturbanceModel) -> tuple[Array, Array]:
    """Return A_e and C_e of plant and disturbance together, without states for past inputs.

        A_e = [A  sum_j b_j c F^-j; 0 F],   C_e = [C 0]

    A past disturbance is F^-j w, so a delayed input needs no state for its disturbance.
    """
    order, states = len(plant.state_matrix), len(disturbance.output)
    past = np.vstack(
        [disturbance.output, _past_outputs(disturbance, plant.input_taps.shape[1] - 1)]
    )
    A_e = np.block(
        [
            [plant.state_matrix, plant.input_taps @ past],
            [np.zeros((states, order)), disturbance.transition],
        ]
    )
    return A_e, np.concatenate([plant.output_vector, np.zeros(states)])


def _past_outputs(disturbance: DisturbanceModel, count: int) -> Array:
    """Return the rows c F^-1, ..., c F^-count."""
    rows: list[Array] = []
    row = disturbance.output
    for _ in range(count):
        row = np.asarray(np.linalg.solve(disturbance.transition.T, row), dtype=np.float64)
        rows.append(row)
    return np.array(rows).reshape(count, len(disturbance.output))


def linear_controller(observer: DisturbanceObserver) -> RstController:
    """Return observer and feedback as one controller S u = T r - R y.

    With M = I - L C_e the state matrix is (A_e - B_e K_e) M, and S its characteristic polynomial;
    T = N det(I - q^-1 A_e M), N times the characteristic polynomial of the observer.
    """
    R, S = feedback_polynomials(observer)
    A_e, _, C_e, L, _ = _stacked(observer)
    corrected = A_e @ (np.eye(len(A_e)) - np.outer(L, C_e))
    return RstController(R=R, S=S, T=observer.reference_gain * _characteristic(corrected))


def feedback_polynomials(observer: DisturbanceObserver) -> tuple[Array, Array]:
    """Return R and S of ``linear_controller``, without T."""
    A_e, B_e, C_e, L, K_e = _stacked(observer)
    correct = np.eye(len(A_e)) - np.outer(L, C_e)
    closed = A_e - np.outer(B_e, K_e)
    transition = closed @ correct
    S = _characteristic(transition)
    # The numerator is the impulse response times the denominator. A difference of characteristic
    # polynomials would lose digits.
    row, state = -K_e @ correct, closed @ L
    impulse = np.empty(len(S))
    impulse[0] = -float(K_e @ L)
    for k in range(1, len(S)):
        impulse[k] = row @ state
        state = transition @ state
    return -np.convolve(impulse, S)[: len(S)], S


def with_oscillators_as_states(observer: DisturbanceObserver) -> DisturbanceObserver:
    """Return the same observer with its oscillators among the states of x.

    The disturbance model of the runtime is a single constant; it runs oscillators this way:

        A' = [A  B c_o; 0 F_o],  B' = [B; 0],  C' = [C 0],  L' = [L; L_o],  K' = [K c_o]
    """
    model = observer.disturbance
    count = len(model.output) - 1
    if count == 0:
        return observer
    oscillation = model.transition[1:, 1:]
    return DisturbanceObserver(
        form=observer.form,
        A=np.block(
            [
                [observer.A, np.outer(observer.B, model.output[1:])],
                [np.zeros((count, len(observer.A))), oscillation],
            ]
        ),
        B=np.concatenate([observer.B, np.zeros(count)]),
        C=np.concatenate([observer.C, np.zeros(count)]),
        disturbance=DisturbanceModel(transition=np.ones((1, 1)), output=np.ones(1)),
        state_gain=np.concatenate([observer.state_gain, observer.disturbance_gain[1:]]),
        disturbance_gain=observer.disturbance_gain[:1],
        feedback_gain=np.concatenate([observer.feedback_gain, model.output[1:]]),
        reference_gain=observer.reference_gain,
    )


def _stacked(observer: DisturbanceObserver) -> tuple[Array, Array, Array, Array, Array]:
    """Return A_e, B_e, C_e, L and K_e of plant and disturbance states together."""
    model = observer.disturbance
    order, states = len(observer.A), len(model.output)
    A_e = np.zeros((order + states, order + states))  # np.block takes three times as long
    A_e[:order, :order], A_e[:order, order:] = observer.A, np.outer(observer.B, model.output)
    A_e[order:, order:] = model.transition
    B_e = np.concatenate([observer.B, np.zeros(states)])
    C_e = np.concatenate([observer.C, np.zeros(states)])
    L = np.concatenate([observer.state_gain, observer.disturbance_gain])
    return A_e, B_e, C_e, L, np.concatenate([observer.feedback_gain, model.output])


def _characteristic(matrix: Array) -> Array:
    """Return det(I - q^-1 M), monic in q^-1, as ``np.poly`` does, in less time for a search."""
    polynomial = [1.0 + 0.0j]
    for root in np.linalg.eigvals(matrix).tolist():
        shifted = [0.0, *polynomial]
        polynomial = [a - root * b for a, b in zip([*polynomial, 0.0], shifted, strict=True)]
    return np.array(polynomial).real.copy()
