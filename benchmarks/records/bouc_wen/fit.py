"""Identification of the mode: a start from the equation of motion, then the output error.

The equation of motion, filtered by F = 1 / (p^2 + a p + b), is linear in m, c, k, k2, k3, h and
f0 once the state z is computed from the measured displacement [Steiglitz & McBride 1965; Young
1981]. Noise of the displacement biases that start. The final fit minimises

    sum_k (y[k] - y_model[k])^2

over all parameters and the three initial states.
"""

from dataclasses import astuple, dataclass, fields

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.stats import t as student

from benchmarks.records.bouc_wen.mode import BoucWenMode, band_limited, integrate, state_along

FINE = 4  # filter steps per sample
ROUNDS = 4  # of the filter, whose a and b follow from the mode of the previous round
# Starts of beta, gamma and n: a knee inside or outside the range of the displacement, a force that
# saturates or stiffens.
KNEES = tuple(
    (beta, gamma, n) for n in (1.0, 2.0) for beta in (0.5, 2.0) for gamma in (-2.0, -0.5, 0.5)
)
KNEE_BOUNDS = ([-20.0, -20.0, 1.0], [20.0, 20.0, 8.0])
BLOCKS = 20  # of the record, whose sums of scores give the covariance
NAMES = tuple(field.name for field in fields(BoucWenMode))[:-1]


@dataclass(frozen=True, kw_only=True)
class BoucWenFit:
    """The identified mode.

    interval        95 % interval by parameter name
    residual_rms_m  on the training record
    """

    mode: BoucWenMode
    interval: dict[str, tuple[float, float]]
    residual_rms_m: float


def fit(force: np.ndarray, displacement_m: np.ndarray, rate_Hz: float) -> BoucWenFit:
    """Identify the mode from force (N) and displacement, (samples,) each."""
    start = equation_error_start(force, displacement_m, rate_Hz)
    steps, size_m = start.steps(rate_Hz), start.size_m
    fine = band_limited(force, 2 * steps)
    scale = _scales(start)
    lower = np.where(np.array([*NAMES, "y", "v", "z"]) == "exponent", 1.0, -np.inf)
    lower[0] = 1e-3

    def mode(x: np.ndarray) -> BoucWenMode:
        values = map(float, (x * scale)[:-3])
        return BoucWenMode(**dict(zip(NAMES, values, strict=True)), size_m=size_m)

    def error(x: np.ndarray) -> np.ndarray:
        simulated = integrate(mode(x), fine, steps, rate_Hz, (x * scale)[-3:])
        return np.minimum(simulated, 1e3) - displacement_m / size_m

    initial = np.array([displacement_m[0] / size_m, 0.0, 0.0])
    x = np.maximum(np.concatenate([astuple(start)[:-1], initial]) / scale, lower)
    best = least_squares(
        error, x, bounds=(lower, np.inf), x_scale="jac", diff_step=1e-6, ftol=1e-9, xtol=1e-9
    )
    half_width = _half_widths(best.jac, best.fun) * scale
    values = best.x * scale
    return BoucWenFit(
        mode=mode(best.x),
        interval={
            name: (float(values[i] - half_width[i]), float(values[i] + half_width[i]))
            for i, name in enumerate(NAMES)
        },
        residual_rms_m=size_m * float(np.sqrt(np.mean(best.fun**2))),
    )


