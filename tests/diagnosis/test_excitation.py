"""Multisines: the spectrum they promise; a drive comes back exactly from its file."""

import numpy as np
import pytest

from piezoid.diagnosis.planning.candidate_drives import EXPERIMENTS, drive_of
from piezoid.diagnosis.planning.drive_limits import Bench, Drive, DriveLimits
from piezoid.diagnosis.planning.waveforms import multisine_period, odd_lines
from piezoid.errors import ExcitationError

RATE_HZ = 10_000.0


def test_a_multisine_has_its_lines_at_rms_one_and_no_others(rng: np.random.Generator) -> None:
    lines = odd_lines(20, 800, 10.0, left_out_of=4, rng=rng)
    period = multisine_period(lines, 1000, rng)
    spectrum = np.abs(np.fft.rfft(period))
    silent = np.setdiff1d(np.arange(501), lines)
    assert np.ptp(spectrum[lines]) < 1e-9 * spectrum.max()
    assert spectrum[silent].max() < 1e-9 * spectrum.max()
    assert (lines % 2 == 1).all()
    assert period.std() == pytest.approx(1.0, rel=1e-9)


def test_every_group_of_lines_leaves_one_silent(rng: np.random.Generator) -> None:
    kept = odd_lines(10, 810, 10.0, left_out_of=4, rng=rng)
    groups = (kept - 1) // 8
    assert np.bincount(groups)[:10].tolist() == [3] * 10


def test_other_axes_are_asked_for_where_none_is_known() -> None:
    limits = DriveLimits(voltage_min_V=0.0, voltage_max_V=10.0, slew_V_per_s=1e3)
    bench = Bench(axis="x", limits=limits, clock_Hz=RATE_HZ)
    with pytest.raises(ExcitationError, match="no other axis"):
        drive_of(next(one for one in EXPERIMENTS if one.needs_other), bench, 0)


def test_the_csv_comes_back_exactly_under_a_header_with_units(rng: np.random.Generator) -> None:
    drive = Drive(
        name="noise",
        why="",
        sampling_rate_Hz=RATE_HZ,
        axes=("x", "y"),
        voltage_V=rng.uniform(-1.0, 9.0, (3000, 2)),
    )
    header, *rows = drive.to_csv().splitlines()
    assert header == "time [s],voltage_x [V],voltage_y [V]"
    numbers = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    np.testing.assert_array_equal(numbers[:, 1:], drive.voltage_V)
    np.testing.assert_array_equal(numbers[:, 0], np.arange(3000) / RATE_HZ)
