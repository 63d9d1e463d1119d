"""A first look at a drive in chunks: turns and cycles are those of the whole drive."""

import numpy as np
import pytest

from piezoid.identification.streamed.fit_streamed import _Watch


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("cuts", [[], [1, 2, 50, 51, 300, 700]])
def test_turns_and_cycles_do_not_depend_on_chunks_or_on_where_a_drive_begins(
    sign: float, cuts: list[int]
) -> None:
    drive = sign * np.sin(2 * np.pi * 5 * np.linspace(0.0, 1.0, 1000, endpoint=False))
    watch = _Watch([])
    for part in np.split(drive, cuts):
        watch.see(part)
    assert watch.seen == 1000
    assert watch.turns == 10  # a largest and a least value in each of five cycles
    rises = np.count_nonzero((drive[:-1] <= 0.0) & (drive[1:] > 0.0))
    assert watch.cycles == rises
