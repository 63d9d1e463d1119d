"""What every play sum and every modified model must obey, whatever its numbers."""

import numpy as np
import pytest

from piezoid.errors import NotInvertibleError
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import Converter, compensate
from piezoid.operators.play import (
    forgetting_sample,
    is_admissible,
    play_columns,
    project_memory,
)
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.operators.worst_case import worst_case
from tests.operators.draws import draw_memory, draw_model, draw_plays, random_walk

ROUNDING = 2e-13  # some hundred operations on numbers of order one


def play_by_definition(u: Array, r: float, z0: float) -> Array:
    z = np.empty_like(u)
    for k, value in enumerate(u):
        z0 = max(value - r, min(value + r, z0))
        z[k] = z0
    return z


def test_kernel_columns_equal_the_definition_for_any_bank_size(rng: np.random.Generator) -> None:
    u = random_walk(rng, 500)
    for plays in (1, 7, 31, 32, 33, 70):
        r, z0 = np.sort(rng.uniform(0, 3, plays)), rng.normal(0, 1, plays)
        columns, after = play_columns(u, r, z0)
        for i in range(plays):
            np.testing.assert_array_equal(columns[:, i], play_by_definition(u, r[i], z0[i]))
        np.testing.assert_array_equal(after, columns[-1])


def test_chunks_of_any_length_give_the_same_bits(rng: np.random.Generator) -> None:
    u = random_walk(rng, 1000)
    r, memory, parts = np.linspace(0, 3, 40), np.zeros(40), []
    whole, end = play_columns(u, r, memory)
    for chunk in np.split(u, [1, 33, 34, 500, 977]):
        part, memory = play_columns(chunk, r, memory)
        parts.append(part)
    np.testing.assert_array_equal(np.vstack(parts), whole)
    np.testing.assert_array_equal(memory, end)


def test_inverse_undoes_the_model_and_the_model_its_inverse() -> None:
    rng = np.random.default_rng(1)
    worst = 0.0
    for _ in range(300):
        model = draw_model(rng)
        memory = draw_memory(rng, model)
        u = random_walk(rng, 2000)
        y, after = model.run(u, memory)
        back, after_inverse = model.inverse_run(y, memory)
        flattest, _ = model.slope_sector_m_per_V
        scale = np.abs(y).max()
        worst = max(worst, np.abs(back - u).max() * flattest / scale)
        worst = max(worst, np.abs(model.run(back, memory)[0] - y).max() / scale)
        np.testing.assert_allclose(after_inverse, after, atol=1e-11)
    assert worst < 2e-14  # some roundings of the output, seen through the flattest slope


def test_a_memory_that_is_not_nested_breaks_the_inverse(rng: np.random.Generator) -> None:
    plays = PrandtlIshlinskii(threshold=np.array([0.0, 1, 2, 3]), weight=np.full(4, 0.25))
    memory = np.array([0.0, 0.9, -1.5, 2.5])  # within r of the input, but not nested
    assert not is_admissible(memory, 0.0, plays.threshold)
    u = 0.4 * random_walk(rng, 300)
    y, _ = plays.run(u, memory)
    back, _ = plays.inverse().run(y, plays.inverse_memory(memory))
    assert np.abs(back - u).max() > 0.1


def test_a_map_that_is_flat_anywhere_has_no_inverse() -> None:
    for last, invertible in ((-0.999, True), (-1.0, False), (-1.001, False)):
        zones = DeadZones(threshold=np.array([0.0, 1.0]), weight=np.array([1.0, last]))
        assert zones.is_invertible is invertible
        assert np.ptp(zones.run(np.array([1.0, 2.0]))) == pytest.approx(abs(1.0 + last))


def test_admissible_memory_stays_admissible(rng: np.random.Generator) -> None:
    for _ in range(50):
        plays = draw_plays(rng)
        r = plays.threshold
        u = random_walk(rng, 200)
        z, _ = play_columns(u, r, project_memory(rng.normal(0, 3, len(r)), u[0], r))
        assert all(is_admissible(z[k], u[k], r) for k in range(200))


def test_memory_map_holds_at_every_time(rng: np.random.Generator) -> None:
    for _ in range(30):
        plays = draw_plays(rng)
        memory = project_memory(rng.normal(0, 2, len(plays.weight)), 0.3, plays.threshold)
        u = random_walk(rng, 60)
        state, inverse = memory, plays.inverse()
        backward = plays.inverse_memory(memory)
        for value in u:
            y, state = plays.run(np.array([value]), state)
            _, backward = inverse.run(y, backward)
            np.testing.assert_allclose(plays.inverse_memory(state), backward, atol=ROUNDING)


def test_synchronised_compensation_survives_clipping_and_rounding() -> None:
    rng = np.random.default_rng(3)
    model = draw_model(rng)
    target, _ = model.run(4.5 * np.sin(np.arange(5000) / 90.0), model.virgin_memory())
    converter = Converter(minimum_V=-3.5, maximum_V=3.5, lsb_V=0.05)
    errors = {}
    for synchronise in (True, False):
        applied, _ = compensate(
            model, target, model.virgin_memory(), converter, synchronise=synchronise
        )
        reached, _ = model.run(applied, model.virgin_memory())
        free = np.abs(applied) < 3.4
        errors[synchronise] = np.abs(reached - target)[free].max()
        np.testing.assert_allclose(applied / 0.05, np.round(applied / 0.05), atol=1e-9)
    half_step = 0.5 * 0.05 * model.slope_sector_m_per_V[1]
    assert errors[True] <= half_step * (1 + 1e-9)
    assert errors[False] > 5 * errors[True]


