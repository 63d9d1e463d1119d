"""ParameterFile and plants in, Verification out."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from piezoid.export.bundle import source_digest
from piezoid.export.parameter_file import ParameterFile, digest_of
from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Executor
from piezoid.runtime.controller import Status
from piezoid.verification import criteria
from piezoid.verification.closed_loop import LoopRecord
from piezoid.verification.coupled_loop import coupling_rows, coupling_verdict
from piezoid.verification.criteria import Limits, Verdict
from piezoid.verification.limit_proof import LimitProof
from piezoid.verification.plant import AxisPlant, with_histories
from piezoid.verification.plotted_paths import (
    SHOWN,
    TRACED_BESIDE,
    Motion,
    is_traced,
    motions_of,
    trace_of,
)
from piezoid.verification.proof import Proof
from piezoid.verification.scenario_runner import Run, ScenarioRunner, scenario_runner
from piezoid.verification.scenarios import SCENARIOS, Path, Scenario
from piezoid.verification.tip_trials import (
    TIP_TRIALS,
    TipTrial,
    judge_tips,
    judge_trials,
    run_tips,
)
from piezoid.verification.tracking import Tracking, track
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
    """Run what ships against plants, scenario by scenario, and judge it.

    file        what ships; alternatives it carries are compared
    plants      one for every axis of the file
    variations  further sets of plants, one of each axis, which the uncertainty allows as well
    limits      by default those of ``Limits``
    trials      what happens to every tip
    proofs      builds that were compared, to stand in the same record
    limit_proofs  what was proved of every input, likewise
    seed        of every noise
    threads     so many axes of a path run at once; what is found does not depend on it

    coupled     how the axes move each other, beside what their plants know; None: not at all
    lab_digest  of the lab.toml that declared plants and limits, to stand in the record

    Raises ``ParameterFileError`` for an axis without a plant.
    """
    bench = scenario_runner(file, plants, limits or Limits(), seed, Executor(threads=threads))
    for scenario in scenarios:
        if scenario.is_varied:
            _run_varied(bench, scenario, variations)
        elif scenario.fault is not None:
            if bench.lateral:
                _run_fault(bench, scenario)
        else:
            _run(bench, scenario)
    judge_trials(bench, trials)
    coupling = coupling_rows(bench, coupled)
    if coupling:
        bench.verdicts.append(coupling_verdict(coupling, bench.limits.coupling_percent))
    drawn = [plant for chosen in variations for plant in chosen]
    shipped = {axis.axis: axis for axis in file.axes}
    drive = criteria.voltage_range_verdict(bench.records, shipped)
    return Verification(
        name=file.name,
        methods={axis.axis: axis.method for axis in file.axes},
        radius_m=bench.radius_m,
        comparison=tuple(bench.comparison),
        spirals=tuple(bench.spirals),
        currents=tuple(bench.currents),
        traces=tuple(bench.traces),
        motions=tuple(_motions(bench, scenarios)),
        verdicts=(drive, *bench.verdicts),
        proofs=tuple(proofs),
        limit_proofs=tuple(limit_proofs),
        plants=tuple(f"{plant.label}, axis {plant.axis}" for plant in (*plants, *drawn)),
        parameters_digest=digest_of(file),
        runtime_digest=source_digest(),
        lab_digest=lab_digest,
        coupling=coupling,
    )


def references_of(bench: ScenarioRunner, path: Path) -> dict[str, Array]:
    """Return where each lateral axis is to be: the first follows x, the next y."""
    ways = (path.x, path.y)
    return {
        name: bench.centre_m[name] + bench.radius_m * ways[place % 2]
        for place, name in enumerate(bench.lateral)
    }


def _lateral_runs(
    bench: ScenarioRunner,
    path: Path,
    method: str | None = None,
    plants: Mapping[str, AxisPlant] | None = None,
    fault: Array | None = None,
) -> dict[str, LoopRecord]:
    """Run all lateral axes along a path, with what ships or one of its methods."""
    runs = []
    others = (path.y, path.x)  # what another axis is driven by, for motion that follows it
    for place, (name, reference) in enumerate(references_of(bench, path).items()):
        axis = bench.file.axis(name)
        chosen = axis if method is None else axis.for_method(method)
        plant = (plants or bench.plants)[name]
        moved_m = plant.motion_m(len(reference), others[place % 2]) if plant.motions else None
        run = Run(
            axis=chosen,
            plant=plant,
            reference=reference,
            disturbance=moved_m,
            fault=fault,
        )
        runs.append(run)
    return bench.run(runs)


def _centred(
    bench: ScenarioRunner, records: Mapping[str, LoopRecord]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return references and positions about the path's middle."""
    return (
        {name: r.reference - bench.centre_m[name] for name, r in records.items()},
        {name: r.position - bench.centre_m[name] for name, r in records.items()},
    )


