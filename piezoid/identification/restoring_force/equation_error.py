"""Starts for a hysteretic mode: its equation of motion, filtered, is linear in what it weighs.

    F f = m F y'' + c F y' + k F y + k2 F y^2 + k3 F y^3 + sum_j w_j F z_j(y) + f0 F 1
    F = 1 / (p^2 + a p + b)

F y'' = y - a F y' - b F y needs no derivative of a measured signal. F is taken from the last
solution, so that the error is close to that of the displacement itself.

Source: Steiglitz & McBride, IEEE Trans. Automatic Control 10 (1965); state-variable filters in
Young, Automatica 17 (1981). What goes wrong: noise in y is in the columns, and biases what they
weigh; it is a start for a fit of the simulation, and no more.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.numerics.levenberg_marquardt import (
    Eliminated,
    Rows,
    Rule,
    eliminated,
    minimise,
)
from piezoid.operators.hysteretic_mode import (
    BoucWenSpring,
    Hold,
    HystereticMode,
    MaxwellSlip,
    bouc_wen_states,
    fine_drive,
)
from piezoid.operators.linear import recursive_filter
from piezoid.operators.play import play_columns

FINER = 4  # of the filters, per sample: what is tried at half the sampling rate is held wrong
ROUNDS = 4  # of the filter: the figures of the last two differ by some percent at most
# Starts of beta and gamma in sizes of the motion, and of n: a knee within the motion or beyond
# it, the force saturating (beta + gamma > 0) or stiffening.
KNEES = tuple(
    (beta, gamma, n) for n in (1.0, 2.0) for beta in (0.5, 2.0) for gamma in (-2.0, -0.5, 0.5)
)
DESCENTS = 3  # of the best of them
KNEE_BOUNDS = (np.array([-20.0, -20.0, 1.0]), np.array([20.0, 20.0, 6.0]))
NO_SPRING = MaxwellSlip(threshold=(), stiffness=())
STOPS = 8
WIDEST = 0.8  # of half the range: a wider play may never move where blocks are left out
RIDGE = 1e-7  # of a column: far below what noise does to a weight
FARTHEST = 1e3  # sizes of the motion; a state beyond has left all bounds
KNEE_STEP = 1e-4  # of a difference, in units of the knee


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """Where a fit of the simulation begins.

    mode   with the spring
    bias   f0, drive unit, with the motion counted from its middle
    error  rms of the equation in displacement, m
    """

    mode: HystereticMode
    bias: float
    error: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Signals:
    """Drive and displacement between the samples, and which samples count.

    drive, motion  (rows,)  the motion in sizes about its middle
    chosen         (samples,)  bool
    rate_Hz        of the rows
    """

    drive: Array
    motion: Array
    chosen: NDArray[np.bool_]
    rate_Hz: float
    size_m: float

    def solved(self, natural: tuple[float, float], forces: Array) -> "_Solution":
        """Weigh inertia, damping, stiffness, a bias, a free decay, and forces (rows, forces)."""
        columns = [self.known(natural), *(self.seen(force, natural) for force in forces.T)]
        found = weighed(np.column_stack(columns), self.seen(self.drive, natural))
        mass = found.coefficients[0]
        error = float(np.sqrt(np.mean(found.residual**2))) * self.size_m / abs(float(mass))
        return _Solution(weights=found.coefficients, error=error)

    def known(self, natural: tuple[float, float]) -> Array:
        """Return the columns that every restoring force has, (chosen samples, 6)."""
        a, b = natural
        position = self._filtered([1.0], natural, self.motion)
        velocity = self._filtered([1.0, 0.0], natural, self.motion)
        impulse = np.zeros_like(self.motion)
        impulse[0] = 1.0
        decays = [self._filtered(top, natural, impulse) for top in ([1.0], [1.0, 0.0])]
        bias = self._filtered([1.0], natural, np.ones_like(impulse))
        inertia = self.motion - a * velocity - b * position
        columns = np.column_stack([inertia, velocity, position, bias, *decays])
        return np.asarray(columns[::FINER][self.chosen])

    def seen(self, signal: Array, natural: tuple[float, float]) -> Array:
        """Return F of a signal at the chosen samples."""
        return np.asarray(self._filtered([1.0], natural, signal)[::FINER][self.chosen])

    def _filtered(self, top: list[float], natural: tuple[float, float], signal: Array) -> Array:
        b, a = second_order(top, natural, self.rate_Hz)
        return recursive_filter(b, a, signal)


def second_order(
    top: Sequence[float], natural: tuple[float, float], rate_Hz: float
) -> tuple[Array, Array]:
    """Return numerator and denominator of top / (p^2 + a p + b), p = 2 r (z - 1) / (z + 1).

    top      constant, or (slope, constant)
    natural  a and b
    """
    p, (a, b) = 2.0 * rate_Hz, natural
    slope, constant = top if len(top) > 1 else (0.0, top[0])
    bottom = np.array([p**2 + a * p + b, 2.0 * (b - p**2), p**2 - a * p + b])
    upper = np.array([slope * p + constant, 2.0 * constant, constant - slope * p])
    return upper / bottom[0], bottom / bottom[0]


def weighed(columns: Array, target: Array) -> Eliminated:
    """Return the weights of columns, (rows, columns), of which some may not move at all.

    A play wider than what is left of a motion is a constant: each weight costs a little.
    """
    size = np.linalg.norm(columns, axis=0)
    held = RIDGE * np.diag(np.maximum(size, RIDGE * size.max()))
    found = eliminated(
        np.vstack([columns, held]), np.concatenate([target, np.zeros(columns.shape[1])])
    )
    return replace(found, Q=found.Q[: len(target)], residual=found.residual[: len(target)])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Solution:
    weights: Array
    error: float

    def natural(self, before: tuple[float, float], stiffening: float) -> tuple[float, float]:
        """Return a and b of the next filter; those of before where the solution is no mode."""
        mass, damping, stiffness = self.weights[:3]
        a, b = damping / mass, (stiffness + stiffening) / mass
        return (max(a, 0.02 * np.sqrt(b)), b) if b > 0.0 else before


def _signals(
    drive: Array,
    displacement_m: Array,
    sampling_rate_Hz: float,
    hold: Hold,
    chosen: NDArray[np.bool_],
) -> _Signals:
    middle_m = 0.5 * (displacement_m.max() + displacement_m.min())
    size_m = 0.5 * float(np.ptp(displacement_m))
    half = FINER // 2
    fine = fine_drive((displacement_m - middle_m) / size_m, sampling_rate_Hz, half, "band_limited")
    return _Signals(
        drive=fine_drive(drive, sampling_rate_Hz, half, hold).values,
        motion=fine.values,
        chosen=chosen,
        rate_Hz=FINER * sampling_rate_Hz,
        size_m=size_m,
    )


def starts(
    drive: Array,
    displacement_m: Array,
    sampling_rate_Hz: float,
    hold: Hold,
    chosen: NDArray[np.bool_],
) -> dict[str, Start]:
    """Return a start for each form of the restoring force.

    drive, displacement_m  (samples,)
    chosen                 (samples,)  bool: what may be learnt from
    returned               linear, duffing, maxwell_slip and bouc_wen
    """
    signals = _signals(drive, displacement_m, sampling_rate_Hz, hold, chosen)
    natural, none = _centroid(signals), np.empty((len(signals.motion), 0))
    linear = signals.solved(natural, none)
    for _ in range(ROUNDS):
        natural = linear.natural(natural, 0.0)
        linear = signals.solved(natural, none)
    mass = abs(float(linear.weights[0] / signals.size_m))
    powers = np.column_stack([signals.motion**2, signals.motion**3])
    bent = signals.solved(natural, powers)
    threshold = WIDEST * (np.arange(1, STOPS + 1) / STOPS) ** 2
    columns, _ = play_columns(signals.motion, threshold, np.zeros(STOPS))
    stops = signals.motion[:, None] - columns
    slip = signals.solved(natural, np.column_stack([powers, stops]))
    spring = MaxwellSlip(
        threshold=tuple(threshold), stiffness=tuple(slip.weights[8:] / signals.size_m)
    )
    return {
        "linear": _start(linear, NO_SPRING, signals, mass),
        "duffing": _start(bent, NO_SPRING, signals, mass),
        "maxwell_slip": _start(slip, spring, signals, mass),
        "bouc_wen": _bouc_wen(signals, natural, powers, mass),
    }


def _centroid(signals: _Signals) -> tuple[float, float]:
    """Return a and b of a well-damped filter at the mean frequency of the motion."""
    speed = np.diff(signals.motion) * signals.rate_Hz
    centre = float(np.sqrt(np.mean(speed**2) / np.var(signals.motion)))
    return 0.5 * centre, centre**2


def _start(
    solution: _Solution, spring: BoucWenSpring | MaxwellSlip, signals: _Signals, mass: float
) -> Start:
    """Return the start of a solution; a mass that is none gives way to that of the linear mode."""
    found, damping, stiffness = map(float, solution.weights[:3] / signals.size_m)
    bend = solution.weights[6:8] if len(solution.weights) > 6 else np.zeros(2)
    return Start(
        mode=HystereticMode(
            mass=found if found > 0.0 else mass,
            damping=damping,
            stiffness=stiffness,
            quadratic=bend[0] / signals.size_m**2,
            cubic=bend[1] / signals.size_m**3,
            spring=spring,
            size_m=signals.size_m,
        ),
        bias=float(solution.weights[3]),
        error=solution.error,
    )  # fmt: skip


def _bouc_wen(
    signals: _Signals, natural: tuple[float, float], powers: Array, mass: float
) -> Start:
    seen = np.column_stack([signals.seen(power, natural) for power in powers.T])
    known = np.column_stack([signals.known(natural), seen])
    without = weighed(known, signals.seen(signals.drive, natural))

    def at(knee: Array) -> "_Knee":
        return _Knee(signals=signals, natural=natural, without=without, knee=knee)

    tried = sorted((at(np.array(knee)) for knee in KNEES), key=lambda one: one.cost)
    rule = Rule(iterations=20, tolerance=1e-4)
    reached = [
        minimise(at, one.knee, KNEE_BOUNDS, rule=rule, longest=1.0) for one in tried[:DESCENTS]
    ]
    best = min((one.point for one in reached), key=lambda point: point.cost)
    solution = signals.solved(natural, np.column_stack([powers, best.state]))
    beta, gamma, n = map(float, best.knee)
    spring = BoucWenSpring(
        stiffness=solution.weights[8] / signals.size_m, beta=beta, gamma=gamma, exponent=n
    )
    return _start(solution, spring, signals, mass)


class _Knee:
    """The equation at one knee: what the state adds to an equation solved without it."""

    def __init__(
        self, *, signals: _Signals, natural: tuple[float, float], without: Eliminated, knee: Array
    ) -> None:
        self.signals, self.natural, self.without, self.knee = signals, natural, without, knee
        beta, gamma, n = map(float, knee)
        state = bouc_wen_states(signals.motion, beta, gamma, n)
        self.state = np.nan_to_num(np.clip(state, -FARTHEST, FARTHEST))
        seen = signals.seen(self.state, natural)
        new = seen - without.Q @ (without.Q.T @ seen)
        self.residual = without.residual - new * (new @ without.residual) / (new @ new)

    @property
    def cost(self) -> float:
        """Return the sum of squares of the equation's error."""
        return float(self.residual @ self.residual)

    def linearised(self) -> Rows:
        """Return the error about this knee, by differences."""
        columns = []
        for i in range(len(self.knee)):
            moved = self.knee.copy()
            moved[i] += KNEE_STEP
            other = _Knee(
                signals=self.signals, natural=self.natural, without=self.without, knee=moved
            )
            columns.append((other.residual - self.residual) / KNEE_STEP)
        return Rows(factor=np.column_stack(columns), residual=self.residual)