def test_without_a_converter_compensation_is_the_inverse(rng: np.random.Generator) -> None:
    model = draw_model(rng)
    memory = draw_memory(rng, model)
    y, _ = model.run(random_walk(rng, 400), memory)
    applied, after = compensate(model, y, memory, Converter())
    command, expected = model.inverse_run(y, memory)
    np.testing.assert_allclose(applied, command, atol=ROUNDING)
    np.testing.assert_allclose(after, expected, atol=ROUNDING)


def test_a_play_forgets_exactly_when_the_range_reaches_twice_its_threshold() -> None:
    rng = np.random.default_rng(5)
    r = np.array([0.2, 0.7, 1.5, 9.0])
    u = random_walk(rng, 800)
    when = forgetting_sample(u, r)
    low, high = project_memory(np.full(4, -9.0), u[0], r), project_memory(np.full(4, 9.0), u[0], r)
    apart = np.abs(play_columns(u, r, low)[0] - play_columns(u, r, high)[0])
    for i, k in enumerate(when.astype(int)):
        if r[i] == 9.0:
            assert k == 800
        assert (apart[k:, i] == 0).all()
        assert k == 0 or apart[k - 1, i] > 0


def test_branches_obey_masings_rule(rng: np.random.Generator) -> None:
    plays = draw_plays(rng)
    peak = 1.5 * plays.threshold[-1]
    down = np.linspace(peak, -peak, 400)
    y, _ = plays.run(np.concatenate([[-peak, peak], down]), plays.virgin_memory())
    branch = y[2:]
    expected = branch[0] - 2 * plays.loading_curve((peak - down) / 2)
    np.testing.assert_allclose(branch, expected, atol=ROUNDING)


def test_minor_loops_of_equal_span_are_equal_at_every_bias(rng: np.random.Generator) -> None:
    plays = draw_plays(rng)
    loop = np.concatenate([np.linspace(0, 1, 50), np.linspace(1, 0, 50)])
    shapes = []
    for bias, approach in ((0.0, -5.0), (1.3, 5.0), (-2.0, 0.4)):
        u = np.concatenate([[approach, bias], bias + loop, bias + loop])
        y, _ = plays.run(u, plays.virgin_memory())
        shapes.append(y[-100:] - y[-100])
    np.testing.assert_allclose(shapes[1], shapes[0], atol=ROUNDING)
    np.testing.assert_allclose(shapes[2], shapes[0], atol=ROUNDING)


def test_worst_case_bounds_every_input_and_is_attained(rng: np.random.Generator) -> None:
    for _ in range(100):
        first, second = draw_plays(rng), draw_plays(rng)
        reach = float(rng.uniform(0.5, 4))
        found = worst_case(first, second, reach)
        for u in (
            np.clip(random_walk(rng, 400), -reach, reach),
            reach * np.sin(np.arange(300) / 9) * np.exp(-np.arange(300) / 90),
        ):
            gap = first.run(u, first.virgin_memory())[0] - second.run(u, second.virgin_memory())[0]
            assert np.abs(gap).max() <= found.bound + ROUNDING
        assert np.abs(found.extrema).max() <= reach + ROUNDING
        at = [p.run(found.extrema, p.virgin_memory())[0][-1] for p in (first, second)]
        assert abs(abs(at[0] - at[1]) - found.bound) < ROUNDING


def test_increments_stay_in_the_slope_sector(rng: np.random.Generator) -> None:
    for _ in range(30):
        model = draw_model(rng)
        u = random_walk(rng, 800, step=0.05)
        y, _ = model.run(u, draw_memory(rng, model))
        low, high = model.slope_sector_m_per_V
        gain = np.diff(y) / np.diff(u)
        assert gain.min() >= low - 1e-6
        assert gain.max() <= high + 1e-6


def test_gauge_changes_numbers_but_not_the_operator(rng: np.random.Generator) -> None:
    model = draw_model(rng)
    zones = DeadZones(threshold=model.dead_zones.threshold / 3, weight=model.dead_zones.weight * 3)
    plays = PrandtlIshlinskii(threshold=model.plays.threshold, weight=model.plays.weight / 3)
    other = type(model)(plays=plays, dead_zones=zones, displacement_offset_m=0.4)
    u = random_walk(rng, 200)
    np.testing.assert_allclose(
        other.regauged().run(u, other.virgin_memory())[0],
        other.run(u, other.virgin_memory())[0],
        atol=ROUNDING,
    )
    assert other.regauged().dead_zones.slope[other.dead_zones.zero] == pytest.approx(1.0)


def test_weights_without_an_inverse_are_refused_with_their_number() -> None:
    plays = PrandtlIshlinskii(threshold=np.array([0.0, 1]), weight=np.array([0.5, -0.7]))
    with pytest.raises(NotInvertibleError, match=r"W_1 is -0.2"):
        plays.inverse()
    zones = DeadZones(threshold=np.array([0.0, 1]), weight=np.array([1.0, -1.5]))
    with pytest.raises(NotInvertibleError, match=r"-0.5"):
        zones.inverse()