def equation_error_start(
    force: np.ndarray, displacement_m: np.ndarray, rate_Hz: float
) -> BoucWenMode:
    """Return the mode whose filtered equation of motion has the smallest error."""
    middle_m = 0.5 * float(displacement_m.max() + displacement_m.min())
    size_m = 0.5 * float(np.ptp(displacement_m))
    y = band_limited((displacement_m - middle_m) / size_m, FINE)
    u = band_limited(force, FINE)
    fine_Hz = FINE * rate_Hz
    impulse = np.zeros_like(y)
    impulse[0] = 1.0

    def solve(natural: tuple[float, float], nonlinear: list[np.ndarray]) -> tuple:
        def low_pass(signal: np.ndarray) -> np.ndarray:
            return lfilter(*_second_order(0.0, natural, fine_Hz), signal)

        def derivative(signal: np.ndarray) -> np.ndarray:
            return lfilter(*_second_order(1.0, natural, fine_Hz), signal)

        position, velocity = low_pass(y), derivative(y)
        acceleration = y - natural[0] * velocity - natural[1] * position
        columns = [
            acceleration, velocity, position, *map(low_pass, nonlinear),
            low_pass(np.ones_like(y)), low_pass(impulse), derivative(impulse),
        ]  # fmt: skip
        matrix, target = np.column_stack(columns)[::FINE], low_pass(u)[::FINE]
        weights = np.linalg.lstsq(matrix, target, rcond=None)[0]
        return weights, (target - matrix @ weights) / abs(weights[0])

    centre = np.sqrt(np.mean((np.diff(y) * fine_Hz) ** 2) / np.var(y))
    natural = 0.5 * centre, centre**2
    for _ in range(ROUNDS):
        weights, _ = solve(natural, [])
        a, b = weights[1] / weights[0], weights[2] / weights[0]
        natural = (max(a, 0.02 * np.sqrt(b)), b) if b > 0.0 else natural

    def bouc_wen(knee: np.ndarray) -> tuple:
        state = np.nan_to_num(np.clip(state_along(y, *knee), -1e3, 1e3))
        return solve(natural, [y**2, y**3, state])

    first = min(KNEES, key=lambda knee: float(np.sum(bouc_wen(np.array(knee))[1] ** 2)))
    knee = least_squares(lambda x: bouc_wen(x)[1], first, bounds=KNEE_BOUNDS, max_nfev=20).x
    weights, _ = bouc_wen(knee)
    mass, damping, stiffness, quadratic, cubic, spring = weights[:6] / size_m
    return BoucWenMode(
        mass=float(mass),
        damping=float(damping),
        stiffness=float(stiffness),
        quadratic=float(quadratic / size_m),
        cubic=float(cubic / size_m**2),
        spring_stiffness=float(spring),
        beta=float(knee[0]),
        gamma=float(knee[1]),
        exponent=float(knee[2]),
        # f0 of the equation counts from the middle of the motion, that of the simulation from zero
        bias=float(weights[6] - stiffness * middle_m),
        size_m=size_m,
    )


def _second_order(
    order: float, natural: tuple[float, float], rate_Hz: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the bilinear filter p^order / (p^2 + a p + b), order 0 or 1, natural = (a, b)."""
    p, (a, b) = 2.0 * rate_Hz, natural
    bottom = np.array([p**2 + a * p + b, 2.0 * (b - p**2), p**2 - a * p + b])
    top = np.array([p, 0.0, -p]) if order else np.array([1.0, 2.0, 1.0])
    return top / bottom[0], bottom / bottom[0]


def _scales(start: BoucWenMode) -> np.ndarray:
    """Return the size of every parameter and initial state."""
    stiffness = max(abs(start.stiffness + start.spring_stiffness), abs(start.stiffness))
    rapid = np.sqrt(stiffness / start.mass)
    rigid = [start.mass, np.sqrt(stiffness * start.mass), stiffness]
    bend = [stiffness / start.size_m, stiffness / start.size_m**2]
    return np.array(
        [*rigid, *bend, stiffness, 1.0, 1.0, 1.0, stiffness * start.size_m, 1.0, rapid, 1.0]
    )


def _half_widths(jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return 95 % half-widths for errors that are correlated within a block.

        C = (J'J)^-1 (sum_b g_b g_b') (J'J)^-1,   g_b = sum of J' r over block b

    Source: Liang & Zeger, Biometrika 73 (1986), with Student's t of the blocks less one.
    """
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    edges = np.linspace(0, len(residual), BLOCKS + 1).astype(int)[:-1]
    scores = np.add.reduceat(jacobian * residual[:, None], edges, axis=0)
    covariance = inverse @ (scores.T @ scores) @ inverse * BLOCKS / (BLOCKS - 1)
    return student.ppf(0.975, BLOCKS - 1) * np.sqrt(np.diag(covariance))
