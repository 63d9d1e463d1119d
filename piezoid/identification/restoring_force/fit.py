"""A recording to one mode with a hysteretic restoring force, by the error of its simulation.

    min  sum_k (y[k] - y_model[k])^2,    m y'' + c y' + k y + k2 y^2 + k3 y^3 + z = u - f0

The form of the force, Bouc-Wen, Maxwell slip or none, is chosen by blocks that were left out.
Where the drive repeats itself, a block is left out of every period, or it would be known from the
others.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.identification.restoring_force.equation_error import Start
from piezoid.identification.restoring_force.task import Task, drive_and_motion, task_of
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import on_one_thread
from piezoid.numerics.levenberg_marquardt import Minimum, NormalEquations, Rule, minimise
from piezoid.numerics.robust import student_quantile
from piezoid.operators.hysteretic_mode import (
    BoucWenSpring,
    FineDrive,
    Hold,
    HystereticMode,
    MaxwellSlip,
    fine_drive,
)
from piezoid.records.recording import Recording
from piezoid.showing import shown

SCORES = 20  # blocks whose sums of scores the intervals are drawn from
# Steps of the integration per period of the mode. With the benchmark's true equations, rms in
# 1e-7 m on its multisine: 10.4 at 43 steps, 3.5 at 86, 2.5 at 172, 2.4 at 430.
STEPS_PER_PERIOD = 200
STEPS = (2, 64)  # per sample, at least and at most
DIFFERENCE = 1e-6  # of a number's size
FAR_M = 1.0  # stands for a motion that left all bounds: no search goes there
RULE = Rule(tolerance=1e-6, iterations=40)
EXPONENT = (1.0, 8.0)
# Of left-out error: a law must be better by so much than one with fewer numbers. On four linear
# modes the laws with more numbers changed it by -0.05 to +1.0 %.
FAINT = 0.02
SHOWN = 0.8  # of what a line leaves: a mode that leaves more does not show

LAWS = {
    "linear": "linear",
    "duffing": "bent, without memory",
    "maxwell_slip": "Maxwell slip",
    "bouc_wen": "Bouc-Wen",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class RestoringForceModel:
    """One mode with a hysteretic restoring force, as identified from one recording.

        m y'' + c y' + k y + k2 y^2 + k3 y^3 + z(y) = u - f0

    law               ``bouc_wen``, ``maxwell_slip``, ``duffing`` (bent, without memory) or
                      ``linear``: chosen on blocks left out
    mode              m, c, k, k2, k3 and the spring z, per unit of the drive
    bias              f0, drive unit
    interval          95 %, by name: mass, damping, stiffness, and those of the spring
    residual_rms_m    on the whole recording
    left_out_rms_m    by law: fitted on half of the blocks, judged on the other half
    hold              how the drive goes on between its samples
    samples           of the recording
    """

    law: str
    mode: HystereticMode
    bias: float
    interval: dict[str, tuple[float, float]]
    residual_rms_m: float
    left_out_rms_m: dict[str, float]
    hold: Hold
    samples: int

    def simulate(self, drive: Array, sampling_rate_Hz: float, *, periodic: bool = False) -> Array:
        """Return the displacement that a drive makes, (samples,) m.

        drive     (samples,)  in the unit of the recording
        periodic  one period of a drive that repeats: the steady motion, as after four periods;
                  otherwise it begins at rest, with k y = u - f0 and z = 0

        >>> swing.simulate(swinging.voltage_V(), swinging.sampling_rate_Hz).shape
        (2000,)
        """
        given = np.asarray(drive, dtype=np.float64) - self.bias
        asked = np.tile(given, PERIODS) if periodic else given
        steps = self.steps(sampling_rate_Hz)
        fine = fine_drive(asked, sampling_rate_Hz, steps, self.hold)
        state = np.zeros(3 + _stops(self.mode))
        if self.mode.stiffness > 0.0:
            state[0] = asked[0] / (self.mode.stiffness * self.mode.size_m)
        y, _ = self.mode.simulated(fine, state)
        if not np.isfinite(y).all():
            raise IdentificationError(
                f"the motion leaves all bounds after {np.isfinite(y).sum()} samples",
                needed="a drive within the range of the recording that the model was fitted to",
                remedy="Lower the drive, or fit a recording that reaches as far.",
            )
        return np.asarray(y[-len(given) :])

    def steps(self, sampling_rate_Hz: float) -> int:
        """Return how many steps of the integration a sample takes.

        >>> swing.steps(swinging.sampling_rate_Hz) >= 1
        True
        """
        return steps_of(self.mode, sampling_rate_Hz)

    @property
    def natural_frequency_Hz(self) -> float:
        """Frequency of small motion: of k and of the spring's stiffness at rest together."""
        return float(np.sqrt(_rest_stiffness(self.mode) / self.mode.mass) / (2.0 * np.pi))

    def _repr_html_(self) -> str:
        known = {**_named(self.mode), **{"bias": self.bias}}
        numbers = [
            (name, f"{value:.5g}" + _told(self.interval.get(name)))
            for name, value in known.items()
        ]
        tried = ", ".join(f"{LAWS[law]} {rms:.2e} m" for law, rms in self.left_out_rms_m.items())
        rows = [("restoring force", LAWS[self.law]), *numbers, ("left out, rms", tried)]
        return shown("Mode with a hysteretic restoring force", rows)


