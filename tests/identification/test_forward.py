"""The forward model: its parts by their definitions, its chunks, its derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.extensions import (
    AmplifierLimits,
    CreepLadder,
    CrossAxis,
    Delay,
    FirstOrderLag,
    GainChange,
    LinearMode,
    PeriodicError,
    RateDependence,
)
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.forward import Forward, Run
from piezoid.identification.hysteresis.coordinates import Scaled
from piezoid.identification.hysteresis.pieces import Scales
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from tests.identification.extensions.samples import RATE_Hz, one_of_each, where
from tests.identification.hysteresis.stages import play_sum, through

SAMPLES = 3000
SCALES = Scales(voltage_V=5.0, voltage_offset_V=5.2, displacement_m=-1.2e-5)
OPERATOR = Scaled(
    gap=np.array([0.16, 0.26]),
    threshold=np.array([0.16, 0.42]),
    weight=np.array([0.8, 0.16, 0.2]),
    knot=np.array([-0.3, 0.0, 0.4]),
    slope=np.array([1.05, 1.0, 1.0, 0.9]),
    zero=1,
    lag_s=0.0,
    envelope=from_slopes(np.array([-0.5, 0.0, 0.5]), np.array([0.8, 1.0, 1.0, 1.3])),
)
SLOPES = np.array([0.4, -0.7])
ZERO_m, CENTRE_m = 2.3e-6, 1.9e-6
FILTERS = {
    "none": {},
    "delay": {"lag": "delay", "lag_s": 2.4 / RATE_Hz},
    "first order": {"lag": "first_order", "lag_s": 4e-3},
    "sensor": {"lag": "delay", "lag_s": 1.3 / RATE_Hz, "sensor_Hz": 70.0},
}
CHANGE = GainChange(recording="sweep.csv", instant_s=1.2, ratio=1.1, offset_m=1e-7)
ROUNDING = 1e-11
HERE = where(SAMPLES)
PLACE = np.arange(5, SAMPLES, 3)


def drive() -> Array:
    """Turns of many heights that end between samples, about as fast as the filters."""
    levels = [0.1, *(np.linspace(0.97, 0.2, 24) * (-1.0) ** np.arange(24)).tolist()]
    return np.ascontiguousarray(through(levels, 120)[:SAMPLES])


def forward_of(*extensions: Extension, filters: str = "none") -> Forward:
    return Forward(operator=OPERATOR, extensions=extensions, scales=SCALES, **FILTERS[filters])


def run_of(forward: Forward) -> Run:
    return Run(
        forward=forward,
        command=np.resize(drive(), SAMPLES),
        memory_slope=SLOPES,
        zero_m=ZERO_m,
        centre_m=CENTRE_m,
        where=HERE,
    )


def relaxed(signal: Array, time_s: float) -> Array:
    """What a first-order lag makes of straight lines between samples, in closed form."""
    found, kept = signal.copy(), np.exp(-1.0 / (time_s * RATE_Hz))
    for k in range(1, len(signal)):
        slope_s = (signal[k] - signal[k - 1]) * RATE_Hz * time_s
        found[k] = signal[k] - slope_s + (found[k - 1] - signal[k - 1] + slope_s) * kept
    return found


def later(signal: Array, samples: float) -> Array:
    place = np.arange(len(signal), dtype=float)
    return np.interp(place - samples, place, signal)


def bent(values: Array, knot: Array, slope: Array) -> Array:
    """A continuous map through 0 with these slopes, segment by segment."""
    edges = np.concatenate([[-9.0], knot, [9.0]])
    height = np.concatenate([[0.0], np.cumsum(slope * np.diff(edges))])
    return np.interp(values, edges, height - np.interp(0.0, edges, height))


@pytest.mark.parametrize("filters", FILTERS)
def test_a_reading_is_what_the_parts_make_one_after_the_other(filters):
    limits, walls = AmplifierLimits(high_V=9.5, low_V=0.9), RateDependence(time_s=6e-3)
    answer = CrossAxis(axis="y", centre_V=5.0, gain_m_per_V=2e-8, curvature_m_per_V_per_V=0.0)
    cyclic = PeriodicError(wavelength_m=6e-7, cosine_m=(3e-9,), sine_m=(2e-9,))
    lag = FirstOrderLag(lag_s=3e-3)
    run = run_of(forward_of(limits, walls, CHANGE, lag, answer, cyclic, filters=filters))
    reached = (np.clip(5.2 + 5.0 * run.command, 0.9, 9.5) - 5.2) / 5.0
    inner = bent(reached, OPERATOR.envelope.threshold, np.array([0.8, 1.0, 1.0, 1.3]))
    memory = inner[0] + np.array([0.0, 0.16 * 0.4, 0.16 * 0.4 - 0.26 * 0.7])
    h = play_sum(inner, np.array([0.0, 0.16, 0.42]), OPERATOR.weight, memory)
    h = 0.8 * inner + relaxed(h - 0.8 * inner, 6e-3)
    static = bent(h, OPERATOR.knot, OPERATOR.slope)
    after = (HERE.time_s >= 1.2).astype(float)
    moved_m = relaxed(static * -1.2e-5 * (1.0 + 0.1 * after), 3e-3)
    chosen = FILTERS[filters]
    if chosen.get("lag") == "delay":
        moved_m = later(moved_m, chosen["lag_s"] * RATE_Hz)
    elif chosen.get("lag") == "first_order":
        moved_m = relaxed(moved_m, chosen["lag_s"])
    if "sensor_Hz" in chosen:
        moved_m = relaxed(moved_m, 1.0 / (2.0 * np.pi * 70.0))
    x_m = ZERO_m + moved_m + 1e-7 * after + 2e-8 * (HERE.others_V["y"] - 5.0)
    turn = 2.0 * np.pi * x_m / 6e-7
    read_m = x_m + 3e-9 * np.cos(turn) + 2e-9 * np.sin(turn)
    np.testing.assert_allclose(run.drive, reached, atol=ROUNDING)
    np.testing.assert_allclose(run.static, static, atol=ROUNDING)
    np.testing.assert_allclose(run.reading, (read_m - CENTRE_m) / -1.2e-5, atol=1e-9)


def test_an_amplifier_stands_in_front_of_all_extensions():
    limits = AmplifierLimits(high_V=6.0)
    forward = replace(forward_of(limits), amplifier_Hz=30.0)
    drive_V = 5.2 + 5.0 * drive()
    expected = np.minimum(relaxed(drive_V, 1.0 / (2.0 * np.pi * 30.0)), 6.0)
    np.testing.assert_allclose(forward.driven_V(drive_V, RATE_Hz), expected, atol=ROUNDING)


def differences(run: Run, changed: Forward, other: Forward, step: float) -> Array:
    """Return the change of the reading from one model to another, over a step."""
    ahead, back = (replace(run, forward=forward).reading for forward in (changed, other))
    return np.asarray((ahead - back)[PLACE] / step)


@pytest.mark.parametrize("extension", one_of_each(), ids=lambda one: one.kind)
def test_the_columns_of_an_extension_are_its_derivatives(extension):
    run = run_of(forward_of(extension, Delay(delay_samples=0.3), filters="sensor"))
    free, found = extension.free(), run.by_extension(0, PLACE)
    assert found.shape == (len(PLACE), len(free.value))
    for j, step in enumerate(0.1 * free.step):
        change = step * np.eye(len(free.value))[j]
        ends = [np.clip(free.value + way, free.lower, free.upper) for way in (change, -change)]
        ahead, back = (
            replace(run.forward, extensions=(extension.moved_to(end), run.forward.extensions[1]))
            for end in ends
        )
        numeric = differences(run, ahead, back, float((ends[0] - ends[1])[j]))
        apart = np.linalg.norm(found[:, j] - numeric)
        assert apart <= 0.02 * np.linalg.norm(numeric) + 1e-9


@pytest.mark.parametrize("filters", ["delay", "first order", "sensor"])
def test_the_column_of_the_lag_is_its_derivative(filters):
    run = run_of(forward_of(filters=filters))
    step_s = 1e-7
    ahead, back = (
        replace(run.forward, lag_s=run.forward.lag_s + sign * step_s) for sign in (1.0, -1.0)
    )
    numeric = differences(run, ahead, back, 2.0 * step_s)
    np.testing.assert_allclose(run.by_lag(PLACE), numeric, atol=1e-3 * np.abs(numeric).max())


def moved(operator: Scaled, name: str, place: int, step: float) -> Scaled:
    """Return an operator with one number otherwise, as the vector of a fit moves it."""
    if name == "gap":
        gap = operator.gap + step * np.eye(2)[place]
        return replace(operator, gap=gap, threshold=np.cumsum(gap))
    if name == "weight":
        return replace(operator, weight=operator.weight + step * np.eye(3)[place])
    slope = operator.envelope.slope + step * np.eye(4)[3 * place]
    return replace(operator, envelope=from_slopes(operator.envelope.threshold, slope))


@pytest.mark.parametrize(
    ("extensions", "filters", "within"),
    [
        ((), "none", 1e-6),
        ((), "delay", 1e-6),
        ((Delay(delay_samples=2.4),), "none", 1e-6),
        ((CHANGE, Delay(delay_samples=3.0)), "delay", 0.02),
        ((), "first order", 1e-6),
        ((FirstOrderLag(lag_s=5e-3),), "sensor", 1e-6),
        ((LinearMode(frequency_Hz=60.0, quality=8.0),), "delay", 1e-6),
        ((CreepLadder(time_s=(1.0,), share=(0.01,)), Delay(delay_samples=0.4)), "none", 0.05),
    ],
)
def test_the_columns_of_the_hysteresis_are_its_derivatives(extensions, filters, within):
    run, step = run_of(forward_of(*extensions, filters=filters)), 1e-6
    found = run.by_hysteresis(PLACE)
    pairs: list[tuple[Run, Run]] = []
    for place in range(2):
        change = step * np.eye(2)[place]
        pairs.append(
            (
                replace(run, memory_slope=SLOPES + change),
                replace(run, memory_slope=SLOPES - change),
            )
        )
    for name, count in (("gap", 2), ("weight", 3)):
        for place in range(count):
            ahead, back = (
                replace(run.forward, operator=moved(OPERATOR, name, place, sign * step))
                for sign in (1.0, -1.0)
            )
            pairs.append((replace(run, forward=ahead), replace(run, forward=back)))
    assert found.shape == (len(PLACE), 2 + 5 + 4 + 2)
    for column, (ahead_run, back_run) in enumerate(pairs):
        numeric = (ahead_run.reading - back_run.reading)[PLACE] / (2.0 * step)
        apart = np.linalg.norm(found[:, column] - numeric)
        assert apart <= within * np.linalg.norm(numeric), column


def test_too_many_numbers_for_one_array_are_taken_for_delayed(monkeypatch):
    monkeypatch.setattr("piezoid.identification.forward.MAX_ENTRIES", 12 * SAMPLES)
    lag, late = (
        run_of(forward_of(extension)).by_hysteresis(PLACE)
        for extension in (FirstOrderLag(lag_s=3.4e-3), Delay(delay_s=3.4e-3))
    )
    np.testing.assert_allclose(lag, late, atol=ROUNDING)
