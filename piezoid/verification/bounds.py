"""Four figures of the largest error: bound, probable, worst found, and simulated.

The bound of a certificate adds up worst cases that no stage combines. The probable error follows
from runs of the compiled controller along references of four kinds, on stages drawn from the
uncertainty of the model:

    plays, dead zones and envelope   from the fit's covariance
    modes, poles and delays          between the ends of their intervals
    discrepancy of the class         as large as in held-out recordings, times exp(0.64 z)
    history of the drive             any turning points within the range

Of the n largest errors of such runs, the error of rank ceil((n + 1) p) bounds the next with
probability p, if the stage and the drawn stages are exchangeable [Vovk, Gammerman & Shafer 2005].
``python -m benchmarks.probable_bounds`` measures the coverage. The figure is no guarantee.

The search for the worst error starts from the largest of these errors. It tries other references
on the same stage, then stages at the ends of every interval with the same reference, twice.

A tip regulates a current, and its error is the height that corresponds to the logarithm of the
current while the surface moves. Its bound is that of the linear loop.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from piezoid.design.certificate import Certificate, divide_by_difference, peak_gain
from piezoid.design.design import Design, LoopDesign
from piezoid.design.feasibility import noise_rms
from piezoid.design.hysteresis_bounds import draw_replicates
from piezoid.design.sensitivity import closed_loop_polynomial
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Executor
from piezoid.numerics.polynomial import product
from piezoid.runtime.controller import Status
from piezoid.verification.closed_loop import approach_path, reference_range, run_axis
from piezoid.verification.plant import AxisPlant, Hysteresis, Junction, varied_plant
from piezoid.verification.verification import ErrorBound

_PROBABILITY, DRAWN = 0.95, 59  # runs at each speed: the third largest of them bounds the next
_SPEEDS = (1.0, 0.3, 0.1)  # of the fastest reference that is certified, or of a full scan
_TRIALS, _ROUNDS = 10, 2  # of other references, then of other stages
_NOMINAL_RUNS = 20  # of the references, on the identified stage
_DURATION_s = 0.5
_REACH = 0.95  # of the distance from the middle of the references to their ends
# On 21 of 29 stages of an independent simulator, a spiral shows 0.5 to 2 times the discrepancy.
_SPREAD, _MAX_SCALE = 0.64, 4.0
# A surface of 0.1 nm rms under a spiral of 10 Hz, and its height.
_TIP_m_per_s, _TIP_m = 0.25e-6, 5e-9
_OUTSIDE = Status.VOLTAGE_LIMITED | Status.REFERENCE_LIMITED | Status.VOLTAGE_STEP
_SIGMAS = 3.0
_TURNS, _TARGETS, _SINES = 6, 12, 5


def error_bounds(
    file: ParameterFile,
    design: Design,
    model: ActuatorModel,
    plants: Sequence[AxisPlant],
    variations: Sequence[Sequence[AxisPlant]],
    *,
    seed: int = 0,
    threads: int = 1,
) -> tuple[ErrorBound, ...]:
    """Return the four figures of every axis at three speeds.

    design      from which the file was exported
    plants      identified, of all axes of the file
    variations  of tips, stages of other gains, as ``stage_plants`` returns them
    threads     number of parallel runs; the result does not depend on it
    """
    executor = Executor(threads=threads)
    rows: list[ErrorBound] = []
    for index, (axis, plant) in enumerate(zip(file.axes, plants, strict=True)):
        axis_design = design.axis(axis.axis)
        loop, specification = axis_design.loop(axis.method), axis_design.specification
        if isinstance(plant.response, Junction):
            noise_ln = max(noise_rms(m, loop.R, loop.S, specification) for m in loop.members)
            task: _LateralTask | _TipTask = _TipTask(
                axis, plant, loop, variations[index], _SIGMAS * noise_ln
            )
        else:
            scan_Hz = specification.scan_frequency_Hz
            task = _LateralTask(axis, plant, model[axis.axis], loop.certificate, scan_Hz)
        for number, share in enumerate(_SPEEDS):
            rng = np.random.default_rng([seed, index, number])
            row = _bound_at_speed(axis.axis, task, share * task.fastest_m_per_s, rng, executor)
            rows += [] if row is None else [row]
    return tuple(rows)


def conformal_quantile(largest_m: Sequence[float], probability: float = _PROBABILITY) -> float:
    """Return the bound of the next number with a probability; infinite for too few numbers.

    >>> conformal_quantile(np.arange(1.0, 20.0), 0.95)
    19.0
    """
    rank = int(np.ceil((len(largest_m) + 1) * probability - 1e-9))
    return float(np.sort(largest_m)[rank - 1]) if rank <= len(largest_m) else float(np.inf)


def _bound_at_speed(
    name: str, task: "_Task", slew: float, rng: np.random.Generator, executor: Executor
) -> ErrorBound | None:
    """Return the figures at one speed; None if no run stays within the conditions."""

    draw_path = partial(_draw_path, rng, slew, task.reach_m, task.nominal.sampling_rate_Hz)

    def run(case: tuple[AxisPlant, Array, int]) -> float | None:
        plant, path, noise = case
        return task.error(plant, path, np.random.default_rng(noise))

    def seeded(runs: Sequence[tuple[AxisPlant, Array]]) -> list[tuple[AxisPlant, Array, int]]:
        return [(plant, reference, int(rng.integers(2**31))) for plant, reference in runs]

    cases = seeded([(task.draw(rng, False), draw_path()) for _ in range(DRAWN)])
    errors = executor.map(run, cases)
    completed = [(e, case) for e, case in zip(errors, cases, strict=True) if e is not None]
    if not completed:
        return None
    nominal_cases = [(task.nominal, path, noise) for _, path, noise in cases[:_NOMINAL_RUNS]]
    nominal_errors = executor.map(run, nominal_cases)
    worst_m, worst = max(completed, key=lambda error_case: error_case[0])
    for _ in range(_ROUNDS):
        for pairs in (
            [(worst[0], draw_path()) for _ in range(_TRIALS)],
            [(task.draw(rng, True), worst[1]) for _ in range(_TRIALS)],
        ):
            neighbours = seeded(pairs)
            for error, case in zip(executor.map(run, neighbours), neighbours, strict=True):
                if error is not None and error > worst_m:
                    worst_m, worst = error, case
    return ErrorBound(
        axis=name,
        slew_m_per_s=slew,
        bound_m=task.bound(slew),
        probable_m=conformal_quantile([error for error, _ in completed]),
        probability=_PROBABILITY,
        worst_found_m=worst_m,
        simulated_m=float(np.median([error for error in nominal_errors if error is not None])),
        runs=len(completed),
    )


class _LateralTask:
    """Draws of stages of a lateral axis, and the errors on them."""

    def __init__(
        self,
        axis: AxisParameters,
        plant: AxisPlant,
        model: AxisModel,
        certificate: Certificate | None,
        scan_Hz: float,
    ) -> None:
        self.nominal, self._axis, self._span = plant, axis, reference_range(axis)
        self._model, self._certificate = model, certificate
        self.reach_m = _REACH * self._span.farthest_m
        # The same speed as in a certificate.
        self.fastest_m_per_s = 2.0 * np.pi * scan_Hz * self._span.farthest_m
        if certificate is not None:
            self.fastest_m_per_s = certificate.reference_slew_m_per_s * (1.0 - 1e-9)
        replicates = draw_replicates(model, np.random.default_rng(0))
        self._operators = replicates or (model.operator,)

    def draw(self, rng: np.random.Generator, is_extreme: bool) -> AxisPlant:
        """Draw a stage, or one at the ends of the intervals."""
        slower, sharper = rng.uniform(-1.0, 1.0, 2)
        size = float(rng.standard_normal())
        if is_extreme:
            slower, sharper, size = np.sign(slower), np.sign(sharper), 2.0
        operator = self._operators[int(rng.integers(len(self._operators)))]
        corner = {"slower": float(slower), "sharper": float(sharper)}
        plant = varied_plant(self.nominal, self._model, operator, **corner)
        response = plant.response
        assert isinstance(response, Hysteresis)
        discrepancy = response.discrepancy
        if discrepancy is not None:
            scale = min(float(np.exp(_SPREAD * size)), _MAX_SCALE)
            discrepancy = replace(discrepancy, weight_m=scale * discrepancy.weight_m)
        # random turning points in the range, possibly after one or both ends of the range
        ends_V = self._model.voltage_V
        first_V = tuple(ends_V)[: int(rng.integers(3))]
        turns_V = tuple(rng.uniform(*ends_V, int(rng.integers(_TURNS))).tolist())
        response = replace(response, discrepancy=discrepancy, history_V=first_V + turns_V)
        return replace(plant, label="drawn", response=response)

    def error(self, plant: AxisPlant, path: Array, rng: np.random.Generator) -> float | None:
        """Return the largest error on a path, m; None if a limit of the controller acts."""
        reference = self._span.centre_m + path
        approach = approach_path(plant, float(reference[0]))
        drive = np.concatenate([np.zeros(len(approach)), path])
        run = run_axis(
            plant,
            self._axis,
            np.concatenate([approach, reference]),
            rng=rng,
            disturbance=plant.motion_m(len(drive), drive) if plant.motions else None,
        ).after(len(approach))
        is_outside = np.any(run.status & np.uint32(_OUTSIDE))
        return None if is_outside else float(np.abs(run.error).max())

    def bound(self, slew: float) -> float | None:
        """Return the bound of the error at a speed, m; None without a useful guarantee."""
        certificate = self._certificate
        if certificate is None:
            return None
        bound_m = certificate.guaranteed_at(slew) + certificate.noise_error_m
        is_useful = certificate.is_guaranteed and bound_m < self._model.quality.range_m
        return bound_m if is_useful else None


class _TipTask:
    """Draws of stages of a tip, whose errors are heights."""

    reach_m, fastest_m_per_s = _TIP_m, _TIP_m_per_s

    def __init__(
        self,
        axis: AxisParameters,
        plant: AxisPlant,
        loop: LoopDesign,
        variations: Sequence[AxisPlant],
        noise_ln: float,
    ) -> None:
        assert isinstance(plant.response, Junction)
        self.nominal, self._axis, self._stages = plant, axis, (plant, *variations)
        self._loop, self._noise_ln, self._response = loop, noise_ln, plant.response

    def draw(self, rng: np.random.Generator, is_extreme: bool) -> AxisPlant:
        count = len(self._stages)
        return self._stages[int(rng.integers(1 if is_extreme and count > 1 else 0, count))]

    def error(self, plant: AxisPlant, path: Array, rng: np.random.Generator) -> float | None:
        response = self._response
        pause = np.zeros(round(_DURATION_s * plant.sampling_rate_Hz))
        height_m = np.concatenate([pause, path])
        run = run_axis(
            plant,
            self._axis,
            np.full(len(height_m), response.current_A),
            rng=rng,
            disturbance=response.decay_per_m * height_m,
        ).after(len(pause))
        if np.any(run.status & np.uint32(Status.RETRACTED)):
            return None
        nepers = np.log(run.position / response.current_A)
        return float(np.abs(nepers).max()) / response.decay_per_m

    def bound(self, slew: float) -> float | None:
        loop = self._loop
        S = divide_by_difference(loop.S)
        gain = max(
            peak_gain(product(m.A, S), closed_loop_polynomial(m, loop.R, loop.S))
            for m in loop.members
        )
        noise_m = self._noise_ln / self._response.decay_per_m
        return gain * slew / self.nominal.sampling_rate_Hz + noise_m


_Task = _LateralTask | _TipTask


def _draw_path(rng: np.random.Generator, slew: float, reach_m: float, rate_Hz: float) -> Array:
    """Draw a sine, a triangle, ramps or a multisine about 0, of limited amplitude and speed."""
    samples = round(_DURATION_s * rate_Hz)
    t = np.arange(samples) / rate_Hz
    amplitude_m = reach_m * rng.uniform(0.1, 1.0)
    kind = rng.integers(4)
    if kind < 2:
        f = rng.uniform(0.2, 1.0) * slew / ((2.0 * np.pi, 4.0)[kind] * amplitude_m)
        sine = np.sin(2.0 * np.pi * f * t)
        return np.asarray(amplitude_m * (sine, 2.0 / np.pi * np.arcsin(sine))[kind])
    if kind == 2:
        targets = np.repeat(
            rng.uniform(-amplitude_m, amplitude_m, _TARGETS), samples // _TARGETS + 1
        )[:samples]
    else:
        frequency_Hz = rng.uniform(0.5, 100.0, _SINES)
        phase = rng.uniform(0.0, 2.0 * np.pi, _SINES)
        sines = np.sin(2.0 * np.pi * np.outer(t, frequency_Hz) + phase)
        targets = amplitude_m / _SINES * sines.sum(axis=1)
    step, position, path = slew / rate_Hz, 0.0, np.empty(samples)
    for k, target in enumerate(targets.tolist()):
        position += min(max(target - position, -step), step)
        path[k] = position
    return path
