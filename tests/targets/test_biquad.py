"""Sections in boxes: their arithmetic against other code of the same sources, and in the loop."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from piezoid.errors import DesignError, ParameterFileError
from piezoid.targets.biquad import biquad_files
from piezoid.targets.box import Box, read_box, run_box
from piezoid.targets.held_sections import held_axis
from piezoid.targets.pid import Notch
from piezoid.targets.section_boxes import BOXES, programmed
from piezoid.verification.plant import Plugged
from tests.targets.known_boxes import BLANK, exported
from tests.verification.rig import GAIN_m_per_V, lateral

STABILIZER, PYRPL, LINIEN = (BOXES[name] for name in ("stabilizer", "pyrpl", "linien"))
RATES_Hz = {"stabilizer": 24414.0625, "pyrpl": 125e6 / 1023, "linien": 125e6}
PI = replace(BLANK, proportional_V_per_m=2e4, integral_V_per_m_s=5e8)
FULL = replace(
    PI,
    derivative_V_s_per_m=3.0,
    notches=(
        Notch(frequency_Hz=630.0, depth=0.05, width=0.7),
        Notch(frequency_Hz=2e3, depth=0.1, width=0.9),
    ),
)
LAST_BIT = 2.0**-16 * 125e6 / 2e-6  # V/(m s) of Linien's integral, 20 um to 10 V
# What each has room for
HELD = {
    "stabilizer": replace(FULL, notches=FULL.notches[:1]),
    "pyrpl": FULL,
    "linien": replace(PI, integral_V_per_m_s=4 * LAST_BIT),
}


def box_with(name, pid=None, limits_V=(-10.0, 10.0), update_Hz=None):
    rate_Hz = update_Hz or RATES_Hz[name]
    return programmed(
        BOXES[name],
        (pid or HELD[name]).sections(rate_Hz),
        update_Hz=rate_Hz,
        input_step_m=20e-6 / 2 ** (BOXES[name].bits - 1),
        output_V=(-10.0, 10.0),
        limits_V=limits_V,
    )


def answers_V(chosen, errors_m):
    """The box in C, its output wired to nothing."""
    plant = lateral(
        response=Plugged(begin=lambda _: lambda _v: 0.0),
        amplifier=(),
        mechanics=(),
        sensor=(),
        delay_s=0.0,
        noise_rms=0.0,
    )
    run = run_box(plant, chosen.compiled(0.0), errors_m, rng=np.random.default_rng(0))
    return run.voltage_V


def code_of(chosen, error_m):
    half = 2 ** (chosen.box.bits - 1)
    return int(min(max(np.round(error_m / chosen.input_step_m), -half), half - 1))


def in_floats(chosen, codes):
    """Direct form 1 in single precision, after idsp's description."""
    past = [[np.float32(0)] * 4 for _ in chosen.coefficient]
    for code in codes:
        x = np.float32(code)
        for place, row in enumerate(chosen.coefficient.astype(np.float32)):
            x1, x2, y1, y2 = past[place]
            y = row[0] * x + row[1] * x1 + row[2] * x2 + row[3] * y1 + row[4] * y2
            last = place + 1 == len(past)
            ends = chosen.output_codes if last else (-32767, 32767)
            y = min(max(y, np.float32(ends[0])), np.float32(ends[1]))
            past[place] = [x, x1, y, y1]
            x = y
        yield int(x)


def side_by_side(chosen, codes):
    """PyRPL's filter in Python's own integers, after red_pitaya_iir_block.v."""
    rows = [[int(value) for value in row] for row in chosen.raw]
    past = [[0] * 3 for _ in rows]

    def clip(value, bits):
        return min(max(value, -(1 << (bits - 1))), (1 << (bits - 1)) - 1)

    for code in codes:
        x = code << 17
        total = 0
        for row, memory in zip(rows, past, strict=True):
            x1, y1, y2 = memory
            products = (row[0] * x, row[1] * x1, row[3] * y1, row[4] * y2)
            y = clip(sum(clip((p + (1 << 28)) >> 29, 32) for p in products), 32)
            memory[:] = [x, y, y1]
            total += y
        yield clip(total >> 17, 14)