PERIODS = 5  # of a periodic drive: the last is returned


@on_one_thread
def identify_restoring_force(
    recording: Recording, *, axis: str | None = None, hold: Hold = "zero_order"
) -> RestoringForceModel:
    """Identify one mode whose spring is hysteretic, for stages that swing about their hysteresis.

        m y'' + c y' + k y + k2 y^2 + k3 y^3 + z(y) = u - f0      [Bouc 1967; Iwan 1966]

    recording  a drive through the resonance, at levels that bring the hysteresis out
    axis       whose; default: the recording's own
    hold       ``zero_order`` where the drive column holds numbers sent to a converter,
               ``band_limited`` where the drive was measured through a filter

    What goes wrong: with hysteresis before or behind the mode this model fits badly and its
    numbers mean nothing; ask ``place_hysteresis`` first. A slow drive leaves m and c unknown. The
    intervals are of noise; the integration adds some 1e-4 of a number.

    Raises ``RecordingError`` for recordings with breaks or without a displacement, and
    ``ExcitationError`` for short ones and such as do not move.

    >>> swing = piezoid.identify_restoring_force(swinging)
    >>> 55.0 < swing.natural_frequency_Hz < 65.0
    True
    """
    return fit_restoring_force(
        *drive_and_motion(recording, axis), recording.sampling_rate_Hz, hold=hold
    )


def fit_restoring_force(
    drive: Array, displacement_m: Array, sampling_rate_Hz: float, *, hold: Hold = "zero_order"
) -> RestoringForceModel:
    """Fit and choose on arrays, whatever the unit of the drive: volts, or newtons.

    drive, displacement_m  (samples,)
    """
    task = task_of(drive, displacement_m, sampling_rate_Hz, hold)
    half = ~task.is_left_out
    simulated, _ = simulated_apart(task, half)
    left_out = {
        law: float(np.sqrt(np.mean((displacement_m - y_m)[task.is_left_out] ** 2)))
        for law, y_m in simulated.items()
    }
    law = _chosen(left_out)
    everything = np.ones(len(drive), dtype=bool)
    best = _fitted(task, law, task.starts(everything)[law], everything)
    residual = displacement_m - best.simulated()
    return RestoringForceModel(
        law=law,
        mode=best.mode,
        bias=best.bias,
        interval=best.interval(residual),
        residual_rms_m=float(np.sqrt(np.mean(residual**2))),
        left_out_rms_m=left_out,
        hold=hold,
        samples=len(drive),
    )


def simulated_apart(
    task: Task, chosen: NDArray[np.bool_]
) -> tuple[dict[str, Array], tuple[float, float]]:
    """Return what every law simulates, (samples,) m, learnt from the chosen samples alone.

    With it a and b of the mode without hysteresis, p^2 + a p + b.
    """
    begins = task.starts(chosen)
    linear = _fitted(task, "linear", begins.pop("linear"), chosen)
    _refuse_without_mode(task, chosen, linear)
    simulated = {"linear": linear.simulated()}
    for law, start in begins.items():
        simulated[law] = _fitted(task, law, start, chosen).simulated()
    mode = linear.mode
    return simulated, (mode.damping / mode.mass, mode.stiffness / mode.mass)


