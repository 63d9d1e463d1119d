"""The one way up: what a record needs of a floor above it, loaded when called.

``model.plot()`` belongs to a model for whoever uses it, and matplotlib to a floor that no
computation may know; a model's file may hold an extension that the file of an effect defines. Only
records and their files ask here; whatever computes imports downwards.
"""

from importlib import import_module
from typing import Any


def upstairs(module: str) -> Any:
    """Return a module of a floor above, such as ``figures``."""
    return import_module(f"piezoid.{module}")
