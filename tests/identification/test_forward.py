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
    MainsLines,
    PeriodicError,
    RateDependence,
    ThermalDrift,
)
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.forward import MAX_ENTRIES, Forward, Run
from piezoid.identification.hysteresis.coordinates import Scaled, envelope_stretch, to_si_units
from piezoid.identification.hysteresis.pieces import Scales
from piezoid.numerics.arrays import Array
from piezoid.operators.chain import Following
from piezoid.operators.dead_zone import from_slopes
from tests.identification.extensions.samples import RATE_Hz, one_of_each, where
from tests.identification.hysteresis.stages import play_sum, through
from tests.operators.strategies import is_admissible

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
def test_a_reading_is_what_the_parts_make_one_after_the_other(filters: str) -> None:
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


def test_an_amplifier_stands_in_front_of_all_extensions() -> None:
    limits = AmplifierLimits(high_V=6.0)
    forward = replace(forward_of(limits), amplifier_Hz=30.0)
    drive_V = 5.2 + 5.0 * drive()
    expected = np.minimum(relaxed(drive_V, 1.0 / (2.0 * np.pi * 30.0)), 6.0)
    np.testing.assert_allclose(forward.driven_V(drive_V, RATE_Hz), expected, atol=ROUNDING)


@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_volts_and_metres_read_as_scaled_numbers_do(filters: str, sign: float) -> None:
    scales = replace(SCALES, displacement_m=sign * 1.2e-5)
    scaled = replace(forward_of(*one_of_each(), filters=filters), scales=scales)
    own = Scales(voltage_V=1.0, voltage_offset_V=5.2, displacement_m=sign)
    plain = replace(scaled, operator=to_si_units(OPERATOR, scales), scales=own)
    run = run_of(scaled)
    driven_V = plain.driven_V(5.2 + 5.0 * run.command, RATE_Hz)
    memory_V = scaled.memory(run.drive[0], SLOPES) * envelope_stretch(OPERATOR) * 5.0
    static_m, _ = plain.static(driven_V - 5.2, memory_V, RATE_Hz)
    read_m = plain.read(plain.position(static_m, HERE, ZERO_m), HERE)
    np.testing.assert_allclose(
        read_m, CENTRE_m + scales.displacement_m * run.reading, rtol=0, atol=1e-14
    )


def test_every_memory_is_one_that_a_drive_can_have_left(rng: np.random.Generator) -> None:
    forward = forward_of()
    for slope in rng.uniform(-1.0, 1.0, (20, 2)):
        memory = forward.memory(0.7, slope)
        assert memory[0] == pytest.approx(0.5 + 1.3 * 0.2)
        assert is_admissible(memory, memory[0], np.array([0.0, 0.16, 0.42]))
        np.testing.assert_allclose(np.diff(memory) / OPERATOR.gap, slope, atol=ROUNDING)


def test_what_is_added_adds_up_and_leaves_the_rest_alone(rng: np.random.Generator) -> None:
    drift, mains = ThermalDrift.of([HERE]), MainsLines.of([HERE], 50.0)
    drift = drift.moved_to(1e-8 * rng.standard_normal(len(drift.free().value)))
    mains = mains.moved_to(1e-8 * rng.standard_normal(len(mains.free().value)))
    lag, static = FirstOrderLag(lag_s=2e-3), rng.standard_normal(SAMPLES)
    found_m = forward_of(lag, drift, mains).position(static, HERE, ZERO_m)
    bare_m = forward_of(lag).position(static, HERE)
    beside_m = sum(
        forward_of(one).position(np.zeros(SAMPLES), HERE, 0.0) for one in (drift, mains)
    )
    np.testing.assert_allclose(found_m - ZERO_m - bare_m, beside_m, rtol=0, atol=1e-19 + 1e-15)


