"""Reference paths have their stated shape, and tracking metrics have known values."""

from functools import partial

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from piezoid.verification.scenarios import (
    constant_angular_velocity,
    constant_linear_velocity,
    raster,
    steps,
)
from piezoid.verification.tip_trials import rough_surface_m
from piezoid.verification.tracking import align, track

RATE_Hz = 20e3
RADIUS_m = 2e-5


def measured(path, position_m, frequency_Hz=10.0):
    reference_m = {"x": RADIUS_m * path.x, "y": RADIUS_m * path.y}
    position_m = dict(zip("xy", position_m, strict=True))
    return track(
        reference_m,
        position_m,
        path=path,
        radius_m=RADIUS_m,
        frequency_Hz=frequency_Hz,
        sampling_rate_Hz=RATE_Hz,
    )


def spiral(turns=5.0, frequency_Hz=10.0):
    return constant_angular_velocity(RATE_Hz, frequency_Hz, turns)


def test_spirals_have_constant_angular_or_linear_velocity():
    path = spiral()
    angle = np.unwrap(np.arctan2(path.y, path.x)[100:])
    turning = np.diff(angle) * RATE_Hz / (2 * np.pi)
    assert turning == pytest.approx(10.0)
    assert np.hypot(path.x, path.y)[-1] == pytest.approx(1.0, abs=1e-4)
    path = constant_linear_velocity(RATE_Hz, 10.0, 10.0)
    speed = np.hypot(np.diff(path.x), np.diff(path.y)) * RATE_Hz
    # The angular velocity is limited within the inner third of the radius.
    outside = np.hypot(path.x, path.y)[:-1] > 0.34
    assert speed[outside] == pytest.approx(2 * np.pi * 10.0, rel=2e-3)
    assert speed.max() < 1.01 * 2 * np.pi * 10.0


def test_a_raster_runs_straight_lines_over_the_whole_square():
    path = raster(RATE_Hz, 5.0, 10.0)
    assert (path.x.min(), path.x.max()) == pytest.approx((-1.0, 1.0), abs=1e-3)
    assert (path.y.min(), path.y.max()) == pytest.approx((-1.0, 1.0), abs=1e-3)
    speed = np.abs(np.diff(path.x)) * RATE_Hz
    straight = np.isclose(speed, speed.max())
    assert straight.mean() > 0.75
    assert np.abs(np.diff(path.y)).max() < 1e-3
    assert np.abs(np.diff(path.x, 2)).max() * RATE_Hz < 0.01 * speed.max()


def test_every_path_begins_in_the_middle():
    for path in (
        spiral(),
        constant_linear_velocity(RATE_Hz, 10.0, 10.0),
        raster(RATE_Hz, 5.0, 4.0),
        steps(RATE_Hz, 0.1),
    ):
        assert abs(path.x[0]) < 1e-12
        assert abs(path.y[0]) < 1e-12


@pytest.mark.parametrize("delay_s", [-3e-4, 0.0, 1.23e-4, 2e-3])
def test_the_delay_of_a_stage_is_estimated_and_aligned(delay_s):
    path = spiral(turns=20.0, frequency_Hz=20.0)
    angle = 2 * np.pi * 20.0 * (np.arange(len(path.x)) / RATE_Hz - delay_s)
    radius = angle / (2 * np.pi * 20.0)
    tracking = measured(
        path, (RADIUS_m * radius * np.cos(angle), RADIUS_m * radius * np.sin(angle)), 20.0
    )
    assert tracking.delay_s == pytest.approx(delay_s, abs=1e-9)
    # a cubic spline over 1000 samples a turn
    assert tracking.aligned_rms_m < 1e-9 * RADIUS_m
    if delay_s:
        assert tracking.rms_m > 1e3 * tracking.aligned_rms_m


def test_known_errors_give_known_metrics():
    path = spiral()
    x, y = RADIUS_m * path.x, RADIUS_m * path.y
    tracking = measured(path, (x + 3e-9, y - 4e-9))
    assert tracking.rms_m == pytest.approx(5e-9)
    assert tracking.max_m == pytest.approx(5e-9)
    assert tracking.rms_percent == pytest.approx(100 * 5e-9 / (2 * RADIUS_m))
    scaled = measured(path, (1.01 * x, 1.01 * y))
    r = np.hypot(x, y)
    assert scaled.radial_rms_m == pytest.approx(0.01 * np.sqrt(np.mean(r**2)))
    assert scaled.pitch_error == pytest.approx(0.0, abs=1e-3)


def test_alternating_turn_spacing_is_a_pitch_error():
    path = spiral(turns=10.0)
    r, angle = np.hypot(path.x, path.y), np.arctan2(path.y, path.x)
    turn = 10.0 * r
    uneven = r + 0.01 * np.where(turn.astype(int) % 2, 1.0, -1.0) * (turn > 1)
    tracking = measured(
        path, (RADIUS_m * uneven * np.cos(angle), RADIUS_m * uneven * np.sin(angle))
    )
    # spacings alternate by +-0.02 about a pitch of 0.1
    assert tracking.pitch_error == pytest.approx(0.2, rel=0.1)


def test_the_delay_never_leaves_its_range():
    reference = np.sin(np.arange(4000) / 50)[None, :]
    rms, delay_s = align(reference, np.roll(reference, 40, axis=1), RATE_Hz, 1e-3)
    assert delay_s == pytest.approx(1e-3)
    assert rms > 0.1


@pytest.mark.parametrize("samples", [5, 8, 400])
@pytest.mark.parametrize("delay", [-40.0, -1.0, -0.25, 0.0, 0.999, 1.0, 40.0])
def test_the_aligned_error_is_measured_from_the_spline_through_the_path(samples, delay):
    rng = np.random.default_rng(samples)
    reference, longest = np.cumsum(rng.normal(size=(2, samples)), axis=1), (samples - 2) // 2
    spline, sample = CubicSpline(np.arange(samples), reference, axis=1), np.arange(samples)
    delay = float(np.clip(delay, -longest, longest))
    rms, delay_s = align(reference, spline(sample - delay), RATE_Hz, longest / RATE_Hz)
    margin = int(np.ceil(longest))
    residual = (spline(sample - delay) - spline(sample - delay_s * RATE_Hz))[
        :, margin : samples - margin
    ]
    assert abs(delay_s) * RATE_Hz <= longest
    assert rms == pytest.approx(np.sqrt((residual**2).sum() / residual.shape[1]), abs=1e-12)


def test_a_surface_has_its_roughness_and_zero_height_at_the_start():
    surface = partial(rough_surface_m, rms_m=1e-10, shortest_m=1e-6)
    points = np.random.default_rng(0).uniform(-1e-3, 1e-3, (2, 20_000))
    assert np.std(surface(*points)) == pytest.approx(1e-10, rel=0.03)
    assert surface(np.zeros(1), np.zeros(1))[0] == 0.0
    height_m = surface(np.array([1e-8]), np.zeros(1))[0]
    assert abs(height_m) < 2 * np.pi * 1e-2 * np.sqrt(2 * 40) * 1e-10
