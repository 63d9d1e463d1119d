"""Invalid readings are detected from the samples, and valid readings are kept."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.numerics.arrays import Array
from piezoid.records.inspection import inspect_files
from piezoid.records.invalid_samples import find_invalid_readings
from tests.laws import LAWS, recorded, swept_um, triangles, write

INVALID_um = {"zero": 0.0, "9999": 9999.0, "-1": -1.0, "full scale": 16.5}
KINDS = (*INVALID_um, "held", "spike")


def with_invalid_readings(reading_um: Array, kind: str, share: float) -> Array:
    """Replace a share of the readings, a third of them by two consecutive values."""
    rng, readings = np.random.default_rng(3), np.array(reading_um)
    single = (
        rng.choice(len(readings) - 4, max(int(0.75 * share * len(readings)), 4), replace=False) + 2
    )
    rows = np.unique(np.concatenate([single, single[: len(single) // 3] + 1]))
    if kind == "held":
        for k in rows.tolist():
            readings[k] = readings[k - 1]
    elif kind == "spike":
        height = rng.choice([-1.0, 1.0], len(rows)) * rng.uniform(0.2, 0.6, len(rows))
        readings[rows] += height * np.ptp(reading_um)
    else:
        readings[rows] = INVALID_um[kind]
    return readings


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", LAWS)
def test_only_invalid_readings_are_detected(law, kind):
    field, clean_um = swept_um(law)
    for share in (0.005, 0.05):
        reading_um = with_invalid_readings(clean_um, kind, share)
        is_detected = np.zeros(len(field), dtype=bool)
        for _, samples in find_invalid_readings(reading_um, field):
            is_detected[samples] = True
        error_um = np.abs(reading_um - clean_um)
        assert not is_detected[error_um == 0.0].any()
        is_missed = (error_um > 0.1) & ~is_detected  # of 15 um; the noise is 8 nm
        # Of 5 % spikes some are too close to each other; the fit excludes those.
        allowed = 0.35 if kind == "spike" and share > 0.02 else 0.02
        assert is_missed.sum() <= allowed * (error_um > 0.0).sum()


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("level", ["last value", "mid-range"])
def test_a_stuck_sensor_is_detected_completely(law, level):
    """The cable is disconnected for a fifth of the record, then for a shorter time."""
    field, clean_um = swept_um(law)
    reading_um, count = np.array(clean_um), len(field)
    is_stuck = np.zeros(count, dtype=bool)
    for begin, share in ((0.3, 0.2), (0.7, 0.05)):
        segment = slice(int(begin * count), int((begin + share) * count))
        reading_um[segment] = reading_um[segment.start] if level == "last value" else 2.0
        is_stuck[segment] = True
    ((kind, samples),) = find_invalid_readings(reading_um, field)
    assert kind == "stuck"
    assert np.count_nonzero(np.isin(np.flatnonzero(is_stuck), samples, invert=True)) == 0
    assert len(samples) == np.count_nonzero(is_stuck)


@pytest.mark.parametrize("law", LAWS)
def test_healthy_readings_are_valid(law):
    field, reading_um = swept_um(law)
    assert find_invalid_readings(reading_um, field) == ()
    assert (
        find_invalid_readings(np.round(reading_um / 0.05) * 0.05, field) == ()
    )  # a coarse converter
    assert find_invalid_readings(10.0 * LAWS[law](field), field) == ()  # no noise at all


def test_rests_pulses_steps_and_ringing_are_valid():
    rng = np.random.default_rng(5)
    pulses = np.zeros(4000)
    pulses[200::400] = 1.0
    steps = np.repeat(rng.choice([-1.0, 0.0, 1.0], 40), 100)
    samples_after = np.arange(4000) % 400
    ringing = np.repeat(np.tile([0.0, 1.0], 5), 400)
    rung_reading = ringing + 0.8 * np.exp(-samples_after / 8.0) * np.cos(
        2.6 * samples_after
    ) * np.where(samples_after, 1, 0)
    with_rests = np.concatenate([np.zeros(1500), triangles(5, 300) + 1.0, np.zeros(1000)])
    noise = 1e-3 * rng.standard_normal(4000)
    time_s = np.arange(2000) / 10_000.0
    fast_mode = np.exp(-10.0 * time_s) * np.sin(2.0 * np.pi * 330.0 * time_s)
    for drive, reading in (
        (pulses, pulses),
        (steps, steps + noise),
        (ringing, rung_reading + noise),
        (with_rests, with_rests),
        (with_rests, with_rests + noise),
        (None, np.repeat(triangles(10, 200)[::2], 4)),  # a sensor slower than the clock
        (np.zeros(2000), fast_mode),
    ):
        assert find_invalid_readings(reading, drive) == ()


def test_readings_equal_by_the_converter_step_are_valid(rng):
    """Approach at 7 um/s, retract at 88 um/s with five lost readings; noise of 4.7 steps."""
    step_nm, rate_Hz = 0.5, 2000.0
    approach_nm = np.cumsum(np.full(10_000, 7e3 / rate_Hz))
    retract_nm = approach_nm[-1] - np.cumsum(np.full(800, 88e3 / rate_Hz))
    motion_nm = np.concatenate([approach_nm, retract_nm])
    noisy_nm = motion_nm + 4.7 * step_nm * rng.standard_normal(len(motion_nm))
    reading_nm = step_nm * np.round(noisy_nm / step_nm)
    invalid = np.arange(10_100, 10_600, 100)
    reading_nm[invalid] = reading_nm[invalid - 1]
    assert np.mean(np.diff(reading_nm) == 0.0) > 0.03
    for drive in (1e-3 * motion_nm, None):
        ((kind, samples),) = find_invalid_readings(reading_nm, drive)
        assert (kind, samples.tolist()) == ("held", invalid.tolist())


def test_readings_equal_by_chance_in_a_motion_are_valid(rng):
    """The stage moves by 4.3 standard deviations of the noise from sample to sample."""
    motion_nm = np.cumsum(np.repeat([4.3, -4.3] * 10, 2000))
    step_nm = 0.6
    reading_nm = step_nm * np.round((motion_nm + rng.standard_normal(len(motion_nm))) / step_nm)
    assert np.count_nonzero(np.diff(reading_nm) == 0.0) > 20
    assert find_invalid_readings(reading_nm, motion_nm) == ()


def test_a_row_with_an_invalid_drive_is_bridged_in_both_channels(tmp_path):
    field, reading_um = swept_um("preisach")
    drive, invalid = np.array(field), np.arange(100, len(field), 61)
    drive[invalid], broken_um = -0.2, np.array(reading_um)
    broken_um[invalid] = -1.0  # the drive of the file is 5 V times this one's
    recording = recorded(tmp_path, drive, broken_um)
    healthy = recorded(tmp_path, field, reading_um)
    assert recording.bridged == tuple(invalid.tolist())
    assert np.abs(recording.voltage_V() - healthy.voltage_V()).max() < 0.1
    assert np.abs(recording.displacement_m() - healthy.displacement_m()).max() < 0.2e-6


def test_an_inspection_states_value_count_and_rows_of_invalid_readings(tmp_path):
    field, reading_um = swept_um("dahl")
    rows = [30, 31, 400, 1200, 1201, 2000]
    broken_um = np.array(reading_um)
    broken_um[rows] = 9999.0
    (inspection,) = inspect_files([write(tmp_path / "sweep.csv", field, broken_um)])
    (problem,) = (p for p in inspection.statements if p.quantity == "lost_readings")
    assert f" {len(rows)} times (" in problem.text
    for fact in ("9999 um", "6 times (0.25 %", "line 32, line 33, line 402", "displacement"):
        assert fact in problem.text


@cache
def held_out_m(kind: str, share: float) -> float:
    """Return the held-out error of a fit to a sweep, with a share of its readings replaced."""
    field, reading_um = swept_um("preisach")
    if kind == "clipped":
        reading_um = np.minimum(reading_um, np.quantile(reading_um, 1.0 - share))
    elif kind:
        reading_um = with_invalid_readings(reading_um, kind, share)
    with TemporaryDirectory() as folder:
        recording = recorded(Path(folder), field, reading_um)
    model = estimate_axis((recording,), "x", Rig(), orders=((8, 2),))
    assert model.verdict.applies
    return model.quality.held_out_rms_m


@pytest.mark.usefixtures("one_order")
@pytest.mark.parametrize(
    ("kind", "share"), [("zero", 0.05), ("held", 0.05), ("spike", 0.05), ("clipped", 0.07)]
)
def test_invalid_readings_hardly_raise_the_held_out_error(kind, share):
    # Of the clipped sweep, the fit lacks the upper ends of the largest loops.
    limit = 1.2 if kind == "clipped" else 1.1
    assert held_out_m(kind, share) < limit * held_out_m("", 0.0)


@pytest.mark.parametrize("law", LAWS)
def test_a_clipped_sensor_is_invalid_and_a_limited_stage_is_not(law, tmp_path):
    field, clean_um = swept_um(law)
    top = float(np.quantile(clean_um, 0.92))
    ((kind, samples),) = find_invalid_readings(np.minimum(clean_um, top), field)
    assert kind == "clipped"
    assert set(np.flatnonzero(clean_um > top)) >= set(samples.tolist())
    assert len(samples) > 0.9 * np.count_nonzero(clean_um > top)
    limited = np.minimum(field, 0.7)  # the amplifier ends, and the sensor goes on scattering
    noise_um = 0.008 * np.random.default_rng(2).standard_normal(len(field))
    assert find_invalid_readings(6.0 + 10.0 * LAWS[law](limited) + noise_um, field) == ()
    assert find_invalid_readings(10.0 * LAWS[law](limited), field) == ()
    (inspection,) = inspect_files([write(tmp_path / "a.csv", field, np.minimum(clean_um, top))])
    (text,) = [p.text for p in inspection.statements if p.quantity == "saturated"]
    assert f"is clipped at {top:.6g} um while the drive moves" in text
    assert "left out as invalid" in text


@pytest.mark.parametrize("samples_per_code", [0.7, 1.3, 2.6])
def test_missing_codes_of_a_converter_are_valid(samples_per_code, rng):
    """Every fourth code is missing, so readings are constant at these levels and then jump."""
    rate_nm = 10.0
    motion_nm = np.cumsum(np.repeat([rate_nm, -rate_nm] * 4, 2000))
    code_nm = samples_per_code * rate_nm
    code = np.floor(motion_nm / code_nm)
    coarse_nm = np.where(code % 4 == 1, code * code_nm, motion_nm)
    step_nm = 0.2
    reading_nm = step_nm * np.round((coarse_nm + rng.standard_normal(len(code))) / step_nm)
    assert find_invalid_readings(reading_nm, motion_nm) == ()
