"""`piezoid learn`: a period of motion in, and perhaps its recording; the next table out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezoid_cli.terminal import Force, Quiet, StageLab, hand_over, say

if TYPE_CHECKING:
    from piezoid.export.parameter_file import ParameterFile
    from piezoid.identification.actuator_model import ActuatorModel
    from piezoid.learning.learn import Learned


def learn(
    stage: Annotated[Path, typer.Argument(help="Folder with model.json and params.json.")],
    reference: Annotated[
        Path, typer.Option(help="One period, a point for each sample: a column of a length.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the table.")],
    period: Annotated[
        Path | None, typer.Option(help="What was recorded, from point 0 on; whole periods count.")
    ] = None,
    table: Annotated[
        Path | None, typer.Option(help="learning.json of the table that was played then.")
    ] = None,
    axis: Annotated[str | None, typer.Option(help="Which axis; default: the only one.")] = None,
    open_loop: Annotated[
        bool, typer.Option("--open-loop", help="The table is all of the voltage: no controller.")
    ] = False,
    gain: Annotated[
        float, typer.Option(help="Of learning, over the best for the worst plant.", min=0.0)
    ] = 1.0,
    lab: StageLab = None,
    force: Force = False,
    quiet: Quiet = False,
    json: Annotated[
        bool, typer.Option("--json", help="For scripts: print learning.json itself.")
    ] = False,
) -> None:
    """Learn the feedforward of a periodic motion: write learning.json and the table to play.

    Without a recording the table is computed from the model; with one, the table is refined. Exit
    status 4 means that the learning filter does not contract on every plant of the family.

    [bold]Examples[/bold]

    piezoid learn stage42/ --reference scan.csv --out a/

    piezoid learn stage42/ --reference scan.csv --table a/learning.json --period seen.csv --out b/

    piezoid learn stage42/ --reference scan.csv --open-loop --axis x --out wave/
    """
    from piezoid.output_folder import check_folder, write_folder
    from piezoid_cli.progress import shown
    from piezoid_cli.stage_files import content_of, lab_of, same_model

    if (period is None) != (table is None):
        raise typer.BadParameter("--period and --table belong together: neither, or both")
    if not gain > 0.0:
        raise typer.BadParameter(f"--gain {gain:g}: a gain above 0 learns")
    given = (reference, period, table, lab, stage / "model.json")
    read = [place for place in given if place is not None]
    check_folder(out, force=force, new=True, inputs=read)
    with shown(quiet=quiet or json) as told:
        told("reading the stage")
        from piezoid.design.design_stage import controller_rate_Hz
        from piezoid.export.parameter_file import from_json
        from piezoid.learning.files import learned_files, read_reference
        from piezoid.learning.learn import learned_from_json
        from piezoid.records.collection import collect
        from piezoid.records.lab import Lab
        from piezoid.sealed_files import read_model
        from piezoid.verbs import learn as learn_table

        declared = lab_of(stage, lab)
        content = content_of(stage / "model.json")
        model = read_model(content, str(stage / "model.json"))
        file = None
        if not open_loop:
            file = from_json(content_of(stage / "params.json"), str(stage / "params.json"))
            same_model(content, file.sources.get("model", ""), "params.json", "piezoid export")
        named = _axis(model, file, axis)
        rate_Hz = (
            controller_rate_Hz(model, None)
            if file is None
            else float(file.axis(named).values["sampling_rate_Hz"])
        )
        wanted_m = read_reference(reference, rate_Hz)
        before = None if table is None else learned_from_json(content_of(table), str(table))
        held = () if period is None else collect([period], declared).recordings
        told("learning the table")
        found = learn_table(
            model,
            wanted_m,
            controller=file,
            axis=named,
            lab=declared,
            before=before,
            period=held[0] if held else None,
            sampling_rate_Hz=rate_Hz,
            gain=gain,
        )
        converter = (declared or Lab()).acquisition
        files = learned_files(found, converter.input_range_V, converter.dac_bits)
        write_folder(out, files, force=force)
    if json:
        hand_over(found.to_json())
    elif not quiet:
        for line in _lines(found, out):
            say(line)


def _axis(model: "ActuatorModel", file: "ParameterFile | None", asked: str | None) -> str:
    """Return the axis that is meant; refuse where that is not one of several."""
    there = list(model.axes) if file is None else [axis.axis for axis in file.axes]
    if asked is None and len(there) == 1:
        return there[0]
    if asked not in there:
        raise typer.BadParameter(
            f"--axis {asked}: there are {', '.join(there)}"
            if asked
            else f"there are {', '.join(there)}: choose one with --axis"
        )
    return asked


def _lines(found: "Learned", out: Path) -> list[str]:
    from piezoid.formatting import with_unit

    lines = [
        f"axis {found.axis}, {with_unit(found.frequency_Hz, 'Hz')}: a period leaves at most "
        f"{found.contraction:.2g} of the error, on plant '{found.worst_plant}'; harmonics up to "
        f"{with_unit(found.learns_to_Hz, 'Hz')} are learnt",
        f"the first table leaves {with_unit(found.model_error_m, 'm')} rms on the identified "
        "plant",
    ]
    if found.errors_m and found.noise_m is not None:
        errors = ", ".join(with_unit(error_m, "m") for error_m in found.errors_m)
        lines.append(f"recorded periods missed by {errors}; noise {with_unit(found.noise_m, 'm')}")
    return [*lines, f"table: {out / found.axis}.csv"]
