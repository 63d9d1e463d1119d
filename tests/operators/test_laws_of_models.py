"""The laws of play sums, kinked curves and whole models: inverses, memory maps, slopes, bounds."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones, from_slopes
from piezoid.operators.modified_prandtl_ishlinskii import (
    Converter,
    ModifiedPrandtlIshlinskii,
    compensate,
)
from piezoid.operators.play import is_admissible, play_columns
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.operators.worst_case import worst_case
from tests.operators.strategies import (
    GRID,
    REACH,
    drives,
    kinked_curves,
    memories,
    models,
    play_sums,
)

ROUNDING = 1e-12  # a hundred operations on numbers of which the steepest is 100 times the flattest


def close(found: Array, wanted: Array, size: float) -> None:
    """Equal to the rounding of numbers of this size."""
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=ROUNDING * size)


def size_of(model: ModifiedPrandtlIshlinskii) -> tuple[float, float]:
    """The largest voltage and displacement that such a drive brings up anywhere inside."""
    envelope = model.envelope.slope.max() * (REACH + abs(model.voltage_offset_V))
    volts = REACH + model.envelope.threshold[-1] + envelope + model.plays.threshold[-1]
    _, steepest = model.slope_sector_m_per_V
    return volts, steepest * volts + abs(model.displacement_offset_m)


@given(st.data(), models(), drives())
def test_model_and_inverse_undo_each_other_from_every_memory(
    data: st.DataObject, model: ModifiedPrandtlIshlinskii, drive: Array
) -> None:
    memory = data.draw(memories(model.plays.threshold))
    y, after = model.run(drive, memory)
    back, after_inverse = model.inverse_run(y, memory)
    flattest, _ = model.slope_sector_m_per_V
    _, metres = size_of(model)
    close(back, drive, metres / flattest)
    close(after_inverse, after, metres / flattest * model.envelope.slope.max())
    close(model.run(back, memory)[0], y, metres / flattest * model.slope_sector_m_per_V[1])


@given(st.data(), models(), drives())
def test_the_inverse_reaches_every_displacement_it_is_asked_for(
    data: st.DataObject, model: ModifiedPrandtlIshlinskii, wanted: Array
) -> None:
    memory = data.draw(memories(model.plays.threshold))
    drive, _ = model.inverse_run(wanted, memory)
    low, high = model.slope_sector_m_per_V
    reached, _ = model.run(drive, memory)
    close(reached, wanted, high * (np.abs(drive).max() + size_of(model)[1] / low))


@given(st.data(), st.integers(-9, 9), st.integers(-12, 6))
def test_units_change_the_numbers_of_a_model_and_not_what_it_does(
    data: st.DataObject, power_V: int, power_m: int
) -> None:
    plain = data.draw(models())
    unit_V, unit_m = 10.0**power_V, 10.0**power_m
    scaled = ModifiedPrandtlIshlinskii(
        plays=PrandtlIshlinskii(
            threshold=plain.plays.threshold * unit_V,
            weight=plain.plays.weight * (unit_m / unit_V),
        ),
        dead_zones=DeadZones(
            threshold=plain.dead_zones.threshold * unit_m, weight=plain.dead_zones.weight
        ),
        voltage_offset_V=plain.voltage_offset_V * unit_V,
        displacement_offset_m=plain.displacement_offset_m * unit_m,
        envelope=DeadZones(
            threshold=plain.envelope.threshold * unit_V, weight=plain.envelope.weight
        ),
    )
    drive, memory = data.draw(drives()), data.draw(memories(plain.plays.threshold))
    y, after = plain.run(drive, memory)
    y_scaled, after_scaled = scaled.run(drive * unit_V, memory * unit_V)
    volts, metres = size_of(plain)
    close(y_scaled / unit_m, y, metres)
    close(after_scaled / unit_V, after, volts)
    back, _ = scaled.inverse_run(y_scaled, memory * unit_V)
    close(back / unit_V, drive, metres / plain.slope_sector_m_per_V[0])


@given(st.data(), models(), drives(least=2))
def test_every_increment_lies_in_the_slope_sector(
    data: st.DataObject, model: ModifiedPrandtlIshlinskii, drive: Array
) -> None:
    y, _ = model.run(drive, data.draw(memories(model.plays.threshold)))
    # The first sample may still follow from a memory of another voltage.
    rise, step = np.diff(y), np.diff(drive)
    low, high = model.slope_sector_m_per_V
    slack = ROUNDING * size_of(model)[1]
    assert (np.sign(step) * rise >= low * np.abs(step) - slack).all()
    assert (np.sign(step) * rise <= high * np.abs(step) + slack).all()


@given(st.data(), models(), drives())
def test_an_envelope_is_a_curve_in_front_of_the_plays_and_dead_zones_one_behind(
    data: st.DataObject, model: ModifiedPrandtlIshlinskii, drive: Array
) -> None:
    memory = data.draw(memories(model.plays.threshold))
    bent = model.envelope.columns(drive - model.voltage_offset_V) @ model.envelope.weight
    states, after = play_columns(bent, model.plays.threshold, memory)
    h = states @ model.plays.weight
    y = model.dead_zones.columns(h) @ model.dead_zones.weight + model.displacement_offset_m
    found, found_after = model.run(drive, memory)
    volts, metres = size_of(model)
    close(found, y, 10 * metres)
    close(found_after, after, 10 * volts)


@given(st.data(), play_sums(), drives())
def test_the_inverse_memory_is_the_map_of_the_memory_at_every_time(
    data: st.DataObject, plays: PrandtlIshlinskii, drive: Array
) -> None:
    memory = data.draw(memories(plays.threshold))
    inverse, backward = plays.inverse(), plays.inverse_memory(memory)
    y, after = plays.run(drive, memory)
    _, carried = inverse.run(y, backward)
    reach = plays.slope.max() * (REACH + plays.threshold[-1])
    close(carried, plays.inverse_memory(after), reach)
    assert is_admissible(memory, memory[0], plays.threshold)
    gap = np.diff(inverse.threshold)
    assert (np.abs(np.diff(backward)) <= gap + ROUNDING * reach).all()


@given(play_sums())
def test_the_inverse_of_the_inverse_is_the_operator(plays: PrandtlIshlinskii) -> None:
    twice = plays.inverse().inverse()
    close(twice.threshold, plays.threshold, 100 * (1 + plays.threshold[-1]))
    close(twice.slope, plays.slope, 100 * plays.slope.max())


@given(play_sums(6), play_sums(6), drives())
def test_one_play_sum_behind_another_has_the_loading_curve_of_both(
    inner: PrandtlIshlinskii, outer: PrandtlIshlinskii, drive: Array
) -> None:
    """P_2 o P_1 = P with phi = phi_2(phi_1): kinks at both, from the virgin state."""
    kinks = np.union1d(
        inner.threshold,
        inner.inverse().loading_curve(outer.threshold),
    )
    assume(np.diff(kinks, append=np.inf).min() > 1e-6)
    middle = kinks + np.append(np.diff(kinks) / 2, 1.0)
    slope = (
        inner.slope[np.searchsorted(inner.threshold, middle) - 1]
        * outer.slope[
            np.searchsorted(outer.threshold, inner.loading_curve(middle), side="right") - 1
        ]
    )
    both = PrandtlIshlinskii(threshold=kinks, weight=np.diff(slope, prepend=0.0))
    between, _ = inner.run(drive, inner.virgin_memory())
    behind, _ = outer.run(between, outer.virgin_memory())
    close(
        both.run(drive, both.virgin_memory())[0], behind, 100 * slope.max() * (REACH + kinks[-1])
    )


@given(play_sums(), st.integers(1, 128))
def test_the_area_of_a_steady_loop_is_the_one_that_is_integrated(
    plays: PrandtlIshlinskii, top: int
) -> None:
    amplitude = top / GRID
    turns = np.concatenate([plays.threshold * 2, [2 * amplitude]])
    rise = -amplitude + np.unique(np.minimum(turns, 2 * amplitude))
    loop = np.concatenate([rise, -rise])
    y, _ = plays.run(np.concatenate([[amplitude], loop, loop]), plays.virgin_memory())
    u, y = loop, y[-len(loop) :]
    around = 0.5 * float(np.sum((u + np.roll(u, 1)) * (y - np.roll(y, 1))))
    size = plays.slope.max() * amplitude * (amplitude + plays.threshold[-1])
    assert plays.loop_area(amplitude) == pytest.approx(around, rel=0, abs=1e-11 * size)


@given(kinked_curves(), drives(most=80))
def test_a_kinked_curve_is_the_sum_of_its_zones_with_its_own_slopes(
    zones: DeadZones, drive: Array
) -> None:
    values, local = zones.run_with_slope(drive)
    size = zones.slope.max() * (REACH + np.abs(zones.threshold).max())
    close(values, zones.columns(drive) @ zones.weight, 10 * size)
    ahead, _ = zones.run_with_slope(drive + np.copysign(1 / GRID / 4, drive))
    # Kinks lie on the grid: between it and a quarter step outward there is none but at the point.
    onward = (ahead - values) / np.copysign(1 / GRID / 4, drive)
    inside = ~np.isin(drive, zones.threshold)
    np.testing.assert_allclose(local[inside], onward[inside], rtol=1e-9)
    inner = np.isin(drive, zones.threshold[zones.threshold != 0.0])
    behind = (values - zones.run(drive * (1 - 1e-6))) / (drive * 1e-6 + (drive == 0))
    np.testing.assert_allclose(local[inner], behind[inner], rtol=1e-5)


@given(kinked_curves(), drives())
def test_a_kinked_curve_and_its_inverse_undo_each_other(zones: DeadZones, drive: Array) -> None:
    inverse = zones.inverse()
    size = zones.slope.max() * (REACH + np.abs(zones.threshold).max()) / zones.slope.min()
    close(inverse.run(zones.run(drive)), drive, size)
    close(zones.run(inverse.run(drive)), drive, size * zones.slope.max())
    np.testing.assert_allclose(inverse.slope, 1.0 / zones.slope, rtol=1e-9)
    np.testing.assert_allclose(
        from_slopes(zones.threshold, zones.slope).weight, zones.weight, atol=1e-12
    )


@given(st.data(), models(), st.floats(1e-9, 1e9), drives())
def test_a_gauge_moves_metres_between_the_parts_and_nothing_else(
    data: st.DataObject, model: ModifiedPrandtlIshlinskii, c: float, drive: Array
) -> None:
    memory = data.draw(memories(model.plays.threshold))
    other = model.rescaled(c)
    wanted, _ = model.run(drive, memory)
    close(other.run(drive, memory)[0], wanted, size_of(model)[1])
    close(other.regauged().run(drive, memory)[0], wanted, size_of(model)[1])
    central = other.regauged().dead_zones
    assert central.weight[central.zero] == pytest.approx(1.0, rel=1e-15)


@given(st.data(), models(), drives(), st.integers(1, 32), drives(2, 2))
def test_what_is_applied_is_a_step_within_the_limits_and_its_memory_is_the_models(
    data: st.DataObject,
    model: ModifiedPrandtlIshlinskii,
    drive: Array,
    step: int,
    limits: Array,
) -> None:
    memory = data.draw(memories(model.plays.threshold))
    low, high = sorted(limits)
    converter = Converter(minimum_V=low, maximum_V=high, lsb_V=step / GRID)
    wanted, _ = model.run(drive, memory)
    applied, after = compensate(model, wanted, memory, converter)
    assert ((low <= applied) & (applied <= high)).all()
    steps = applied / converter.lsb_V
    assert ((steps == np.round(steps)) | (applied == low) | (applied == high)).all()
    reached, expected = model.run(applied, memory)
    close(after, expected, size_of(model)[0])
    # Farther than a step from both limits nothing was clipped before it was rounded.
    inside = np.minimum(applied - low, high - applied) >= converter.lsb_V
    half = 0.5 * converter.lsb_V * model.slope_sector_m_per_V[1]
    slack = ROUNDING * size_of(model)[1] / model.slope_sector_m_per_V[0] * 100
    assert (np.abs(reached - wanted)[inside] <= half * (1 + 1e-9) + slack).all()


@given(play_sums(), play_sums(), play_sums(), st.integers(1, 128), drives())
def test_the_worst_case_is_a_distance_that_no_drive_exceeds_and_its_own_reaches(
    first: PrandtlIshlinskii,
    second: PrandtlIshlinskii,
    third: PrandtlIshlinskii,
    top: int,
    drive: Array,
) -> None:
    reach = top / GRID
    found = worst_case(first, second, reach)
    slack = ROUNDING * (first.slope.max() + second.slope.max()) * 100

    def gap(u: Array) -> Array:
        outputs = [plays.run(u, plays.virgin_memory())[0] for plays in (first, second)]
        return np.abs(outputs[0] - outputs[1])

    assert (gap(np.clip(drive, -reach, reach)) <= found.bound + slack).all()
    assert gap(found.extrema)[-1] == pytest.approx(found.bound, rel=1e-9, abs=slack)
    assert worst_case(second, first, reach).bound == pytest.approx(found.bound, rel=1e-12)
    around = worst_case(first, third, reach).bound + worst_case(third, second, reach).bound
    assert found.bound <= around + slack
    assert worst_case(first, first, reach).bound == 0.0
