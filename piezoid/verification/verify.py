"""Verify a parameter file: run every scenario on the plants, and judge the results."""

from collections.abc import Mapping, Sequence

import numpy as np

from piezoid.export.bundle import source_digest
from piezoid.export.parameter_file import ParameterFile, digest_of
from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid.numerics.executor import Executor
from piezoid.runtime.controller import Status
from piezoid.verification import criteria
from piezoid.verification.closed_loop import LoopRecord
from piezoid.verification.coupled_loop import coupling_rows, coupling_verdict
from piezoid.verification.criteria import Limits, Verdict
from piezoid.verification.limit_proof import LimitProof
from piezoid.verification.plant import AxisPlant
from piezoid.verification.plotted_paths import (
    MOTION_KINDS,
    UNCOMPENSATED,
    Motion,
    SPIRALS_Hz,
    motions_of,
    spiral_trace,
)
from piezoid.verification.rebuild import Proof
from piezoid.verification.scenario_runner import ScenarioRunner, scenario_runner
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
    """Run the exported controllers on plants, scenario by scenario, and judge the results.

    Args:
        file: exported parameters; alternatives it carries are compared
        plants: one for every axis of the file
        variations: further sets of plants, one of each axis, which the uncertainty allows
        limits: by default those of ``Limits``
        scenarios: what lateral axes, and tips above a surface, are made to do
        trials: what happens to every tip
        proofs: builds that were compared, for the record
        limit_proofs: proofs over every input, for the record
        seed: of every noise
        threads: axes of a path that run at once; the result does not depend on it
        lab_digest: of the lab.toml that declared plants and limits, for the record
        coupled: coupling of the axes beyond what their plants contain; None: none

    Raises:
        ParameterFileError: an axis has no plant
    """
    runner = scenario_runner(file, plants, limits or Limits(), seed, Executor(threads=threads))
    for scenario in scenarios:
        path = scenario.path(runner.rate_Hz)
        if scenario.is_varied:
            _run_variations(runner, scenario, path, variations)
        elif scenario.fault is not None:
            _run_fault(runner, scenario, path)
        else:
            _run_scenario(runner, scenario, path)
    judge_trials(runner, trials)
    coupling = coupling_rows(runner, coupled)
    if coupling:
        runner.verdicts.append(coupling_verdict(coupling, runner.limits.coupling_percent))
    axes = {axis.axis: axis for axis in file.axes}
    voltage_range = criteria.voltage_range_verdict(runner.records, axes)
    varied = [plant for plants_of_set in variations for plant in plants_of_set]
    return Verification(
        name=file.name,
        methods={axis.axis: axis.method for axis in file.axes},
        radius_m=runner.radius_m,
        comparison=tuple(runner.comparison),
        spirals=tuple(runner.spirals),
        currents=tuple(runner.currents),
        traces=tuple(runner.traces),
        motions=_motions(runner, scenarios),
        verdicts=(voltage_range, *runner.verdicts),
        proofs=tuple(proofs),
        limit_proofs=tuple(limit_proofs),
        plants=tuple(f"{plant.label}, axis {plant.axis}" for plant in (*plants, *varied)),
        parameters_digest=digest_of(file),
        runtime_digest=source_digest(),
        lab_digest=lab_digest,
        coupling=coupling,
    )


def _run_scenario(runner: ScenarioRunner, scenario: Scenario, path: Path) -> None:
    """Run the lateral axes, all methods where they are compared, and the tip above a surface."""
    records: dict[str, LoopRecord] = {}
    if scenario.is_compared and runner.lateral:
        records = _compare_methods(runner, scenario, path)
    elif runner.lateral:
        records = runner.run_path(path)
        runner.single_runs[scenario.name] = records
        _judge(runner, scenario, records, runner.track(scenario, path, records))
    if scenario.kind == "spiral":
        judge_tips(runner, scenario, path, records)


