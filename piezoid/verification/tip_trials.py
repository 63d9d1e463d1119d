"""What may happen to a tip: the tuple TIP_TRIALS, run on the junction with a surface in metres.

The tip's extension z and the surface's height h are followed beside the current, so that a tip in
the surface is seen even where the amplifier is full. A tip is

    c = z - z_0 + h - max(h_jump, 0)

closer to the surface than its set point held it and the fault itself put it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.export.parameter_file import AxisParameters
from piezoid.numerics.arrays import Array
from piezoid.runtime.controller import Status
from piezoid.verification import criteria
from piezoid.verification.closed_loop import Fault, LoopRecord
from piezoid.verification.criteria import Verdict
from piezoid.verification.plant import AxisPlant, Junction
from piezoid.verification.scenario_runner import Run, ScenarioRunner
from piezoid.verification.scenarios import Path, Scenario
from piezoid.verification.verification import CurrentRow

_WAVES = 40

_ROUGHNESS_m = 0.1e-9
_WAVELENGTH = 0.5  # of the radius, the surface's shortest
_WITHOUT_PATH_m = 1e-6  # radius a tip is given that has no lateral axes

_AT_s = 0.1  # when it happens; before, the loop settles
_SEEN_s = 1e-4  # a fault of the sensor begins so much after the surface moved: two samples see it
_FULL = 1.1  # of the ceiling: where an amplifier is full, if the converter does not end before
_OFFSET_A = 3e-12  # what a good transimpedance amplifier shows without a current
_LATCHED_AFTER_s = 1.0  # a fault that stays has latched by then
_WAY = 0.9  # of the drive's range, the most an approach is begun from


@dataclass(frozen=True, kw_only=True)
class RoughSurface:
    """A sum of plane waves of random direction, equal height and wavelengths over a decade.

    rms_m       roughness, > 0
    shortest_m  wavelength, > 0; the longest is ten times that
    seed        which surface
    """

    rms_m: float
    shortest_m: float
    seed: int = 0

    def height(self, x_m: Array, y_m: Array) -> Array:
        """Return the height at each point, (samples,) m; 0 at the origin."""
        rng = np.random.default_rng(self.seed)
        wavelength = self.shortest_m * 10.0 ** rng.uniform(0.0, 1.0, _WAVES)
        direction, phase = rng.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
        found = np.zeros_like(x_m)
        for w, d, p in zip(2.0 * np.pi / wavelength, direction, phase, strict=True):
            found += np.cos(w * (x_m * np.cos(d) + y_m * np.sin(d)) + p) - np.cos(p)
        return np.asarray(self.rms_m * np.sqrt(2.0 / _WAVES) * found)


def judge_tips(
    bench: ScenarioRunner, scenario: Scenario, path: Path, records: Mapping[str, LoopRecord]
) -> None:
    """Judge every tip while the stage moves it over a rough surface."""
    for name, record in run_tips(bench, path, records, bench.plants).items():
        response = _junction(bench.plants[name])
        verdicts = criteria.current_verdicts(scenario.name, record, bench.limits)
        bench.currents.append(
            CurrentRow(
                scenario=scenario.name,
                ln_current_std=verdicts[0].value,
                height_rms_m=verdicts[0].value / response.decay_per_m,
                largest_ratio=float(record.position.max()) / response.current_A,
                retracted_samples=int(verdicts[1].value),
            )
        )
        if scenario.frequency_Hz <= bench.limits.judged_Hz:
            bench.verdicts.extend(verdicts)


def run_tips(
    bench: ScenarioRunner,
    path: Path,
    records: Mapping[str, LoopRecord],
    plants: Mapping[str, AxisPlant],
) -> dict[str, LoopRecord]:
    """Let every tip regulate its current where the lateral axes took it."""
    radius_m = bench.radius_m or _WITHOUT_PATH_m
    ways = [r.position - bench.centre_m[name] for name, r in records.items()]
    ideal = [radius_m * path.x, radius_m * path.y]
    surface = RoughSurface(rms_m=_ROUGHNESS_m, shortest_m=_WAVELENGTH * radius_m)
    height_m = surface.height(*(*ways, *ideal[len(ways) :])[:2])
    return bench.run([_over(bench, name, plants[name], height_m) for name in bench.tunnelling])


def _over(bench: ScenarioRunner, name: str, plant: AxisPlant, height_m: Array) -> Run:
    response = _junction(plant)
    return Run(
        axis=bench.file.axis(name),
        plant=plant,
        reference=np.full(len(height_m), response.current_A),
        disturbance=response.decay_per_m * height_m,
    )


@dataclass(frozen=True, kw_only=True)
class TipTrial:
    """One thing that happens to a tip at its set point, or on the way there.

    name       as in tables
    steps_m    the surface steps by each of these at once, a run for each; > 0 towards the tip
    fault      what the sensor shows from then on: a ``Fault``, or NaN
    fault_s    for how long; infinite: for good
    drift_m_per_s   of the surface, all the time
    away_m     so much farther from the surface than its set point the tip begins
    gain       the junction's, against the one identified
    cause      the status that must be latched with; None: the tip comes back by itself
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
_A_LITTLE_m = (-3e-11, 3e-11)  # a sensor that stops in mid-motion: the loop has an error to act on

