"""`piezoid demo`: the main job on the recordings that come with piezoid."""

from pathlib import Path
from typing import Annotated

import typer

from piezoid_cli.terminal import Force, Json, Processes, Quiet


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("piezoid-demo"),
    force: Force = False,
    processes: Processes = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Calibrate the bundled three-axis stage: `piezoid fit` on recordings that come with piezoid.

    X and Y have hysteresis, Z has a tunnelling tip. Open report.html in the folder of results.

    [bold]Examples[/bold]

    piezoid demo

    piezoid demo --out build/demo --force
    """
    from piezoid_cli.fit import fit
    from piezoid_datasets import LAB, stage_files

    # As a shell lists them: recordings over time first, whose order the results follow.
    files = sorted(stage_files(), key=lambda path: (path.suffix, path.name))
    fit(files, out, lab=LAB, force=force, processes=processes, quiet=quiet, json=json)