def one_behind_the_other(chosen, codes):
    """Linien's two filters in Python's own integers, after gateware/logic/iir.py."""
    rows = [[int(value) for value in row] for row in chosen.raw]
    past = [[0] * 4 for _ in rows]
    for code in np.repeat(codes, chosen.repeats):
        x = int(code) << 11
        for row, memory in zip(rows, past, strict=True):
            x1, x2, y1, y2 = memory
            y = (row[0] * x + row[1] * x1 + row[2] * x2 + row[3] * y1 + row[4] * y2) >> 16
            y = y if -(1 << 24) <= y < 1 << 24 else y1
            memory[:] = [x, x1, y, y1]
            x = y
        yield x >> 11


OTHER = {"stabilizer": in_floats, "pyrpl": side_by_side, "linien": one_behind_the_other}


@pytest.mark.parametrize("name", BOXES)
@pytest.mark.parametrize("size_m", [3e-8, 3e-5])
def test_the_arithmetic_is_that_of_its_source_bit_for_bit(name, size_m, rng):
    chosen = box_with(name)
    errors_m = size_m * (0.5 + rng.standard_normal(90 if name == "linien" else 2000))
    out_V = answers_V(chosen, errors_m)
    codes = [code_of(chosen, error_m) for error_m in errors_m]
    wanted = np.array(list(OTHER[name](chosen, codes)))[chosen.repeats - 1 :: chosen.repeats]
    found = np.round((out_V - chosen.output_middle_V) / chosen.output_step_V)
    np.testing.assert_array_equal(found, wanted)
    assert np.ptp(found) > 0
    if size_m > 1e-5:  # Linien keeps the last output that fits
        assert found.max() > (7900 if name == "linien" else chosen.output_codes[1] - 1)


@pytest.mark.parametrize("name", BOXES)
def test_the_rounded_sections_answer_as_the_controller_they_were_made_of(name):
    chosen, frequency_Hz = box_with(name), np.geomspace(5.0, 5e3, 50)
    q = np.exp(-2j * np.pi * frequency_Hz / chosen.update_Hz)
    wanted = np.ones(50, dtype=complex)
    for b, a in HELD[name].sections(chosen.update_Hz):
        wanted *= np.polyval(b[::-1], q) / np.polyval(a[::-1], q)
    # b0 + b1 of Linien is the integral and keeps its last bit; P is within half of one, of 2600
    tolerance = 3e-4
    assert np.abs(chosen.response(frequency_Hz) / wanted - 1.0).max() < tolerance


def test_the_limits_of_the_axis_hold_where_the_box_has_its_own():
    chosen = box_with("stabilizer", limits_V=(-2.0, 5.0))
    out_V = answers_V(chosen, np.r_[np.full(9000, 1e-5), np.full(9000, -1e-5)])
    assert -2.0 <= out_V.min() < -1.99
    assert 4.99 < out_V.max() <= 5.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("name", BOXES)
