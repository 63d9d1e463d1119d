"""Rows that two recordings share: a part of a file saved twice, or two exports that overlap."""

from dataclasses import dataclass

import numpy as np

from piezoid.records.recording import Recording

MIN_ROWS = 100  # readings with noise in their digits do not agree in so many rows by chance


@dataclass(frozen=True, kw_only=True)
class SharedRows:
    """The longest run of equal rows of two recordings.

    first_start, second_start  its first row in each
    count                      its rows
    """

    first_start: int
    second_start: int
    count: int


def shared_rows(first: Recording, second: Recording) -> SharedRows | None:
    """Return the longest run of rows in which drive and displacement of two recordings agree.

    The rows are compared at the offset at which most single rows agree. None where fewer than
    ``MIN_ROWS`` rows in succession agree, or where one has no drive or displacement.
    """
    if first.axis != second.axis or not all(
        first.axis in recording.complete_axes for recording in (first, second)
    ):
        return None
    rows = [
        np.stack([r.voltage_V(r.axis), r.displacement_m(r.axis)], axis=1) for r in (first, second)
    ]
    keys = [np.ascontiguousarray(values).view(np.complex128).ravel() for values in rows]
    unique, place = np.unique(keys[0], return_index=True)
    index = np.minimum(np.searchsorted(unique, keys[1]), len(unique) - 1)
    matches = np.flatnonzero(unique[index] == keys[1])
    if len(matches) < MIN_ROWS:
        return None
    offsets, counts = np.unique(place[index[matches]] - matches, return_counts=True)
    offset = int(offsets[np.argmax(counts)])
    start, stop = max(0, -offset), min(len(keys[1]), len(keys[0]) - offset)
    equal = keys[0][start + offset : stop + offset] == keys[1][start:stop]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], equal.astype(np.int8), [0]])))
    begins, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - begins))
    count = int(ends[longest] - begins[longest])
    if count < MIN_ROWS:
        return None
    begin = start + int(begins[longest])
    return SharedRows(first_start=begin + offset, second_start=begin, count=count)
