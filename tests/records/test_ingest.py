"""From files to recordings: units, axes, and refusals with a remedy."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from piezoid.errors import LabFileError, UnitError
from piezoid.records.collection import collect
from piezoid.records.inspection import inspect_files
from piezoid.records.lab import Acquisition, Lab, RecordingEntry, Sensor, read_lab
from piezoid.records.recording import Quantity
from tests.records.tables import (
    RESPONSE,
    VOLTAGE_V,
    RATE_Hz,
    TIME_s,
    lab_with,
    statements_of,
    table,
)


def test_units_are_converted_to_si(tmp_path):
    recording = collect([table(
            tmp_path, "time [ms],drive (mV),position_nm,temp [°C],current [pA],RH [%]",
            1e3 * TIME_s, 1e3 * VOLTAGE_V, RESPONSE, 20 + TIME_s, RESPONSE, 40 + TIME_s,
        )])[0]  # fmt: skip
    assert recording.sampling_rate_Hz == RATE_Hz
    np.testing.assert_allclose(recording.voltage_V(), VOLTAGE_V, rtol=1e-8)
    np.testing.assert_allclose(recording.displacement_m(), RESPONSE * 1e-9, rtol=1e-8)
    np.testing.assert_allclose(recording.tunnel_current_A(), RESPONSE * 1e-12, rtol=1e-8)
    first = [channel.values[0] for channel in recording.channels]
    assert first[2] == pytest.approx(293.15)
    assert first[4] == pytest.approx(0.4)


def test_two_axes_have_separate_channels(tmp_path):
    recording = collect([table(
            tmp_path, "time [s],voltage_x [V],voltage_y [V],pos_x [um],pos_y [um]",
            TIME_s, VOLTAGE_V, 0.1 * VOLTAGE_V, RESPONSE, 0.1 * RESPONSE,
        )])[0]  # fmt: skip
    assert recording.axes == ("x", "y")
    assert recording.axis == "x"
    assert [p.quantity for p in recording.statements] == ["several_axes"]
    np.testing.assert_allclose(recording.voltage_V("y"), 0.1 * VOLTAGE_V, rtol=1e-8)
    # A column without an axis belongs to the only named axis.
    path = table(tmp_path, "time [s],voltage [V],position_z [um]", TIME_s, VOLTAGE_V, RESPONSE)
    assert collect([path])[0].complete_axes == ("z",)


def test_a_second_drive_does_not_claim_columns_without_axis(tmp_path):
    path = table(
        tmp_path, "time [s],voltage [V],displacement [um],voltage_y [V]",
        TIME_s, VOLTAGE_V, RESPONSE, RESPONSE,
    )  # fmt: skip
    recording = collect([path])[0]
    assert recording.axis == "x"
    assert recording.find(Quantity.VOLTAGE, "y") is not None


@pytest.mark.parametrize(
    ("heading", "has_axis", "is_read"),
    [
        ("voltage_y [V]", True, True),
        ("voltage_y [um]", True, False),  # no drive
        ("monitor_y [V]", True, False),  # a drive by its unit only
        ("voltage_x [V]", True, False),  # of the same axis as the declared drive
        ("voltage_y [V]", False, False),  # the axis of the declared columns is not stated
    ],
)
def test_drives_of_other_axes_are_read_with_declared_columns(tmp_path, heading, has_axis, is_read):
    path = table(
        tmp_path, f"time [s],U [V],s [um],{heading}", TIME_s, VOLTAGE_V, RESPONSE, 0.1 * VOLTAGE_V
    )
    entry = RecordingEntry(
        file=path.name,
        axis="x" if has_axis else None,
        columns={"voltage": "U [V]", "displacement": "s [um]"},
    )
    recording = collect([path], Lab(recordings=(entry,)))[0]
    np.testing.assert_allclose(recording.voltage_V("x"), VOLTAGE_V, rtol=1e-8)
    assert (recording.find(Quantity.VOLTAGE, "y") is not None) is is_read


@pytest.mark.parametrize(
    ("headings", "reason"),
    [
        ("time [s],voltage,displacement [um]", "voltage without a unit"),
        ("time [s],voltage [V],displacement", "displacement without a unit"),
        ("time,voltage [V],displacement [um]", "time without a unit"),
        (
            "t,drive,pos",
            r"a time, column 2 'drive' a voltage, column 3 'pos' a displacement, each",
        ),
        ("X_Value,DAC,Sensor", r"displacement without a unit; no column is a drive"),
        ("t,drive,pos", r'voltage = "drive", displacement = "pos" }'),
        ("time [s],CH 1 (V),CH 2 (V)", "in volts may be a drive or a sensor's output"),
        ("time [s],pos A [um],pos B [um]", "both claim to be the displacement of x"),
        ("time [s],voltage [A],displacement [um]", "voltage by name but in A"),
        ("time [s],foo,bar", "no column is a drive voltage or a displacement"),
        ("voltage [V],displacement [um],foo", "no column is a time"),
        ("time [s],time2 [s],displacement [um]", "both a time"),
        ("time [s],voltage [V],sensor voltage [V]", r"\[sensor\]\ngain_V_per_m"),
    ],
)
def test_an_ambiguous_heading_is_refused_with_the_lines_to_write(headings, reason, tmp_path):
    headings = headings.replace("time2", "elapsed")
    with pytest.raises(UnitError, match=reason):
        collect([table(tmp_path, headings, TIME_s, VOLTAGE_V, RESPONSE)])[0]


def test_an_incomplete_entry_is_named_with_what_it_lacks(tmp_path):
    path = table(tmp_path, "X_Value,DAC,Sensor", TIME_s, VOLTAGE_V, RESPONSE)
    columns = {"time": "X_Value", "voltage": "DAC", "displacement_z": "Sensor"}
    lab = lab_with(axis="z", columns=columns, units={"time": "s"})
    with pytest.raises(UnitError, match="states no unit of displacement_z") as refusal:
        collect([path], lab)
    assert 'displacement_z = "..."' in refusal.value.remedy
    assert "[[recording]]" not in refusal.value.remedy
    (inspection,) = inspect_files([path], lab)
    assert all("lab.toml" in column.meaning for column in inspection.columns)
    complete = lab_with(axis="z", columns=columns, units={"time": "s", "displacement_z": "um"})
    recording = collect([path], complete)[0]
    np.testing.assert_allclose(recording.displacement_m("z"), RESPONSE * 1e-6, rtol=1e-8)


def test_a_refusal_proposes_the_axis_of_the_other_recordings(tmp_path):
    path = table(tmp_path, "t,drive,pos", TIME_s, VOLTAGE_V, RESPONSE)
    with pytest.raises(UnitError, match='axis = "z"'):
        collect([path], Lab(recordings=(RecordingEntry(file=str(path.parent), axis="z"),)))


def test_columns_and_units_of_lab_toml_replace_the_headings(tmp_path):
    path = table(tmp_path, "time [s],U,pos", TIME_s, VOLTAGE_V, RESPONSE)
    lab = lab_with(
        axis="y",
        columns={"time": "time [s]", "voltage": "U", "displacement": "pos"},
        units={"displacement": "um"},
    )
    recording = collect([path], lab)[0]
    assert recording.axis == "y"
    np.testing.assert_allclose(recording.displacement_m(), RESPONSE * 1e-6, rtol=1e-8)
    assert [p.quantity for p in recording.statements] == ["unit_assumed"]


@pytest.mark.parametrize(("unit", "is_stated"), [("nm", True), ("um", False), ("µm", False)])
def test_a_unit_of_lab_toml_that_contradicts_the_heading_is_stated_with_both(
    tmp_path, unit, is_stated
):
    path = table(tmp_path, "time [s],voltage [V],position [um]", TIME_s, VOLTAGE_V, RESPONSE)
    lab = lab_with(
        columns={"time": 1, "voltage": 2, "displacement": 3}, units={"displacement": unit}
    )
    statements = statements_of(collect([path], lab)[0], "unit_contradicts_heading")
    assert len(statements) == is_stated
    assert all("um in its heading, lab.toml nm" in s.text for s in statements)


def test_volts_of_a_sensor_become_a_displacement_by_its_gain(tmp_path):
    headings = "time [s],voltage_z [V],sensor_z [V]"
    path = table(tmp_path, headings, TIME_s, VOLTAGE_V, RESPONSE)
    recording = collect([path], Lab(sensor=Sensor(gain_V_per_m=2e5)))[0]
    np.testing.assert_allclose(recording.displacement_m(), RESPONSE / 2e5, rtol=1e-8)


def test_a_table_without_time_has_the_rate_of_lab_toml(tmp_path):
    path = table(tmp_path, "voltage [V],displacement [um]", VOLTAGE_V, RESPONSE)
    lab = Lab(acquisition=Acquisition(sampling_rate_Hz=20000))
    (recording,) = collect([path], lab)
    assert recording.sampling_rate_Hz == 20000
    (statement,) = recording.statements
    assert statement.quantity == "controller_rate"
    assert statement.value == 20000
    assert "20000 Hz" in statement.text
    assert "[acquisition] of lab.toml" in statement.text
    confirmed = lab_with(sampling_rate_Hz=500)
    assert collect([path], replace(confirmed, acquisition=lab.acquisition))[0].statements == ()
    assert collect([path], confirmed)[0].sampling_rate_Hz == 500


@pytest.mark.parametrize(
    ("headings", "completed"),
    [("time,voltage,position", ("s", "V", "um")), ("voltage [V],position [um]", ("V", "um"))],
)
def test_the_entry_of_a_refusal_is_valid_once_completed(tmp_path, headings, completed):
    columns = (TIME_s, VOLTAGE_V, RESPONSE)[-len(completed) :]
    path = table(tmp_path, headings, *columns)
    with pytest.raises(UnitError) as refusal:
        collect([path], Lab())
    entry = refusal.value.remedy[refusal.value.remedy.index("[[recording]]") :]
    assert all(len(line) < 80 for line in entry.splitlines())  # a terminal does not break it
    # Columns that the headings identify are filled in.
    blanks = entry.partition("#")[0].count('"..."')
    values = iter((*headings.split(",")[-2:], *completed)[-blanks:])
    entry = re.sub('"\\.\\.\\."', lambda _: json.dumps(next(values)), entry.partition("#")[0])
    (tmp_path / "lab.toml").write_text(entry.replace("...", "1000"))
    (recording,) = collect([path], read_lab(tmp_path / "lab.toml"))
    assert recording.sampling_rate_Hz == 1000
    np.testing.assert_allclose(recording.displacement_m(), RESPONSE * 1e-6, rtol=1e-8)


def test_entries_select_time_ranges_and_may_not_contradict_the_clock(tmp_path):
    path = table(tmp_path, "time [s],voltage [V],pos [um]", TIME_s, VOLTAGE_V, RESPONSE)
    with pytest.raises(LabFileError, match="1000 Hz"):
        collect([path], lab_with(sampling_rate_Hz=20000))[0]
    recording = collect([path], lab_with(start_s=0.1, stop_s=0.2))[0]
    assert recording.samples == 101
    np.testing.assert_allclose(recording.voltage_V(), VOLTAGE_V[100:201], rtol=1e-8)
    with pytest.raises(LabFileError, match="start_s"):
        collect([path], lab_with(start_s=9.0))[0]
    entries = (
        RecordingEntry(file="run.csv", stop_s=0.1),
        RecordingEntry(file="run.csv", start_s=0.2),
    )
    lab = Lab(recordings=entries)
    assert [r.samples for r in collect([path], lab).recordings] == [101, 200]


def test_a_missing_column_of_lab_toml_is_refused(tmp_path):
    path = table(tmp_path, "time [s],U [V],pos [um]", TIME_s, VOLTAGE_V, RESPONSE)
    for columns in ({"voltage": "Umon"}, {"voltage": 9}, {"voltage": 2, "displacement": 2}):
        with pytest.raises(LabFileError, match=r"run\.csv has no column"):
            collect([path], lab_with(columns=columns))[0]
    with pytest.raises(LabFileError, match="one of time, voltage"):
        collect([path], lab_with(columns={"speed": 2}))[0]
    with pytest.raises(LabFileError, match="furlong"):
        collect([path], lab_with(units={"displacement": "furlong"}))[0]


@pytest.mark.parametrize(
    ("unit", "factor", "message"),
    [
        ("nm", 1e-6, "In m or mm it would be usual"),  # metres, labelled nm
        ("um", 1e24, "to 1 m"),
        ("um", 1e-310, "to 1 m"),
    ],
)
def test_an_implausible_displacement_is_refused_with_the_usual_unit(
    unit, factor, message, tmp_path
):
    rows = "".join(f"{k / 100},{k % 20},{1.7 * (k % 20) * factor!r}\n" for k in range(200))
    (tmp_path / "s.csv").write_text(f"time [s],voltage [V],position [{unit}]\n{rows}")
    with pytest.raises(UnitError, match=message):
        collect([tmp_path / "s.csv"])[0]
