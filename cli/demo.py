"""`piezoid demo`: calibrate the bundled stage."""

from pathlib import Path
from typing import Annotated

import typer

from piezoid_cli.options import Force, Json, Processes, Quiet
from piezoid_cli.terminal import say


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("piezoid-demo"),
    force: Force = False,
    processes: Processes = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Calibrate the bundled three-axis stage: `piezoid fit` on the recordings in the package.

    X and Y have hysteresis, and Z has a tunnelling tip. Open report.html in the output folder.
    Allow one to four minutes, depending on the number of cores.

    [bold]Examples[/bold]

    piezoid demo

    piezoid demo --out build/demo --force
    """
    from piezoid_cli.fit import fit
    from piezoid_datasets import LAB, stage_files

    if not (quiet or json):
        say("calibrating three axes: one to four minutes, depending on the cores", err=True)
    # The order of a shell pattern, with recordings over time first; results keep this order.
    files = sorted(stage_files(), key=lambda path: (path.suffix, path.name))
    fit(files, out, lab=LAB, force=force, processes=processes, quiet=quiet, json=json)
