"""Copy, check and freeze the arrays of records."""

from cmath import isfinite
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Samples = NDArray[np.int_]  # numbers of samples or rows


def frozen(values: ArrayLike, name: str, *, ndim: int = 1, dtype: DTypeLike = np.float64) -> Array:
    """Return a read-only, C-contiguous copy of finite values.

    values  anything array-like
    name    the field it becomes, for the message
    ndim    the number of axes it must have
    dtype   of the copy

    Raises ``ValueError`` naming the first value that is not finite.
    """
    array = np.array(values, dtype=dtype, order="C", copy=True)
    if array.ndim != ndim:
        raise ValueError(f"{name} has {array.ndim} axes, expected {ndim}")
    # If the sum of squares is finite, so are all values; this takes a third of the time.
    if not (isfinite(np.vdot(array, array)) or np.isfinite(array).all()):
        index = int(np.flatnonzero(~np.isfinite(array.ravel()))[0])
        raise ValueError(f"{name}[{index}] is {array.ravel()[index]}, expected finite numbers")
    array.setflags(write=False)
    return array


def freeze(record: object, *names: str, ndim: int = 1, dtype: DTypeLike = np.float64) -> None:
    """Replace array fields of a frozen record by read-only copies; see ``frozen``."""
    for name in names:
        copy = frozen(getattr(record, name), name, ndim=ndim, dtype=dtype)
        object.__setattr__(record, name, copy)


def runs_of(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and stop of each run of true values.

    >>> runs_of(np.array([True, True, False, True]))
    [(0, 2), (3, 4)]
    """
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def spread_rows(samples: int, max_rows: int) -> NDArray[np.intp]:
    """Select at most ``max_rows`` rows, evenly distributed on average but at random distances.

    Rows at a constant distance would alias a hum of the grid.

    >>> len(spread_rows(1000, 100)), spread_rows(3, 100).tolist()
    (100, [0, 1, 2])
    """
    if samples <= max_rows:
        return np.arange(samples)
    spread = np.random.default_rng(samples).random(max_rows)
    return np.unique(((np.arange(max_rows) + spread) * (samples / max_rows)).astype(np.intp))


def expect_shapes(record: object, expected: Mapping[str, tuple[int, ...]]) -> None:
    """Raise ``ValueError`` naming the first field whose array has another shape."""
    for name, shape in expected.items():
        if (actual := getattr(record, name).shape) != shape:
            raise ValueError(f"{name} has shape {actual}, expected {shape}")


def same_length(arrays: Sequence[tuple[str, Array]]) -> None:
    """Raise ``ValueError`` unless all arrays have as many rows as the first."""
    first, reference = arrays[0]
    for name, array in arrays[1:]:
        if len(array) != len(reference):
            raise ValueError(f"{name} has {len(array)} values, {first} has {len(reference)}")


def strictly_increasing(array: Array, name: str) -> None:
    """Raise ``ValueError`` naming the first index where ``array`` does not increase."""
    increases = array[1:] > array[:-1]  # not np.diff, which rounds to zero for large numbers
    if not increases.all():
        index = int(np.flatnonzero(~increases)[0])
        raise ValueError(
            f"{name} does not increase: [{index}] = {array[index]}, [{index + 1}] = "
            f"{array[index + 1]}"
        )