def _compare_methods(
    runner: ScenarioRunner, scenario: Scenario, path: Path
) -> dict[str, LoopRecord]:
    """Run every method from every history and judge the worst; return the runs of what ships."""
    shipped_method, *_ = runner.methods()
    shipped: dict[str, LoopRecord] = {}
    worst: dict[str, Tracking] = {}
    for method in runner.methods():
        runs = [runner.run_path(path, method, plants) for plants in runner.histories()]
        tracked = [runner.track(scenario, path, records) for records in runs]
        index = max(range(len(runs)), key=lambda k: tracked[k].rms_m)
        worst[method] = tracked[index]
        if scenario.frequency_Hz in SPIRALS_Hz and method in (shipped_method, UNCOMPENSATED):
            runner.traces.append(
                spiral_trace(
                    method,
                    tracked[index],
                    runs[index],
                    path=path,
                    centre_m=runner.centre_m,
                    radius_m=runner.radius_m,
                    frequency_Hz=scenario.frequency_Hz,
                )
            )
        if method == shipped_method:
            shipped = runs[index]
            _judge(runner, scenario, shipped, tracked[index])
    for method, tracking in worst.items():
        runner.comparison.append(
            ComparisonRow(
                method=method,
                frequency_Hz=scenario.frequency_Hz,
                rms_m=tracking.rms_m,
                rms_percent=tracking.rms_percent,
                max_m=tracking.max_m,
                aligned_rms_m=tracking.aligned_rms_m,
                delay_s=tracking.delay_s,
            )
        )
        runner.spirals.append(
            SpiralRow(
                method=method,
                frequency_Hz=scenario.frequency_Hz,
                radial_rms_m=tracking.radial_rms_m,
                pitch_error=tracking.pitch_error,
            )
        )
    if UNCOMPENSATED in worst and shipped_method != UNCOMPENSATED:
        improvement = criteria.improvement_verdict(
            scenario.name, worst[shipped_method], worst[UNCOMPENSATED]
        )
        runner.verdicts.append(improvement)
    return shipped


def _judge(
    runner: ScenarioRunner,
    scenario: Scenario,
    records: Mapping[str, LoopRecord],
    tracking: Tracking,
) -> None:
    limits = runner.limits
    if scenario.kind == "steps":  # which may use the whole range of the drive
        for record in records.values():
            runner.verdicts.extend(criteria.step_verdicts(scenario.name, record, limits))
        return
    runner.verdicts.append(criteria.saturation_verdict(scenario.name, list(records.values())))
    if scenario.frequency_Hz <= limits.judged_Hz:
        runner.verdicts.append(
            criteria.shape_verdict(
                scenario.name, tracking, runner.radius_m, limits.aligned_percent
            )
        )


def _run_variations(
    runner: ScenarioRunner,
    scenario: Scenario,
    path: Path,
    variations: Sequence[Sequence[AxisPlant]],
) -> None:
    """Judge the worst of the plants that the uncertainty allows."""
    verdicts: list[Verdict] = []
    for varied in variations:
        plants = {**runner.plants, **{plant.axis: plant for plant in varied}}
        records = runner.run_path(path, plants=plants)
        if records:
            tracking = runner.track(scenario, path, records)
            limit = runner.limits.varied_percent
            verdicts.append(
                criteria.shape_verdict(scenario.name, tracking, runner.radius_m, limit)
            )
        for record in run_tips(runner, path, records, plants).values():
            verdicts.extend(criteria.current_verdicts(scenario.name, record, runner.limits))
    runner.verdicts.extend(criteria.worst_by_name(verdicts))


def _run_fault(runner: ScenarioRunner, scenario: Scenario, path: Path) -> None:
    """Judge the axes while their sensors fail, for a time or for good."""
    if not runner.lateral:
        return
    name, fault = scenario.name, scenario.fault_of(len(path.x), runner.rate_Hz)
    if np.isinf(scenario.fault_s):
        records = runner.run_path(path, fault=fault)
        verdicts = [
            verdict
            for record in _with_feedback(runner, records)
            for verdict in criteria.hold_verdicts(name, record, len(path.x) // 2, runner.limits)
        ]
        runner.verdicts.extend(criteria.worst_by_name(verdicts))
        return
    healthy = runner.track(scenario, path, runner.run_path(path))
    records = runner.run_path(path, fault=fault)
    error_m = np.sqrt(sum((r.position - r.reference) ** 2 for r in records.values()))
    runner.verdicts.extend(
        criteria.fault_verdicts(name, error_m, healthy, runner.radius_m, runner.limits)
    )
    is_lost = scenario.fault is not None and np.isnan(scenario.fault)
    flag = Status.BAD_MEASUREMENT if is_lost else Status.STUCK_SENSOR
    watching = _with_feedback(runner, records)
    runner.verdicts.append(criteria.fault_reported_verdict(name, watching, flag))


def _with_feedback(runner: ScenarioRunner, records: Mapping[str, LoopRecord]) -> list[LoopRecord]:
    methods = ("dob", "mpi_dob", "rst")
    return [r for r in records.values() if runner.file.axis(r.axis).method in methods]


def _motions(runner: ScenarioRunner, scenarios: Sequence[Scenario]) -> tuple[Motion, ...]:
    """Return the motions that are plotted; the static gain is simulated for comparison only."""
    motions: list[Motion] = []
    for scenario in scenarios:
        if scenario.kind not in MOTION_KINDS or scenario.name not in runner.single_runs:
            continue
        uncompensated = {}
        if UNCOMPENSATED in runner.methods()[1:]:
            uncompensated = runner.run_path(scenario.path(runner.rate_Hz), UNCOMPENSATED)
        shipped = runner.single_runs[scenario.name]
        motions += motions_of(scenario.name, shipped, uncompensated, runner.centre_m)
    return tuple(motions)