def _tracked(
    bench: ScenarioRunner, scenario: Scenario, path: Path, records: Mapping[str, LoopRecord]
) -> Tracking:
    """Compare what was run with the path."""
    return track(
        *_centred(bench, records),
        path=path,
        radius_m=bench.radius_m,
        frequency_Hz=scenario.frequency_Hz,
        sampling_rate_Hz=bench.rate_Hz,
    )


def _run(bench: ScenarioRunner, scenario: Scenario) -> None:
    """Run what ships, the other methods where they are compared, and the tip over a surface."""
    path = scenario.path(bench.rate_Hz)
    records: dict[str, LoopRecord] = {}
    if scenario.is_compared and bench.lateral:
        records = _compare(bench, scenario, path)
    elif bench.lateral:
        records = _lateral_runs(bench, path)
        bench.shown[scenario.name] = records
        _judge(bench, scenario, records, _tracked(bench, scenario, path, records))
    if scenario.kind == "spiral":
        judge_tips(bench, scenario, path, records)


def _judge(
    bench: ScenarioRunner,
    scenario: Scenario,
    records: Mapping[str, LoopRecord],
    found: Tracking,
) -> None:
    if scenario.kind == "steps":  # which may use all the drive there is
        for record in records.values():
            bench.verdicts.extend(criteria.step_verdicts(scenario.name, record, bench.limits))
        return
    bench.verdicts.append(criteria.saturation_verdict(scenario.name, list(records.values())))
    if scenario.frequency_Hz <= bench.limits.judged_Hz:
        limit = bench.limits.aligned_percent
        bench.verdicts.append(criteria.shape_verdict(scenario.name, found, bench.radius_m, limit))


def _compare(bench: ScenarioRunner, scenario: Scenario, path: Path) -> dict[str, LoopRecord]:
    """Run every method from every past, and keep the worst: what ships is judged by it too.

    Returns the records of what ships.
    """
    pasts = _all_pasts(bench)
    found: dict[str, Tracking] = {}
    shipped: dict[str, LoopRecord] = {}
    for method in bench.methods():
        runs = [_lateral_runs(bench, path, method, plants) for plants in pasts]
        each = [_tracked(bench, scenario, path, records) for records in runs]
        worst = max(range(len(runs)), key=lambda k: each[k].rms_m)
        found[method] = each[worst]
        _trace(bench, scenario, path, runs[worst], method, found[method])
        if not shipped:
            shipped = runs[worst]
            _judge(bench, scenario, shipped, found[method])
    for method, numbers in found.items():
        bench.comparison.append(
            ComparisonRow(
                method=method,
                frequency_Hz=scenario.frequency_Hz,
                rms_m=numbers.rms_m,
                rms_percent=numbers.rms_percent,
                max_m=numbers.max_m,
                aligned_rms_m=numbers.aligned_rms_m,
                delay_s=numbers.delay_s,
            )
        )
        bench.spirals.append(
            SpiralRow(
                method=method,
                frequency_Hz=scenario.frequency_Hz,
                radial_rms_m=numbers.radial_rms_m,
                pitch_error=numbers.pitch_error,
            )
        )
    first = bench.methods()[0]
    if "none" in found and first != "none":
        bench.verdicts.append(
            criteria.improvement_verdict(scenario.name, found[first], found["none"])
        )
    return shipped


def _all_pasts(bench: ScenarioRunner) -> list[dict[str, AxisPlant]]:
    """Return all plants by axis, as each past left them; each axis has as many as the most."""
    by_axis = {name: with_histories(plant) for name, plant in bench.plants.items()}
    count = max(len(pasts) for pasts in by_axis.values())
    return [{name: p[k % len(p)] for name, p in by_axis.items()} for k in range(count)]


