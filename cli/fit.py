"""`piezoid fit`: calibrate a stage from its recordings."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piezoid_cli.options import Force, Json, Processes, Quiet, RecordingLab
from piezoid_cli.tables import budget_lines, show_statements, table
from piezoid_cli.terminal import display, print_record, say, show_progress

if TYPE_CHECKING:
    from rich.table import Table

    from piezoid.calibration.calibrate import Calibration, Progress

WRITTEN = (
    *("model.json", "diagnosis.json", "design.json", "params.json", "verification.json"),
    *("report.html", "bundle/README.md"),
)
LEGEND = (
    "(table: error on held-out data; closure: error / noise, 1 if only noise remains; bandwidth "
    "of the feedback; guaranteed: proven limit of the tracking error{speeds}, the worst of all "
    "uncertainties together, without sensor noise; ships: verified, in bundle/)"
)
UNDIAGNOSED = (
    "not diagnosed, because the recordings were read in chunks; for a diagnosis, fit a part that "
    "fits into memory (start_s and stop_s in lab.toml)"
)


def fit(
    files: Annotated[list[Path], typer.Argument(help="Recordings of one stage, any number.")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    lab: RecordingLab = None,
    force: Force = False,
    stream: Annotated[
        bool,
        typer.Option(
            "--stream",
            help="For files larger than memory: read in chunks, downsample, do not diagnose.",
        ),
    ] = False,
    processes: Processes = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Calibrate a stage: fit and diagnose it, design its controllers, and verify them.

    Writes model.json, diagnosis.json, design.json, params.json, bundle/ (C source to compile),
    verification.json and report.html. Without the sampling rate of the controller in lab.toml, or
    without dynamics that limit the speed of the stage, no controller is designed, and the report
    states what is missing.

    The progress counts elements of the hysteresis model: plays set the width of a loop, dead zones
    and bends its curvature.

    Exit status 1 means that a check of the verification failed, that the model class does not
    apply, or that the controller of an axis does not ship; the other axes still ship, and the
    report states the reason. The status is 0 for a poor grade of the model, and if no controller
    could be designed because information is missing; --json then gives the reason as
    "undesigned".

    [bold]Examples[/bold]

    piezoid fit sweep.csv --out stage42/

    piezoid fit sweep.csv check.csv rates.csv --lab lab.toml --out stage42/ --force

    piezoid fit *.csv --lab lab.toml --out stage42/ --json | jq .axes.x.held_out_rms_m

    piezoid fit night.parquet --lab lab.toml --out stage42/ --stream
    """
    from piezoid.output_folder import check_folder, write_folder
    from piezoid_cli.calibration import calibrate
    from piezoid_cli.workers import usable_cores

    check_folder(out, force=force, new=True, names=WRITTEN, inputs=files)
    count = processes or usable_cores()
    with show_progress(quiet=quiet or json) as progress:
        run = calibrate_streamed if stream else calibrate
        calibration = run(files, lab, progress, count)
        write_folder(out, calibration.files, force=force)
    if json:
        print_record("summary", **summary_of(calibration))
    elif not quiet:
        show(calibration)
        names = dict.fromkeys(name.partition("/")[0] for name in calibration.files)
        say(f"report: {out / 'report.html'}")
        say(f"also in {out}: {', '.join(name for name in names if name != 'report.html')}")
    if not calibration.passed:
        raise typer.Exit(1)


