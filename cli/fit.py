"""`piezoid fit`: recordings in, the whole folder of a stage out."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piezoid_cli.terminal import Force, Json, Quiet, hand_over, plain, say, table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console
    from rich.table import Table

    from piezoid.calibration.calibrate import Calibration, Told
    from piezoid.calibration.controllers import Controllers
    from piezoid.diagnosis.diagnosis import Finding
    from piezoid.identification.actuator_model import ActuatorModel
    from piezoid.identification.coupled.coupled_stage import CoupledStage
    from piezoid.identification.model import AxisModel
    from piezoid.identification.tunnelling.model import TunnellingModel

WRITTEN = (
    *("model.json", "diagnosis.json", "design.json", "params.json", "verification.json"),
    *("report.html", "bundle/README.md"),
)
UNDIAGNOSED = (
    "not diagnosed: recordings that are read in chunks are not searched for causes; fit a part "
    "that fits into memory (start_s and stop_s in lab.toml) to have it diagnosed"
)


def fit(
    files: Annotated[list[Path], typer.Argument(help="Recordings of one stage, any number.")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    lab: Annotated[Path | None, typer.Option(help="lab.toml: rig, columns and units.")] = None,
    force: Force = False,
    stream: Annotated[
        bool,
        typer.Option(
            "--stream",
            help="For files larger than memory: read in chunks and thinned, without diagnosis.",
        ),
    ] = False,
    processes: Annotated[
        int | None,
        typer.Option(
            help="At most so many work side by side; not given, as many as there are cores.",
            min=1,
        ),
    ] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Do all of it: fit a stage, diagnose it, design its controllers, verify what ships.

    Writes model.json, diagnosis.json, design.json, params.json, bundle/ (C source to compile),
    verification.json and report.html. Without a controller's sampling rate in lab.toml, or with
    nothing that limits the stage's speed, there is no controller, and the report says what is
    missing.

    Exit status 1 means that a verdict failed, that the model class does not apply, or that no
    controller of an axis may ship; the other axes ship all the same, and the report says why.

    [bold]Examples[/bold]

    piezoid fit sweep.csv --out stage42/

    piezoid fit sweep.csv check.csv rates.csv --lab lab.toml --out stage42/ --force

    piezoid fit *.csv --lab lab.toml --out stage42/ --json | jq .axes.x.held_out_rms_m

    piezoid fit night.parquet --lab lab.toml --out stage42/ --stream
    """
    from piezoid.output_folder import check_folder, write_folder
    from piezoid_cli.calibration import calibrate
    from piezoid_cli.progress import shown
    from piezoid_cli.side_by_side import usable_cores

    check_folder(out, force=force, new=True, names=WRITTEN, inputs=files)
    count = processes or usable_cores()
    with shown(quiet=quiet or json) as told:
        if stream:
            found = calibrate_streamed(files, lab, told, count)
        else:
            found = calibrate(files, lab, told, count)
        write_folder(out, found.files, force=force)
    if json:
        from json import dumps

        hand_over(dumps(summary_of(found), indent=1, allow_nan=False))
    elif not quiet:
        _show_model(found.model)
        for sentence in _diagnosis_sentences(found):
            say(sentence)
        ranges_m = {name: axis.quality.range_m for name, axis in found.model.axes.items()}
        _show_controllers(found.controllers, ranges_m)
        say(f"report: {out / 'report.html'}")
    if not found.passed:
        raise typer.Exit(1)


def summary_of(found: "Calibration") -> dict[str, Any]:
    """Return what a script wants to know of a stage."""
    causes = [] if found.diagnosis is None else found.diagnosis.findings
    named = {one.axis: list(one.names) for one in found.diagnoses}
    made = found.controllers
    verdicts = () if made.verification is None else made.verification.verdicts
    return {
        "schema": "piezoid.summary/1",
        "stage": found.model.stage,
        "passed": found.passed,
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
                "causes": named.get(name),
            }
            for name, axis in found.model.axes.items()
        },
        "coupled": None
        if found.model.coupled is None
        else {
            "axes": list(found.model.coupled.outputs),
            "levels_V": found.model.coupled.levels_V.tolist(),
            "error_rms_m": found.model.coupled.error_rms_m.tolist(),
            "moved_rms_m": found.model.coupled.moved_rms_m.tolist(),
        },
        "diagnosed_axis": None if found.diagnosis is None else found.diagnosis.axis,
        "causes": [finding.effect for finding in causes],
        "remarks": list(found.model.remarks),
        "undiagnosed": list(found.undiagnosed),
        "undesigned": made.reason,
        "unshipped": dict(made.unshipped),
        "verdicts_passed": sum(verdict.passed for verdict in verdicts),
        "verdicts": len(verdicts),
        "files": sorted(found.files),
    }


def _show_controllers(made: "Controllers", ranges_m: "Mapping[str, float]") -> None:
    from rich.console import Console

    from piezoid_cli.design import show as show_design
    from piezoid_cli.export import show_unshipped

    console = Console()
    if made.design is not None:
        show_design(made.design, made.shipped, ranges_m)
    if made.reason:
        what = "no controller" if made.design is None else "not exported"
        tone = "dim" if made.passed else "bold red"
        console.print(plain(f"{what}: {made.reason}", style=tone))
    show_unshipped(made.unshipped)
    if made.verification is not None:
        verdicts = made.verification.verdicts
        passed = sum(verdict.passed for verdict in verdicts)
        line = f"verification: {passed} of {len(verdicts)} verdicts passed"
        console.print(plain(line, style="" if made.verification.passed else "bold red"))


