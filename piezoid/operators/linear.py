"""Linear systems with a delay, sampled exactly behind a zero-order hold."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from piezoid.numerics.arrays import Array, ComplexArray, expect_shapes, freeze

EQUAL_POLES = 1e-5  # relative difference of poles that are treated as equal
BLOCK_SAMPLES = 64  # of run(): smaller blocks cost time in Python, larger ones in the products


@dataclass(frozen=True, kw_only=True, eq=False)
class ContinuousSystem:
    """A linear system in continuous time with an input delay.

        x'(t) = A x(t) + B u(t - delay),    y(t) = C x(t) + D u(t - delay)

    A (states, states), B (states, inputs), C (outputs, states), D (outputs, inputs)
    delay_s  scalar  s, >= 0
    """

    A: Array
    B: Array
    C: Array
    D: Array
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        _freeze_matrices(self)
        if not (np.isfinite(self.delay_s) and self.delay_s >= 0):
            raise ValueError(f"delay_s is {self.delay_s}, expected a finite number >= 0")

    def response(self, frequency_Hz: ArrayLike) -> NDArray[np.complex128]:
        """Return the frequency response, (lines, outputs, inputs)."""
        s = np.asarray(2j * np.pi * np.asarray(frequency_Hz, dtype=np.float64), np.complex128)
        delay = np.exp(-s * self.delay_s)[:, None, None]
        return np.asarray(delay * _transfer(self.A, self.B, self.C, self.D, s))


@dataclass(frozen=True, kw_only=True, eq=False)
class DiscreteSystem:
    """A linear system in discrete time.

        x[k+1] = A x[k] + B u[k],    y[k] = C x[k] + D u[k]

    A (states, states), B (states, inputs), C (outputs, states), D (outputs, inputs)
    interval_s  scalar  s, > 0, from one sample to the next
    """

    A: Array
    B: Array
    C: Array
    D: Array
    interval_s: float

    def __post_init__(self) -> None:
        _freeze_matrices(self)
        if not (np.isfinite(self.interval_s) and self.interval_s > 0):
            raise ValueError(f"interval_s is {self.interval_s}, expected a finite number > 0")

    def response(self, frequency_Hz: ArrayLike) -> NDArray[np.complex128]:
        """Return the frequency response, (lines, outputs, inputs)."""
        f = np.asarray(frequency_Hz, dtype=np.float64)
        z = np.exp(2j * np.pi * f * self.interval_s)
        return _transfer(self.A, self.B, self.C, self.D, z)

    def run(self, drive: Array, state: Array | None = None) -> tuple[Array, Array]:
        """Return the outputs for a whole record, and the state behind it.

        drive     (samples,) or (samples, inputs)
        state     (states,)  before the first sample; zero if None
        returned  outputs, of the shape of the drive, and (states,)

        Inside a block y = observe x + forced u, where forced is the block Toeplitz matrix of the
        impulse response; from block to block x = A^length x + reach u.
        """
        is_vector, count = np.ndim(drive) == 1, len(drive)
        outputs, inputs = self.D.shape
        u = np.asarray(drive, dtype=np.float64).reshape(count, inputs)
        x = np.zeros(len(self.A)) if state is None else np.asarray(state, dtype=np.float64)
        length = min(BLOCK_SAMPLES, max(count, 1))
        powers = [np.eye(len(x))]
        for _ in range(length):
            powers.append(self.A @ powers[-1])
        observe = np.concatenate([self.C @ power for power in powers[:length]])
        reach = np.concatenate([power @ self.B for power in powers[length - 1 :: -1]], axis=1)
        impulse = self.impulse_response(length)
        triangle = np.zeros((length, outputs, length, inputs))  # of blocks impulse[row - column]
        for column in range(length):
            triangle[column:, :, column, :] = impulse[: length - column]
        forced = triangle.reshape(length * outputs, length * inputs)
        block_count = count // length
        blocks = u[: block_count * length].reshape(block_count, length * inputs)
        starts = np.empty((block_count, len(x)))
        pushes = blocks @ reach.T
        for k in range(block_count):
            starts[k] = x
            x = powers[length] @ x + pushes[k]
        response = (blocks @ forced.T + starts @ observe.T).reshape(block_count * length, outputs)
        remaining = np.empty((count - len(response), outputs))
        for k, row in enumerate(u[len(response) :]):
            x, remaining[k] = self.A @ x + self.B @ row, self.C @ x + self.D @ row
        response = np.concatenate([response, remaining])
        return (response[:, 0] if is_vector and outputs == 1 else response), x

    def impulse_response(self, samples: int) -> Array:
        """Return D, CB, CAB, ..., (samples, outputs, inputs)."""
        response = np.empty((samples, *self.D.shape))
        response[:1] = self.D
        column = self.B
        for k in range(1, samples):
            response[k] = self.C @ column
            column = self.A @ column
        return response


def _freeze_matrices(system: ContinuousSystem | DiscreteSystem) -> None:
    freeze(system, "A", "B", "C", "D", ndim=2)
    states, (outputs, inputs) = len(system.A), system.D.shape
    expected = {"A": (states, states), "B": (states, inputs), "C": (outputs, states)}
    expect_shapes(system, expected)


def _transfer(
    A: Array, B: Array, C: Array, D: Array, v: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """Return C (v I - A)^-1 B + D for every value of v.

    For two states the adjugate is used, which is ten times faster: fits of modes spend their time
    here.

        adj(v I - A) = v I - adj(A)
    """
    if len(A) == 2:
        (a, b), (c, d) = A
        determinant = (v - a) * (v - d) - b * c
        numerator = np.multiply.outer(v, C @ B) - C @ np.array([[d, -b], [-c, a]]) @ B
        return np.asarray(numerator / determinant[:, None, None] + D)
    resolvent = v[:, None, None] * np.eye(len(A)) - A
    inner = np.linalg.solve(resolvent, np.broadcast_to(B, (len(v), *B.shape)))
    return np.asarray(C @ inner + D)


def hold_matrices(A: Array, B: Array, duration_s: float) -> tuple[Array, Array]:
    """Return exp(A t) and the integral of exp(A s) B over [0, t], from one exponential.

        exp([A B; 0 0] t) = [Ad Bd; 0 I]                                    [Van Loan 1978]

    A  (n, n)    B, Bd  (n,) or (n, inputs)
    """
    order, inputs = len(A), B.shape[1] if B.ndim == 2 else 1
    block = np.zeros((order + inputs, order + inputs))
    block[:order, :order], block[:order, order:] = A, B.reshape(order, inputs)
    exponential = expm(block * duration_s)
    held = exponential[:order, order:]
    return exponential[:order, :order], held if B.ndim == 2 else held[:, 0]


def split_delay(delay_s: float, period_s: float) -> tuple[int, float]:
    """Return a delay as whole samples and the remaining seconds, 0 below rounding."""
    delay_samples = int(np.floor(delay_s / period_s + 1e-9))
    remainder_s = delay_s - delay_samples * period_s
    return delay_samples, (remainder_s if remainder_s > 1e-9 * period_s else 0.0)


def sample(system: ContinuousSystem, sampling_rate_Hz: float) -> DiscreteSystem:
    """Sample a system behind a zero-order hold exactly, with any delay.

        exp([A B; 0 0] t) = [A(t) B(t); 0 I]                               [Van Loan 1978]
        x[k+1] = A(T) x[k] + B(T - e) u[k-d] + A(T - e) B(e) u[k-d-1],   delay = d T + e

    Delayed inputs are states after those of the system, the newest first. The direct term acts on
    the delayed input: u[k-d] for e = 0, else u[k-d-1].
    """
    interval_s = 1.0 / sampling_rate_Hz
    delay_samples, rest_s = split_delay(system.delay_s, interval_s)
    transition, newest = hold_matrices(system.A, system.B, interval_s - rest_s)
    # Input matrices of states and outputs, beginning with the newest input.
    taps = [np.zeros_like(system.B)] * delay_samples + [newest]
    direct = [np.zeros_like(system.D)] * delay_samples + [system.D]
    if rest_s > 0.0:
        remainder, oldest = hold_matrices(system.A, system.B, rest_s)
        taps.append(transition @ oldest)
        direct.insert(delay_samples, np.zeros_like(system.D))
        transition = transition @ remainder
    (states, inputs), outputs = system.B.shape, len(system.C)
    delayed_inputs = (len(taps) - 1) * inputs
    shift = np.eye(delayed_inputs, k=-inputs)
    return DiscreteSystem(
        A=np.block([[transition, *taps[1:]], [np.zeros((delayed_inputs, states)), shift]])
        if delayed_inputs
        else transition,
        B=np.concatenate([taps[0], np.eye(delayed_inputs, inputs)]),
        C=np.concatenate([system.C, *direct[1:]], axis=1) if delayed_inputs else system.C,
        D=direct[0].reshape(outputs, inputs),
        interval_s=interval_s,
    )


def sampled_fractions(
    gain: Array, pole: ComplexArray, delay_s: Array, rate_Hz: float, frequency_Hz: Array
) -> ComplexArray:
    """Return the frequency responses of sampled systems given by gains and poles.

        g / prod_k (s - p_k) = sum_k r_k / (s - p_k)
        r (e^(p (T - e)) - 1 + (e^(p T) - e^(p (T - e))) z^-1) / (p (z - e^(p T))) z^-d

    gain      (systems,)        g
    pole      (systems, poles)  none of them 0
    delay_s   (systems,)        d T + e
    returned  (systems, lines)

    Equal poles are separated symmetrically, with an error of second order and a loss of five
    digits, ten digits for three equal poles.
    """
    interval_s = 1.0 / rate_Hz
    split = [split_delay(float(delay), interval_s) for delay in delay_s]
    delay_samples, rest_s = np.array(split).T[:, :, None]
    z = np.exp(2j * np.pi * frequency_Hz * interval_s)
    if not pole.shape[1]:  # a constant acts on the delayed input
        return np.asarray(gain[:, None] / z ** (delay_samples + (rest_s > 0.0)))
    number = np.arange(pole.shape[1])
    is_equal = np.abs(pole[:, :, None] - pole[:, None]) < EQUAL_POLES * np.abs(pole)[:, :, None]
    shift = (is_equal * np.sign(number - number[:, None])).sum(axis=2)
    pole = pole * (1.0 + 0.5 * EQUAL_POLES * shift)
    difference = pole[:, :, None] - pole[:, None]
    difference[:, number, number] = 1.0
    residue = gain[:, None] / (pole * difference.prod(axis=2))
    decay, early = np.exp(pole * interval_s), np.exp(pole * (interval_s - rest_s))
    inside = 1.0 / (z[:, None] - decay[:, None])
    response = inside @ (residue * (early - 1.0))[:, :, None]
    response += inside @ (residue * (decay - early))[:, :, None] / z[:, None]
    return np.asarray(response[:, :, 0] * z**-delay_samples)


def recursive_filter(numerator: ArrayLike, denominator: ArrayLike, signal: Array) -> Array:
    """Filter a signal by a fraction in the delay operator, zero before the first sample.

        a_0 y[k] = sum_i b_i x[k-i] - sum_(i>0) a_i y[k-i]       [Oppenheim & Schafer, ch. 6]

    numerator    (zeros + 1,)  b, the newest input first
    denominator  (poles + 1,)  a, a_0 != 0
    signal       (samples,)
    returned     (samples,)

    With poles outside the unit circle the output grows until it is infinite.
    """
    from scipy.signal import lfilter

    a = np.atleast_1d(denominator)
    if len(a) == 1:  # SciPy would convolve, and round in another order
        a = np.append(a, 0.0)
    return np.asarray(lfilter(numerator, a, signal), dtype=np.float64)


def first_order(frequency_Hz: float) -> ContinuousSystem:
    """Return the first-order low-pass w / (s + w), w = 2 pi ``frequency_Hz``."""
    w = 2 * np.pi * frequency_Hz
    unit = np.ones((1, 1))
    return ContinuousSystem(A=-w * unit, B=w * unit, C=unit, D=np.zeros((1, 1)))


def resonance(frequency_Hz: float, damping: float) -> ContinuousSystem:
    """Return one mode of unit static gain, w^2 / (s^2 + 2 zeta w s + w^2).

    w     2 pi frequency_Hz  > 0
    zeta  damping            > 0

    The states are the displacement over w^2 and its rate over w, which have similar sizes.
    """
    w = 2 * np.pi * frequency_Hz
    return ContinuousSystem(
        A=np.array([[0.0, w], [-w, -2 * damping * w]]),
        B=np.array([[0.0], [w]]),
        C=np.array([[1.0, 0.0]]),
        D=np.zeros((1, 1)),
    )


def butterworth(order: int, frequency_Hz: float) -> ContinuousSystem:
    """Return the Butterworth low-pass filter of unit static gain.

    order         >= 1; the poles lie at equal angles on the circle of radius 2 pi frequency_Hz
    frequency_Hz  > 0, -3 dB
    """
    angles = np.pi * (2 * np.arange(1, order // 2 + 1) - 1) / (2 * order)
    pairs = [resonance(frequency_Hz, float(np.sin(angle))) for angle in angles]
    return cascade(*pairs, *([first_order(frequency_Hz)] if order % 2 else []))


def cascade(*systems: ContinuousSystem) -> ContinuousSystem:
    """Return the series connection of systems, the first at the drive; delays add up."""
    chain = systems[0]
    for system in systems[1:]:
        upper = np.zeros((len(chain.A), len(system.A)))
        chain = ContinuousSystem(
            A=np.block([[chain.A, upper], [system.B @ chain.C, system.A]]),
            B=np.concatenate([chain.B, system.B @ chain.D]),
            C=np.concatenate([system.D @ chain.C, system.C], axis=1),
            D=system.D @ chain.D,
            delay_s=chain.delay_s + system.delay_s,
        )
    return chain