@pytest.mark.parametrize("filters", FILTERS)
def test_what_is_linear_answers_to_columns_as_to_their_sum(
    rng: np.random.Generator, filters: str
) -> None:
    mode = LinearMode(frequency_Hz=80.0, quality=20.0, participation=0.7)
    forward = forward_of(CreepLadder(time_s=(0.1,), share=(0.02,)), mode, filters=filters)
    columns = np.asfortranarray(rng.standard_normal((SAMPLES, 3)))
    whole = forward.linear_response(columns @ np.array([1.0, -2.0, 0.5]), HERE)
    each = forward.linear_response(columns, HERE)
    np.testing.assert_allclose(each @ np.array([1.0, -2.0, 0.5]), whole, atol=1e-10)


def test_only_what_follows_within_samples_is_passed_where_asked(rng: np.random.Generator) -> None:
    creep, late = CreepLadder(time_s=(0.1,), share=(0.02,)), Delay(delay_samples=3.0)
    signal = rng.standard_normal(SAMPLES)
    quick = forward_of(creep, late, filters="sensor").linear_response(signal, HERE, fast_only=True)
    alone = forward_of(late, filters="sensor").linear_response(signal, HERE)
    np.testing.assert_array_equal(quick, alone)
    assert (forward_of(creep, late).linear_response(signal, HERE) != quick).any()


def test_plays_follow_chunk_after_chunk_to_the_bit() -> None:
    forward, asked = forward_of(), drive()
    memory = forward.memory(asked[0], SLOPES)
    whole, end = forward.static(asked, memory, RATE_Hz)
    parts = []
    for part in np.split(asked, [1, 40, 41, 1000]):
        found, memory = forward.static(part, memory, RATE_Hz)
        parts.append(found)
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    np.testing.assert_array_equal(memory, end)


@pytest.mark.parametrize("filters", FILTERS)
def test_a_pass_over_a_stream_is_the_model_in_chunks_of_any_length(filters: str) -> None:
    forward, asked = forward_of(filters=filters), drive()
    chain, late = forward.filtered_chain(SLOPES, RATE_Hz)
    assert late == int(forward.lag_s * RATE_Hz) * (forward.lag == "delay")
    found = []
    for cuts in ([], [1, 33, 500]):
        following, rows = Following(chain, float(asked[0])), []
        for part in np.split(asked, cuts):
            block = np.empty((len(part), chain.plays + chain.columns), order="F")
            following.rows(part, np.arange(len(part)), block)
            rows.append(block)
        found.append(np.concatenate(rows))
    np.testing.assert_array_equal(found[1], found[0])
    static, _ = forward.static(asked, forward.memory(asked[0], SLOPES), RATE_Hz)
    expected = forward.filtered(static, RATE_Hz)
    read = found[0][: len(asked) - late, -1]
    np.testing.assert_allclose(read[1:], expected[late + 1 :], atol=ROUNDING)


def test_hysteresis_knows_the_way_of_a_drive_and_not_its_time() -> None:
    forward, asked = forward_of(), drive()
    memory = forward.memory(asked[0], SLOPES)
    static, _ = forward.static(asked, memory, RATE_Hz)
    np.testing.assert_array_equal(forward.static(asked, memory, 7.0 * RATE_Hz)[0], static)
    slow, _ = forward.static(np.repeat(asked, 3), memory, RATE_Hz)
    np.testing.assert_array_equal(slow, np.repeat(static, 3))
    place = np.arange(len(asked), dtype=float)
    between = np.interp(np.arange(0.0, len(asked) - 0.9, 0.25), place, asked)
    fine, _ = forward.static(between, memory, RATE_Hz)
    np.testing.assert_allclose(fine[::4], static, atol=ROUNDING)
    late = forward_of(RateDependence(time_s=5e-3))
    assert np.abs(late.static(asked, memory, 7.0 * RATE_Hz)[0] - static).max() > 1e-4


@pytest.mark.parametrize("filters", FILTERS)
def test_a_ramp_comes_later_by_what_the_model_says(filters: str) -> None:
    extensions = (FirstOrderLag(lag_s=2e-3), Delay(delay_samples=2.5))
    forward = forward_of(*extensions, filters=filters)
    behind = HERE.time_s - forward.linear_response(HERE.time_s, HERE)
    assert forward.group_delay_s(RATE_Hz) == pytest.approx(behind[-1], rel=1e-9)


