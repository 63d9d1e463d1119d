"""Limits that somebody writes down: a file of their own, or ``[verification]`` of lab.toml."""

import sys
from collections.abc import Mapping
from dataclasses import fields, replace
from reprlib import repr as short

from piezoid.errors import LabFileError
from piezoid.toml_text import read_toml
from piezoid.verification.criteria import Limits


def limits_from_toml(text: str, place: str = "limits.toml") -> Limits:
    """Return the default limits with those of a TOML text in their place.

        aligned_percent = 0.5
        judged_Hz = 20

    Raises ``LabFileError`` as ``limits_from`` does, and for text that is not TOML.
    """
    try:
        table = read_toml(text)
    except ValueError as fault:
        raise _unusable(place, f"not TOML: {fault}", "correct TOML") from fault
    return limits_from(table, place)


def limits_from(table: Mapping[str, object], place: str) -> Limits:
    """Return the default limits with those of a table in their place.

    table  by the names of ``Limits``
    place  where it was read, for the message

    Raises ``LabFileError`` for an unknown name and for anything but a positive number.
    """
    known = [field.name for field in fields(Limits)]
    given: dict[str, float] = {}
    for name, value in table.items():
        if name not in known:
            raise _unusable(place, f"unknown limit {short(name)}", "one of " + ", ".join(known))
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise _unusable(place, f"{name} is {short(value)}", "a number")
        if not 0 < value <= sys.float_info.max:
            raise _unusable(place, f"{name} is {short(value)}", "a finite number above zero")
        given[name] = float(value)
    return replace(Limits(), **given)


def _unusable(place: str, found: str, needed: str) -> LabFileError:
    return LabFileError(
        f"{place}: {found}", needed=needed, remedy=f"Correct {place} and verify again."
    )
