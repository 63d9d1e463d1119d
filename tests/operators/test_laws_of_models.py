"""Laws of models: inverses from every memory, units, slopes, gauges, order of the operators."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.play import play_columns
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from tests.operators.strategies import REACH, ROUNDING, assert_close, drives, memories, models


def size_of(model: ModifiedPrandtlIshlinskii) -> tuple[float, float]:
    """Return the largest voltage and displacement that a drive causes inside the model."""
    envelope = model.envelope.slope.max() * (REACH + abs(model.voltage_offset_V))
    volts = REACH + model.envelope.threshold[-1] + envelope + model.plays.threshold[-1]
    _, steepest = model.slope_sector_m_per_V
    return volts, steepest * volts + abs(model.displacement_offset_m)


@given(st.data(), models(), drives())
def test_model_and_inverse_undo_each_other_from_every_memory(data, model, drive):
    memory = data.draw(memories(model.plays.threshold))
    y, final_memory = model.run(drive, memory)
    voltage, inverse_memory = model.inverse_run(y, memory)
    flattest, _ = model.slope_sector_m_per_V
    _, metres = size_of(model)
    assert_close(voltage, drive, metres / flattest)
    assert_close(inverse_memory, final_memory, metres / flattest * model.envelope.slope.max())
    assert_close(
        model.run(voltage, memory)[0], y, metres / flattest * model.slope_sector_m_per_V[1]
    )


@given(st.data(), st.integers(-9, 9), st.integers(-12, 6))
def test_units_change_the_numbers_of_a_model_and_not_what_it_does(data, power_V, power_m):
    model = data.draw(models())
    unit_V, unit_m = 10.0**power_V, 10.0**power_m
    scaled = ModifiedPrandtlIshlinskii(
        plays=PrandtlIshlinskii(
            threshold=model.plays.threshold * unit_V, weight=model.plays.weight * (unit_m / unit_V)
        ),
        dead_zones=DeadZones(
            threshold=model.dead_zones.threshold * unit_m, weight=model.dead_zones.weight
        ),
        voltage_offset_V=model.voltage_offset_V * unit_V,
        displacement_offset_m=model.displacement_offset_m * unit_m,
        envelope=DeadZones(
            threshold=model.envelope.threshold * unit_V, weight=model.envelope.weight
        ),
    )
    drive, memory = data.draw(drives()), data.draw(memories(model.plays.threshold))
    y, final_memory = model.run(drive, memory)
    y_scaled, final_memory_scaled = scaled.run(drive * unit_V, memory * unit_V)
    volts, metres = size_of(model)
    assert_close(y_scaled / unit_m, y, metres)
    assert_close(final_memory_scaled / unit_V, final_memory, volts)
    voltage, _ = scaled.inverse_run(y_scaled, memory * unit_V)
    assert_close(voltage / unit_V, drive, metres / model.slope_sector_m_per_V[0])


@given(st.data(), models(), drives(min_samples=2))
def test_every_increment_lies_in_the_slope_sector(data, model, drive):
    y, _ = model.run(drive, data.draw(memories(model.plays.threshold)))
    # The first sample may still follow from a memory of another voltage.
    rise, step = np.diff(y), np.diff(drive)
    low, high = model.slope_sector_m_per_V
    slack = ROUNDING * size_of(model)[1]
    assert (np.sign(step) * rise >= low * np.abs(step) - slack).all()
    assert (np.sign(step) * rise <= high * np.abs(step) + slack).all()


@given(st.data(), models(), drives())
def test_an_envelope_is_a_curve_in_front_of_the_plays_and_dead_zones_one_behind(
    data, model, drive
):
    memory = data.draw(memories(model.plays.threshold))
    envelope_V = model.envelope.columns(drive - model.voltage_offset_V) @ model.envelope.weight
    states, final_memory = play_columns(envelope_V, model.plays.threshold, memory)
    h = states @ model.plays.weight
    y = model.dead_zones.columns(h) @ model.dead_zones.weight + model.displacement_offset_m
    output, output_memory = model.run(drive, memory)
    volts, metres = size_of(model)
    assert_close(output, y, 10 * metres)
    assert_close(output_memory, final_memory, 10 * volts)


@given(st.data(), models(), st.floats(1e-9, 1e9), drives())
def test_a_gauge_moves_metres_between_the_parts_and_nothing_else(data, model, c, drive):
    memory = data.draw(memories(model.plays.threshold))
    rescaled = model.rescaled(c)
    expected, _ = model.run(drive, memory)
    assert_close(rescaled.run(drive, memory)[0], expected, size_of(model)[1])
    assert_close(rescaled.regauged().run(drive, memory)[0], expected, size_of(model)[1])
    central = rescaled.regauged().dead_zones
    assert central.weight[central.zero] == pytest.approx(1.0, rel=1e-15)
