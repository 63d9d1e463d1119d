"""`piezoid design`: a fitted stage in, its controllers with proven margins beside it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezoid_cli.terminal import Force, Quiet, StageLab, hand_over, plain, say, table

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from rich.table import Table

    from piezoid.design.certificate import Certificate
    from piezoid.design.design import Design


def design(
    stage: Annotated[Path, typer.Argument(help="Folder that `piezoid fit` wrote.")],
    spec: Annotated[Path | None, typer.Option(help="design.toml: what is asked.")] = None,
    rate: Annotated[
        float | None,
        typer.Option(help="Controller's samples per second, if lab.toml did not say.", min=0.0),
    ] = None,
    lab: StageLab = None,
    force: Force = False,
    quiet: Quiet = False,
    json: Annotated[
        bool, typer.Option("--json", help="For scripts: print design.json itself.")
    ] = False,
) -> None:
    """Design the controllers of a stage: write design.json and design.html beside model.json.

    Exit status 4 means that no controller meets what is asked; the message says which could. Where
    that is so of one axis among several the others are written, and the status is 1.

    [bold]Examples[/bold]

    piezoid design stage42/

    piezoid design stage42/ --rate 20000 --spec design.toml

    piezoid design stage42/ --json | jq .axes[].loops[].bandwidth_Hz
    """
    from json import loads

    from piezoid.design.design_stage import Asked, design_stage
    from piezoid.output_folder import add_to_folder, check_folder
    from piezoid.sealed_files import read_model
    from piezoid_cli.export import show_unshipped
    from piezoid_cli.progress import shown
    from piezoid_cli.stage_files import content_of, lab_of, text_of
    from piezoid_reports.render import render_design

    content = content_of(stage / "model.json")
    model = read_model(content, str(stage / "model.json"))
    asked = None if spec is None else Asked(text=text_of(spec), place=spec.name)
    check_folder(stage, force=force, names=("design.json", "design.html"))
    with shown(quiet=quiet or json) as told:
        found = design_stage(
            model,
            model_digest=loads(content)["digest"],
            sampling_rate_Hz=rate,
            lab=lab_of(stage, lab),
            asked=asked,
            progress=told,
        )
    page = render_design(model, found)
    written = found.to_json()
    pages = {"design.json": written, "design.html": page.encode()}
    add_to_folder(stage, pages, force=force)
    if json:
        hand_over(written)
    elif not quiet:
        show(found)
        show_unshipped(found.refused)
        say(f"design: {stage / 'design.json'}, {stage / 'design.html'}")
    if found.refused:
        raise typer.Exit(1)


def show(
    found: "Design",
    shipped: "Collection[str]" = (),
    ranges_m: "Mapping[str, float] | None" = None,
) -> None:
    """Print what each axis reached.

    shipped   axes whose own verification passed: of no other a bound is told
    ranges_m  displacement range by axis: a bound beyond it is none
    """
    from rich.console import Console

    console = Console()
    console.print(_table(found, shipped, ranges_m or {}))
    for remark in found.remarks:
        console.print(plain(remark, style="dim"))


def _table(
    found: "Design", shipped: "Collection[str]", ranges_m: "Mapping[str, float]"
) -> "Table":
    from math import inf

    from piezoid.formatting import with_unit

    def margin(delay_s: float | None) -> str:
        return "any" if delay_s is None else with_unit(delay_s, "s")

    rows = [
        (
            axis.axis,
            loop.method,
            with_unit(loop.bandwidth_Hz, "Hz"),
            f"{loop.worst_modulus_margin:.3f}",
            margin(loop.worst_delay_margin_s),
            _bound(
                loop.certificate, ranges_m.get(axis.axis, inf), is_verified=axis.axis in shipped
            ),
        )
        for axis in found.axes
        for loop in axis.loops
    ]
    headings = ("axis", "method", "bandwidth", "modulus margin", "delay margin", "guaranteed")
    return table("controllers, worst member of each plant family", headings, rows)


def _bound(proven: "Certificate | None", range_m: float, *, is_verified: bool) -> str:
    from math import isfinite

    from piezoid.formatting import with_unit

    if proven is None or not proven.is_guaranteed or not isfinite(proven.guaranteed_error_m):
        return "no bound"
    if proven.guaranteed_error_m > range_m:
        return "no useful bound: wider than the stroke"
    return with_unit(proven.guaranteed_error_m, "m") if is_verified else "not verified"