def differences(run: Run, changed: Forward, other: Forward, step: float) -> Array:
    """Return the change of the reading from one model to another, over a step."""
    ahead, back = (replace(run, forward=forward).reading for forward in (changed, other))
    return np.asarray((ahead - back)[PLACE] / step)


@pytest.mark.parametrize("extension", one_of_each(), ids=lambda one: one.kind)
def test_the_columns_of_an_extension_are_its_derivatives(extension: Extension) -> None:
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


def test_a_number_at_its_end_is_moved_the_other_way() -> None:
    mode = LinearMode(frequency_Hz=80.0, quality=20.0, participation=3.0)
    run = run_of(forward_of(mode))
    less = replace(run.forward, extensions=(replace(mode, participation=2.99),))
    numeric = differences(run, run.forward, less, 0.01)
    np.testing.assert_allclose(run.by_extension(0, PLACE)[:, 2], numeric, atol=1e-6)


@pytest.mark.parametrize("filters", ["delay", "first order", "sensor"])
def test_the_column_of_the_lag_is_its_derivative(filters: str) -> None:
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
def test_the_columns_of_the_hysteresis_are_its_derivatives(
    extensions: tuple[Extension, ...], filters: str, within: float
) -> None:
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


def slow_run(extensions: tuple[Extension, ...], **chosen: float | str) -> Run:
    """One long swing behind filters that it hardly feels."""
    asked = np.sin(np.linspace(0.3, 6.0, SAMPLES))
    forward = replace(forward_of(*extensions), **chosen)
    return replace(run_of(forward), command=np.ascontiguousarray(asked))


def test_where_motion_is_slow_filters_are_taken_for_a_delay_and_creep_is_left_out() -> None:
    creep, lag = CreepLadder(time_s=(0.1, 1.0), share=(0.2, 0.2)), FirstOrderLag(lag_s=2.4e-3)
    late = slow_run((), lag="delay", lag_s=3.7e-3)
    pole_Hz = 1.0 / (2.0 * np.pi * 1.3e-3)
    found = slow_run((creep, lag), sensor_Hz=pole_Hz).by_hysteresis(PLACE)
    np.testing.assert_allclose(found, late.by_hysteresis(PLACE), atol=ROUNDING)
    passed = slow_run((lag,), sensor_Hz=pole_Hz).forward.linear_response(late.static, HERE)
    assert np.abs(passed - late.forward.linear_response(late.static, HERE))[PLACE].max() > 1e-6


def test_where_motion_is_quick_filters_are_passed_and_creep_is_left_out() -> None:
    creep, mode = (
        CreepLadder(time_s=(0.1,), share=(0.2,)),
        LinearMode(frequency_Hz=60.0, quality=8),
    )
    found = run_of(forward_of(creep, mode)).by_hysteresis(PLACE)
    np.testing.assert_array_equal(found, run_of(forward_of(mode)).by_hysteresis(PLACE))


def test_too_many_numbers_for_one_array_are_taken_for_delayed() -> None:
    """Behind a lag that a short piece would pass: 14 columns of 1.3 million samples."""
    asked = np.tile(drive(), MAX_ENTRIES // 12 // len(drive()) + 1)
    here = where(len(asked))
    lag, late = (
        replace(run_of(forward), command=asked, where=here)
        for forward in (forward_of(FirstOrderLag(lag_s=3.4e-3)), forward_of(Delay(delay_s=3.4e-3)))
    )
    np.testing.assert_allclose(lag.by_hysteresis(PLACE), late.by_hysteresis(PLACE), atol=ROUNDING)


def test_without_scales_a_number_is_a_volt_or_a_metre() -> None:
    forward = Forward(operator=OPERATOR, extensions=(AmplifierLimits(high_V=0.5),))
    np.testing.assert_array_equal(
        forward.driven_V(np.array([0.1, 0.6, 0.3]), RATE_Hz), [0.1, 0.5, 0.3]
    )
    here = where(3)
    np.testing.assert_array_equal(
        forward.position(np.array([0.2, 0.3, 0.1]), here), [0.2, 0.3, 0.1]
    )