def test_the_box_in_the_loop_rejects_what_its_response_says(name, sign):
    """Signs included: a disturbance of 40 Hz on a plant that is nothing but its gain."""
    pid = replace(BLANK, integral_V_per_m_s=sign * LAST_BIT)
    chosen = box_with(name, pid)
    plant = replace(
        lateral(
            response=Plugged(begin=lambda _: lambda v: sign * GAIN_m_per_V * v),
            amplifier=(),
            mechanics=(),
            sensor=(),
            # Linien rounds the integral down to 32 codes: without noise the loop is not linear
            noise_rms=2e-7 if name == "linien" else 0.0,
            delay_s=0.0,
        ),
        sampling_rate_Hz=chosen.reading_Hz,
    )
    samples = round(0.5 * chosen.reading_Hz)
    time_s = np.arange(samples) / chosen.reading_Hz
    wave_m = 2e-6 * np.sin(2 * np.pi * 40.0 * time_s)
    moved = run_box(
        plant,
        chosen.compiled(0.0),
        np.zeros(samples),
        rng=np.random.default_rng(0),
        disturbance_m=wave_m,
    )
    later = slice(samples // 2, None)
    tone = np.exp(-2j * np.pi * 40.0 * time_s[later])
    left = abs(np.mean(moved.position_m[later] * tone) / np.mean(wave_m[later] * tone))
    q = np.exp(-2j * np.pi * 40.0 / chosen.reading_Hz)
    loop = sign * GAIN_m_per_V * q * chosen.response(np.array([40.0]))[0]
    # Codes of 2.4 nm where 14 bits hold 40 um, a fifth of what is left of the disturbance
    assert left == pytest.approx(abs(1.0 / (1.0 + loop)), rel=0.03)


def test_a_box_with_the_wrong_sign_runs_to_its_end():
    """What the test of signs would see: the same loop with one of them turned."""
    chosen = box_with("stabilizer", replace(BLANK, integral_V_per_m_s=-5e8))
    plant = lateral(response=Plugged(begin=lambda _: lambda v: GAIN_m_per_V * v), noise_rms=0.0)
    moved = run_box(plant, chosen.compiled(0.0), np.full(4000, 1e-6), rng=np.random.default_rng(0))
    assert moved.voltage_V[-1] == chosen.output_middle_V - 10.0


def test_files_hold_the_registers_and_say_what_is_lost():
    made, notes = biquad_files(replace(exported(), box=Box(format="pyrpl")))
    assert set(made) == {"README.md", "pyrpl.csv", "rejection.csv"}
    rows = list(csv.DictReader(io.StringIO(made["pyrpl.csv"].decode())))
    assert {row["coefficient"] for row in rows} == {"b0", "b1", "b2", "a1", "a2"}
    for row in rows:
        assert int(row["register"]) == float(row["value"]) * 2**29
    one = held_axis(exported(), exported().lateral[0], PYRPL)
    asked = exported().designs["x"].specification.modulus_margin
    assert one.modulus >= asked
    assert f"{len(one.programmed.coefficient)} section" in notes[0]
    assert "dB of rejection below" in notes[0]
    assert "Not tested, because no such box was at hand" in made["README.md"].decode()
    assert "red_pitaya_iir_block.v" in made["README.md"].decode()
    still = [row for row in one.rows if row.asked == "standing still"]
    assert len(still) == len(exported().family("x"))
    assert max(row.box_m for row in still) < 20e-9


def test_a_box_without_enough_bits_is_refused_with_what_would_fit():
    asked = Box(format="linien", error_range_m=2e-8)
    with pytest.raises(
        DesignError, match=r"last bit of its integral is .* fit.*\"pyrpl\""
    ) as told:
        biquad_files(replace(exported(), box=asked))
    assert "3051" not in str(told.value)  # a rate at which no margin is left


def test_rates_sections_and_ends_that_a_box_lacks_are_refused_with_what_would_fit():
    def refused(**asked):
        with pytest.raises(ParameterFileError) as error:
            biquad_files(replace(exported(), box=Box(**asked)))
        return str(error.value)

    assert "update_Hz = 24414.062" in refused(format="stabilizer", update_Hz=20e3)
    assert "sections = 2 or less" in refused(format="linien", sections=3)
    assert "Leave output_V away" in refused(format="pyrpl", output_V=(-50.0, 50.0))


def test_box_toml_names_the_boxes_there_are(tmp_path):
    place = tmp_path / "box.toml"
    place.write_text('[biquad]\nformat = "moku"\n')
    with pytest.raises(ParameterFileError, match="stabilizer or pyrpl or linien"):
        read_box(place)
    place.write_text('[biquad]\nformat = "pyrpl"\nsections = 4\noutput_V = [0, 5]\n')
    assert read_box(place) == Box(format="pyrpl", sections=4, output_V=(0.0, 5.0))
