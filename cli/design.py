"""`piezoid design`: design the controllers of a fitted stage."""

from pathlib import Path
from typing import Annotated

import typer

from piezoid_cli.options import ForceEdited, JsonFile, Quiet, StageLab
from piezoid_cli.tables import report_table, show_statements
from piezoid_cli.terminal import display, print_raw, say, show_progress


def design(
    stage: Annotated[Path, typer.Argument(help="Folder that `piezoid fit` wrote.")],
    spec: Annotated[
        Path | None,
        typer.Option(help=r"design.toml: a table per axis, such as \[x] with bandwidth_Hz = 120."),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(help="Sampling rate of the controller in Hz; default: lab.toml.", min=0.0),
    ] = None,
    lab: StageLab = None,
    force: ForceEdited = False,
    quiet: Quiet = False,
    json: JsonFile = False,
) -> None:
    """Design the controllers of a stage: write design.json and design.html to its folder.

    Exit status 4 means that no controller meets the specification; the message states what is
    achievable. If this applies to some axes only, the others are written and the status is 1.
    Each design starts from the defaults: pass --spec again to keep its limits.

    [bold]Examples[/bold]

    piezoid design stage42/

    piezoid design stage42/ --rate 20000 --spec design.toml

    piezoid design stage42/ --json | jq .axes[].loops[].bandwidth_Hz
    """
    from piezoid.design.design_stage import SpecificationText, design_stage
    from piezoid.design.design_statements import design_statements
    from piezoid.output_folder import add_to_folder, check_folder
    from piezoid.statement import Level
    from piezoid_cli.export import show_unshipped
    from piezoid_cli.stage_files import StageFolder, text_of
    from piezoid_reports.page import Page
    from piezoid_reports.render import render_design
    from piezoid_reports.sections.controllers import loops_table

    folder = StageFolder(stage, lab)
    model = folder.model
    requested = None if spec is None else SpecificationText(text=text_of(spec), source=spec.name)
    check_folder(stage, force=force, names=("design.json", "design.html"))
    with show_progress(quiet=quiet or json) as progress:
        result = design_stage(
            model,
            model_digest=folder.model_digest,
            sampling_rate_Hz=rate,
            lab=folder.lab,
            requested=requested,
            progress=progress,
        )
    content = result.to_json()
    page = render_design(model, result).encode()
    add_to_folder(stage, {"design.json": content, "design.html": page}, force=force)
    if json:
        print_raw(content)
    elif not quiet:
        loops = loops_table(Page(model=model, design=result))
        display(report_table(loops, "controllers, worst case over each plant family"))
        show_statements(design_statements(result, model), Level.WARNING)
        for axis in result.axes:
            if rate is not None and axis.sampling_rate_Hz != rate:
                say(f"axis {axis.axis}: {axis.sampling_rate_Hz:g} Hz, the rate of its recordings")
        show_unshipped(result.refused)
        say(f"design: {stage / 'design.json'}, {stage / 'design.html'}")
        say("params.json and bundle/ still contain the earlier design. To update them:")
        say(f"piezoid export {stage}")
    if result.refused:
        raise typer.Exit(1)
