"""Faults of a tunnelling tip: the tuple TIP_TRIALS, run on the junction above a surface.

The simulation records the tip's extension z and the surface's height h as well as the current, so
that a tip in the surface is detected even when the amplifier saturates. A tip is

    c = z - z_0 + h - max(h_jump, 0)

closer to the surface than at its set point, without the step of the surface.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from piezoid.export.parameter_file import AxisParameters
from piezoid.numerics.arrays import Array
from piezoid.runtime.controller import Status
from piezoid.verification import criteria
from piezoid.verification.closed_loop import Fault, run_axis
from piezoid.verification.criteria import Verdict, judge, none_of
from piezoid.verification.plant import AxisPlant, Junction
from piezoid.verification.scenario_runner import ScenarioRunner
from piezoid.verification.scenarios import Path, Scenario
from piezoid.verification.tracking import LoopRecord
from piezoid.verification.verification import CurrentRow

_WAVES = 40
_RECOVERED = 0.5  # nepers, within which the current has recovered

_ROUGHNESS_m = 0.1e-9
_WAVELENGTH = 0.5  # shortest of the surface, as a share of the radius
_DEFAULT_RADIUS_m = 1e-6  # of the path of a tip without lateral axes

_EVENT_s = 0.1  # start of the event, after the loop has settled
_FAULT_DELAY_s = 1e-4  # from a step of the surface to the fault of the sensor: two samples
_SATURATION = 1.1  # times the ceiling: saturation of the amplifier, unless the converter is first
_OFFSET_A = 3e-12  # of a good transimpedance amplifier
_LATCHED_AFTER_s = 1.0  # time by which a permanent fault has latched
_MAX_APPROACH = 0.9  # of the drive's range


def rough_surface_m(x_m: Array, y_m: Array, *, rms_m: float, shortest_m: float) -> Array:
    """Return the height of a rough surface at each point, (samples,) m; 0 at the origin.

    The surface is a sum of plane waves of random direction and equal height, with wavelengths over
    a decade.

    rms_m       roughness, > 0
    shortest_m  wavelength, > 0; the longest is ten times that
    """
    rng = np.random.default_rng(0)
    wavelength = shortest_m * 10.0 ** rng.uniform(0.0, 1.0, _WAVES)
    direction, phase = rng.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
    height_m = np.zeros_like(x_m)
    for w, d, p in zip(2.0 * np.pi / wavelength, direction, phase, strict=True):
        height_m += np.cos(w * (x_m * np.cos(d) + y_m * np.sin(d)) + p) - np.cos(p)
    return np.asarray(rms_m * np.sqrt(2.0 / _WAVES) * height_m)


def judge_tips(
    runner: ScenarioRunner, scenario: Scenario, path: Path, records: Mapping[str, LoopRecord]
) -> None:
    """Add current figures and verdicts of every tip while the stage moves over a rough surface."""
    for name, record in run_tips(runner, path, records, runner.plants).items():
        junction = _junction(runner.plants[name])
        deviation, retracted = criteria.current_verdicts(scenario.name, record, runner.limits)
        runner.currents.append(
            CurrentRow(
                scenario=scenario.name,
                ln_current_std=deviation.value,
                height_rms_m=deviation.value / junction.decay_per_m,
                largest_ratio=float(record.position.max()) / junction.current_A,
                retracted_samples=int(retracted.value),
            )
        )
        if scenario.frequency_Hz <= runner.limits.judged_Hz:
            runner.verdicts += [deviation, retracted]


def run_tips(
    runner: ScenarioRunner,
    path: Path,
    records: Mapping[str, LoopRecord],
    plants: Mapping[str, AxisPlant],
) -> dict[str, LoopRecord]:
    """Simulate every tip above a rough surface, along the positions of the lateral axes."""
    radius_m = runner.radius_m or _DEFAULT_RADIUS_m
    positions_m = [r.position - runner.centre_m[name] for name, r in records.items()]
    ideal_m = [radius_m * path.x, radius_m * path.y]
    x_m, y_m = (*positions_m, *ideal_m[len(positions_m) :])[:2]
    shortest_m = _WAVELENGTH * radius_m
    height_m = rough_surface_m(x_m, y_m, rms_m=_ROUGHNESS_m, shortest_m=shortest_m)
    junctions = {name: _junction(plants[name]) for name in runner.tunnelling}
    return runner.run(
        [
            partial(
                run_axis,
                plants[name],
                runner.file.axis(name),
                np.full(len(height_m), junction.current_A),
                disturbance=junction.decay_per_m * height_m,
            )
            for name, junction in junctions.items()
        ]
    )


@dataclass(frozen=True, kw_only=True)
class TipTrial:
    """One event for a tip at its set point, or during its approach.

    name       in tables
    steps_m    steps of the surface, one run for each; > 0 towards the tip
    fault      of the sensor from the event on: a ``Fault``, or NaN
    fault_s    duration of the fault; infinite: permanent
    drift_m_per_s   of the surface, during the whole run
    away_m     initial distance from the surface, in addition to that of the set point
    gain       of the junction, relative to the identified gain
    cause      status with which the tip must latch; None: the tip must recover by itself
    """

    name: str
    steps_m: tuple[float, ...] = (0.0,)
    fault: float = Fault.SOUND
    fault_s: float = 0.0
    drift_m_per_s: float = 0.0
    away_m: float = 0.0
    gain: float = 1.0
    cause: Status | None = None


_SIZES_m = (1e-10, 3e-10, 1e-9, 2e-9)
_SMALL_STEPS_m = (-3e-11, 3e-11)  # before a frozen reading, which then has an error to control

TIP_TRIALS: tuple[TipTrial, ...] = (
    TipTrial(name="surface steps up", steps_m=_SIZES_m),
    TipTrial(name="surface steps down", steps_m=tuple(-size_m for size_m in _SIZES_m)),
    TipTrial(name="current lost for 50 ms", fault=Fault.DEAD, fault_s=0.05),
    TipTrial(name="reading NaN for 1.25 ms", fault=math.nan, fault_s=1.25e-3),
    TipTrial(name="reading NaN for 20 ms", fault=math.nan, fault_s=0.02),
    TipTrial(
        name="reading frozen for 20 ms", steps_m=_SMALL_STEPS_m, fault=Fault.FROZEN, fault_s=0.02
    ),
    TipTrial(name="amplifier full for 20 ms", fault=Fault.FULL, fault_s=0.02),
    *(
        TipTrial(name=name, steps_m=steps_m, fault=fault, fault_s=math.inf, cause=cause)
        for name, steps_m, fault, cause in (
            ("reading NaN for good", (0.0,), math.nan, Status.BAD_MEASUREMENT),
            ("reading frozen for good", _SMALL_STEPS_m, Fault.FROZEN, Status.STUCK_SENSOR),
            ("amplifier dead", (0.0,), Fault.DEAD, Status.NO_CURRENT),
            ("amplifier full for good", (0.0,), Fault.FULL, Status.MEASUREMENT_LIMITED),
            ("bias reversed", (0.0,), Fault.REVERSED, Status.WRONG_SIGN),
        )
    ),
    TipTrial(name="drift towards the tip, 1 nm/s", drift_m_per_s=1e-9),
    TipTrial(name="drift away from the tip, 1 nm/s", drift_m_per_s=-1e-9),
    TipTrial(name="approach from 200 nm", away_m=2e-7),
    TipTrial(name="gain of the junction tripled: the loop oscillates", gain=3.0),
)


def judge_trials(runner: ScenarioRunner, trials: Sequence[TipTrial]) -> None:
    """Run every trial on every tip, and add the verdicts on the worst of its runs."""
    for name in runner.tunnelling:
        for trial in trials:
            verdicts = [
                trial_verdict
                for step_m in trial.steps_m
                for trial_verdict in _trial_verdicts(runner, name, trial, step_m)
            ]
            runner.verdicts.extend(criteria.worst_by_name(verdicts))


def _surface_and_fault(
    trial: TipTrial, step_m: float, range_m: float, samples: int, rate_Hz: float
) -> tuple[Array, Array]:
    """Return the height of the surface and the fault of the sensor, (samples,) each."""
    time_s = np.arange(samples) / rate_Hz
    height_m = trial.drift_m_per_s * time_s
    height_m[round(_EVENT_s / (time_s[1] - time_s[0])) :] += step_m
    if trial.away_m:
        height_m -= min(trial.away_m, _MAX_APPROACH * range_m)
    fault = np.zeros(samples)
    start = round((_EVENT_s + (_FAULT_DELAY_s if any(trial.steps_m) else 0.0)) * rate_Hz)
    duration = samples if math.isinf(trial.fault_s) else round(trial.fault_s * rate_Hz)
    fault[start : start + duration] = trial.fault
    return height_m, fault


def _trial_verdicts(
    runner: ScenarioRunner, name: str, trial: TipTrial, step_m: float
) -> list[Verdict]:
    axis, rate_Hz, limits = runner.file.axis(name), runner.rate_Hz, runner.limits
    plant = _plant(runner.plants[name], axis, trial)
    junction = _junction(plant)
    # A step beyond the search range loses the surface.
    search_V = float(axis.values["search_voltage_V"])
    contact_m = float(axis.values["contact_log"]) / junction.decay_per_m
    search_m = search_V * junction.gain_nepers_per_V / junction.decay_per_m
    is_lost = search_V > 0.0 and -step_m - contact_m > search_m
    cause = trial.cause or (Status.NO_CURRENT if is_lost else None)
    reset_s = None if trial.cause or not cause else _EVENT_s + _LATCHED_AFTER_s
    is_far = trial.away_m > 0.0 or reset_s is not None
    allowed_s = limits.approach_s if is_far else limits.recovery_s
    fault_s = 0.0 if math.isinf(trial.fault_s) else trial.fault_s
    ends_s = 0.0 if trial.away_m else _EVENT_s + fault_s
    recovers_from_s = ends_s if reset_s is None else reset_s
    duration_s = recovers_from_s + (1.5 * _LATCHED_AFTER_s if trial.cause else 1.1 * allowed_s)
    samples = round(duration_s * rate_Hz)
    low_V, high_V = axis.voltage_range_V
    range_m = (high_V - low_V) * junction.gain_nepers_per_V / junction.decay_per_m
    height_m, fault = _surface_and_fault(trial, step_m, range_m, samples, rate_Hz)
    run = partial(
        run_axis,
        plant,
        axis,
        np.full(samples, junction.current_A),
        disturbance=-junction.decay_per_m * height_m,
        fault=fault,
        reset_at=None if reset_s is None else round(reset_s * rate_Hz),
    )
    record = runner.run([run])[name]
    extension_m = record.driven / junction.decay_per_m
    closer_m = float(np.max(extension_m - extension_m[0] + height_m)) - max(step_m, 0.0)
    distance = "closer to the surface than the set point"
    verdicts = [judge(distance, trial.name, max(closer_m, 0.0), limits.closest_m, "m")]
    if cause:
        end_s = duration_s if reset_s is None else reset_s
        final_status = record.status[round((end_s - 0.1) * rate_Hz) : round(end_s * rate_Hz) - 1]
        expected = np.uint32(Status.LATCHED | Status.RETRACTED | cause)
        silent = int(np.sum((final_status & expected) != expected))
        verdicts.append(none_of("faults not latched with their cause", trial.name, silent))
    if not trial.cause and trial.gain == 1.0:
        nepers = np.log(record.position[round(recovers_from_s * rate_Hz) :] / junction.current_A)
        outside = np.flatnonzero(np.abs(nepers) > _RECOVERED)
        recovery_s = (int(outside[-1]) + 1 if len(outside) else 0) / rate_Hz
        figure = "time until the current recovers" + (" from far away" if is_far else "")
        verdicts.append(judge(figure, trial.name, recovery_s, allowed_s, "s"))
    return verdicts


def _plant(plant: AxisPlant, axis: AxisParameters, trial: TipTrial) -> AxisPlant:
    """Return the plant of a trial, with an amplifier that saturates and has an offset."""
    junction = _junction(plant)
    saturation_A = _SATURATION * float(axis.values["current_ceiling_A"])
    low_A, high_A = plant.reading_range
    low_A, high_A = max(low_A, -saturation_A), min(high_A, saturation_A)
    retracted_V, _ = axis.voltage_range_V
    return replace(
        plant,
        response=replace(
            junction,
            gain_nepers_per_V=trial.gain * junction.gain_nepers_per_V,
            saturation_A=high_A,
        ),
        reading_range=(low_A, high_A),
        reading_zero=_OFFSET_A,
        rest_voltage_V=retracted_V if trial.away_m else plant.rest_voltage_V,
    )


def _junction(plant: AxisPlant) -> Junction:
    assert isinstance(plant.response, Junction)
    return plant.response
