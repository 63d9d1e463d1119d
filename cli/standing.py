"""The folder somebody stands in while a verb puts the finished one in its place.

A folder of results is exchanged whole, so that nobody ever sees half of one. A shell that stands
in it then stands in the folder of before, which is gone: it lists nothing until it enters again.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def standing(*, quiet: bool) -> Iterator[None]:
    """Begin in the folder the shell names, and say at the end where it must be entered again."""
    name = os.environ.get("PWD", "")
    with suppress(OSError):
        if name and not _is_there():
            os.chdir(name)  # an earlier verb of the same line has replaced it
    with suppress(OSError):
        name = name if name and os.path.samefile(name, ".") else os.getcwd()
    try:
        yield
    finally:
        if not quiet and name and _is_another(name):
            sys.stderr.write("this folder was replaced by the finished one: `cd .` enters it\n")


def _is_there() -> bool:
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True


def _is_another(name: str) -> bool:
    try:
        return not os.path.samefile(name, ".")
    except OSError:
        return False
