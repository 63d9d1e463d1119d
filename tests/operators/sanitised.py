"""A pytest plugin: the kernels come from the library that ``SANITISED_KERNELS`` names."""

import importlib.machinery
import os
import sys
from typing import Any

LIBRARY = "SANITISED_KERNELS"


class Sanitised:
    """Hands out that library in place of the installed one."""

    @staticmethod
    def find_spec(name: str, *_: Any) -> importlib.machinery.ModuleSpec | None:
        if name != "piezoid.operators._kernels":
            return None
        place = os.environ[LIBRARY]
        loader = importlib.machinery.ExtensionFileLoader(name, place)
        return importlib.machinery.ModuleSpec(name, loader, origin=place)


sys.meta_path.insert(0, Sanitised)
