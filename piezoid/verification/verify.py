"""Verify a parameter file: simulate every scenario, and compare the results with their limits."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from piezoid.export.bundle import source_digest
from piezoid.export.parameter_file import ParameterFile, digest_of
from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid.numerics.executor import Executor
from piezoid.runtime.controller import Status
from piezoid.verification import criteria
from piezoid.verification.closed_loop import LoopRecord
from piezoid.verification.coupled_loop import coupling_rows
from piezoid.verification.criteria import Limits, Verdict, none_of, verdict
from piezoid.verification.limit_proof import LimitProof
from piezoid.verification.plant import AxisPlant
from piezoid.verification.plotted_paths import (
    MOTION_KINDS,
    UNCOMPENSATED,
    Motion,
    SPIRALS_Hz,
    motion_of,
    spiral_trace,
)
from piezoid.verification.rebuild import Proof
from piezoid.verification.scenario_runner import ScenarioRunner
from piezoid.verification.scenarios import SCENARIOS, Path, Scenario
from piezoid.verification.tip_trials import (
    TIP_TRIALS,
    TipTrial,
    judge_tips,
    judge_trials,
    run_tips,
)
from piezoid.verification.tracking import Tracking
from piezoid.verification.verification import ComparisonRow, SpiralRow, Verification

_FEEDBACK_METHODS = ("dob", "mpi_dob", "rst")

Records = Mapping[str, LoopRecord]


def verify(
    file: ParameterFile,
    plants: Sequence[AxisPlant],
    *,
    variations: Sequence[Sequence[AxisPlant]] = (),
    limits: Limits | None = None,
    scenarios: Sequence[Scenario] = SCENARIOS,
    trials: Sequence[TipTrial] = TIP_TRIALS,
    proofs: Sequence[Proof] = (),
    limit_proofs: Sequence[LimitProof] = (),
    seed: int = 0,
    threads: int = 1,
    lab_digest: str = "",
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
        proofs: comparisons of builds, for the record
        limit_proofs: proofs for every input, for the record
        seed: of the noise
        threads: axes of a path that run in parallel; the result does not depend on it
        lab_digest: of the lab.toml that declared plants and limits, for the record
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
    coupling = coupling_rows(runner, coupled)
    if coupling:
        largest_percent = max(row.percent for row in coupling)
        limit_percent, unit = runner.limits.coupling_percent, "% of the motion"
        name = "motion of an axis while another one moves"
        runner.verdicts.append(verdict(name, "coupled axes", largest_percent, limit_percent, unit))
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
        proofs=tuple(proofs),
        limit_proofs=tuple(limit_proofs),
        plants=tuple(f"{plant.label}, axis {plant.axis}" for plant in (*plants, *varied)),
        parameters_digest=digest_of(file),
        runtime_digest=source_digest(),
        lab_digest=lab_digest,
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
        runner.verdicts.append(verdict(criteria.SHAPE_RATIO, scenario.name, ratio, 1.0, "1"))
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
    records = runner.run_path(path, fault=scenario.fault_of(len(path.x), runner.rate_Hz))
    with_feedback = [
        record
        for record in records.values()
        if runner.file.axis(record.axis).method in _FEEDBACK_METHODS
    ]
    if healthy is None:
        verdicts = [
            hold_verdict
            for record in with_feedback
            for hold_verdict in criteria.hold_verdicts(name, record, len(path.x) // 2, limits)
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
