"""`piezoid fit`: recordings in, a folder with model.json and report.html out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.table import Table

    from piezoid.design.design import Design
    from piezoid.identification.model import ActuatorModel
    from piezoid.records.lab import Lab
    from piezoid.records.recording import Recording


def fit(
    files: Annotated[list[Path], typer.Argument(help="Recordings of one stage, any number.")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    lab: Annotated[Path | None, typer.Option(help="lab.toml: rig, columns and units.")] = None,
    force: Annotated[bool, typer.Option(help="Replace what the folder holds.")] = False,
    quiet: Annotated[bool, typer.Option(help="Print nothing but errors.")] = False,
) -> None:
    """Fit a stage and design its controllers: write model.json, design.json and report.html.

    Example: piezoid fit sweep.csv check.csv --lab lab.toml --out stage42/

    Without a controller's sampling rate in lab.toml, or with nothing that limits the stage's
    speed, no controller is designed, and the report says what is missing.

    Exit status 1 means that the model class does not apply; the report says why.
    """
    from piezoid_cli.output_folder import check_free, write_folder
    from piezoid_cli.progress import shown

    check_free(out, force=force)
    with shown(quiet=quiet) as told:
        told("reading recordings")
        from piezoid.identification.fit import fit as fit_model
        from piezoid.identification.store import write_model
        from piezoid.records.collection import collect
        from piezoid.records.lab import read_lab
        from piezoid_reports.render import render

        declared = None if lab is None else read_lab(lab)
        held = collect(files, declared)
        model = fit_model(held.recordings, lab=declared, sweeps=held.sweeps, progress=told)
        content = write_model(model)
        design, undesigned = _designed(model, content, told)
        told("writing the report")
        page = render(model, held.recordings, held.sweeps, design, undesigned)
        diagnosis, sentence = _diagnosed(held.recordings, declared, model, told)
        files_out = {"model.json": content, "report.html": page.encode(), **diagnosis}
        if design is not None:
            files_out["design.json"] = design.to_json()
        write_folder(out, files_out)
    if not quiet:
        _show(model, out)
        typer.echo(sentence)
        _show_design(design, undesigned)
    if not model.applies:
        raise typer.Exit(1)


def _diagnosed(
    recordings: "Sequence[Recording]",
    lab: "Lab | None",
    model: "ActuatorModel",
    told: "Callable[[str], None]",
) -> tuple[dict[str, bytes], str]:
    """Return diagnosis.json of the first axis, and a sentence on it and the axes left out."""
    from piezoid.diagnosis.diagnose import diagnose
    from piezoid.diagnosis.diagnosis import write_diagnosis

    if not model.axes:
        return {}, "diagnosis: no axis with a drive and a displacement"
    axis, *others = model.axes
    found = diagnose(recordings, axis=axis, lab=lab, progress=told)
    causes = ", ".join(finding.effect for finding in found.findings) or "nothing"
    sentence = f"diagnosis of axis {axis}: {causes} named"
    if others:
        sentence += f"; not diagnosed here: {', '.join(others)} (piezoid diagnose --axis)"
    return {"diagnosis.json": write_diagnosis(found)}, sentence


def _designed(
    model: "ActuatorModel", content: bytes, told: "Callable[[str], None]"
) -> "tuple[Design | None, str]":
    """Return the recommended controllers, or why there are none.

    `piezoid design` adds the affine form beside them, for comparison; that takes longer.
    """
    from json import loads

    from piezoid.design.stage import design_stage
    from piezoid.errors import DesignError

    if not model.axes:
        return None, ""
    try:
        digest = loads(content)["digest"]
        found = design_stage(model, model_digest=digest, forms=("inverse",), progress=told)
    except DesignError as refusal:
        return None, str(refusal)
    return found, ""


def _show_design(design: "Design | None", undesigned: str) -> None:
    from rich.console import Console
    from rich.text import Text

    from piezoid_cli.design import show

    if design is not None:
        show(design)
    elif undesigned:
        Console().print(Text(f"no controller: {undesigned}", style="dim"))


def _show(model: "ActuatorModel", out: Path) -> None:
    from rich.console import Console
    from rich.text import Text

    from piezoid_reports.junction_words import barrier_sentence

    console = Console()
    if model.axes:
        console.print(_table(model))
    law = None if model.tunnelling is None else model.tunnelling.gap_law
    if law is not None:
        console.print(Text(f"tunnelling: {barrier_sentence(law)}"))
        for reason in law.reasons:
            console.print(Text(f"tunnelling: {reason}", style="dim"))
    for remark in model.remarks:
        console.print(Text(remark, style="dim"))
    for axis in model.axes.values():
        if not axis.verdict.applies:
            reason = f"axis {axis.axis}: the model class does not apply: {axis.verdict.reason}."
            console.print(Text(reason, style="bold red"))
        for remark in axis.verdict.remarks:
            console.print(Text(f"axis {axis.axis}: {remark}", style="dim"))
    console.print(Text(f"report: {out / 'report.html'}"))


def _table(model: "ActuatorModel") -> "Table":
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(f"stage {model.stage}"))
    for heading in ("axis", "plays", "dead zones", "lag", "held-out rms", "of range", "noise"):
        table.add_column(heading, justify="right")
    for axis in model.axes.values():
        quality = axis.quality
        table.add_row(
            Text(axis.axis),
            str(len(axis.hysteresis.plays.weight)),
            str(len(axis.hysteresis.dead_zones.weight) - 1),
            f"{1e6 * axis.lag.time_s:.0f} us",
            f"{1e9 * quality.held_out_rms_m:.1f} nm",
            f"{quality.held_out_rms_percent:.3f} %",
            f"{1e9 * quality.noise_rms_m:.1f} nm",
        )
    return table