def summary_of(calibration: "Calibration") -> dict[str, Any]:
    """Return the summary of a stage for scripts."""
    model, controllers = calibration.model, calibration.controllers
    diagnosis, verification = calibration.diagnosis, controllers.verification
    causes = {diagnosis.axis: list(diagnosis.names) for diagnosis in calibration.diagnoses}
    verdicts = () if verification is None else verification.verdicts
    coupled = model.coupled
    return {
        "stage": model.stage,
        "passed": calibration.passed,
        "axes": {
            name: {
                "applies": axis.verdict.applies,
                "reason": axis.verdict.reason,
                "held_out_rms_m": axis.quality.held_out_rms_m,
                "held_out_rms_percent": axis.quality.held_out_rms_percent,
                "held_out_kind": axis.quality.held_out_kind,
                "limits": [limit.reason for limit in axis.quality.limits],
                "noise_rms_m": axis.quality.noise_rms_m,
                "error_bound_m": axis.certificate.bound_m,
                "causes": causes.get(name),
            }
            for name, axis in model.axes.items()
        },
        "coupled": None
        if coupled is None
        else {
            "axes": list(coupled.outputs),
            "levels_V": coupled.levels_V.tolist(),
            "error_rms_m": coupled.error_rms_m.tolist(),
            "moved_rms_m": coupled.moved_rms_m.tolist(),
        },
        "diagnosed_axis": None if diagnosis is None else diagnosis.axis,
        "causes": [] if diagnosis is None else [f.effect for f in diagnosis.findings],
        "remarks": list(model.remarks),
        "undiagnosed": list(calibration.undiagnosed),
        "undesigned": controllers.reason,
        "unshipped": dict(controllers.unshipped),
        "verdicts_passed": sum(verdict.passed for verdict in verdicts),
        "verdicts": len(verdicts),
        "files": sorted(calibration.files),
    }


def show(calibration: "Calibration") -> None:
    """Print a table of axes, their error budgets, the tip, and the statements."""
    from piezoid.calibration.stage_statements import stage_statements
    from piezoid.statement import Level
    from piezoid_reports.sections.tunnelling import barrier_sentence, joint_sentence, loop_sentence

    model, controllers = calibration.model, calibration.controllers
    display(_table(calibration))
    lines = [*budget_lines(calibration.diagnoses), _legend(calibration)]
    if (tip := model.tunnelling) is not None:
        of_tip = [] if tip.gap_law is None else [barrier_sentence(tip.gap_law)]
        of_tip += [] if tip.loop_plant is None else [loop_sentence(tip.loop_plant)]
        of_tip += [] if tip.joint is None else [joint_sentence(tip.joint)]
        lines += [f"tunnelling: {line}" for line in of_tip]
    if (coupled := model.coupled) is not None:
        share = 100.0 * coupled.error_rms_m / coupled.moved_rms_m
        kind = "held-out" if coupled.error_is_left_out else "in-sample"
        levels = "; ".join(
            f"{level:.3g} V rms: {', '.join(f'{error:.2f} %' for error in row)}"
            for level, row in zip(coupled.levels_V, share, strict=True)
        )
        lines.append(f"coupled axes {', '.join(coupled.outputs)}: {kind} error {levels}")
    for line in lines:
        display(line)
    verification = controllers.verification
    if verification is not None:
        passed = sum(verdict.passed for verdict in verification.verdicts)
        line = f"verification: {passed} of {len(verification.verdicts)} checks passed"
        display(line, "" if verification.passed else "bold red")
    statements = stage_statements(
        model,
        diagnoses=calibration.diagnoses,
        undiagnosed=calibration.undiagnosed,
        design=controllers.design,
        undesigned=controllers.reason,
        unshipped=controllers.unshipped,
        verification=verification,
    )
    # Reasons for the grade of an axis and for a missing bound are also shown if only warnings.
    explained = {
        (name, quantity)
        for name, axis in model.axes.items()
        for quantity in ("guaranteed_error", *(limit.lack for limit in axis.quality.limits))
    }
    for fact in statements:
        if (fact.axis, fact.quantity) in explained and fact.level is Level.WARNING:
            display(f"axis {fact.axis}: {fact.text}")
    show_statements(statements)


