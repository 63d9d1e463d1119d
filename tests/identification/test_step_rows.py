"""Rows behind steps of the drive count only where their instants within a sample do not matter."""

import numpy as np

from piezoid.identification.extensions.linear_mode import LinearMode, rows_after_steps

STAIRS = np.repeat([0.0, 0.8, -0.4, -0.4, 0.5], 100)  # steps in front of 100, 200 and 400


def test_a_mode_between_the_samples_hides_its_ringing_behind_every_step() -> None:
    mode = LinearMode(frequency_Hz=495.0, quality=5.0)  # a time constant is 1.6 samples of 500 Hz
    rows = rows_after_steps(STAIRS, 500.0, (mode,), min_rows=2)
    np.testing.assert_array_equal(rows, [k + n for k in (100, 200, 400) for n in range(13)])


def test_a_mode_that_the_samples_resolve_hides_nothing() -> None:
    mode = LinearMode(frequency_Hz=495.0, quality=5.0)
    assert not len(rows_after_steps(STAIRS, 20_000.0, (mode,)))
    np.testing.assert_array_equal(
        rows_after_steps(STAIRS, 20_000.0, (mode,), min_rows=2), [100, 101, 200, 201, 400, 401]
    )
    assert not len(
        rows_after_steps(np.sin(np.linspace(0.0, 9.0, 500)), 500.0, (mode,), min_rows=2)
    )