def _refuse_without_mode(task: Task, chosen: NDArray[np.bool_], linear: "_Fitted") -> None:
    """Refuse a recording whose left-out blocks a straight line predicts as well as a mode."""
    lines = np.column_stack([np.ones(len(task.drive)), task.drive])
    weights = np.linalg.lstsq(lines[chosen], task.displacement_m[chosen], rcond=None)[0]
    line_m, mode_m = (
        float(np.sqrt(np.mean((task.displacement_m - y_m)[~chosen] ** 2)))
        for y_m in (lines @ weights, linear.simulated())
    )
    mode = linear.mode
    squared = mode.stiffness / mode.mass
    mode_Hz = float(np.sqrt(max(squared, 0.0)) / (2.0 * np.pi))
    longest_s = len(task.drive) / task.sampling_rate_Hz
    if mode_m < SHOWN * line_m and 2.0 / longest_s < mode_Hz < 0.45 * task.sampling_rate_Hz:
        return
    raise ExcitationError(
        f"a straight line predicts left-out blocks to {line_m:.3g} m, and the best mode found, at "
        f"{mode_Hz:.4g} Hz, does no better",
        needed="a recording in which the mode shows",
        remedy="Record a random-phase multisine from a tenth of the first resonance to three "
        "times it. If the displacement falls as the drive rises, turn the sign of one.",
    )


def _chosen(left_out: dict[str, float]) -> str:
    """Return the simplest law that no other betters by more than is faint."""
    best = min(left_out.values())
    return next(law for law in LAWS if left_out[law] <= (1.0 + FAINT) * best)


def steps_of(mode: HystereticMode, sampling_rate_Hz: float) -> int:
    """Return the steps of the integration per sample."""
    stiffness = max(_rest_stiffness(mode), mode.stiffness)
    natural_Hz = np.sqrt(max(stiffness, 0.0) / mode.mass) / (2.0 * np.pi)
    return int(np.clip(np.ceil(STEPS_PER_PERIOD * natural_Hz / sampling_rate_Hz), *STEPS))


def _rest_stiffness(mode: HystereticMode) -> float:
    return mode.stiffness + float(np.sum(mode.spring.stiffness))


def _stops(mode: HystereticMode) -> int:
    return len(mode.spring.threshold) if isinstance(mode.spring, MaxwellSlip) else 0


def _named(mode: HystereticMode) -> dict[str, float]:
    """Return the numbers of a mode by name, in the order in which they are fitted."""
    names = ("mass", "damping", "stiffness", "quadratic", "cubic")
    found = {name: float(getattr(mode, name)) for name in names}
    if isinstance(mode.spring, BoucWenSpring):
        spring = mode.spring
        return found | {
            "spring_stiffness": spring.stiffness,
            "beta": spring.beta,
            "gamma": spring.gamma,
            "exponent": spring.exponent,
        }
    return found | {f"slip_{i + 1}": w for i, w in enumerate(mode.spring.stiffness)}


def _mode(before: HystereticMode, numbers: Array) -> HystereticMode:
    mass, damping, stiffness, quadratic, cubic, *rest = map(float, numbers)
    spring = (
        BoucWenSpring(stiffness=rest[0], beta=rest[1], gamma=rest[2], exponent=rest[3])
        if isinstance(before.spring, BoucWenSpring)
        else MaxwellSlip(threshold=before.spring.threshold, stiffness=tuple(rest))
    )
    return HystereticMode(
        mass=mass,
        damping=damping,
        stiffness=stiffness,
        quadratic=quadratic,
        cubic=cubic,
        spring=spring,
        size_m=before.size_m,
    )


def _told(interval: tuple[float, float] | None) -> str:
    return "" if interval is None else f" [{interval[0]:.5g}, {interval[1]:.5g}]"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Problem:
    """Simulations of one law: numbers to a displacement.

    numbers   those of the mode, f0, then y, y' and s at the first sample in sizes and sizes per s
    scale     (numbers,)  of each
    chosen    (samples,)  bool: what may be learnt from
    """

    task: Task
    before: HystereticMode
    drive: FineDrive
    scale: Array
    chosen: NDArray[np.bool_]

    def simulated(self, numbers: Array) -> Array:
        given = numbers * self.scale
        bias, first = given[-4], given[-3:]
        mode = _mode(self.before, given[:-4])
        shifted = replace(self.drive, values=self.drive.values - bias)
        y, _ = mode.simulated(shifted, np.concatenate([first, np.zeros(_stops(mode))]))
        return np.nan_to_num(y, nan=FAR_M, posinf=FAR_M, neginf=FAR_M)

    def at(self, numbers: Array) -> "_Simulation":
        return _Simulation(problem=self, numbers=numbers, y=self.simulated(numbers))


