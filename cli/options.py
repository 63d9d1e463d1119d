"""Options that mean the same in every verb."""

from typing import Annotated

import typer

Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]
Force = Annotated[bool, typer.Option("--force", help="Replace what the folder holds.")]
Json = Annotated[bool, typer.Option("--json", help="For scripts: one JSON text.")]
