"""Recordings from arrays and data frames: the same numbers in and out, and no guesses."""

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


def made(**changed) -> Recording:
    given = {"time_s": TIME_s, "voltage_V": VOLTAGE_V, "displacement_m": 1e-7 * VOLTAGE_V}
    return from_arrays(**{**given, **changed})


@pytest.mark.parametrize("file", ["x_sweep.csv", "x_rates.csv", "y_check.csv"])
def test_a_frame_of_a_file_is_the_recording_of_that_file(file: str) -> None:
    path = piezoid_datasets.FOLDER / file
    read, framed = collect([path])[0], from_frame(pd.read_csv(path), name=file)
    assert framed.sampling_rate_Hz == read.sampling_rate_Hz
    assert framed.axes == read.axes
    for one, other in zip(read.channels, framed.channels, strict=True):
        assert (one.quantity, one.axis) == (other.quantity, other.axis)
        assert np.array_equal(one.values, other.values)


def test_to_frame_and_back_is_the_identity() -> None:
    assert made().digest == made().digest != made(voltage_V=VOLTAGE_V + 1e-9).digest
    once = made(voltage_V={"x": VOLTAGE_V, "y": -VOLTAGE_V}, current_A=1e-9 * VOLTAGE_V)
    again = from_frame(to_frame(once), axis=once.axis)
    assert again.sampling_rate_Hz == pytest.approx(once.sampling_rate_Hz, rel=1e-12)
    assert {(c.quantity, c.axis) for c in again.channels} == {
        (Quantity.VOLTAGE, "x"),
        (Quantity.VOLTAGE, "y"),
        (Quantity.DISPLACEMENT, "x"),
        (Quantity.CURRENT, "x"),
    }
    for channel in once.channels:
        found = again.find(channel.quantity, channel.axis)
        assert found is not None
        assert np.array_equal(found.values, channel.values)


def test_breaks_come_back_as_breaks() -> None:
    torn = frame(**{"weg [um]": 0.1 * VOLTAGE_V})
    torn.loc[[50, 51, 120, 121], "weg [um]"] = np.nan
    once = from_frame(torn)
    assert once.breaks == (50, 118)
    again = from_frame(to_frame(once))
    assert again.breaks == once.breaks
    assert np.array_equal(again.displacement_m(), once.displacement_m())


def test_units_come_from_headings_or_are_told() -> None:
    found = from_frame(
        frame(gauge=0.1 * VOLTAGE_V).rename(columns={"U [V]": "piezo_mV"}),
        units={"gauge": "um"},
        columns={"voltage": "piezo_mV", "displacement": "gauge"},
    )
    assert np.allclose(found.voltage_V(), 1e-3 * VOLTAGE_V)
    assert np.allclose(found.displacement_m(), 1e-7 * VOLTAGE_V)


@pytest.mark.parametrize(
    "index",
    [
        pd.to_timedelta(TIME_s, unit="s"),
        pd.Timestamp("2024-02-03") + pd.to_timedelta(TIME_s, unit="s"),
        pd.Index(1e3 * TIME_s, name="time [ms]"),
    ],
)
def test_an_index_of_times_is_the_clock(index: pd.Index) -> None:
    table = frame(**{"weg [um]": VOLTAGE_V}).drop(columns="t [s]").set_index(index)
    assert from_frame(table).sampling_rate_Hz == pytest.approx(1000.0)


@pytest.mark.parametrize(
    ("table", "options", "said"),
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
def test_what_is_ambiguous_is_refused(table: pd.DataFrame, options: dict, said: str) -> None:
    with pytest.raises((UnitError, RecordingError), match=said):
        from_frame(table, **options)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"voltage_V": VOLTAGE_V[:-1]}, "different length: time 200, voltage_x 199"),
        ({"voltage_V": np.zeros((200, 2))}, r"shape \(200, 2\)"),
        ({"voltage_V": ["high"] * 200}, "values that are not numbers"),
        ({"time_s": None}, "neither time_s nor sampling_rate_Hz"),
        ({"sampling_rate_Hz": 1000.0}, "both time_s and sampling_rate_Hz"),
    ],
)
def test_arrays_of_other_shapes_are_refused(changed: dict, said: str) -> None:
    with pytest.raises(RecordingError, match=said):
        made(**changed)


def test_seconds_cut_a_recording_and_count_its_breaks_anew() -> None:
    torn = frame(**{"weg [um]": VOLTAGE_V})
    torn.loc[[100, 101], "weg [um]"] = np.nan
    whole = from_frame(torn)
    part = whole.seconds(0.05, 0.15)
    assert part.samples == 100
    assert part.breaks == (50,)
    assert np.array_equal(part.voltage_V(), whole.voltage_V()[50:150])
    assert part.name != whole.name
    assert part.digest != whole.digest
    assert whole.seconds(0.1).samples == whole.samples - 100
    with pytest.raises(RecordingError, match="from 3 s to 4 s asked"):
        whole.seconds(3.0, 4.0)
