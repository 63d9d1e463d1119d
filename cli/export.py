"""`piezoid export`: write the parameters and the C source of a design for firmware."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from piezoid_cli.options import ForceEdited, Json, Quiet, StageLab
from piezoid_cli.terminal import display, print_record, say, show_progress


def export(
    stage: Annotated[Path, typer.Argument(help="Folder with model.json and design.json.")],
    lab: StageLab = None,
    target: Annotated[
        list[str] | None,
        typer.Option(help="Also write: fmu, library, pid, nanonis, waveform. Repeatable."),
    ] = None,
    box: Annotated[
        Path | None, typer.Option(help="box.toml: limits of the hardware, see above.")
    ] = None,
    force: ForceEdited = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Write params.json and bundle/: the controller of the stage as C source, with its README.

    --target fmu adds fmu/: the controller and the identified plant of each axis as co-simulation
    units of FMI 2.0 for Simulink, OpenModelica and FMPy. --target library adds library/: a shared
    library for LabVIEW, MATLAB, EPICS, Rust and Python. Both contain the same source as the
    bundle.

    --target pid adds settings and second-order sections of a PID with notches. --target nanonis
    adds tables of sensitivity and hysteresis. --target waveform adds a predistorted drive for a
    wave generator. Each of these three states how much accuracy it loses against the exported
    controller. Stale target folders are deleted.

    box.toml contains the tables \\[pid] (notches, slew, rate of the sections), \\[nanonis] (points
    of a table, size of the frame) and \\[waveform] (shape, frequency and size of the scan; rate,
    memory and converter of the generator). Without --box, defaults and the values of the stage
    apply.

    The controllers are first verified on the identified stage. An axis that fails is not
    exported: its results go to refused/ and the exit status is 1. The other axes are exported.

    [bold]Examples[/bold]

    piezoid export stage42/ && cc -std=c99 -O2 -ffp-contract=off stage42/bundle/*.c -o controller

    piezoid export stage42/ --target fmu --target library

    piezoid export stage42/ --json | jq .methods
    """
    from piezoid.calibration.controllers import REFUSED, export_and_verify, shipping_files
    from piezoid.digests import digest_in
    from piezoid.output_folder import add_to_folder, check_folder
    from piezoid.targets.target_inputs import read_hardware
    from piezoid.targets.targets import FOLDERS, check_targets, inputs_of, target_files
    from piezoid_cli.stage_files import StageFolder, content_of
    from piezoid_cli.workers import usable_cores

    targets = check_targets(target or ())
    hardware = None if box is None else read_hardware(box)
    folder = StageFolder(stage, lab)
    design, model = folder.design, folder.model
    check_folder(stage, force=force, names=("params.json", "verification.json"))
    with show_progress(quiet=quiet or json) as progress:
        shipping = export_and_verify(
            model,
            design,
            design_digest=digest_in(content_of(stage / "design.json")),
            lab=folder.lab,
            progress=progress,
            threads=usable_cores(),
        )
    contents, notes = shipping_files(shipping), tuple[str, ...]()
    file = shipping.parameters
    if file is not None:
        inputs = inputs_of(file, model, design, folder.lab, hardware=hardware)
        files, notes = target_files(inputs, targets)
        contents |= files
    add_to_folder(stage, contents, gone=("params.json", *FOLDERS, REFUSED), force=force)
    axes, unshipped = ((), shipping.reasons) if file is None else (file.axes, file.unshipped)
    if json:
        print_record(
            "exported",
            methods={axis.axis: axis.method for axis in axes},
            unshipped=dict(unshipped),
            files=sorted(contents),
            notes=list(notes),
        )
    elif not quiet:
        for axis in axes:
            alternatives = ", ".join(axis.methods[1:])
            comparison = f" (for comparison: {alternatives})" if alternatives else ""
            say(f"axis {axis.axis}: {axis.method}{comparison}")
        show_unshipped(unshipped)
        if file is not None:
            folders = dict.fromkeys(("bundle", *targets))
            say(f"exported: {', '.join(str(stage / name) for name in ('params.json', *folders))}")
            if (stage / "report.html").exists():
                say(f"to update report.html: piezoid report {stage} RECORDINGS, those of the fit")
        elif targets:
            say("no target was written, because no controller ships")
        for note in notes:
            say(note)
    if unshipped:
        raise typer.Exit(1)


def show_unshipped(reasons: Mapping[str, str]) -> None:
    """Print the axes that do not ship, with the reasons."""
    for axis, reason in reasons.items():
        display(f"axis {axis} does not ship: {reason}", "bold red")
