"""A plan says where no drive answers, which limit forbids more, and never promises the absurd."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid.diagnosis.candidate import MINIMUM_SHARE
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.effect import Tangent
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.experiment import (
    Alternative,
    CandidateTable,
    Choice,
    Plan,
    plan,
    simulate_candidates,
)
from piezoid.diagnosis.planning.candidate_drives import EXPERIMENTS, drive_of
from piezoid.diagnosis.planning.drive_limits import Bench, DriveLimits, bench_of
from piezoid.diagnosis.planning.open_questions import (
    expected_limit_m,
    questions_of,
)
from piezoid.diagnosis.planning.plan_file import sentences
from piezoid.diagnosis.planning.separation import SeparationEstimate
from piezoid.errors import ExcitationError
from piezoid.records.lab import Amplifier, Lab
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import axis_model, stage_model

MODEL = stage_model(axis_model("x"), axis_model("y"))
CLOCK_Hz = 1000.0
HIGH_m = 2e-8  # a limit of detection that leaves something to be asked


def _open(**limit_m: float) -> Diagnosis:
    """Return a diagnosis that found nothing, and shows effects from these sizes, others well."""
    found = diagnosed()
    absent = tuple(
        replace(one, detection_limit_m=limit_m.get(one.effect, 1e-12), upper_bound_m=1e-12)
        for one in found.not_detected
    )
    return replace(found, not_detected=absent)


def _planned(diagnosis: Diagnosis, slew_V_per_s: float | None = None, **asked: str) -> Plan:
    lab = Lab(amplifier=Amplifier(slew_V_per_s=slew_V_per_s))
    return plan(MODEL, diagnosis, lab=lab, clock_Hz=CLOCK_Hz, **asked)


@cache
def _too_slow() -> Plan:
    return _planned(_open(delay=HIGH_m), 2.0, effect="delay")


@cache
def _table() -> CandidateTable:
    axis = MODEL["x"]
    bench = bench_of(MODEL, axis, Lab(), (), CLOCK_Hz)
    return simulate_candidates(axis, bench, diagnosed(), (), 0)


@pytest.mark.parametrize(
    "effect", [one.name for one in EFFECTS if isinstance(one.tangent, Tangent)]
)
def test_nothing_is_promised_to_show_below_what_the_diagnosis_names(effect):
    diagnosis = _open(**{effect: HIGH_m})
    (asked,) = questions_of(diagnosis, effect)
    best = _table().choice(asked).best
    if best.estimate is not None and best.score > 0.0:
        assert expected_limit_m(asked, None, best.estimate) >= MINIMUM_SHARE * diagnosis.stroke_m


def test_a_coupling_that_no_recording_excites_has_a_size_along_the_drive_that_would():
    found = diagnosed()
    absent = tuple(
        replace(one, detection_limit_m=None, upper_bound_m=None)
        if one.effect == "cross_coupling"
        else one
        for one in found.not_detected
    )
    (asked,) = questions_of(replace(found, not_detected=absent), "cross_coupling")
    best = _table().choice(asked).best
    assert best.name == "other_axis"
    assert best.estimate is not None
    assert 1e-6 < best.estimate.errors[0] < 1.0


def test_other_axes_that_reach_their_loops_late_are_waited_for():
    slow = DriveLimits(voltage_min_V=0.0, voltage_max_V=10.0, slew_V_per_s=1.0)
    fast = replace(slow, slew_V_per_s=50.0)
    bench = Bench(axis="x", limits=fast, clock_Hz=CLOCK_Hz, other_limits={"y": slow, "z": fast})
    drive = drive_of(next(one for one in EXPERIMENTS if one.name == "other_axis"), bench, 0)
    still_V = drive.voltage_V[:, 0] == 5.0
    for k in (1, 2):
        moving = np.abs(np.diff(drive.voltage_V[:, k])) > 0.0
        loops = moving & (drive.voltage_V[1:, k] > 1.0)
        assert still_V[1:][loops].mean() > 0.7


def test_where_speed_is_what_is_missing_the_plan_says_so_and_is_right():
    slow = _too_slow()
    assert not slow.answers
    assert "No drive answers this within these limits" in sentences(slow)[1]
    said = re.search(
        r"The limit is the speed, 2 V/s .*slew_V_per_s.* leave (\d+) % .* not (\d+) %",
        slow.forbids,
    )
    assert said is not None
    faster = _planned(_open(delay=HIGH_m), 8.0, effect="delay")
    left = faster.remaining_share
    assert 100 * left == pytest.approx(float(said[1]), abs=0.6)
    assert left < slow.remaining_share


def test_a_question_that_no_drive_answers_gives_way_to_one_that_is_answered():
    both = _open(delay=HIGH_m, thermal_drift=1e-8)
    planned = _planned(both, 2.0)
    assert planned.answers
    assert planned.question.effects == ("thermal_drift",)
    assert [one.effects for one in planned.set_aside] == [("delay",)]
    assert "More important, but answered by no drive" in sentences(planned)[-1]
    assert "whether there is delay" in sentences(planned)[-1]


def test_a_stage_of_one_axis_is_not_asked_for_coupling():
    found = _open(cross_coupling=HIGH_m, thermal_drift=1e-8)
    alone = plan(stage_model(axis_model("x")), found, clock_Hz=CLOCK_Hz)
    assert (alone.question.effects, alone.set_aside) == (("thermal_drift",), ())
    assert _planned(found).question.effects == ("cross_coupling",)


def test_what_shows_already_from_the_least_that_is_named_needs_no_recording():
    planned = _planned(_open(), effect="delay")
    assert not planned.answers
    assert not planned.forbids
    assert "no recording is needed" in sentences(planned)[0]


def test_a_diagnosis_that_leaves_nothing_open_asks_for_nothing():
    with pytest.raises(ExcitationError, match="no open question"):
        _planned(_open())


@pytest.mark.parametrize(("errors", "is_answered"), [((2.0, 0.1), False), ((0.1, 0.1), True)])
def test_two_that_stay_lost_in_their_errors_are_not_told_apart_however_unlike_they_are(
    errors, is_answered
):
    asked = questions_of(diagnosed(finding("creep", rivals=("thermal_drift",))), "creep")[0]
    unlike = SeparationEstimate(separability=0.9, errors=errors)
    best = Alternative(name="drive", why="", estimate=unlike, score=1.0)
    choice = Choice(question=asked, alternatives=(best,), best=best, recorded=None)
    assert choice.answers is is_answered