def _diagnosis_sentences(found: "Calibration") -> tuple[str, ...]:
    if not found.model.axes:
        return ("diagnosis: no axis with a drive and a displacement",)
    from piezoid.counts import in_counts
    from piezoid_reports.what_is_left import shape_lacked

    named = []
    for one in found.diagnoses:
        shape = shape_lacked(one, found.model.axes.get(one.axis))
        causes = ", ".join(map(_told_apart, one.findings)) or "nothing"
        said = f"{causes} named{f'; {shape}' if shape else ''}"
        named.append(f"diagnosis of axis {one.axis}: {in_counts(said, one.counted)}")
    return (*named, *found.undiagnosed)


def _told_apart(finding: "Finding") -> str:
    rivals = " or ".join(finding.not_separable_from)
    return f"{finding.effect} (not separable from {rivals})" if rivals else finding.effect


def _show_model(model: "ActuatorModel") -> None:
    from rich.console import Console

    console = Console()
    if model.axes:
        console.print(_table(model))
    if model.tunnelling is not None:
        _show_tip(model.tunnelling)
    if model.coupled is not None:
        _show_coupled(model.coupled)
    for remark in model.remarks:
        console.print(plain(remark, style="dim"))
    for axis in model.axes.values():
        _show_axis(axis, console)


def _show_coupled(coupled: "CoupledStage") -> None:
    share = 100.0 * coupled.error_rms_m / coupled.moved_rms_m
    kind = "on realisations left out" if coupled.error_is_left_out else "in sample"
    levels = "; ".join(
        f"{level:.3g} V rms: {', '.join(f'{error:.2f} %' for error in row)}"
        for level, row in zip(coupled.levels_V, share, strict=True)
    )
    names = ", ".join(coupled.outputs)
    say(f"coupled axes {names}: error {kind}, by level and axis, {levels}")


def _show_axis(axis: "AxisModel", console: "Console") -> None:
    quality = axis.quality
    if not axis.verdict.applies:
        reason = f"axis {axis.axis}: the model class does not apply: {axis.verdict.reason}."
        console.print(plain(reason, style="bold red"))
    for limit in quality.limits:
        console.print(plain(f"axis {axis.axis}: {limit.reason}.", style="yellow"))
    error = "held-out error" if quality.is_tested else "error"
    said = f"the {error} is on {quality.held_out_words}."
    for remark in (said, *axis.verdict.remarks):
        console.print(plain(f"axis {axis.axis}: {remark}", style="dim"))


def _show_tip(tip: "TunnellingModel") -> None:
    from rich.console import Console

    from piezoid_reports.junction_words import barrier_sentence, joint_sentence, loop_sentence

    console = Console()
    law, loop, joint = tip.gap_law, tip.loop_plant, tip.joint
    if law is not None:
        console.print(plain(f"tunnelling: {barrier_sentence(law)}"))
        for reason in law.reasons:
            console.print(plain(f"tunnelling: {reason}", style="dim"))
    if loop is not None:
        console.print(plain(f"tunnelling: {loop_sentence(loop)}"))
        for reason in loop.reasons:
            console.print(plain(f"tunnelling: {reason}", style="dim"))
    if law is not None and loop is not None and joint is not None:
        tone = "" if joint.agree else "bold red"
        console.print(plain(f"tunnelling: {joint_sentence(law, loop, joint)}", style=tone))


def _table(model: "ActuatorModel") -> "Table":
    from piezoid.counts import in_counts
    from piezoid.formatting import with_unit

    rows = [
        (
            axis.axis,
            str(len(axis.hysteresis.plays.weight)),
            str(len(axis.hysteresis.dead_zones.weight) - 1),
            "loop or lag" if axis.quality.lag_is_open else with_unit(axis.lag.time_s, "s"),
            in_counts(with_unit(axis.quality.held_out_rms_m, "m"), axis.counted)
            + ("" if axis.quality.is_tested else " in sample"),
            f"{axis.quality.held_out_rms_percent:.3f} %",
            axis.quality.noise_bound
            + in_counts(with_unit(axis.quality.noise_rms_m, "m"), axis.counted),
        )
        for axis in model.axes.values()
    ]
    headings = ("axis", "plays", "dead zones", "lag", "held-out rms", "of range", "noise")
    return table(f"stage {model.stage}", headings, rows)


def calibrate_streamed(
    files: Sequence[Path], lab: Path | None, told: "Told", processes: int = 1
) -> "Calibration":
    """Fit recordings that are read in chunks, design, export, verify and report one stage.

    processes  at most so many threads verify

    The report has no diagnosis, no loops and no residuals: they need the whole recordings.
    """
    from dataclasses import replace

    from piezoid.calibration.calibrate import FittedStage, finished
    from piezoid.identification.fit import fit as fit_stage
    from piezoid.records.chunked_reader import read_thinned
    from piezoid.records.lab import read_lab
    from piezoid_reports.render import with_report

    declared = None if lab is None else read_lab(lab)
    recordings = read_thinned(files, declared, progress=told)
    model = fit_stage(recordings, lab=declared, progress=told)
    notes = dict.fromkeys(f"{r.name}: {s.text}" for r in recordings for s in r.statements)
    model = replace(model, remarks=(*notes, *model.remarks))
    done = finished(
        FittedStage(model=model, undiagnosed=(UNDIAGNOSED,)), declared, told, processes
    )
    told("writing the report")
    return with_report(done, None, declared)
