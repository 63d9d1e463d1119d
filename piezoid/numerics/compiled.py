"""The package's own compiled modules, opened with ctypes."""

import ctypes
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from typing import Any

from piezoid.errors import RuntimeLibraryError

Signatures = Mapping[str, tuple[Any, tuple[Any, ...] | None]]  # what a function returns and takes


def opened(name: str, signatures: Signatures) -> ctypes.CDLL:
    """Open a compiled module of the package and declare its functions.

    name        as it is imported
    signatures  by function; arguments of None are not declared

    Raises ``RuntimeLibraryError`` where the installation compiled none.
    """
    code = _opened(name)
    for function, (answer, arguments) in signatures.items():
        getattr(code, function).restype = answer
        if arguments is not None:
            getattr(code, function).argtypes = arguments
    return code


@cache
def _opened(name: str) -> ctypes.CDLL:
    module = find_spec(name)
    if module is None or module.origin is None:
        raise RuntimeLibraryError(
            f"the compiled module {name} is not beside the package",
            needed="an installation that compiled it",
            remedy="Install piezoid with a C compiler present: pip install .",
        )
    return ctypes.CDLL(module.origin)
