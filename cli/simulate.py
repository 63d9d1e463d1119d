"""`piezoid simulate`: simulate recordings of a virtual stage with known effects."""

from pathlib import Path
from typing import Annotated

import typer

from piezoid_cli.options import Force, Json, Quiet
from piezoid_cli.terminal import print_record, say, show_progress


def simulate(
    out: Annotated[Path, typer.Option(help="Folder for recordings/ and truth/.")],
    seed: Annotated[int, typer.Option(min=0, help="Random seed.")] = 0,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            help="Add this effect; creep=0.8 sets its size in percent of stroke. Repeatable.",
            metavar="NAME[=PERCENT]",
        ),
    ] = None,
    truth: Annotated[
        str | None, typer.Option(help="Type of ceramic; default: random, from the seed.")
    ] = None,
    recording: Annotated[
        list[str] | None,
        typer.Option(help="Record this drive. Repeatable; default: chosen for the effects."),
    ] = None,
    careless: Annotated[
        bool,
        typer.Option(
            "--careless", help="Do not cycle the drive before recording: unknown initial state."
        ),
    ] = False,
    junction: Annotated[
        float | None,
        typer.Option(
            help="Record a tunnelling tip in closed loop instead, with this duration per spot.",
            metavar="SECONDS",
        ),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Simulate recordings of a virtual stage: CSV files, a lab.toml, and the true parameters.

    For an unknown effect, drive or ceramic, the error lists the available names. The simulator
    shares no code with the model.

    [bold]Examples[/bold]

    piezoid simulate --out virtual/ --seed 7

    piezoid simulate --out virtual/ --seed 7 --effect creep --effect slew_limit=0.6

    piezoid simulate --out tip/ --seed 7 --junction 4 --json
    """
    from piezoid.output_folder import check_folder, write_folder
    from piezoid_datasets.virtual_lab.campaign import draw_campaign
    from piezoid_datasets.virtual_lab.junction_campaign import (
        draw_junction_campaign,
        junction_files,
    )
    from piezoid_datasets.virtual_lab.write import campaign_files

    check_folder(out, force=force, new=True)
    if junction is not None and (effect or truth or recording or careless):
        raise typer.BadParameter(
            "--junction records a tip; it excludes --effect, --truth, --recording and --careless"
        )
    sizes: dict[str, float | None] = {}  # percent of the stroke
    for text in effect or ():
        name, equals, percent = text.partition("=")
        try:
            sizes[name] = float(percent) if equals else None
        except ValueError:
            raise typer.BadParameter(
                f"--effect {text}: {percent!r} is not a number; write the size in percent of the "
                f"stroke, as in {name}=0.8"
            ) from None
    with show_progress(quiet=quiet or json) as progress:
        progress(f"simulating the virtual {'stage' if junction is None else 'tip'}")
        try:
            if junction is None:
                campaign = draw_campaign(
                    seed, effects=sizes, truth=truth, plans=recording, careless=careless
                )
                files = campaign_files(campaign)
                lines = [
                    f"{out / 'recordings' / rows.run.name}.csv: {len(rows.time_s)} rows at "
                    f"{rows.run.sampling_rate_Hz:g} Hz"
                    for rows in campaign.recordings
                ]
                answer = campaign.answer
                hidden = ", ".join(effect.name for effect in answer.effects) or "nothing"
                lines.append(
                    f"{out / 'truth' / 'truth.json'}: {answer.truth} ceramic, hidden effects: "
                    f"{hidden}"
                )
            else:
                files = junction_files(draw_junction_campaign(seed, seconds=junction))
                lines = [str(out / name) for name in files]
        except ValueError as error:
            raise typer.BadParameter(str(error)) from error
        write_folder(out, files, force=force)
    if json:
        print_record("simulated", seed=seed, files=list(files))
    elif not quiet:
        for line in lines:
            say(line)
