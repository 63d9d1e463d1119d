"""A plan asks what was left open, stays inside the limits, and its promise comes true."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.experiment import Plan, plan
from piezoid.diagnosis.planning.candidate_drives import (
    EXPERIMENTS,
    Experiment,
    drive_of,
    multisine_period,
    odd_lines,
)
from piezoid.diagnosis.planning.drive_limits import Bench, DriveLimits
from piezoid.diagnosis.planning.plan_file import SCHEMA, plan_files, sentences
from piezoid.digests import unseal
from piezoid.errors import ExcitationError, LabFileError
from piezoid.records.collection import collect
from piezoid.records.lab import Amplifier, Lab

from .planned import (
    Hidden,
    change_percent,
    diagnosis_of,
    found,
    hidden,
    model_of,
    really_separable,
    recordings_of,
)

CLOCK_Hz = 20_000.0
SLOW = ("creep", "thermal_drift")
LATE = ("delay", "lag")


@cache
def _slow() -> tuple[Hidden, Diagnosis]:
    case = hidden(3, {"creep": 0.6, "thermal_drift": 0.3}, ("sweep", "long_hold"))
    share = change_percent(case, "creep")
    return case, diagnosis_of(case, [found("creep", share_percent=share, confounded=SLOW[1:])])


@cache
def _planned() -> Plan:
    case, diagnosis = _slow()
    before = recordings_of(case.played(None)[0])
    return plan(model_of(case), diagnosis, recordings=before, clock_Hz=CLOCK_Hz)


def test_creep_and_drift_after_one_hold_are_sent_to_levels_of_random_sign() -> None:
    planned = _planned()
    assert planned.question.kind == "separate"
    assert planned.question.effects == SLOW
    assert planned.drive.name in ("held_levels", "held_levels_mirrored")


def test_the_laboratory_plays_the_plan_and_separates_creep_from_drift_as_promised() -> None:
    case, _ = _slow()
    planned, axis = _planned(), model_of(case).axes["x"]
    before = really_separable(case, axis, SLOW, None, drifting=True)
    after = really_separable(case, axis, SLOW, planned.drive, drifting=True)
    assert planned.recorded is not None
    assert planned.recorded.separability < 0.2
    assert before < 0.2
    assert after > 2.0 * before
    assert planned.planned.separability / 2 < after < 2.5 * planned.planned.separability


def test_the_laboratory_separates_delay_from_lag_once_small_motion_is_fast() -> None:
    case = hidden(4, {"delay": 0.5, "lag": 0.4}, ("sweep", "rates"), "bouc_wen")
    model = model_of(case)
    late = found("delay", share_percent=change_percent(case, "delay"), confounded=LATE[1:])
    before = recordings_of(case.played(None)[0])
    diagnosis = diagnosis_of(case, [late])
    planned = plan(model, diagnosis, recordings=before, clock_Hz=CLOCK_Hz)
    axis = model.axes["x"]
    assert planned.drive.name == "small_multisine"
    assert planned.recorded is not None
    promised = planned.planned.separability / planned.recorded.separability
    kept = really_separable(case, axis, LATE, planned.drive, drifting=False)
    kept /= really_separable(case, axis, LATE, None, drifting=False)
    assert promised > 5.0
    assert promised / 4 < kept < promised * 4


def test_a_wide_interval_is_tightened_and_a_narrow_one_left_alone() -> None:
    case, _ = _slow()
    model = model_of(case)
    wide = diagnosis_of(case, [found("creep", share_percent=0.3, half=0.6)])
    planned = plan(model, wide, clock_Hz=CLOCK_Hz)
    assert (planned.question.kind, planned.question.effects) == ("tighten", ("creep",))
    narrow = diagnosis_of(case, [found("creep", share_percent=0.3, half=0.05)])
    assert plan(model, narrow, clock_Hz=CLOCK_Hz).question.kind == "detect"


def test_an_effect_the_recordings_could_not_show_is_planned_for() -> None:
    case, _ = _slow()
    diagnosis = diagnosis_of(case, [])
    absent = tuple(
        replace(one, upper_bound_m=None, detection_limit_m=None) if one.effect == "delay" else one
        for one in diagnosis.not_detected
    )
    planned = plan(model_of(case), replace(diagnosis, not_detected=absent), clock_Hz=CLOCK_Hz)
    assert planned.question.effects == ("delay",)
    assert "cannot show delay" in sentences(planned)[0]


@pytest.mark.parametrize("slew_V_per_s", [60.0, 30_000.0])
@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda one: one.name)
def test_every_drive_of_the_menu_stays_inside_range_and_slew(
    experiment: Experiment, slew_V_per_s: float
) -> None:
    limits = DriveLimits(voltage_min_V=1.0, voltage_max_V=8.0, slew_V_per_s=slew_V_per_s)
    bench = Bench(axis="x", limits=limits, clock_Hz=CLOCK_Hz, other_limits={"y": limits})
    drive = drive_of(experiment, bench, 0)
    assert drive.voltage_V.min() >= 1.0
    assert drive.voltage_V.max() <= 8.0
    jumps_V = np.abs(np.diff(drive.voltage_V, axis=0)).max()
    assert jumps_V * drive.sampling_rate_Hz <= 1.01 * slew_V_per_s
    assert (drive.voltage_V[[0, -1]] == 1.0).all()


def test_other_axes_are_asked_for_where_none_is_known() -> None:
    limits = DriveLimits(voltage_min_V=0.0, voltage_max_V=10.0, slew_V_per_s=1e3)
    bench = Bench(axis="x", limits=limits, clock_Hz=CLOCK_Hz)
    with pytest.raises(ExcitationError, match="no other axis"):
        drive_of(next(one for one in EXPERIMENTS if one.name == "other_axis"), bench, 0)


def test_a_multisine_has_its_lines_at_rms_one_and_no_others(rng: np.random.Generator) -> None:
    lines = odd_lines(20, 800, 10.0, left_out_of=4, rng=rng)
    period = multisine_period(lines, 1000, rng)
    spectrum = np.abs(np.fft.rfft(period))
    silent = np.setdiff1d(np.arange(501), lines)
    assert np.ptp(spectrum[lines]) < 1e-9 * spectrum.max()
    assert spectrum[silent].max() < 1e-9 * spectrum.max()
    assert np.bincount((lines - 2) // 8)[:9].tolist() == [3] * 9  # of each four odd lines
    assert (lines % 2 == 1).all()
    assert period.std() == pytest.approx(1.0, rel=1e-9)


def test_limits_are_those_of_lab_toml_inside_what_was_driven() -> None:
    case, diagnosis = _slow()
    amplifier = Amplifier(
        gain_V_per_V=15.0, output_min_V=-30.0, output_max_V=120.0, slew_V_per_s=900.0
    )
    planned = plan(model_of(case), diagnosis, lab=Lab(amplifier=amplifier), clock_Hz=CLOCK_Hz)
    limits = planned.limits
    assert (limits.voltage_min_V, limits.voltage_max_V, limits.slew_V_per_s) == (0.0, 8.0, 60.0)


def test_the_files_of_a_plan_are_read_back(tmp_path: Path) -> None:
    planned = _planned()
    files = plan_files(planned, model_digest="sha256:a", diagnosis_digest="sha256:b")
    content = unseal(files["plan.json"], SCHEMA, "plan.json")
    assert content["drive"]["name"] == planned.drive.name
    assert content["why"] == " ".join(sentences(planned))
    assert len(content["alternatives"]) == len(EXPERIMENTS)
    place = tmp_path / "drive.csv"
    place.write_bytes(files["drive.csv"])
    (recording,) = collect([place], Lab()).recordings
    assert np.array_equal(recording.voltage_V("x"), planned.drive.voltage_V[:, 0])
    again = plan_files(planned, model_digest="sha256:a", diagnosis_digest="sha256:b")
    assert again == files


def test_no_drive_is_planned_for_a_fault_of_the_data_or_an_unknown_name() -> None:
    case, diagnosis = _slow()
    with pytest.raises(ExcitationError, match="No drive helps"):
        plan(model_of(case), diagnosis, effect="outliers", clock_Hz=CLOCK_Hz)
    with pytest.raises(ExcitationError, match="Name one of these"):
        plan(model_of(case), diagnosis, effect="gremlins", clock_Hz=CLOCK_Hz)


def test_without_any_rate_the_line_for_lab_toml_is_asked_for() -> None:
    case, diagnosis = _slow()
    with pytest.raises(LabFileError, match="sampling_rate_Hz"):
        plan(model_of(case), diagnosis)