TIP_TRIALS: tuple[TipTrial, ...] = (
    TipTrial(name="surface steps up", steps_m=_SIZES_m),
    TipTrial(name="surface steps down", steps_m=tuple(-size_m for size_m in _SIZES_m)),
    TipTrial(name="current lost for 50 ms", fault=Fault.DEAD, fault_s=0.05),
    TipTrial(name="reading NaN for 1.25 ms", fault=math.nan, fault_s=1.25e-3),
    TipTrial(name="reading NaN for 20 ms", fault=math.nan, fault_s=0.02),
    TipTrial(
        name="reading frozen for 20 ms", steps_m=_A_LITTLE_m, fault=Fault.FROZEN, fault_s=0.02
    ),
    TipTrial(name="amplifier full for 20 ms", fault=Fault.FULL, fault_s=0.02),
    TipTrial(
        name="reading NaN for good",
        fault=math.nan,
        fault_s=math.inf,
        cause=Status.BAD_MEASUREMENT,
    ),
    TipTrial(
        name="reading frozen for good",
        steps_m=_A_LITTLE_m,
        fault=Fault.FROZEN,
        fault_s=math.inf,
        cause=Status.STUCK_SENSOR,
    ),
    TipTrial(name="amplifier dead", fault=Fault.DEAD, fault_s=math.inf, cause=Status.NO_CURRENT),
    TipTrial(
        name="amplifier full for good",
        fault=Fault.FULL,
        fault_s=math.inf,
        cause=Status.MEASUREMENT_LIMITED,
    ),
    TipTrial(
        name="bias reversed", fault=Fault.REVERSED, fault_s=math.inf, cause=Status.WRONG_SIGN
    ),
    TipTrial(name="drift towards the tip, 1 nm/s", drift_m_per_s=1e-9),
    TipTrial(name="drift away from the tip, 1 nm/s", drift_m_per_s=-1e-9),
    TipTrial(name="approach from 200 nm", away_m=2e-7),
    TipTrial(name="gain of the junction tripled: the loop oscillates", gain=3.0),
)


def judge_trials(bench: ScenarioRunner, trials: Sequence[TipTrial]) -> None:
    """Run every trial on every tip; the worst of its runs is judged."""
    for name in bench.tunnelling:
        for trial in trials:
            found = [
                verdict
                for step_m in trial.steps_m
                for verdict in _verdicts(bench, name, trial, step_m)
            ]
            for kind in dict.fromkeys(verdict.name for verdict in found):
                same = [verdict for verdict in found if verdict.name == kind]
                bench.verdicts.append(max(same, key=lambda verdict: verdict.value))


