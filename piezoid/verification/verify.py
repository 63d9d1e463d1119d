"""Verify a parameter file: simulate every scenario, and compare the results with their limits.

Coupled axes are simulated at the same time behind the decoupling matrix,

    y'_i = P_i u_i + sum_(j != i) T_ij P_j u_j,   T_ij = [D G]_ij / [D G]_jj

P_i is the identified axis with its hysteresis and its compiled controller. The loops are simulated
one after the other with the coupled motion of the other axes added, until it converges: waveform
relaxation [Lelarasmee, Ruehli & Sangiovanni-Vincentelli 1982].
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from piezoid.export.bundle import source_digest
from piezoid.export.parameter_file import ParameterFile, digest_of
from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.executor import Executor
from piezoid.runtime.controller import Status
from piezoid.verification import criteria
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.criteria import Limits, Verdict, judge, none_of
from piezoid.verification.plant import AxisPlant
from piezoid.verification.scenario_runner import ScenarioRunner
from piezoid.verification.scenarios import SCENARIOS, Path, Scenario
from piezoid.verification.tip_trials import (
    TIP_TRIALS,
    TipTrial,
    judge_tips,
    judge_trials,
    run_tips,
)
from piezoid.verification.tracking import (
    MOTION_KINDS,
    UNCOMPENSATED,
    LoopRecord,
    Motion,
    SPIRALS_Hz,
    Tracking,
    motion_of,
    spiral_trace,
)
from piezoid.verification.verification import ComparisonRow, CouplingRow, SpiralRow, Verification

_FEEDBACK_METHODS = ("dob", "mpi_dob", "rst")
# Of the simulation of coupled axes.
_PERIODS = 4  # of the motion; the first is discarded
_TOLERANCE = 1e-3  # of the motion, between two iterations
_MAX_ITERATIONS = 12
_DIVERGED = 1e3  # times the motion
# Of the gain at rest: T_ij is regularised at frequencies where the axis hardly responds.
_MIN_GAIN = 0.05

Records = Mapping[str, LoopRecord]


def verify(
    file: ParameterFile,
    plants: Sequence[AxisPlant],
    *,
    variations: Sequence[Sequence[AxisPlant]] = (),
    limits: Limits | None = None,
    scenarios: Sequence[Scenario] = SCENARIOS,
    trials: Sequence[TipTrial] = TIP_TRIALS,
    seed: int = 0,
    threads: int = 1,
    coupled: CoupledStage | None = None,
) -> Verification:
    """Simulate the exported controllers in every scenario, and compare figures with limits.

    Args:
        file: exported parameters; its alternative methods are compared
        plants: one for every axis of the file
        variations: sets of plants, one for every axis, which the uncertainty allows
        limits: by default those of ``Limits``
        scenarios: of lateral axes, and of tips above a surface
        trials: events for every tip
        seed: of the noise
        threads: axes of a path that run in parallel; the result does not depend on it
        coupled: coupling between the axes, which their plants do not contain; None: none

    Raises:
        ParameterFileError: an axis has no plant
    """
    runner = ScenarioRunner(
        file=file,
        plants={plant.axis: plant for plant in plants},
        limits=limits or Limits(),
        seed=seed,
        executor=Executor(threads=threads),
    )
    plotted: list[tuple[Scenario, Records]] = []
    for scenario in scenarios:
        path = scenario.path(runner.rate_Hz)
        if scenario.is_varied:
            _judge_variations(runner, scenario, path, variations)
        elif scenario.fault is not None:
            _judge_fault(runner, scenario, path, scenario.fault)
        else:
            records = _judge_scenario(runner, scenario, path)
            if scenario.kind in MOTION_KINDS and records:
                plotted.append((scenario, records))
            if scenario.kind == "spiral":
                judge_tips(runner, scenario, path, records)
    judge_trials(runner, trials)
    coupling = _coupling_rows(runner, coupled)
    if coupling:
        largest_percent = max(row.percent for row in coupling)
        limit_percent, unit = runner.limits.coupling_percent, "% of the motion"
        name = "motion of an axis while another one moves"
        runner.verdicts.append(judge(name, "coupled axes", largest_percent, limit_percent, unit))
    outside = none_of("voltages not finite or outside the limits", "all", runner.outside_voltages)
    varied = [plant for plants_of_set in variations for plant in plants_of_set]
    return Verification(
        name=file.name,
        methods={axis.axis: axis.method for axis in file.axes},
        radius_m=runner.radius_m,
        comparison=tuple(runner.comparison),
        spirals=tuple(runner.spirals),
        currents=tuple(runner.currents),
        traces=tuple(runner.traces),
        motions=_motions(runner, plotted),
        verdicts=(outside, *runner.verdicts),
        proofs=(),
        plants=tuple(f"{plant.label}, axis {plant.axis}" for plant in (*plants, *varied)),
        parameters_digest=digest_of(file),
        runtime_digest=source_digest(),
        coupling=coupling,
    )


def _judge_scenario(runner: ScenarioRunner, scenario: Scenario, path: Path) -> Records:
    """Simulate one scenario, add its figures and verdicts, and return the shipped method's
    records.

    In a compared scenario, every method runs from every history of the drive, and the figures are
    those of the worst history.
    """
    if not scenario.is_compared or not runner.lateral:
        records = runner.run_path(path)
        if records:
            _judge_records(runner, scenario, records, runner.track(scenario, path, records))
        return records
    methods = runner.methods()
    shipped = methods[0]
    worst: dict[str, tuple[Tracking, Records]] = {}
    for method in methods:
        runs = [runner.run_path(path, method, plants) for plants in runner.histories()]
        tracked = [(runner.track(scenario, path, records), records) for records in runs]
        tracking, records = worst[method] = max(tracked, key=lambda run: run[0].rms_m)
        if method == shipped:
            _judge_records(runner, scenario, records, tracking)
        if scenario.frequency_Hz in SPIRALS_Hz and method in (shipped, UNCOMPENSATED):
            trace = spiral_trace(
                method,
                records,
                path=path,
                delay_s=tracking.delay_s,
                centre_m=runner.centre_m,
                radius_m=runner.radius_m,
                frequency_Hz=scenario.frequency_Hz,
            )
            runner.traces.append(trace)
        figures = {"method": method, "frequency_Hz": scenario.frequency_Hz, **asdict(tracking)}
        spiral = {name: figures.pop(name) for name in ("radial_rms_m", "pitch_error")}
        runner.comparison.append(ComparisonRow(**figures))
        runner.spirals.append(
            SpiralRow(method=method, frequency_Hz=scenario.frequency_Hz, **spiral)
        )
    if UNCOMPENSATED in methods[1:]:
        errors_m = [worst[method][0].aligned_rms_m for method in (shipped, UNCOMPENSATED)]
        ratio = errors_m[0] / errors_m[1]
        runner.verdicts.append(judge(criteria.SHAPE_RATIO, scenario.name, ratio, 1.0, "1"))
    return worst[shipped][1]


def _judge_records(
    runner: ScenarioRunner, scenario: Scenario, records: Records, tracking: Tracking
) -> None:
    """Add the verdicts on the shipped method's records of one scenario."""
    limits = runner.limits
    if scenario.kind == "steps":  # may use the whole range of the drive
        for record in records.values():
            runner.verdicts.extend(criteria.step_verdicts(scenario.name, record, limits))
        return
    limited = sum(
        int(np.sum((record.status & Status.VOLTAGE_LIMITED) != 0)) for record in records.values()
    )
    runner.verdicts.append(none_of("samples at a voltage limit", scenario.name, limited))
    if scenario.frequency_Hz <= limits.judged_Hz:
        runner.verdicts.append(
            criteria.shape_verdict(
                scenario.name, tracking, runner.radius_m, limits.aligned_percent
            )
        )