class _Simulation:
    """One simulation and its derivatives, by differences."""

    def __init__(self, *, problem: _Problem, numbers: Array, y: Array) -> None:
        self.problem, self.numbers, self.y = problem, numbers, y

    @property
    def residual(self) -> Array:
        error = self.y - self.problem.task.displacement_m
        return np.asarray(error[self.problem.chosen] / self.problem.before.size_m)

    @property
    def cost(self) -> float:
        residual = self.residual
        return float(residual @ residual)

    def tangents(self) -> Array:
        """Return the derivative of the simulated motion, (samples, numbers), in sizes."""
        columns = np.empty((len(self.y), len(self.numbers)), order="F")
        for i in range(len(self.numbers)):
            moved = self.numbers.copy()
            moved[i] += DIFFERENCE
            columns[:, i] = (self.problem.simulated(moved) - self.y) / DIFFERENCE
        return np.asarray(columns / self.problem.before.size_m)

    def linearised(self) -> NormalEquations:
        J, r = self.tangents()[self.problem.chosen], self.residual
        return NormalEquations(gram=J.T @ J, slope=J.T @ r, cost=self.cost)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fitted:
    """Where the search of one law ended."""

    problem: _Problem
    minimum: Minimum[_Simulation]

    @property
    def mode(self) -> HystereticMode:
        return _mode(self.problem.before, (self.minimum.x * self.problem.scale)[:-4])

    @property
    def bias(self) -> float:
        return float((self.minimum.x * self.problem.scale)[-4])

    def simulated(self) -> Array:
        return self.minimum.point.y

    def interval(self, residual_m: Array) -> dict[str, tuple[float, float]]:
        """Return 95 % intervals that hold for errors which go on for less than a block.

        C = (J'J)^-1 (sum_b g_b g_b') (J'J)^-1,   g_b = sum of J' r over block b

        Source: Liang & Zeger, Biometrika 73 (1986), with Student's t of blocks less one.
        """
        J = self.minimum.point.tangents()
        inverse = np.linalg.pinv(J.T @ J, hermitian=True)
        scores = J * (residual_m / self.problem.before.size_m)[:, None]
        edges = np.linspace(0, len(J), SCORES + 1).astype(int)[:-1]
        sums = np.add.reduceat(scores, edges, axis=0)
        covariance = inverse @ (sums.T @ sums) @ inverse * SCORES / (SCORES - 1)
        half = float(student_quantile(0.975, SCORES - 1)) * np.sqrt(np.diag(covariance))
        names = list(_named(self.mode))
        values, halves = self.minimum.x * self.problem.scale, half * self.problem.scale
        return {
            name: (float(values[i] - halves[i]), float(values[i] + halves[i]))
            for i, name in enumerate(names)
        }


def _fitted(task: Task, law: str, start: Start, chosen: NDArray[np.bool_]) -> _Fitted:
    """Search from the start of one law for the least error of its simulation."""
    mode = start.mode
    middle_m = 0.5 * (task.displacement_m.max() + task.displacement_m.min())
    numbers = np.array([*_named(mode).values(), start.bias])
    stiff = max(abs(_rest_stiffness(mode)), abs(mode.stiffness))
    rapid = np.sqrt(stiff / mode.mass)
    scale = np.full(len(numbers), stiff)
    scale[0], scale[1], scale[-1] = mode.mass, np.sqrt(stiff * mode.mass), stiff * mode.size_m
    scale[3:5] = stiff / mode.size_m ** np.array([1, 2])
    if isinstance(mode.spring, BoucWenSpring):
        scale[6:9] = 1.0
    steps = steps_of(mode, task.sampling_rate_Hz)
    problem = _Problem(
        task=task,
        before=mode,
        drive=fine_drive(task.drive, task.sampling_rate_Hz, steps, task.hold),
        scale=np.concatenate([scale, [1.0, rapid, 1.0]]),
        chosen=chosen,
    )
    # f0 of the equation counts from the middle of the motion, that of the simulation from zero
    numbers[-1] -= mode.stiffness * middle_m
    first = np.array([task.displacement_m[0] / mode.size_m, 0.0, 0.0])
    lower, upper = np.full((2, len(numbers) + 3), np.inf) * np.array([[-1.0], [1.0]])
    lower[0] = 1e-3
    if isinstance(mode.spring, BoucWenSpring):
        lower[8], upper[8] = EXPONENT
    begin = np.concatenate([numbers / scale, first])
    if law == "linear":
        lower[3:5] = upper[3:5] = 0.0
    return _Fitted(problem=problem, minimum=minimise(problem.at, begin, (lower, upper), rule=RULE))
