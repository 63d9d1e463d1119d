"""The forward model: definitions of its parts, chunks and derivatives."""

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
from piezoid.identification.forward import Forward, Run, Scaled
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
PIECE = where(SAMPLES)
ROWS = np.arange(5, SAMPLES, 3)


def drive() -> Array:
    """Return turns of many amplitudes that end between samples, about as fast as the filters."""
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
        where=PIECE,
    )


def relaxed(signal: Array, time_s: float) -> Array:
    """Return the response of a first-order lag to straight lines between samples."""
    lagged, pole = signal.copy(), np.exp(-1.0 / (time_s * RATE_Hz))
    for k in range(1, len(signal)):
        slope_s = (signal[k] - signal[k - 1]) * RATE_Hz * time_s
        lagged[k] = signal[k] - slope_s + (lagged[k - 1] - signal[k - 1] + slope_s) * pole
    return lagged


def delayed(signal: Array, samples: float) -> Array:
    sample = np.arange(len(signal), dtype=float)
    return np.interp(sample - samples, sample, signal)


def piecewise_linear(values: Array, knot: Array, slope: Array) -> Array:
    """Return a continuous map through 0 with one slope per segment."""
    edges = np.concatenate([[-9.0], knot, [9.0]])
    height = np.concatenate([[0.0], np.cumsum(slope * np.diff(edges))])
    return np.interp(values, edges, height - np.interp(0.0, edges, height))


@pytest.mark.parametrize("filters", FILTERS)
def test_a_reading_is_the_composition_of_all_parts(filters):
    limits, rate_dependence = AmplifierLimits(high_V=9.5, low_V=0.9), RateDependence(time_s=6e-3)
    coupling = CrossAxis(axis="y", centre_V=5.0, gain_m_per_V=2e-8, curvature_m_per_V_per_V=0.0)
    periodic = PeriodicError(wavelength_m=6e-7, cosine_m=(3e-9,), sine_m=(2e-9,))
    lag = FirstOrderLag(lag_s=3e-3)
    run = run_of(
        forward_of(limits, rate_dependence, CHANGE, lag, coupling, periodic, filters=filters)
    )
    driven = (np.clip(5.2 + 5.0 * run.command, 0.9, 9.5) - 5.2) / 5.0
    inner = piecewise_linear(driven, OPERATOR.envelope.threshold, np.array([0.8, 1.0, 1.0, 1.3]))
    memory = inner[0] + np.array([0.0, 0.16 * 0.4, 0.16 * 0.4 - 0.26 * 0.7])
    h = play_sum(inner, np.array([0.0, 0.16, 0.42]), OPERATOR.weight, memory)
    h = 0.8 * inner + relaxed(h - 0.8 * inner, 6e-3)
    static = piecewise_linear(h, OPERATOR.knot, OPERATOR.slope)
    is_changed = (PIECE.time_s >= 1.2).astype(float)
    displacement_m = relaxed(static * -1.2e-5 * (1.0 + 0.1 * is_changed), 3e-3)
    filter_settings = FILTERS[filters]
    if filter_settings.get("lag") == "delay":
        displacement_m = delayed(displacement_m, filter_settings["lag_s"] * RATE_Hz)
    elif filter_settings.get("lag") == "first_order":
        displacement_m = relaxed(displacement_m, filter_settings["lag_s"])
    if "sensor_Hz" in filter_settings:
        displacement_m = relaxed(displacement_m, 1.0 / (2.0 * np.pi * 70.0))
    position_m = ZERO_m + displacement_m + 1e-7 * is_changed + 2e-8 * (PIECE.others_V["y"] - 5.0)
    phase = 2.0 * np.pi * position_m / 6e-7
    reading_m = position_m + 3e-9 * np.cos(phase) + 2e-9 * np.sin(phase)
    np.testing.assert_allclose(run.drive, driven, atol=ROUNDING)
    np.testing.assert_allclose(run.static, static, atol=ROUNDING)
    np.testing.assert_allclose(run.reading, (reading_m - CENTRE_m) / -1.2e-5, atol=1e-9)


def test_the_amplifier_precedes_all_extensions():
    limits = AmplifierLimits(high_V=6.0)
    forward = replace(forward_of(limits), amplifier_Hz=30.0)
    drive_V = 5.2 + 5.0 * drive()
    expected = np.minimum(relaxed(drive_V, 1.0 / (2.0 * np.pi * 30.0)), 6.0)
    np.testing.assert_allclose(forward.driven_V(drive_V, RATE_Hz), expected, atol=ROUNDING)


