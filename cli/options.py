"""Options that several verbs share."""

from pathlib import Path
from typing import Annotated

import typer

Quiet = Annotated[bool, typer.Option("--quiet", help="Print only errors.")]
Force = Annotated[
    bool,
    typer.Option("--force", help="Replace earlier results in --out, also files that you edited."),
]
ForceEdited = Annotated[
    bool,
    typer.Option(
        "--force", help="Also replace files that you edited; unedited files are always replaced."
    ),
]
StageLab = Annotated[Path | None, typer.Option(help="lab.toml; default: in the stage folder.")]
RecordingLab = Annotated[
    Path | None, typer.Option("--lab", help="lab.toml: rig, columns and units.")
]
Processes = Annotated[
    int | None, typer.Option(help="Number of worker processes; default: one per core.", min=1)
]
Json = Annotated[bool, typer.Option("--json", help="For scripts: print a JSON summary.")]
JsonFile = Annotated[bool, typer.Option("--json", help="For scripts: print the JSON file.")]