def _verdicts(bench: ScenarioRunner, name: str, trial: TipTrial, step_m: float) -> list[Verdict]:
    axis = bench.file.axis(name)
    plant = _plant(bench.plants[name], axis, trial)
    cause = trial.cause or _beyond_search(axis, plant, step_m)
    reset_s = None if trial.cause or not cause else _AT_s + _LATCHED_AFTER_s
    is_far = trial.away_m > 0.0 or reset_s is not None
    allowed_s = bench.limits.approach_s if is_far else bench.limits.recovery_s
    ends_s = 0.0 if trial.away_m else _AT_s + (0.0 if math.isinf(trial.fault_s) else trial.fault_s)
    since_s = ends_s if reset_s is None else reset_s
    seconds = since_s + (1.5 * _LATCHED_AFTER_s if trial.cause else 1.1 * allowed_s)
    samples = round(seconds * bench.rate_Hz)
    height_m = _height(bench, axis, plant, trial, step_m, samples)
    junction = _junction(plant)
    record = bench.run(
        [
            Run(
                axis=axis,
                plant=plant,
                reference=np.full(samples, junction.current_A),
                disturbance=-junction.decay_per_m * height_m,
                fault=_fault(bench, trial, samples),
                reset_at=None if reset_s is None else round(reset_s * bench.rate_Hz),
            )
        ]
    )[name]
    beyond_m = _beyond_m(record, junction, height_m, step_m)
    found = [criteria.tip_distance_verdict(trial.name, beyond_m, bench.limits)]
    if cause:
        at_s = seconds if reset_s is None else reset_s
        last = slice(round((at_s - 0.1) * bench.rate_Hz), round(at_s * bench.rate_Hz) - 1)
        found.append(criteria.latch_verdict(trial.name, record.status[last], cause))
    if not trial.cause and trial.gain == 1.0:
        after = np.log(record.position[round(since_s * bench.rate_Hz) :] / junction.current_A)
        found.append(
            criteria.recovery_verdict(trial.name, after, bench.rate_Hz, allowed_s, far=is_far)
        )
    return found


def _plant(plant: AxisPlant, axis: AxisParameters, trial: TipTrial) -> AxisPlant:
    """Return the junction behind an amplifier that fills up and has an offset."""
    values, junction = axis.values, _junction(plant)
    low_A, high_A = plant.reading_range
    full_A = _FULL * float(values["current_ceiling_A"])
    high_A, low_A = min(high_A, full_A), max(low_A, -full_A)
    return replace(
        plant,
        response=replace(
            junction, gain_nepers_per_V=trial.gain * junction.gain_nepers_per_V, most_A=high_A
        ),
        reading_range=(low_A, high_A),
        reading_zero=_OFFSET_A,
        rest_voltage_V=_start_V(plant, axis, trial),
    )


def _start_V(plant: AxisPlant, axis: AxisParameters, trial: TipTrial) -> float:
    return float(axis.values["voltage_minimum_V"]) if trial.away_m else plant.rest_voltage_V


def _beyond_search(axis: AxisParameters, plant: AxisPlant, step_m: float) -> Status | None:
    """Return the status a surface leaves that stepped away farther than it is searched for."""
    search_V, junction = float(axis.values["search_voltage_V"]), _junction(plant)
    found_m = float(axis.values["contact_log"]) / junction.decay_per_m
    reach_m = search_V * junction.gain_nepers_per_V / junction.decay_per_m
    is_beyond = search_V > 0.0 and -step_m - found_m > reach_m
    return Status.NO_CURRENT if is_beyond else None


def _height(
    bench: ScenarioRunner,
    axis: AxisParameters,
    plant: AxisPlant,
    trial: TipTrial,
    step_m: float,
    count: int,
) -> Array:
    """Return the surface's height in every sample, m."""
    time_s = np.arange(count) / bench.rate_Hz
    height_m = trial.drift_m_per_s * time_s
    height_m[round(_AT_s * bench.rate_Hz) :] += step_m
    if trial.away_m:
        values, junction = axis.values, _junction(plant)
        range_V = float(values["voltage_maximum_V"]) - float(values["voltage_minimum_V"])
        range_m = range_V * junction.gain_nepers_per_V / junction.decay_per_m
        height_m -= min(trial.away_m, _WAY * range_m)
    return height_m


def _fault(bench: ScenarioRunner, trial: TipTrial, count: int) -> Array:
    found = np.zeros(count)
    begins = round((_AT_s + (_SEEN_s if any(trial.steps_m) else 0.0)) * bench.rate_Hz)
    lasts = count if math.isinf(trial.fault_s) else round(trial.fault_s * bench.rate_Hz)
    found[begins : begins + lasts] = trial.fault
    return found


def _beyond_m(record: LoopRecord, junction: Junction, height_m: Array, step_m: float) -> float:
    """Return the largest c of a run, m; see the head of this file."""
    extended_m = record.driven / junction.decay_per_m
    return float(np.max(extended_m - extended_m[0] + height_m)) - max(step_m, 0.0)


def _junction(plant: AxisPlant) -> Junction:
    assert isinstance(plant.response, Junction)
    return plant.response
