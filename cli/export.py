"""`piezoid export`: a designed stage in, what firmware needs beside it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from piezoid_cli.terminal import plain, say


def export(
    stage: Annotated[Path, typer.Argument(help="Folder with model.json and design.json.")],
    lab: Annotated[
        Path | None, typer.Option(help="lab.toml; by default the one in the folder.")
    ] = None,
    quiet: Annotated[bool, typer.Option(help="Print nothing but errors.")] = False,
) -> None:
    """Write params.json and bundle/: the controller of the stage as C source, ready to compile.

    An axis that cannot ship keeps no other back: exit status 1 says that one is missing.

    [bold]Example[/bold]

    piezoid export stage42/ && cc -std=c99 stage42/bundle/*.c -o controller
    """
    from json import loads

    from piezoid.design.design import design_from_json
    from piezoid.export.bundle import bundle
    from piezoid.export.parameter_file import to_json
    from piezoid.export.stage import export_stage
    from piezoid.identification.store import read_model
    from piezoid_cli.output_folder import add_to_folder
    from piezoid_cli.stage_files import content_of, lab_of, same_model

    content = content_of(stage / "design.json")
    design = design_from_json(content, str(stage / "design.json"))
    model_content = content_of(stage / "model.json")
    model = read_model(model_content, str(stage / "model.json"))
    same_model(model_content, design.model_digest, "design.json", "piezoid design")
    digest = loads(content)["digest"]
    file = export_stage(model, design, design_digest=digest, lab=lab_of(stage, lab))
    contents = {f"bundle/{name}": text for name, text in bundle(file).files.items()}
    add_to_folder(stage, {"params.json": to_json(file), **contents})
    if not quiet:
        for axis in file.axes:
            others = f", to compare {', '.join(axis.methods[1:])}" if axis.alternatives else ""
            say(f"axis {axis.axis}: {axis.method}{others}")
        show_unshipped(file.unshipped)
        say(f"exported: {stage / 'params.json'}, {stage / 'bundle'}")
    if file.unshipped:
        raise typer.Exit(1)


def show_unshipped(reasons: Mapping[str, str]) -> None:
    """Print which axes do not ship, and why."""
    from rich.console import Console

    for axis, reason in reasons.items():
        Console().print(plain(f"axis {axis} does not ship: {reason}", style="bold red"))
