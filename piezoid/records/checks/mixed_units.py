"""Report recordings in counts of a converter beside recordings in metres or volts."""

from collections.abc import Sequence

from piezoid.records.recording import Quantity, Recording
from piezoid.statement import Statement, finding

_MAX_NAMES = 3


def check_mixed_units(recordings: Sequence[Recording]) -> list[Statement]:
    """Report each recording in counts of a quantity that others have in SI units."""
    statements = []
    for quantity in (Quantity.VOLTAGE, Quantity.DISPLACEMENT):
        channels = [(r.name, c) for r in recordings for c in r.channels if c.quantity is quantity]
        in_si = sorted({name for name, channel in channels if not channel.is_counted})
        in_counts = dict.fromkeys(name for name, channel in channels if channel.is_counted)
        kind, si = quantity.name.lower(), quantity.value
        for name in in_counts if in_si else ():
            text = (
                f"The {kind} of {name} is in counts, that of {', '.join(in_si[:_MAX_NAMES])} in "
                f"{si}: they cannot be compared. Write scale = {{ {kind} = ... }}, {si} per "
                "count, into its [[recording]]."
            )
            statements.append(finding("mixed_units", text, recording=name))
    return statements
