"""Report recordings a thousand times slower than others: times in milliseconds read as seconds."""

from collections.abc import Sequence

from piezoid.records.recording import Recording
from piezoid.statement import Statement, finding

_TOLERANCE = 0.03  # relative
_MAX_NAMES = 3


def check_sampling_rates(recordings: Sequence[Recording]) -> list[Statement]:
    """Report each recording beside which others of its axis are sampled 1000 times as fast."""
    statements = []
    for slow in recordings:
        fast = [
            other.name
            for other in recordings
            if other.axis == slow.axis
            and abs(other.sampling_rate_Hz / slow.sampling_rate_Hz / 1000 - 1) < _TOLERANCE
        ]
        if fast:
            more = f" and {len(fast) - _MAX_NAMES} others" if len(fast) > _MAX_NAMES else ""
            text = (
                f"{slow.name} is sampled at {slow.sampling_rate_Hz:.9g} Hz, "
                f"{', '.join(fast[:_MAX_NAMES])}{more} a thousand times as fast. Check whether "
                "the times of one are in milliseconds."
            )
            statements.append(finding(quantity="sampling_rate", recording=slow.name, text=text))
    return statements
