"""Tables for a waveform generator: motion of known plants, limits of the hardware."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.errors import ParameterFileError
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.loop_shape_fit import with_loop_shape
from piezoid.targets.target_inputs import ControllerHardware, read_hardware
from piezoid.targets.waveform import (
    expected_error_m,
    scan_errors_m,
    waveform_files,
    waveform_of,
)
from piezoid.verification.closed_loop import run_law
from piezoid.verification.plant import Hysteresis, lateral_plant
from tests.identification.test_loop_shape import (
    NOISE_M,
    SWEEP,
    law_of,
    path_through,
    recorded,
    walk,
)
from tests.targets.known_inputs import csv_rows, exported
from tests.verification.rig import RATE_Hz


def inputs_with(**settings):
    return replace(exported(), hardware=ControllerHardware(**settings))


def table(**settings):
    return waveform_of(inputs_with(**settings), exported().lateral[0])


@pytest.mark.parametrize("shape", ["triangle", "sine"])
def test_the_identified_plant_follows_the_table_to_a_few_steps_of_its_converter(shape):
    inputs, axis = inputs_with(shape=shape), exported().lateral[0]
    waveform = waveform_of(inputs, axis)
    errors_m = scan_errors_m(inputs, axis, waveform)["identified"]
    step_m = waveform.step_V * 4e-6
    assert errors_m["waveform"] < 3 * step_m
    assert abs(errors_m["offset"]) < 0.2 * step_m
    assert errors_m["straight"] > 100 * errors_m["waveform"]
    assert np.ptp(waveform.wanted_m) > 1e-5


def test_sine_and_triangle_have_their_shape():
    sine, triangle = table(shape="sine").wanted_m, table().wanted_m
    middle_m = 0.5 * (sine.max() + sine.min())
    half_m = 0.5 * np.ptp(sine)
    turns = np.arange(len(sine)) / len(sine)
    np.testing.assert_allclose(sine, middle_m + half_m * np.sin(2 * np.pi * turns), atol=1e-12)
    straight = np.diff(triangle)[: len(triangle) // 5]
    np.testing.assert_allclose(straight, straight[0], rtol=1e-6)


def test_integer_codes_are_the_voltages_of_the_csv():
    files, _ = waveform_files(inputs_with(bits=12, rate_Hz=RATE_Hz / 4, range_V=(-5.0, 11.0)))
    rows = csv_rows(files["x.csv"])
    code = np.frombuffer(files["x_int16.bin"], dtype="<i2")
    assert len(code) == len(rows) == RATE_Hz / 4 / 10
    assert np.abs(code).max() < 2**11
    voltage_V = [float(row["voltage_V"]) for row in rows]
    np.testing.assert_allclose(3.0 + code * 16.0 / 2**12, voltage_V, rtol=1e-15)
    assert "voltage = 3.0 V + code x 0.00390625 V" in files["README.md"].decode()


def test_a_stage_of_negative_polarity_follows_its_waveform():
    inputs = exported()
    plant = inputs.plants[0]
    assert isinstance(plant.response, Hysteresis)
    mirrored = replace(plant, response=replace(plant.response, polarity=-1))
    model = replace(inputs.models["x"], polarity=-1)
    mirrored_inputs = replace(inputs, plants=(mirrored,), drawn={}, models={"x": model})
    waveform = waveform_of(
        replace(mirrored_inputs, hardware=ControllerHardware(half_range_m=1e-6)), inputs.lateral[0]
    )
    commands = iter(np.tile(waveform.voltage_V, 3).tolist())
    samples = 3 * len(waveform.wanted_m)
    run = run_law(
        replace(mirrored, noise_rms=0.0),
        lambda _reference, _measured: next(commands),
        np.zeros(samples),
        rng=np.random.default_rng(0),
    )
    np.testing.assert_allclose(
        run.position[-len(waveform.wanted_m) :], waveform.wanted_m, atol=5e-9
    )


def test_a_fast_scan_over_a_mode_is_followed_with_a_smooth_drive():
    inputs = exported()
    mode = LinearMode(frequency_Hz=630.0, quality=20.0)
    model = replace(inputs.models["x"], extensions=(mode,))
    plant = lateral_plant(model, sampling_rate_Hz=RATE_Hz)
    hardware = ControllerHardware(frequency_Hz=200.0, half_range_m=5e-6)
    fast_inputs = replace(
        inputs, plants=(plant,), drawn={}, models={"x": model}, hardware=hardware
    )
    waveform = waveform_of(fast_inputs, inputs.lateral[0])
    errors_m = scan_errors_m(fast_inputs, inputs.lateral[0], waveform)["identified"]
    assert errors_m["waveform"] < 5e-8
    assert errors_m["straight"] > 10 * errors_m["waveform"]
    assert np.abs(np.diff(waveform.voltage_V)).max() < 0.5


@pytest.mark.slow
def test_loop_shape_makes_the_waveform_of_a_dahl_stage_accurate():
    base_inputs, recordings = (
        exported(),
        [recorded("dahl", SWEEP, "sweep"), recorded("dahl", walk(3), "walk")],
    )
    plays = estimate_axis(recordings, "x", Rig(), orders=((8, 2),))
    axis = with_loop_shape(plays, recordings)
    hardware = ControllerHardware(half_range_m=6e-6, frequency_Hz=2.0, rate_Hz=2e3)
    values = dict(base_inputs.lateral[0].values) | {
        "reference_minimum_m": axis.zero_m - 8e-6,
        "reference_maximum_m": axis.zero_m + 8e-6,
        "voltage_minimum_V": -5.0,
        "voltage_maximum_V": 5.0,
    }
    parameters = replace(base_inputs.lateral[0], values=values)
    errors_m = []
    for fit in (plays, axis):
        model = replace(fit, rig=Rig(sensor_bandwidth_Hz=2000.0))
        plant = lateral_plant(model, sampling_rate_Hz=RATE_Hz)
        inputs = replace(
            base_inputs, plants=(plant,), drawn={}, models={"x": model}, hardware=hardware
        )
        waveform = waveform_of(inputs, parameters)
        cycles = path_through(np.array([0.0, 1.0, -1.0, 1.0, -1.0]))
        field = np.concatenate([cycles, np.tile(waveform.voltage_V / 5.0, 3)])
        position_m = 2e-5 * law_of("dahl")(field)[-len(waveform.wanted_m) :]
        errors_m.append(float(np.std(position_m - waveform.wanted_m)))
        plant_errors_m = scan_errors_m(inputs, parameters, waveform)
        assert errors_m[-1] < 2.0 * expected_error_m(model, plant_errors_m)
    assert errors_m[1] < 0.35 * errors_m[0]
    assert errors_m[1] < 2.0 * NOISE_M


@pytest.mark.parametrize(
    ("settings", "message", "remedy"),
    [
        ({"points": 1000}, "the table holds 1000", {"points": 1000, "frequency_Hz": 20.0}),
        ({"frequency_Hz": 5e3}, "has 4 points", {"frequency_Hz": 625.0, "half_range_m": 1e-7}),
        ({"rate_Hz": 3e3}, "a rate that divides", {"rate_Hz": 4000.0}),
        ({"half_range_m": 1e-3}, "half_range_m of", {"half_range_m": 1e-6}),
    ],
)
def test_an_impossible_waveform_is_refused_and_its_remedy_works(settings, message, remedy):
    with pytest.raises(ParameterFileError, match=message):
        table(**settings)
    assert len(table(**remedy).wanted_m) >= 32


def test_a_range_that_is_too_small_is_refused_with_the_largest_scan():
    limited = {"range_V": (3.0, 8.0)}
    with pytest.raises(ParameterFileError, match="Set half_range_m to") as refusal:
        table(**limited)
    fits_m = float(str(refusal.value).split("Set half_range_m to ")[1].split()[0])
    waveform = table(half_range_m=fits_m, **limited)
    assert waveform.voltage_V.min() >= 3.0
    assert waveform.voltage_V.max() <= 8.0


def test_without_a_converter_range_there_are_no_integer_codes():
    files, notes = waveform_files(replace(exported(), converter_V=None))
    assert set(files) == {"README.md", "x.csv"}
    assert files["x.csv"].startswith(b"point,time_s,voltage_V,wanted_m\n")
    assert "range_V = [-10, 10]" in notes[0]
    with_codes, _ = waveform_files(exported())
    columns = [
        [float(row["voltage_V"]) for row in csv_rows(contents["x.csv"])]
        for contents in (files, with_codes)
    ]
    np.testing.assert_allclose(*columns, atol=0.51 * 20 / 2**16)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[waveform]\npoints = 0", "points of .waveform. is 0. Needed: `int` >= 4"),
        ("[waveform]\nshape = 'square'", "is 'square'. Needed: .*triangle|sine"),
        ("[waveform]\nrange_V = [5, 5]", "two voltages, the lower first"),
        ("[waveform]\nfrequency_Hz = nan", "Needed: `float` > 0"),
        ("[pid]\nnotches = 3", "Needed: `int` <= 2"),
        ("[pid]\nnotches = true", "notches of .pid. is True"),
        ("[pid]\npoints = 3", "one of notches, slew_V_per_s"),
        ("[biquad]\na = 3", r".biquad. is no table.*\[pid\], .*\[waveform\]"),
        ("[waveform", "cannot be read"),
    ],
)
def test_an_invalid_hardware_file_is_refused_by_its_key(text, message, tmp_path):
    (tmp_path / "box.toml").write_text(text)
    with pytest.raises(ParameterFileError, match=message):
        read_hardware(tmp_path / "box.toml")


def test_a_hardware_file_is_read(tmp_path):
    (tmp_path / "box.toml").write_text(
        "[pid]\nnotches = 1\nslew_V_per_s = 200\n"
        "[waveform]\nshape = 'sine'\nrange_V = [0, 10]\nbits = 12\npoints = 4096\n"
    )
    assert read_hardware(tmp_path / "box.toml") == ControllerHardware(
        notches=1, slew_V_per_s=200.0, shape="sine", range_V=(0.0, 10.0), bits=12, points=4096
    )
