"""Recordings from arrays and data frames: equal numbers, and refusals of ambiguous input."""

import numpy as np
import pandas as pd
import pytest

import piezoid_datasets
from piezoid.errors import RecordingError, UnitError
from piezoid.records.collection import collect
from piezoid.records.frames import from_arrays, from_frame, to_frame
from piezoid.records.recording import Quantity, Recording

TIME_s = np.arange(200) / 1000.0
VOLTAGE_V = 5.0 - 5.0 * np.cos(2.0 * np.pi * 10.0 * TIME_s)


def frame(**columns) -> pd.DataFrame:
    return pd.DataFrame({"t [s]": TIME_s, "U [V]": VOLTAGE_V, **columns})


def recording_with(**overrides) -> Recording:
    arguments = {"time_s": TIME_s, "voltage_V": VOLTAGE_V, "displacement_m": 1e-7 * VOLTAGE_V}
    return from_arrays(**{**arguments, **overrides})


@pytest.mark.parametrize("file", ["x_sweep.csv", "x_rates.csv", "y_check.csv"])
def test_a_data_frame_gives_the_recording_of_its_file(file):
    path = piezoid_datasets.FOLDER / file
    recording, framed = collect([path])[0], from_frame(pd.read_csv(path), name=file)
    assert framed.sampling_rate_Hz == recording.sampling_rate_Hz
    assert framed.axes == recording.axes
    for expected, channel in zip(recording.channels, framed.channels, strict=True):
        assert (expected.quantity, expected.axis) == (channel.quantity, channel.axis)
        assert np.array_equal(expected.values, channel.values)


def test_to_frame_and_back_is_the_identity():
    assert (
        recording_with().digest
        == recording_with().digest
        != recording_with(voltage_V=VOLTAGE_V + 1e-9).digest
    )
    recording = recording_with(
        voltage_V={"x": VOLTAGE_V, "y": -VOLTAGE_V}, current_A=1e-9 * VOLTAGE_V
    )
    read = from_frame(to_frame(recording), axis=recording.axis)
    assert read.sampling_rate_Hz == pytest.approx(recording.sampling_rate_Hz, rel=1e-12)
    assert {(c.quantity, c.axis) for c in read.channels} == {
        (Quantity.VOLTAGE, "x"),
        (Quantity.VOLTAGE, "y"),
        (Quantity.DISPLACEMENT, "x"),
        (Quantity.CURRENT, "x"),
    }
    for channel in recording.channels:
        read_channel = read.find(channel.quantity, channel.axis)
        assert read_channel is not None
        assert np.array_equal(read_channel.values, channel.values)


def test_breaks_are_kept_in_a_data_frame():
    table = frame(**{"weg [um]": 0.1 * VOLTAGE_V})
    table.loc[[50, 51, 120, 121], "weg [um]"] = np.nan
    recording = from_frame(table)
    assert recording.breaks == (50, 118)
    read = from_frame(to_frame(recording))
    assert read.breaks == recording.breaks
    assert np.array_equal(read.displacement_m(), recording.displacement_m())


def test_units_come_from_headings_or_arguments():
    recording = from_frame(
        frame(gauge=0.1 * VOLTAGE_V).rename(columns={"U [V]": "piezo_mV"}),
        units={"gauge": "um"},
        columns={"voltage": "piezo_mV", "displacement": "gauge"},
    )
    assert np.allclose(recording.voltage_V(), 1e-3 * VOLTAGE_V)
    assert np.allclose(recording.displacement_m(), 1e-7 * VOLTAGE_V)


@pytest.mark.parametrize(
    "index",
    [
        pd.to_timedelta(TIME_s, unit="s"),
        pd.Timestamp("2024-02-03") + pd.to_timedelta(TIME_s, unit="s"),
        pd.Index(1e3 * TIME_s, name="time [ms]"),
    ],
)
def test_an_index_of_times_is_the_clock(index):
    table = frame(**{"weg [um]": VOLTAGE_V}).drop(columns="t [s]").set_index(index)
    assert from_frame(table).sampling_rate_Hz == pytest.approx(1000.0)


@pytest.mark.parametrize(
    ("table", "options", "message"),
    [
        (frame(position=VOLTAGE_V), {}, "a displacement without a unit.*units="),
        (frame(position=VOLTAGE_V), {"units": {"position": "parsec"}}, "stated as 'parsec'"),
        (frame(**{"weg [um]": VOLTAGE_V}), {"units": {"weg [um]": "nm"}}, "names the unit um"),
        (frame(**{"weg [um]": VOLTAGE_V, "pos [nm]": VOLTAGE_V}), {}, "both claim to be"),
        (frame(**{"weg [um]": ["far"] * 200}), {}, "column 3 'weg .um.' is of type"),
        (frame(**{"weg [um]": VOLTAGE_V}), {"units": {"way": "um"}}, "0 columns are called 'way'"),
        (frame(**{"weg [um]": VOLTAGE_V}).drop(columns="t [s]"), {}, "no column is a time"),
        (pd.DataFrame({"note": ["a", "b"]}), {}, "no column of 1 holds numbers"),
        ({"U [V]": [1.0]}, {}, "dict given"),
    ],
)
def test_an_ambiguous_data_frame_is_refused(table, options, message):
    with pytest.raises((UnitError, RecordingError), match=message):
        from_frame(table, **options)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"voltage_V": VOLTAGE_V[:-1]}, "different length: time 200, voltage_x 199"),
        ({"voltage_V": np.zeros((200, 2))}, r"shape \(200, 2\)"),
        ({"voltage_V": ["high"] * 200}, "values that are not numbers"),
        ({"time_s": None}, "neither time_s nor sampling_rate_Hz"),
        ({"sampling_rate_Hz": 1000.0}, "both time_s and sampling_rate_Hz"),
    ],
)
def test_invalid_arrays_are_refused(overrides, message):
    with pytest.raises(RecordingError, match=message):
        recording_with(**overrides)


def test_a_time_range_of_a_recording_has_its_breaks():
    table = frame(**{"weg [um]": VOLTAGE_V})
    table.loc[[100, 101], "weg [um]"] = np.nan
    recording = from_frame(table)
    part = recording.seconds(0.05, 0.15)
    assert part.samples == 100
    assert part.breaks == (50,)
    assert np.array_equal(part.voltage_V(), recording.voltage_V()[50:150])
    assert part.name != recording.name
    assert part.digest != recording.digest
    assert recording.seconds(0.1).samples == recording.samples - 100
    with pytest.raises(RecordingError, match="from 3 s to 4 s asked"):
        recording.seconds(3.0, 4.0)
