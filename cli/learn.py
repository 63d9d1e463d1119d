"""`piezoid learn`: compute or refine the feedforward table of a periodic motion."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezoid_cli.options import Force, JsonFile, Quiet, StageLab
from piezoid_cli.terminal import print_raw, say, show_progress

if TYPE_CHECKING:
    from piezoid.learning.learn import Learned


def learn(
    stage: Annotated[Path, typer.Argument(help="Folder with model.json and params.json.")],
    reference: Annotated[
        Path, typer.Option(help="One period of the motion: displacement, one row per sample.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the table.")],
    period: Annotated[
        Path | None, typer.Option(help="Recorded motion, starting at point 0 of a period.")
    ] = None,
    table: Annotated[
        Path | None, typer.Option(help="learning.json of the table that --period recorded.")
    ] = None,
    axis: Annotated[str | None, typer.Option(help="Axis; default: the only one.")] = None,
    open_loop: Annotated[
        bool, typer.Option("--open-loop", help="For a drive without a controller.")
    ] = False,
    gain: Annotated[
        float, typer.Option(help="Learning gain; 1 is optimal for the worst plant.", min=0.0)
    ] = 1.0,
    lab: StageLab = None,
    force: Force = False,
    quiet: Quiet = False,
    json: JsonFile = False,
) -> None:
    """Learn the feedforward of a periodic motion: write learning.json and the table to play.

    Without --period the table is computed from the model; with --period, an earlier table is
    refined. Exit status 4 means that learning does not converge for every plant of the family.

    [bold]Examples[/bold]

    piezoid learn stage42/ --reference scan.csv --out a/

    piezoid learn stage42/ --reference scan.csv --table a/learning.json --period seen.csv --out b/

    piezoid learn stage42/ --reference scan.csv --open-loop --axis x --out wave/
    """
    from piezoid.output_folder import check_folder, write_folder
    from piezoid_cli.stage_files import StageFolder, content_of

    if (period is None) != (table is None):
        raise typer.BadParameter("--period and --table must be given together")
    if not gain > 0.0:
        raise typer.BadParameter(f"--gain {gain:g}: the gain must be above 0")
    inputs = [path for path in (reference, period, table, lab, stage / "model.json") if path]
    check_folder(out, force=force, new=True, inputs=inputs)
    with show_progress(quiet=quiet or json) as progress:
        progress("reading the stage")
        from piezoid.control_verbs import learn as learn_table
        from piezoid.design.design_stage import controller_rate_Hz
        from piezoid.learning.files import learned_files, read_reference
        from piezoid.learning.learn import learned_from_json
        from piezoid.records.collection import collect
        from piezoid.records.lab import Lab

        folder = StageFolder(stage, lab)
        declared, model = folder.lab, folder.model
        controller = None if open_loop else folder.parameters
        if controller is None:
            selected = _select_axis(list(model.axes), axis)
            rate_Hz = controller_rate_Hz(model, None)
        else:
            selected = _select_axis([parameters.axis for parameters in controller.axes], axis)
            rate_Hz = controller.axis(selected).sampling_rate_Hz
        reference_m = read_reference(reference, rate_Hz)
        previous = None if table is None else learned_from_json(content_of(table), str(table))
        recordings = () if period is None else collect([period], declared).recordings
        progress("learning the table")
        learned = learn_table(
            model,
            reference_m,
            controller=controller,
            axis=selected,
            lab=declared,
            previous=previous,
            period=recordings[0] if recordings else None,
            sampling_rate_Hz=rate_Hz,
            gain=gain,
        )
        converter = (declared or Lab()).acquisition
        files = learned_files(learned, converter.input_range_V, converter.dac_bits)
        write_folder(out, files, force=force)
    if json:
        print_raw(learned.to_json())
    elif not quiet:
        for line in _lines(learned, out, files):
            say(line)


def _select_axis(axes: list[str], requested: str | None) -> str:
    if requested is None and len(axes) == 1:
        return axes[0]
    if requested not in axes:
        raise typer.BadParameter(
            f"--axis {requested}: the axes are {', '.join(axes)}"
            if requested
            else f"the axes are {', '.join(axes)}: choose one with --axis"
        )
    return requested


def _lines(learned: "Learned", out: Path, files: Iterable[str]) -> list[str]:
    from piezoid.formatting import with_unit

    lines = [
        f"axis {learned.axis}, period of {with_unit(learned.frequency_Hz, 'Hz')}: each recorded "
        f"period multiplies the error by at most {learned.contraction:.2g}, up to "
        f"{with_unit(learned.learns_to_Hz, 'Hz')} (worst plant: {learned.worst_plant})",
        f"simulated error of the first table: {with_unit(learned.model_error_m, 'm')} rms on the "
        "identified plant",
    ]
    if learned.errors_m and learned.noise_m is not None:
        errors = ", ".join(with_unit(error_m, "m") for error_m in learned.errors_m)
        noise = with_unit(learned.noise_m, "m")
        lines.append(f"recorded errors, oldest first: {errors} rms; latest noise: {noise} rms")
    return [
        *lines,
        f"table: {', '.join(str(out / name) for name in files)}",
        f"next: play the table, record the settled motion starting at point 0, and run again with "
        f"--table {out / 'learning.json'} --period FILE",
    ]
