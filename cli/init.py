"""`piezoid init`: draft a lab.toml from recordings."""

from pathlib import Path
from typing import Annotated

import typer

from piezoid_cli.options import Json, Quiet
from piezoid_cli.terminal import print_record, say, show_progress


def init(
    files: Annotated[list[Path], typer.Argument(help="Recordings of one stage, any number.")],
    out: Annotated[Path, typer.Option(help="The file to write.")] = Path("lab.toml"),
    force: Annotated[
        bool, typer.Option("--force", help="Replace a file that this command wrote.")
    ] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Show the contents of recordings and write a commented lab.toml for them.

    Every readable file becomes an entry. Values of amplifier, sensor and controller are comments
    to complete.

    Exit status 3 means that an entry must be completed before its file can be used; lab.toml is
    still written, with the reason above the entry.

    [bold]Examples[/bold]

    piezoid init sweep.csv check.csv

    piezoid init data/*.csv --out data/lab.toml

    piezoid init data/*.csv --out data/lab.toml --json | jq .incomplete[]
    """
    from piezoid.output_folder import write_file
    from piezoid.records.inspection import inspect_files
    from piezoid.records.lab_draft import HEAD, draft_lab
    from piezoid_cli.inspect import show

    opening = HEAD.partition("\n")[0].encode()
    write_file(out, b"", opening=opening, force=force, only_check=True)
    for file in files:
        file.stat()
    with show_progress(quiet=quiet or json) as progress:
        progress("reading recordings")
        inspections = inspect_files(files)
        draft = draft_lab(files, out.parent)
    if not (quiet or json):
        show(inspections)
    write_file(out, draft.text.encode(), opening=opening, force=force)
    if json:
        print_record("drafted", file=str(out), incomplete=list(draft.incomplete))
    elif not quiet:
        title = "written, but incomplete" if draft.incomplete else "written"
        say(f"{title}: {out}; complete it, then pass it with --lab {out}")
    if draft.incomplete:
        names = ", ".join(draft.incomplete)
        say(f"to complete in {out} before it can be used: the entries of {names}", err=True)
        raise typer.Exit(3)