def _trace(
    bench: ScenarioRunner,
    scenario: Scenario,
    path: Path,
    records: Mapping[str, LoopRecord],
    method: str,
    found: Tracking,
) -> None:
    """Keep what a picture of this run needs, if it is one of those shown."""
    if not is_traced(method, bench.methods()[0], scenario.frequency_Hz):
        return
    kept = trace_of(
        method,
        found,
        *_centred(bench, records),
        path=path,
        radius_m=bench.radius_m,
        frequency_Hz=scenario.frequency_Hz,
        sampling_rate_Hz=bench.rate_Hz,
    )
    bench.traces.append(kept)


def _motions(bench: ScenarioRunner, scenarios: Sequence[Scenario]) -> Iterator[Motion]:
    """Keep what pictures in time need; the static gain is run last and judges nothing."""
    for scenario in scenarios:
        if scenario.kind not in SHOWN or scenario.name not in bench.shown:
            continue
        beside = {}
        if TRACED_BESIDE in bench.methods()[1:]:
            beside = _lateral_runs(bench, scenario.path(bench.rate_Hz), TRACED_BESIDE)
        shown = bench.shown[scenario.name]
        yield from motions_of(scenario.name, shown, beside, bench.centre_m, bench.rate_Hz)


def _run_varied(
    bench: ScenarioRunner, scenario: Scenario, variations: Sequence[Sequence[AxisPlant]]
) -> None:
    """Judge the worst of the plants the uncertainty allows."""
    path = scenario.path(bench.rate_Hz)
    found: list[Verdict] = []
    for chosen in variations:
        plants = {**bench.plants, **{plant.axis: plant for plant in chosen}}
        records = _lateral_runs(bench, path, plants=plants)
        if records:
            numbers = _tracked(bench, scenario, path, records)
            limit = bench.limits.varied_percent
            found.append(criteria.shape_verdict(scenario.name, numbers, bench.radius_m, limit))
        for record in run_tips(bench, path, records, plants).values():
            found.extend(criteria.current_verdicts(scenario.name, record, bench.limits))
    for name in dict.fromkeys(verdict.name for verdict in found):
        same = [verdict for verdict in found if verdict.name == name]
        bench.verdicts.append(max(same, key=lambda verdict: verdict.value))


def _run_fault(bench: ScenarioRunner, scenario: Scenario) -> None:
    path = scenario.path(bench.rate_Hz)
    if np.isinf(scenario.fault_s):
        _run_blind(bench, scenario, path)
        return
    healthy = _tracked(bench, scenario, path, _lateral_runs(bench, path))
    fault = scenario.fault_of(len(path.x), bench.rate_Hz)
    records = _lateral_runs(bench, path, fault=fault)
    error_m = np.sqrt(sum((r.position - r.reference) ** 2 for r in records.values()))
    bench.verdicts.extend(
        criteria.fault_verdicts(scenario.name, error_m, healthy, bench.radius_m, bench.limits)
    )
    is_lost = scenario.fault is not None and np.isnan(scenario.fault)
    flag = Status.BAD_MEASUREMENT if is_lost else Status.STUCK_SENSOR
    watching = [r for r in records.values() if _has_feedback(bench, r.axis)]
    bench.verdicts.append(criteria.fault_reported_verdict(scenario.name, watching, flag))


def _run_blind(bench: ScenarioRunner, scenario: Scenario, path: Path) -> None:
    """Judge the worst axis of a stage whose sensors never come back."""
    fault = scenario.fault_of(len(path.x), bench.rate_Hz)
    records = _lateral_runs(bench, path, fault=fault).values()
    found = [
        verdict
        for record in records
        if _has_feedback(bench, record.axis)
        for verdict in criteria.hold_verdicts(
            scenario.name, record, len(path.x) // 2, bench.limits
        )
    ]
    for name in dict.fromkeys(verdict.name for verdict in found):
        same = [verdict for verdict in found if verdict.name == name]
        bench.verdicts.append(max(same, key=lambda verdict: verdict.value))


def _has_feedback(bench: ScenarioRunner, axis: str) -> bool:
    return bench.file.axis(axis).method in ("dob", "mpi_dob", "rst")
