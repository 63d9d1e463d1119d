"""The one way up: methods of records that a floor above them carries out, loaded when called.

``model.plot()`` belongs to a model for whoever uses it, and matplotlib to a floor that no
computation may know. Only methods of that kind ask here; whatever computes imports downwards.
"""

from importlib import import_module
from typing import Any


def upstairs(module: str) -> Any:
    """Return a module of a floor above, such as ``figures``."""
    return import_module(f"piezoid.{module}")
