"""Numbers written where nothing was measured: found from the samples alone, and nothing else."""

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

WRITTEN = {"zero": 0.0, "9999": 9999.0, "-1": -1.0, "full scale": 16.5}
KINDS = (*WRITTEN, "held", "spike")


def broken(reading_um: Array, kind: str, share: float) -> Array:
    """Replace a share of the readings, a third of them two in a row."""
    rng, found = np.random.default_rng(3), np.array(reading_um)
    alone = rng.choice(len(found) - 4, max(int(0.75 * share * len(found)), 4), replace=False) + 2
    where = np.unique(np.concatenate([alone, alone[: len(alone) // 3] + 1]))
    if kind == "held":
        for k in where.tolist():
            found[k] = found[k - 1]
    elif kind == "spike":
        height = rng.choice([-1.0, 1.0], len(where)) * rng.uniform(0.2, 0.6, len(where))
        found[where] += height * np.ptp(reading_um)
    else:
        found[where] = WRITTEN[kind]
    return found


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", LAWS)
def test_lost_readings_are_found_and_no_others(law: str, kind: str) -> None:
    field, clean_um = swept_um(law)
    for share in (0.005, 0.05):
        reading_um = broken(clean_um, kind, share)
        found = np.zeros(len(field), dtype=bool)
        for _, samples in find_invalid_readings(reading_um, field):
            found[samples] = True
        away_um = np.abs(reading_um - clean_um)
        assert not found[away_um == 0.0].any()
        left = (away_um > 0.1) & ~found  # of 15 um; the noise is 8 nm
        # among one spike in twenty some stand too near each other; the fit leaves those out
        allowed = 0.35 if kind == "spike" and share > 0.02 else 0.02
        assert left.sum() <= allowed * (away_um > 0.0).sum()


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("level", ["last value", "mid-range"])
def test_a_sensor_that_hangs_in_mid_motion_is_found_whole(law: str, level: str) -> None:
    """A cable came off for a fifth of the record, then for a shorter time: both, and no more."""
    field, clean_um = swept_um(law)
    reading_um, count = np.array(clean_um), len(field)
    hung = np.zeros(count, dtype=bool)
    for begin, share in ((0.3, 0.2), (0.7, 0.05)):
        here = slice(int(begin * count), int((begin + share) * count))
        reading_um[here] = reading_um[here.start] if level == "last value" else 2.0
        hung[here] = True
    ((kind, samples),) = find_invalid_readings(reading_um, field)
    assert kind == "stuck"
    assert np.count_nonzero(np.isin(np.flatnonzero(hung), samples, invert=True)) == 0
    assert len(samples) == np.count_nonzero(hung)


@pytest.mark.parametrize("law", LAWS)
def test_healthy_readings_are_kept(law: str) -> None:
    field, reading_um = swept_um(law)
    assert find_invalid_readings(reading_um, field) == ()
    assert (
        find_invalid_readings(np.round(reading_um / 0.05) * 0.05, field) == ()
    )  # a coarse converter
    assert find_invalid_readings(10.0 * LAWS[law](field), field) == ()  # no noise at all


def test_rests_pulses_steps_and_ringing_are_no_losses() -> None:
    rng = np.random.default_rng(5)
    pulses = np.zeros(4000)
    pulses[200::400] = 1.0
    steps = np.repeat(rng.choice([-1.0, 0.0, 1.0], 40), 100)
    since = np.arange(4000) % 400
    ringing = np.repeat(np.tile([0.0, 1.0], 5), 400)
    rung = ringing + 0.8 * np.exp(-since / 8.0) * np.cos(2.6 * since) * np.where(since, 1, 0)
    rested = np.concatenate([np.zeros(1500), triangles(5, 300) + 1.0, np.zeros(1000)])
    noise = 1e-3 * rng.standard_normal(4000)
    for drive, reading in (
        (pulses, pulses),
        (steps, steps + noise),
        (ringing, rung + noise),
        (rested, rested),
        (rested, rested + noise),
        (None, np.repeat(triangles(10, 200)[::2], 4)),  # a sensor slower than the clock
    ):
        assert find_invalid_readings(reading, drive) == ()


def test_a_mode_that_passes_its_middle_in_two_samples_loses_none() -> None:
    time_s = np.arange(2000) / 10_000.0
    reading = np.exp(-10.0 * time_s) * np.sin(2.0 * np.pi * 330.0 * time_s)
    assert find_invalid_readings(reading, np.zeros(2000)) == ()


def test_neighbours_that_are_equal_by_the_step_of_the_converter_are_kept(
    rng: np.random.Generator,
) -> None:
    """Approach at 7 um/s, retract at 88 um/s with five lost readings; noise of 4.7 steps."""
    step_nm, rate_Hz = 0.5, 2000.0
    approach_nm = np.cumsum(np.full(10_000, 7e3 / rate_Hz))
    retract_nm = approach_nm[-1] - np.cumsum(np.full(800, 88e3 / rate_Hz))
    motion_nm = np.concatenate([approach_nm, retract_nm])
    noisy_nm = motion_nm + 4.7 * step_nm * rng.standard_normal(len(motion_nm))
    reading_nm = step_nm * np.round(noisy_nm / step_nm)
    lost = np.arange(10_100, 10_600, 100)
    reading_nm[lost] = reading_nm[lost - 1]
    assert np.mean(np.diff(reading_nm) == 0.0) > 0.03
    for drive in (1e-3 * motion_nm, None):
        ((kind, samples),) = find_invalid_readings(reading_nm, drive)
        assert (kind, samples.tolist()) == ("held", lost.tolist())


def test_a_row_of_one_number_is_lost_with_its_drive(tmp_path: Path) -> None:
    field, reading_um = swept_um("preisach")
    drive, lost = np.array(field), np.arange(100, len(field), 61)
    drive[lost], broken_um = -0.2, np.array(reading_um)
    broken_um[lost] = -1.0  # the drive of the file is 5 V times this one's
    whole = recorded(tmp_path, drive, broken_um)
    healthy = recorded(tmp_path, field, reading_um)
    assert whole.bridged == tuple(lost.tolist())
    assert np.abs(whole.voltage_V() - healthy.voltage_V()).max() < 0.1
    assert np.abs(whole.displacement_m() - healthy.displacement_m()).max() < 0.2e-6


def test_inspect_tells_what_was_written_how_often_and_where(tmp_path: Path) -> None:
    field, reading_um = swept_um("dahl")
    where = [30, 31, 400, 1200, 1201, 2000]
    broken_um = np.array(reading_um)
    broken_um[where] = 9999.0
    (inspection,) = inspect_files([write(tmp_path / "sweep.csv", field, broken_um)])
    (problem,) = (p for p in inspection.statements if p.quantity == "lost_readings")
    assert f" {len(where)} times (" in problem.text
    for told in ("9999 um", "6 times (0.25 %", "line 32, line 33, line 402", "displacement"):
        assert told in problem.text


@cache
def held_out_m(law: str, kind: str, share: float) -> float:
    """Return the held-out error of a fit to a sweep, with a share of its readings replaced."""
    field, reading_um = swept_um(law)
    if kind == "clipped":
        reading_um = np.minimum(reading_um, np.quantile(reading_um, 1.0 - share))
    elif kind:
        reading_um = broken(reading_um, kind, share)
    with TemporaryDirectory() as folder:
        recording = recorded(Path(folder), field, reading_um)
    model = estimate_axis((recording,), "x", Rig(), orders=((8, 2),))
    assert model.verdict.applies
    return model.quality.held_out_rms_m


@pytest.mark.usefixtures("one_order")
@pytest.mark.parametrize(
    ("law", "kind", "share"),
    [
        ("preisach", "zero", 0.05),
        ("preisach", "held", 0.05),
        ("plays", "spike", 0.05),
        ("plays", "clipped", 0.07),
    ],
)
def test_the_held_out_error_hardly_rises(law: str, kind: str, share: float) -> None:
    # Clipped: the upper ends of the largest loops were not seen by the fit.
    limit = 1.2 if kind == "clipped" else 1.1
    assert held_out_m(law, kind, share) < limit * held_out_m(law, "", 0.0)


@pytest.mark.parametrize("law", LAWS)
def test_a_sensor_at_the_end_of_its_range_is_left_out_and_a_stage_at_its_end_is_not(
    law: str, tmp_path: Path
) -> None:
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
    (found,) = inspect_files([write(tmp_path / "a.csv", field, np.minimum(clean_um, top))])
    (told,) = [p.text for p in found.statements if p.quantity == "saturated"]
    assert f"is clipped at {top:.6g} um while the drive moves" in told
    assert "left out as invalid" in told


@pytest.mark.parametrize("samples_per_code", [0.7, 1.3, 2.6])
def test_missing_codes_of_a_converter_are_no_lost_readings(
    samples_per_code: float, rng: np.random.Generator
) -> None:
    """Every fourth code is missing: readings are held at these levels and jump behind them."""
    rate_nm = 10.0
    motion_nm = np.cumsum(np.repeat([rate_nm, -rate_nm] * 4, 2000))
    code_nm = samples_per_code * rate_nm
    code = np.floor(motion_nm / code_nm)
    held_nm = np.where(code % 4 == 1, code * code_nm, motion_nm)
    step_nm = 0.2
    reading_nm = step_nm * np.round((held_nm + rng.standard_normal(len(code))) / step_nm)
    assert find_invalid_readings(reading_nm, motion_nm) == ()
