"""What a search keeps, takes back, and says of the rest."""

from collections.abc import Iterable
from functools import cache

import numpy as np
import pytest

import piezoid.diagnosis.diagnose as diagnose
import piezoid.diagnosis.selection as search
from piezoid.diagnosis.diagnosis import Diagnosis, Finding
from piezoid.diagnosis.effects import creep, cross_coupling, initial_state, thermal_drift
from piezoid.diagnosis.signals import with_displacement
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording

from .bench import causes, view_of_recordings
from .played import NOISE, cycled, forgotten, recordings_after, with_another_axis, wobbling

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order")

DRIFT = 10.0 * NOISE * np.sqrt(3.0)  # of the stroke, at either end: ten times the noise, rms


def nearly_cycled(_: float) -> tuple[float, float]:
    return (-1.0, 0.85)


def drifting() -> tuple[Recording, ...]:
    """Return recordings that all drift along a straight line."""
    found = []
    for one in recordings_after(cycled, cycled, cycled):
        moved_m = one.displacement_m()
        line_m = DRIFT * float(np.ptp(moved_m)) * np.linspace(-1.0, 1.0, one.samples)
        found.append(with_displacement(one, moved_m + line_m))
    return tuple(found)


def creeping(recordings: Iterable[Recording], share: float) -> tuple[Recording, ...]:
    return tuple(creep.EFFECT.inject(one, share) for one in recordings)


def finding_of(diagnosis: Diagnosis, name: str) -> Finding:
    return next(one for one in diagnosis.findings if one.effect == name)


@cache
def creep_and_an_unknown_memory(share: float) -> Diagnosis:
    """Diagnose creep in recordings of which the second began from turns that nobody knows."""
    return diagnose.diagnose(creeping(recordings_after(cycled, forgotten, cycled), share))


@cache
def drift_alone() -> Diagnosis:
    return diagnose.diagnose(drifting())


@pytest.mark.slow
def test_structure_is_no_name_where_much_else_is_left_and_may_be_what_causes_are():
    """A gain that wobbles leaves more than this memory, and the class that leaves it is none."""
    stage = recordings_after(cycled, nearly_cycled, cycled)
    wrong = map(with_another_axis, creeping(wobbling(stage, 0.006), 0.01))
    coupled = tuple(cross_coupling.EFFECT.inject(one, 0.004) for one in wrong)
    found = search.search(view_of_recordings(coupled, Lab()))
    assert [cause.effect.name for cause in found.causes] == ["cross_coupling", "creep"]
    assert found.inseparable == ("initial_state",)
    assert "initial_state" in {one.effect.name for one in found.dismissed}
    assert found.final.rms > 2.0 * found.final.noise
    # a memory looks like creep, and not like the drive of another axis
    assert found.confounded == {"cross_coupling": (), "creep": ("initial_state",)}


@pytest.mark.slow
def test_a_cause_that_may_be_another_cause_keeps_its_size_and_its_experiment():
    drift = finding_of(drift_alone(), "thermal_drift")
    assert drift.not_separable_from == ("creep",)
    assert drift.size.ci95[0] > 0.5 * drift.size.value
    assert "Not separable" not in drift.explanation
    assert drift.next_experiment == thermal_drift.EFFECT.experiment


@pytest.mark.slow
def test_a_doubtful_cause_beside_structure_that_was_found_may_be_a_part_of_it():
    found = creep_and_an_unknown_memory(0.004)
    assert causes(found) == ("initial_state", "creep")
    doubtful = finding_of(found, "creep")
    assert doubtful.not_separable_from == ("initial_state",)
    assert doubtful.size.ci95[0] == 0.0
    assert doubtful.size.ci95[1] > doubtful.size.value
    assert "Not separable from initial state" in (doubtful.explanation)
    assert doubtful.next_experiment == (
        f"{creep.EFFECT.experiment} For initial state: {initial_state.EFFECT.experiment}"
    )


@pytest.mark.slow
def test_a_sure_cause_beside_structure_that_was_found_is_no_part_of_it():
    found = creep_and_an_unknown_memory(0.02)
    assert set(causes(found)) == {"initial_state", "creep"}
    sure, memory = finding_of(found, "creep"), finding_of(found, "initial_state")
    assert (sure.not_separable_from, memory.not_separable_from) == ((), ())
    assert sure.size.ci95[0] > 0.5 * sure.size.value
    assert "Not separable" not in sure.explanation
    assert sure.next_experiment == creep.EFFECT.experiment
    for one in (sure, memory):
        assert one.held_out_rms_after_m < one.held_out_rms_before_m
        ratio = one.held_out_rms_after_m / one.held_out_rms_before_m
        assert one.held_out_gain == pytest.approx(1.0 - ratio)
