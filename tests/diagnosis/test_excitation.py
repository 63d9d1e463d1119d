"""Drives: inside their limits, with the spectrum they promise, and read back exactly."""

import numpy as np
import pytest

from piezoid.diagnosis.planning.excitation import Drive, DriveLimits, multisines, odd_lines
from piezoid.errors import ExcitationError

RATE_HZ = 10_000.0
LIMITS = DriveLimits(voltage_min_V=-1.0, voltage_max_V=9.0, slew_V_per_s=2e4)


def sines(rng: np.random.Generator, **changed: object) -> tuple[Drive, ...]:
    asked: dict[str, object] = {
        "lines": odd_lines(20, 800, 10.0, left_out_of=4, rng=rng),
        "period_samples": 1000,
        "periods": 3,
        "realisations": 4,
        "rms_V": 0.5,
        "offset_V": 4.0,
        "axes": ("x", "y"),
        "sampling_rate_Hz": RATE_HZ,
        "limits": LIMITS,
        "rng": rng,
    }
    return multisines(**{**asked, **changed})  # type: ignore[arg-type]


def test_a_multisine_has_its_lines_and_no_others(rng: np.random.Generator) -> None:
    lines = odd_lines(20, 800, 10.0, left_out_of=4, rng=rng)
    drive = sines(rng, lines=lines)[0]
    spectrum = np.abs(np.fft.rfft(drive.voltage_V[:1000, 0] - 4.0))
    silent = np.setdiff1d(np.arange(501), lines)
    assert np.ptp(spectrum[lines]) < 1e-9 * spectrum.max()
    assert spectrum[silent].max() < 1e-9 * spectrum.max()
    assert (lines % 2 == 1).all()


def test_every_group_of_lines_leaves_one_silent(rng: np.random.Generator) -> None:
    kept = odd_lines(10, 810, 10.0, left_out_of=4, rng=rng)
    groups = (kept - 1) // 8
    assert np.bincount(groups)[:10].tolist() == [3] * 10


def test_a_multisine_repeats_and_has_the_asked_rms(rng: np.random.Generator) -> None:
    drive = sines(rng)[0]
    np.testing.assert_array_equal(drive.voltage_V[:1000], drive.voltage_V[2000:])
    np.testing.assert_allclose(drive.voltage_V.std(axis=0), 0.5, rtol=1e-9)
    np.testing.assert_allclose(drive.voltage_V.mean(axis=0), 4.0, rtol=1e-12)


def test_a_block_of_multisines_is_orthogonal_at_every_line(rng: np.random.Generator) -> None:
    lines = odd_lines(20, 800, 10.0, left_out_of=0, rng=rng)
    drives = sines(rng, lines=lines, axes=("x", "y", "z"), realisations=3)
    U = np.stack([np.fft.rfft(d.voltage_V[:1000], axis=0)[lines] for d in drives], axis=2)
    gram = U @ np.conj(np.swapaxes(U, 1, 2))
    size = gram[:, 0, 0].real
    np.testing.assert_allclose(
        gram / size[:, None, None], np.broadcast_to(np.eye(3), gram.shape), atol=1e-9
    )


def test_realisations_must_fill_whole_blocks(rng: np.random.Generator) -> None:
    with pytest.raises(ExcitationError, match="Ask for 4 realisations"):
        sines(rng, realisations=3)


@pytest.mark.parametrize("changed", [{"rms_V": 3.0}, {"offset_V": 8.9}])
def test_a_multisine_outside_its_limits_is_refused(
    rng: np.random.Generator, changed: dict[str, float]
) -> None:
    with pytest.raises(ExcitationError, match="Lower rms_V"):
        sines(rng, **changed)


def test_the_csv_comes_back_exactly_under_a_header_with_units(rng: np.random.Generator) -> None:
    drive = sines(rng)[1]
    header, *rows = drive.to_csv().splitlines()
    assert header == "time [s],voltage_x [V],voltage_y [V]"
    numbers = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    np.testing.assert_array_equal(numbers[:, 1:], drive.voltage_V)
    np.testing.assert_array_equal(numbers[:, 0], np.arange(3000) / RATE_HZ)


def _assert_inside(drive: Drive) -> None:
    tolerance = 1 + 1e-12
    assert drive.voltage_V.min() >= LIMITS.voltage_min_V * tolerance
    assert drive.voltage_V.max() <= LIMITS.voltage_max_V * tolerance
    slew = np.abs(np.diff(drive.voltage_V, axis=0)).max() * drive.sampling_rate_Hz
    assert slew <= LIMITS.slew_V_per_s * (1 + 1e-9)
