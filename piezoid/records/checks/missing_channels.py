"""Report a recording without a drive or a displacement, which cannot be fitted alone."""

from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording
from piezoid.statement import Statement, finding

_CLOSED_LOOP = {Quantity.VOLTAGE, Quantity.CURRENT, Quantity.REFERENCE}


def check_missing_channels(recording: Recording, _lab: Lab) -> list[Statement]:
    """Report a missing drive and a missing displacement.

    A closed tunnelling loop (drive, current and reference) needs no displacement.
    """
    recorded = {channel.quantity for channel in recording.channels}
    if recorded >= _CLOSED_LOOP:
        return []
    return [
        finding(
            "incomplete",
            f"No {quantity.name.lower()} is recorded; this recording cannot be fitted alone.",
            place="columns",
        )
        for quantity in (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
        if quantity not in recorded
    ]
