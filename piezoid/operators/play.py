"""The play operator: banks of plays along a drive, and thinning of drives."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous

Indices = NDArray[np.intp]

BLOCK = 1 << 15  # rows; some megabytes for a bank of plays


def turns_of(drive: Array) -> NDArray[np.bool_]:
    """Return which samples of a drive are the first sample or a reversal, (samples,)."""
    moves = np.flatnonzero(np.diff(drive))
    up = drive[moves + 1] > drive[moves]
    is_turn = np.zeros(len(drive), dtype=bool)
    is_turn[:1] = is_turn[moves[np.flatnonzero(up[1:] != up[:-1]) + 1]] = True
    return is_turn


def thinned_drive(
    drive: Array,
    samples: Indices,
    *,
    with_previous: bool = False,
    turns: NDArray[np.bool_] | None = None,
) -> tuple[Array, Indices]:
    """Thin a drive to its reversals and some samples; also return the new indices of the samples.

    samples        (rows,)     in increasing order
    with_previous  whether to keep the sample before each of them as well
    turns          (samples,)  ``turns_of`` the drive, if known
    returned       (kept,)     first sample, reversals and samples; (rows,) indices of the samples

    The states of plays at these samples do not change, to the last bit.
    """
    is_kept = turns_of(drive) if turns is None else turns.copy()
    is_kept[samples] = True
    if with_previous:
        is_kept[np.maximum(samples - 1, 0)] = True
    return drive[is_kept], (np.cumsum(is_kept) - 1)[samples]


def play_columns(voltage_V: Array, threshold_V: Array, memory_V: Array) -> tuple[Array, Array]:
    """Return the states of a bank of plays of half-widths ``threshold_V`` along a voltage.

        z_i[k] = max(u[k] - r_i, min(u[k] + r_i, z_i[k-1]))           [Kuhnen 2003]

    u      voltage_V    (samples,)        V
    r      threshold_V  (plays,)          V, >= 0; r = 0 returns u
    z(-1)  memory_V     (plays,)          V, before the first sample
    z      returned     (samples, plays)  V, column-major
    z(end) returned     (plays,)          V, the memory before the next chunk

    The thresholds are half-widths, as in Kuhnen's papers; a dead band is 2 r.
    """
    u = contiguous(voltage_V)
    state = np.array(memory_V, dtype=np.float64)
    columns = np.empty((len(u), len(state)), order="F")
    KERNELS.pk_play_columns(
        len(u),
        address(u),
        len(state),
        address(contiguous(threshold_V)),
        address(state),
        len(u),
        address(columns),
    )
    return columns, state


def play_blocks(
    voltage_V: Array, threshold_V: Array, memory_V: Array, rows: int = BLOCK
) -> Iterator[tuple[int, Array]]:
    """Yield first row and states of the plays block by block, to limit the memory.

    The states, (rows, plays), are identical to those of ``play_columns``.
    """
    for first in range(0, len(voltage_V), rows):
        states, memory_V = play_columns(voltage_V[first : first + rows], threshold_V, memory_V)
        yield first, states


def forgetting_sample(voltage_V: Array, threshold_V: Array) -> Array:
    """Return, for each play, the first sample at which its initial state no longer matters.

    A play forgets its initial state when the running range of the input reaches 2 r.

    voltage_V    (samples,)  V
    threshold_V  (plays,)    V
    returned     (plays,)    sample index as float; the number of samples if it never does
    """
    span_V = np.maximum.accumulate(voltage_V) - np.minimum.accumulate(voltage_V)
    return np.searchsorted(span_V, 2 * threshold_V, side="left").astype(np.float64)