def differences(run: Run, changed: Forward, reference_forward: Forward, step: float) -> Array:
    """Return the change of the reading from one model to another, over a step."""
    reading, reference = (
        replace(run, forward=forward).reading for forward in (changed, reference_forward)
    )
    return np.asarray((reading - reference)[ROWS] / step)


@pytest.mark.parametrize("extension", one_of_each(), ids=lambda extension: extension.kind)
def test_the_columns_of_an_extension_are_its_derivatives(extension):
    run = run_of(forward_of(extension, Delay(delay_samples=0.3), filters="sensor"))
    free, columns = extension.free(), run.by_extension(0, ROWS)
    assert columns.shape == (len(ROWS), len(free.value))
    for j, step in enumerate(0.1 * free.step):
        change = step * np.eye(len(free.value))[j]
        points = [
            np.clip(free.value + offset, free.lower, free.upper) for offset in (change, -change)
        ]
        upper, lower = (
            replace(run.forward, extensions=(extension.moved_to(point), run.forward.extensions[1]))
            for point in points
        )
        numeric = differences(run, upper, lower, float((points[0] - points[1])[j]))
        distance = np.linalg.norm(columns[:, j] - numeric)
        assert distance <= 0.02 * np.linalg.norm(numeric) + 1e-9


@pytest.mark.parametrize("filters", ["delay", "first order", "sensor"])
def test_the_column_of_the_lag_is_its_derivative(filters):
    run = run_of(forward_of(filters=filters))
    step_s = 1e-7
    upper, lower = (
        replace(run.forward, lag_s=run.forward.lag_s + sign * step_s) for sign in (1.0, -1.0)
    )
    numeric = differences(run, upper, lower, 2.0 * step_s)
    np.testing.assert_allclose(run.by_lag(ROWS), numeric, atol=1e-3 * np.abs(numeric).max())


def perturbed(operator: Scaled, name: str, index: int, step: float) -> Scaled:
    """Return the operator with one perturbed parameter."""
    if name == "gap":
        gap = operator.gap + step * np.eye(2)[index]
        return replace(operator, gap=gap, threshold=np.cumsum(gap))
    if name == "weight":
        return replace(operator, weight=operator.weight + step * np.eye(3)[index])
    slope = operator.envelope.slope + step * np.eye(4)[3 * index]
    return replace(operator, envelope=from_slopes(operator.envelope.threshold, slope))


@pytest.mark.parametrize(
    ("extensions", "filters", "tolerance"),
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
def test_the_columns_of_the_hysteresis_are_its_derivatives(extensions, filters, tolerance):
    run, step = run_of(forward_of(*extensions, filters=filters)), 1e-6
    columns = run.by_hysteresis(ROWS)
    pairs: list[tuple[Run, Run]] = []
    for index in range(2):
        change = step * np.eye(2)[index]
        pairs.append(
            (
                replace(run, memory_slope=SLOPES + change),
                replace(run, memory_slope=SLOPES - change),
            )
        )
    for name, count in (("gap", 2), ("weight", 3)):
        for index in range(count):
            upper, lower = (
                replace(run.forward, operator=perturbed(OPERATOR, name, index, sign * step))
                for sign in (1.0, -1.0)
            )
            pairs.append((replace(run, forward=upper), replace(run, forward=lower)))
    assert columns.shape == (len(ROWS), 2 + 5 + 4 + 2)
    for column, (upper_run, lower_run) in enumerate(pairs):
        numeric = (upper_run.reading - lower_run.reading)[ROWS] / (2.0 * step)
        distance = np.linalg.norm(columns[:, column] - numeric)
        assert distance <= tolerance * np.linalg.norm(numeric), column


def test_a_lag_is_approximated_by_a_delay_above_the_size_limit(monkeypatch):
    monkeypatch.setattr("piezoid.identification.forward.MAX_ENTRIES", 12 * SAMPLES)
    lag, delay = (
        run_of(forward_of(extension)).by_hysteresis(ROWS)
        for extension in (FirstOrderLag(lag_s=3.4e-3), Delay(delay_s=3.4e-3))
    )
    np.testing.assert_allclose(lag, delay, atol=ROUNDING)
