"""Real-world headings and their units."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezoid.records.column_roles import meaning_of
from piezoid.records.recording import Quantity
from piezoid.records.units import Dimension, heading_of, unit_of


@pytest.mark.parametrize(
    ("label", "stem", "factor", "dimension"),
    [
        ("time [s]", "time", 1.0, Dimension.TIME),
        ("Voltage (V)", "Voltage", 1.0, Dimension.VOLTAGE),
        ("Position_um", "Position", 1e-6, Dimension.LENGTH),
        ("voltage_y [mV]", "voltage_y", 1e-3, Dimension.VOLTAGE),
        ("current [nA]", "current", 1e-9, Dimension.CURRENT),
        ("U/V", "U", 1.0, Dimension.VOLTAGE),
        ("Pos. X (µm)", "Pos. X", 1e-6, Dimension.LENGTH),
        ("Weg in mm", "Weg", 1e-3, Dimension.LENGTH),
        ("Current [00001] (A)", "Current [00001]", 1.0, Dimension.CURRENT),
        ("Input 3 (A) [bwd] [filt]", "Input 3 [bwd] [filt]", 1.0, Dimension.CURRENT),
        ("height / Å", "height", 1e-10, Dimension.LENGTH),
        ("t (minutes)", "t (minutes)", None, None),
        ("rel. humidity [%]", "rel. humidity", 1e-2, Dimension.RATIO),
        ("force (N)", "force", 1.0, Dimension.OTHER),
        ("a [m/s^2]", "a", 1.0, Dimension.OTHER),
    ],
)
def test_a_heading_is_parsed(label, stem, factor, dimension):
    heading = heading_of(label)
    assert heading.stem == stem
    assert (heading.unit and heading.unit.factor) == factor
    assert (heading.unit and heading.unit.dimension) == dimension


def test_the_abscissa_of_an_oscilloscope_is_its_clock():
    assert meaning_of(heading_of("x-axis [second]")).is_time


def test_celsius_has_an_offset_and_case_matters_in_symbols_only():
    unit = unit_of("degC")
    assert unit is not None
    assert 20 * unit.factor + unit.offset == pytest.approx(293.15)
    milli, mega = unit_of("mV"), unit_of("MV")
    assert milli is not None
    assert mega is not None
    assert mega.factor / milli.factor == pytest.approx(1e9)
    assert unit_of("VOLTS") is not None
    assert unit_of("S") is None


@pytest.mark.parametrize("label", ["V", "A", "m", "h", "sensor_h", "m_1", "voltage_x", "", "CH1"])
def test_a_single_letter_is_no_unit(label):
    assert heading_of(label).unit is None


@settings(max_examples=25)
@given(st.text(max_size=30))
def test_any_text_is_a_heading(label):
    heading = heading_of(label)
    meaning = meaning_of(heading)
    assert meaning.is_read is not bool(meaning.reason)


@pytest.mark.parametrize(
    ("label", "quantity", "axis"),
    [
        ("Ux [V]", Quantity.VOLTAGE, "x"),
        ("PositionZ_nm", Quantity.DISPLACEMENT, "z"),
        ("y [um]", Quantity.DISPLACEMENT, "y"),
        ("Temp [°C]", Quantity.TEMPERATURE, None),
        ("RH [%]", Quantity.HUMIDITY, None),
        ("tunnel current [pA]", Quantity.CURRENT, None),
        ("sensor voltage [V]", Quantity.DISPLACEMENT, None),
        ("drive command [V]", Quantity.VOLTAGE, None),
    ],
)
def test_names_and_units_determine_quantity_and_axis(label, quantity, axis):
    meaning = meaning_of(heading_of(label))
    assert (meaning.quantity, meaning.axis) == (quantity, axis)


@pytest.mark.parametrize(
    "label",
    ["setpoint [um]", "position error [nm]", "Bias (V)", "Amplitude (m)", "segment", "force [N]"],
)
def test_other_quantities_are_not_read(label):
    assert meaning_of(heading_of(label)).is_read is False