def _legend(calibration: "Calibration") -> str:
    """Return the legend of the table, with the speeds up to which errors are guaranteed."""
    from piezoid.design.certificate import useful_bound_m
    from piezoid.formatting import with_unit

    design, axes, speeds = calibration.controllers.design, calibration.model.axes, []
    for axis in () if design is None else design.axes:
        certificate = axis.recommended.certificate
        has_bound = axis.axis in axes and useful_bound_m(certificate, axes[axis.axis]) is not None
        if certificate is not None and has_bound:
            speed = with_unit(certificate.reference_slew_m_per_s, "m/s")
            speeds.append(f"{axis.axis} up to {speed}")
    return LEGEND.format(speeds=f" ({', '.join(speeds)})" if speeds else "")


def _table(calibration: "Calibration") -> "Table":
    from piezoid.design.certificate import guaranteed_error_m
    from piezoid.formatting import significant, with_unit
    from piezoid.identification.fit_statements import grade_of
    from piezoid.raw_counts import in_counts

    model, design = calibration.model, calibration.controllers.design
    loops = {} if design is None else {axis.axis: axis.recommended for axis in design.axes}
    rows = []
    for name in dict.fromkeys([*model.axes, *loops]):
        axis, loop = model.axes.get(name), loops.get(name)
        ships = name in calibration.controllers.shipped
        error = noise = closure = bound = grade = ""
        if axis is not None:
            quality = axis.quality
            error = in_counts(with_unit(quality.held_out_rms_m, "m"), axis.counted)
            error = error if quality.is_tested else f"{error} in sample"
            noise_rms = in_counts(with_unit(quality.noise_rms_m, "m"), axis.counted)
            noise = f"{quality.noise_bound}{noise_rms}"
            ratio = quality.held_out_rms_m / quality.noise_rms_m if quality.noise_rms_m else 0.0
            closure = significant(ratio, 2) if ratio else ""
            grade = f"{grade_of(axis).value}; "
        if axis is not None and loop is not None:
            bound_m = guaranteed_error_m(loop.certificate, axis, is_verified=ships)
            text = bound_m if isinstance(bound_m, str) else with_unit(bound_m, "m")
            bound = in_counts(text, axis.counted)
        bandwidth, verdict = "", "no controller"
        if loop is not None:
            bandwidth = with_unit(loop.bandwidth_Hz, "Hz")
            verdict = "ships" if ships else "does not ship"
        rows.append((name, error, noise, closure, bandwidth, bound, f"{grade}{verdict}"))
    headings = ("axis", "error", "noise", "closure", "bandwidth", "guaranteed", "verdict")
    is_named_after_file = any(name.partition(".")[0] == model.stage for name in model.sources)
    origin = " (named after a recording; [rig] name in lab.toml)" if is_named_after_file else ""
    return table(f"stage {model.stage}{origin}", headings, rows)


def calibrate_streamed(
    files: Sequence[Path], lab: Path | None, progress: "Progress", processes: int = 1
) -> "Calibration":
    """Fit recordings read in chunks; design, export, verify and report the stage.

    processes  maximum number of threads of the verification

    The report has no diagnosis, loops or residuals, which need complete recordings in memory.
    """
    from dataclasses import replace

    from piezoid.calibration.calibrate import JobResult, finish, try_design
    from piezoid.records.chunked_reader import read_thinned
    from piezoid.records.collection import Collection
    from piezoid.records.lab import read_lab
    from piezoid.verbs import fit as fit_stage
    from piezoid_reports.render import with_report

    declared = None if lab is None else read_lab(lab)
    recordings = read_thinned(files, declared, progress=progress)
    model = fit_stage(recordings, lab=declared, progress=progress)
    notes = dict.fromkeys(f"{r.name}: {s.text}" for r in recordings for s in r.statements)
    model = replace(model, remarks=(*notes, *model.remarks))
    outcomes, fault = try_design(model, declared, progress)
    result = JobResult(undiagnosed=UNDIAGNOSED, outcomes=outcomes, fault=fault)
    calibration = finish(model, [result], declared, progress, processes)
    progress("writing the report")
    return with_report(calibration, Collection(recordings=()), declared)
