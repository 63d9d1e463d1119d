"""The axis a recording is about, and what it lacks to be fitted alone."""

import numpy as np

from piezoid.errors import LabFileError
from piezoid.records.lab import RecordingEntry
from piezoid.records.recording import Channel, Quantity
from piezoid.statement import Statement, finding


def _complete_axes(channels: tuple[Channel, ...]) -> list[str]:
    held = {(c.quantity, c.axis) for c in channels}
    axes = sorted({c.axis for c in channels})
    pair = (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
    return [axis for axis in axes if all((quantity, axis) in held for quantity in pair)]


def own_axis(entry: RecordingEntry, channels: tuple[Channel, ...], place: str) -> str:
    """The axis of the entry, else the one with drive and response that is driven the most."""
    axes = sorted({c.axis for c in channels})
    if entry.axis is not None:
        if entry.axis not in axes:
            raise LabFileError(
                f"{place}: {entry.file} is said to be about axis {entry.axis!r}, its columns are "
                f"of {', '.join(axes)}",
                needed="an axis one of its columns belongs to",
                remedy="Correct the axis, or name the columns.",
            )
        return entry.axis
    complete = _complete_axes(channels)
    spans = {c.axis: float(np.ptp(c.values)) for c in channels if c.quantity is Quantity.VOLTAGE}
    if complete:
        return max(complete, key=lambda axis: spans[axis])
    displaced = [c.axis for c in channels if c.quantity is Quantity.DISPLACEMENT]
    return min(displaced or axes)


def several_axes(entry: RecordingEntry, channels: tuple[Channel, ...]) -> tuple[Statement, ...]:
    """Return a statement where the axis had to be chosen among several."""
    complete = _complete_axes(channels)
    if entry.axis is not None or len(complete) < 2:
        return ()
    own = own_axis(entry, channels, "")
    text = (
        f"drive and response of the axes {', '.join(complete)} are here; taken to be about {own}, "
        "whose drive moves the most, as lab.toml names none"
    )
    return (finding(quantity="several_axes", place="columns", text=text),)


def incomplete(channels: tuple[Channel, ...]) -> tuple[Statement, ...]:
    """Return a statement for each of drive and response that is missing.

    With a reference beside drive and current it is a closed loop, which needs no displacement.
    """
    held = {c.quantity for c in channels}
    if {Quantity.VOLTAGE, Quantity.CURRENT, Quantity.REFERENCE} <= held:
        return ()
    wanted = (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
    return tuple(
        finding(
            quantity="incomplete",
            place="columns",
            text=f"no {quantity.name.lower()} here: alone this recording cannot be fitted",
        )
        for quantity in wanted
        if quantity not in held
    )