def _judge_variations(
    runner: ScenarioRunner,
    scenario: Scenario,
    path: Path,
    variations: Sequence[Sequence[AxisPlant]],
) -> None:
    """Add the verdicts on the worst of the plants that the uncertainty allows."""
    name, limits, verdicts = scenario.name, runner.limits, list[Verdict]()
    for varied in variations:
        plants = {**runner.plants, **{plant.axis: plant for plant in varied}}
        records = runner.run_path(path, plants=plants)
        if records:
            tracking = runner.track(scenario, path, records)
            verdicts.append(
                criteria.shape_verdict(name, tracking, runner.radius_m, limits.varied_percent)
            )
        for record in run_tips(runner, path, records, plants).values():
            verdicts.extend(criteria.current_verdicts(name, record, limits))
    runner.verdicts.extend(criteria.worst_by_name(verdicts))


def _judge_fault(runner: ScenarioRunner, scenario: Scenario, path: Path, reading: float) -> None:
    """Add the verdicts on the lateral axes during a fault of all their sensors."""
    if not runner.lateral:
        return
    name, limits = scenario.name, runner.limits
    is_permanent = np.isinf(scenario.fault_s)
    healthy = None if is_permanent else runner.track(scenario, path, runner.run_path(path))
    samples, fault = len(path.x), np.zeros(len(path.x))
    duration = samples if is_permanent else round(scenario.fault_s * runner.rate_Hz)
    fault[samples // 2 : samples // 2 + duration] = reading
    records = runner.run_path(path, fault=fault)
    with_feedback = [
        record
        for record in records.values()
        if runner.file.axis(record.axis).method in _FEEDBACK_METHODS
    ]
    if healthy is None:
        verdicts = [
            hold_verdict
            for record in with_feedback
            for hold_verdict in criteria.hold_verdicts(name, record, samples // 2, limits)
        ]
        runner.verdicts.extend(criteria.worst_by_name(verdicts))
        return
    error_m = np.sqrt(sum((r.position - r.reference) ** 2 for r in records.values()))
    runner.verdicts.extend(
        criteria.fault_verdicts(name, error_m, healthy, runner.radius_m, limits)
    )
    flag = np.uint32(Status.BAD_MEASUREMENT if np.isnan(reading) else Status.STUCK_SENSOR)
    unreported = sum(not np.any(record.status & flag) for record in with_feedback)
    runner.verdicts.append(none_of("faults not reported by the status", name, unreported))


def _motions(
    runner: ScenarioRunner, plotted: Sequence[tuple[Scenario, Records]]
) -> tuple[Motion, ...]:
    """Return the traces of plotted scenarios, with those of a static gain for comparison."""
    motions = []
    for scenario, shipped in plotted:
        baseline: Records = {}
        if UNCOMPENSATED in runner.methods()[1:]:
            baseline = runner.run_path(scenario.path(runner.rate_Hz), UNCOMPENSATED)
        motions += [
            motion_of(scenario.name, record, baseline.get(axis), runner.centre_m[axis])
            for axis, record in shipped.items()
        ]
    return tuple(motions)


def _coupling_rows(
    runner: ScenarioRunner, coupled: CoupledStage | None
) -> tuple[CouplingRow, ...]:
    """Return the remaining coupling in closed loop, where all coupled axes ship."""
    decoupled = runner.file.decoupled
    if coupled is None or decoupled is None or set(decoupled.axes) - set(runner.lateral):
        return ()
    axes, D = decoupled.axes, decoupled.matrix
    samples = round(_PERIODS * runner.rate_Hz / runner.limits.judged_Hz)
    # Lines of twice the record, to avoid circular convolution.
    f = np.asarray(np.arange(samples + 1) * runner.rate_Hz / (2 * samples))
    level_V = float(np.sqrt(coupled.levels_V[0] * coupled.levels_V[-1]))
    G = coupled.response(np.clip(f, *coupled.band_Hz), level_V)
    G[f > coupled.band_Hz[1]] = 0.0
    rows = []
    for k, driven in enumerate(axes):
        percent = _amplitudes(runner, axes, k, D, _transmission(D @ G))
        without_percent = _amplitudes(runner, axes, k, np.eye(len(axes)), _transmission(G))
        if percent is None:
            continue
        rows += [
            CouplingRow(
                moved=driven,
                answers=axis,
                frequency_Hz=runner.limits.judged_Hz,
                percent=float(percent[i]),
                without_percent=None if without_percent is None else float(without_percent[i]),
            )
            for i, axis in enumerate(axes)
            if i != k
        ]
    return tuple(rows)


def _transmission(response: ComplexArray) -> ComplexArray:
    """Return T, (lines, axes, axes), 0 on the diagonal."""
    direct = np.einsum("fjj->fj", response)
    floor = (_MIN_GAIN * np.abs(direct[1])) ** 2
    T = response * (direct.conj() / (np.abs(direct) ** 2 + floor))[:, None, :]
    return np.asarray(T * (1.0 - np.eye(response.shape[1])))


def _amplitudes(
    runner: ScenarioRunner, axes: tuple[str, ...], driven: int, D: Array, T: ComplexArray
) -> Array | None:
    """Return the amplitude of each axis in percent of the driven axis; None if it diverges."""
    samples = len(T) - 1
    time_s = np.arange(samples) / runner.rate_Hz
    sine = np.sin(2.0 * np.pi * runner.limits.judged_Hz * time_s)
    amplitude_m = runner.radius_m / float(np.abs(D[:, driven]).max())
    reference_m = np.stack(
        [runner.centre_m[a] + amplitude_m * D[i, driven] * sine for i, a in enumerate(axes)]
    )
    coupled_m = np.zeros_like(reference_m)
    for _ in range(_MAX_ITERATIONS):
        # the motion of each axis by its drive, with the coupled motion of the other axes
        driven_m = np.empty_like(reference_m)
        for i, axis in enumerate(axes):
            record = run_axis(
                runner.plants[axis],
                runner.file.axis(axis),
                reference_m[i],
                rng=np.random.default_rng(runner.seed),
                added_m=coupled_m[i],
                has_approach=True,
            )
            driven_m[i] = record.position - coupled_m[i] - runner.centre_m[axis]
        lines = np.fft.rfft(driven_m, 2 * samples, axis=1)
        previous_m = coupled_m
        coupled_m = np.fft.irfft(np.einsum("fij,jf->if", T, lines), 2 * samples, axis=1)
        coupled_m = coupled_m[:, :samples]
        change_m = float(np.abs(coupled_m - previous_m).max())
        if change_m > _DIVERGED * amplitude_m:
            return None
        if change_m < _TOLERANCE * amplitude_m:
            break
    else:
        return None
    sensed_m = np.linalg.solve(D, driven_m + coupled_m)[:, samples // _PERIODS :]
    deviation_m = (sensed_m - sensed_m.mean(axis=1)[:, None]).std(axis=1)
    return np.asarray(100.0 * np.sqrt(2.0) * deviation_m / amplitude_m)
