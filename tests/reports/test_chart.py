"""Charts: simplified curves with their spikes and gaps, and labels of the axes."""

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezoid.numerics.arrays import Array
from piezoid_reports.chart import (
    HEIGHT,
    STEPS,
    WIDTH,
    Canvas,
    axis_over,
    decade_ticks,
    envelope,
    even_ticks,
    finite_runs,
    simplify_curve,
)
from piezoid_reports.quantities import MINUS


def _points(path: str) -> list[Array]:
    """Read the polylines of an SVG path."""
    polylines = []
    for segment in path.split("M")[1:]:
        numbers = np.array([int(n) for n in re.findall(r"-?\d+", segment)]).reshape(-1, 2)
        polylines.append(np.cumsum(numbers, axis=0).astype(float))
    return polylines


def _distance(x: Array, y: Array, a: Array, b: Array) -> float:
    """Return the largest distance of the curve (x, y) from the polyline (a, b)."""
    max_distance = 0.0
    for px, py in zip(x, y, strict=True):
        dx, dy = np.diff(a), np.diff(b)
        length = np.maximum(dx**2 + dy**2, 1e-300)
        t = np.clip(((px - a[:-1]) * dx + (py - b[:-1]) * dy) / length, 0, 1)
        distance = np.hypot(a[:-1] + t * dx - px, b[:-1] + t * dy - py).min()
        max_distance = max(max_distance, float(distance))
    return max_distance


def _spiral() -> tuple[Array, Array]:
    angle = np.linspace(0, 12 * np.pi, 2000)
    return 1000 * np.cos(angle) * np.exp(-angle / 30), 700 * np.sin(angle)


def test_a_simplified_curve_stays_within_its_tolerance():
    x, y = _spiral()
    rows = simplify_curve(x, y, tolerance=3.0, points=5000)
    assert len(rows) < 500
    # The tolerance of the chords, and the diagonal of the cells that the first step skips.
    assert _distance(x, y, x[rows], y[rows]) <= 3.0 + 1.5 * np.sqrt(2)
    assert len(simplify_curve(x, y, tolerance=0.1, points=40)) == 40
    x = np.linspace(0.0, 1000.0, 5001)
    assert simplify_curve(x, 2 * x, tolerance=3.0, points=100).tolist() == [0, 5000]
    assert simplify_curve(np.zeros(9), np.zeros(9), tolerance=3.0, points=100).tolist() == [0, 8]


def test_long_signals_keep_the_budget_and_their_spikes():
    rng = np.random.default_rng(5)
    x, y = np.linspace(0, 12800, 500_000), 3000 + rng.normal(scale=20.0, size=500_000)
    rows = simplify_curve(x, y, tolerance=3.0, points=2400)
    assert len(rows) <= 2400
    assert {0, 499_999} <= set(rows.tolist())
    x = np.arange(100_000.0)
    y = np.zeros(100_000)
    y[77_777] = 5.0
    middle, low, high = envelope(x, y, 500)
    assert len(middle) == 500
    assert high.max() == 5.0
    assert low.min() == 0.0
    assert abs(middle[high.argmax()] - 77_777) <= 200


def test_a_path_is_accurate_to_half_a_step():
    voltage_V, displacement_m = np.array([0.0, 1.0, 3.0, 2.0]), np.array([0.0, 4e-6, 1e-6, 2e-6])
    canvas = Canvas(x=axis_over("u", [voltage_V], "V"), y=axis_over("y", [displacement_m], "m"))
    layer = canvas.line("model", "model", voltage_V, displacement_m)
    (points,) = _points(layer.path)
    x_V = canvas.x.low + points[:, 0] / (WIDTH * STEPS) * (canvas.x.high - canvas.x.low)
    y_um = canvas.y.high - points[:, 1] / (HEIGHT * STEPS) * (canvas.y.high - canvas.y.low)
    np.testing.assert_allclose(x_V, voltage_V, atol=0.51 * 3.3 / (WIDTH * STEPS))
    np.testing.assert_allclose(y_um * 1e-6, displacement_m, atol=0.51 * 4.4e-6 / (HEIGHT * STEPS))


def test_a_curve_has_gaps_without_values_and_an_axis_always_a_length():
    y = np.array([0.0, 1.0, np.nan, np.nan, 1.0, 0.0, np.nan])
    assert finite_runs(y) == [slice(0, 2), slice(4, 6)]
    canvas = Canvas(x=axis_over("t", [np.arange(7.0)], "s"), y=axis_over("y", [y], "m"))
    assert len(_points(canvas.line("model", "model", np.arange(7.0), y).path)) == 2
    axis = axis_over("u", [np.full(3, 2e-9)], "m")
    assert axis.low < 2.0 < axis.high
    assert axis_over("u", [np.full(3, np.nan)], "m").ticks


def _number(label: str) -> float:
    return float(label.replace(MINUS, "-"))


@given(st.floats(-16.0, 8.0), st.floats(1e-3, 16.0))
def test_a_logarithmic_label_is_the_number_at_its_position(low, span):
    for position, label in decade_ticks(low, low + span):
        assert low - 1e-6 <= position <= low + span + 1e-6
        # Between neighbouring decades labels have the digits of an even step.
        assert math.log10(_number(label)) == pytest.approx(position, abs=1e-3)


@given(st.floats(-16.0, 8.0), st.floats(0.05, 16.0))
def test_a_logarithmic_axis_has_3_to_18_labels(low, span):
    assert 3 <= len(decade_ticks(low, low + span)) <= 18


@pytest.mark.parametrize(
    ("low", "high", "labels"),
    [
        (0.0, 4.0, ["1", "10", "100", "1000", "10000"]),
        (0.9, 2.1, ["10", "20", "50", "100"]),
        (-2.0, 1.0, ["0.01", "0.1", "1", "10"]),
        (-13.0, -10.9, [f"1e{MINUS}13", f"1e{MINUS}12", f"1e{MINUS}11"]),
        (2.0, 2.1, ["100", "105", "110", "115", "120", "125"]),
    ],
)
def test_decades_have_round_labels(low, high, labels):
    assert [label for _, label in decade_ticks(low, high)] == labels


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))
def test_even_labels_are_the_numbers_at_their_positions(low, span):
    ticks = even_ticks(low, low + span)
    assert 3 <= len(ticks) <= 8
    for position, label in ticks:
        assert _number(label) == pytest.approx(position, rel=1e-6, abs=1e-9 * abs(low) + 1e-12)
