"""Report recordings that duplicate another one.

A copy differs only in its digits or its unit; two recordings of one drive differ by the noise. A
part of a file, or an overlapping export, has common rows with it.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from piezoid.numerics.arrays import Array, runs_of
from piezoid.records.recording import Recording
from piezoid.records.sample_statistics import noise_rms
from piezoid.statement import Statement, finding

MAX_DIFFERENCE = 0.3  # standard deviations of the noise; two recordings differ by 1.4
MIN_ROWS = 100  # noisy readings do not agree in so many rows by chance
MIN_SHARED = 0.5  # of the rows of the shorter recording, which is then left out
SAME_DRIVE = 1e-3  # rms of the difference of the standardised drives
_FIRST_SAMPLES = 1000  # compared before all samples are


def check_copies(recordings: Sequence[Recording]) -> list[Statement]:
    """Report each recording that is a copy or a part of another one."""
    return [
        finding("copy", f"{copy} holds samples of {original} and is left out.", recording=copy)
        for copy, original in copies(recordings).items()
    ]


def copies(recordings: Sequence[Recording]) -> dict[str, str]:
    """Return the name of the original by the name of each copy.

    The copy is the later of two equal recordings, or the shorter of two recordings that share half
    of its rows.
    """
    original_of: dict[str, str] = {}
    for first, second in combinations(recordings, 2):
        if first.name in original_of or first.name == second.name:
            continue
        if is_copy(first, second):
            original_of.setdefault(second.name, first.name)
            continue
        longer, shorter = (first, second) if first.samples >= second.samples else (second, first)
        if shared_rows(longer, shorter) >= MIN_SHARED * shorter.samples:
            original_of.setdefault(shorter.name, longer.name)
    return original_of


def shared_rows(first: Recording, second: Recording) -> int:
    """Return the number of successive rows of two recordings that agree.

    The rows are compared at the offset at which most single rows agree. The result is 0 for fewer
    than ``MIN_ROWS`` rows, and without a drive or a displacement.
    """
    if first.axis != second.axis or not all(
        first.axis in recording.complete_axes for recording in (first, second)
    ):
        return 0
    rows = [
        np.stack([r.voltage_V(r.axis), r.displacement_m(r.axis)], axis=1) for r in (first, second)
    ]
    keys = [np.ascontiguousarray(values).view(np.complex128).ravel() for values in rows]
    unique, position = np.unique(keys[0], return_index=True)
    index = np.minimum(np.searchsorted(unique, keys[1]), len(unique) - 1)
    matches = np.flatnonzero(unique[index] == keys[1])
    if len(matches) < MIN_ROWS:
        return 0
    offsets, counts = np.unique(position[index[matches]] - matches, return_counts=True)
    offset = int(offsets[np.argmax(counts)])
    start, stop = max(0, -offset), min(len(keys[1]), len(keys[0]) - offset)
    equal = keys[0][start + offset : stop + offset] == keys[1][start:stop]
    count = max(stop - start for start, stop in runs_of(equal))
    return count if count >= MIN_ROWS else 0


def is_copy(first: Recording, second: Recording) -> bool:
    """Return whether two recordings have the same samples, in any unit."""
    axis = first.axis
    kinds = [{(c.quantity, c.axis) for c in r.channels} for r in (first, second)]
    if first.samples != second.samples or kinds[0] != kinds[1] or axis not in first.complete_axes:
        return False
    for step in (max(first.samples // _FIRST_SAMPLES, 1), 1):
        if _rms_difference(*(r.voltage_V(axis)[::step] for r in (first, second))) > SAME_DRIVE:
            return False
    displacements = [r.displacement_m(axis) for r in (first, second)]
    spreads = [float(values.std()) for values in displacements]
    if not min(spreads) > 0.0:
        return False
    decades = np.log10(spreads[0] / spreads[1])  # another unit is a whole power of ten
    if abs(decades - np.round(decades)) > SAME_DRIVE:
        return False
    difference = _rms_difference(*displacements)
    return difference <= MAX_DIFFERENCE * noise_rms(displacements[0]) / spreads[0]


def _rms_difference(*signals: Array) -> float:
    """Return the rms of the difference of two signals, each scaled to mean 0 and rms 1."""
    first, second = (
        (values - values.mean()) / (spread if (spread := float(values.std())) > 0 else 1.0)
        for values in signals
    )
    return float(np.sqrt(np.mean((first - second) ** 2)))
