"""Compiled modules of the package, opened with ctypes."""

import ctypes
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

from piezoid.errors import RuntimeLibraryError

Signatures = Mapping[str, tuple[Any, tuple[Any, ...] | None]]  # types of result and arguments


def opened(name: str, signatures: Signatures) -> ctypes.CDLL:
    """Open a compiled module of the package and declare its functions.

    name        import name
    signatures  by function; arguments of None are not declared

    Raises ``RuntimeLibraryError`` if the installation does not contain the module.
    """
    module = find_spec(name)
    if module is None or module.origin is None:
        raise RuntimeLibraryError(
            f"the package does not contain the compiled module {name}",
            needed="an installation that compiled it",
            remedy="Install piezoid with a C compiler present: pip install .",
        )
    library = ctypes.CDLL(module.origin)
    for function, (result, arguments) in signatures.items():
        getattr(library, function).restype = result
        if arguments is not None:
            getattr(library, function).argtypes = arguments
    return library
