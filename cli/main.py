"""`piezoid`: the list of its verbs, and the conversion of errors to messages."""

from piezoid_cli.interrupt import install, interruptible

if __name__ == "__main__":
    install()

import os
import sys
from typing import Annotated, Any, cast

import typer
from typer.core import TyperGroup

# Matrices are small: more threads of linear algebra cost time and change the last digits.
os.environ.update(
    dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
)

from piezoid.errors import printable
from piezoid_cli.batch import batch
from piezoid_cli.demo import demo
from piezoid_cli.design import design
from piezoid_cli.diagnose import diagnose
from piezoid_cli.export import export
from piezoid_cli.fit import fit
from piezoid_cli.init import init
from piezoid_cli.inspect import inspect
from piezoid_cli.learn import learn
from piezoid_cli.plan import plan
from piezoid_cli.report import report
from piezoid_cli.simulate import simulate
from piezoid_cli.terminal import VERBOSE, guard_output, rich_text, say
from piezoid_cli.verify import verify

VERBOSE_OPTIONS = ("-v", "--verbose")
USAGE = 2

# Base class of all usage errors; typer exports only this sub-class of it.
_UsageError = cast(type[typer.BadParameter], typer.BadParameter.__base__)

_OUT_OF_MEMORY = (
    "out of memory. Needed: memory for all recordings, about 1 kB for each sample of a fit. Fit "
    "them with --stream, which reads in chunks, or select a part of them with start_s and stop_s "
    "in lab.toml."
)

VERBS = (
    *(inspect, init, fit, diagnose, plan, design, export, verify, learn, report, simulate),
    *(batch, demo),
)


class Verbs(TyperGroup):
    """Group of the verbs; usage errors show arguments, such as names of files, as text."""

    def invoke(self, ctx: Any) -> Any:
        """Run a verb; a folder that may not be written is a usage error."""
        try:
            return super().invoke(ctx)
        except _UsageError as error:
            error.message = printable(error.message)
            raise
        except Exception as error:
            if getattr(error, "exit_status", 0) != USAGE:
                raise
            raise _UsageError(printable(str(error)), ctx) from error

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the verb of a name, or list all verbs if it does not exist."""
        from difflib import get_close_matches

        if args and not args[0].startswith("-") and args[0] not in self.commands:
            matches = get_close_matches(args[0], self.commands, n=1)
            remedy = f"Did you mean {matches[0]}?" if matches else "See piezoid --help."
            raise _UsageError(
                f"there is no command {args[0]!r}. Needed: one of {', '.join(self.commands)}. "
                f"{remedy}",
                ctx,
            )
        return super().resolve_command(ctx, args)


app = typer.Typer(
    name="piezoid",
    cls=Verbs,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
for verb in VERBS:
    app.command()(verb)


def _show_version(is_requested: bool) -> None:
    if is_requested:
        from piezoid import __version__

        say(f"piezoid {__version__}")
        raise typer.Exit


@app.callback()
def piezoid(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_show_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    """Turn recordings of a piezo stage into a calibrated, verified controller.

    [bold]Typical use[/bold]: check the files, draft lab.toml, complete it, calibrate:

    piezoid inspect sweep.csv check.csv

    piezoid init sweep.csv check.csv

    piezoid fit sweep.csv check.csv --lab lab.toml --out stage42/

    Then open stage42/report.html and compile stage42/bundle/. Each command has examples, as in
    piezoid fit --help

    Options of every command: -v, --verbose logs each step with its elapsed time; --debug adds a
    traceback to errors.

    Exit status: 0 success, 1 a verdict failed, 2 wrong usage, 3 unusable data or file, 4 no
    solution, 70 internal error, 130 interrupted.
    """


def main() -> None:
    """Run the command line; print an error as one message and set the exit status."""
    arguments = [word for word in sys.argv[1:] if word not in ("--debug", *VERBOSE_OPTIONS)]
    if set(sys.argv[1:]) & set(VERBOSE_OPTIONS):
        VERBOSE.set(True)
    install()
    guard_output()
    try:
        with interruptible():
            try:
                app(arguments)
            finally:
                sys.stdout.flush()
    except Exception as error:
        if "--debug" in sys.argv[1:]:
            raise
        from rich.console import Console
        from rich.text import Text

        from piezoid.errors import PiezoidError

        if isinstance(error, PiezoidError):
            status, message = error.exit_status, str(error)
        elif isinstance(error, OSError):
            status, problem = 3, f"{error.filename or 'a file'}: {error.strerror or error}"
            message = (
                f"{problem}. Needed: a file or folder that this command can read and write. Check "
                "its name, its permissions and the free disk space."
            )
        elif isinstance(error, MemoryError):
            status, message = 3, _OUT_OF_MEMORY
        else:
            status, problem = 70, f"internal error ({type(error).__name__}: {error})"
            message = (
                f"{problem}. Please report it with the output of the same command with --debug."
            )
        text = Text.assemble(("error: ", "bold red"), rich_text(message))
        Console(stderr=True).print(text)
        sys.exit(status)


if __name__ == "__main__":
    main()
