"""What is being done and for how long, shown while a verb works."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from piezoid_cli.terminal import doing, one_line


@contextmanager
def shown(*, quiet: bool) -> Iterator[Callable[[str], None]]:
    """Show what is being done and for how long, on a terminal only."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), doing(), TimeElapsedColumn())
    console = Console(stderr=True, quiet=quiet)
    hidden = quiet or not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as progress:
        task = progress.add_task("starting", total=None)

        def told(text: str) -> None:
            progress.update(task, description=one_line(text))

        yield told
