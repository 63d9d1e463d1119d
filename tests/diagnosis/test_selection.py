"""Selection of effects: confirmed, dismissed, and not separable."""

from collections.abc import Iterable
from functools import cache

import numpy as np
import pytest

import piezoid.diagnosis.diagnose as diagnose
import piezoid.diagnosis.selection as search
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.effects import creep, cross_coupling, initial_state, thermal_drift
from piezoid.diagnosis.signals import with_displacement
from piezoid.records.recording import Recording

from .bench import causes, finding_of, view_of_recordings
from .play_recordings import (
    NOISE,
    cycled,
    forgotten,
    recordings_after,
    with_another_axis,
    wobbling,
)

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order")

DRIFT = 10.0 * NOISE * np.sqrt(3.0)  # of the stroke, at either end: rms of ten times the noise


def nearly_cycled(_: float) -> tuple[float, float]:
    return (-1.0, 0.85)


def drifting() -> tuple[Recording, ...]:
    """Return recordings with a linear drift."""
    drifted = []
    for recording in recordings_after(cycled, cycled, cycled):
        displacement_m = recording.displacement_m()
        line_m = DRIFT * float(np.ptp(displacement_m)) * np.linspace(-1.0, 1.0, recording.samples)
        drifted.append(with_displacement(recording, displacement_m + line_m))
    return tuple(drifted)


def creeping(recordings: Iterable[Recording], share: float) -> tuple[Recording, ...]:
    return tuple(creep.EFFECT.inject(recording, share) for recording in recordings)


@cache
def creep_with_unknown_initial_state(share: float) -> Diagnosis:
    """Diagnose creep in recordings of which the second has an unknown history."""
    return diagnose.diagnose(creeping(recordings_after(cycled, forgotten, cycled), share))


@cache
def drift_alone() -> Diagnosis:
    return diagnose.diagnose(drifting())


@pytest.mark.slow
def test_an_initial_state_below_other_structure_is_dismissed_and_not_separable():
    """A modulated gain leaves more than this initial state; no class represents it."""
    stage = recordings_after(cycled, nearly_cycled, cycled)
    disturbed = map(with_another_axis, creeping(wobbling(stage, 0.006), 0.01))
    coupled = tuple(cross_coupling.EFFECT.inject(recording, 0.004) for recording in disturbed)
    outcome = search.search(view_of_recordings(coupled))
    assert [cause.effect.name for cause in outcome.causes] == ["cross_coupling", "creep"]
    assert outcome.inseparable == ("initial_state",)
    assert "initial_state" in {candidate.effect.name for candidate in outcome.dismissed}
    assert outcome.final.rms > 2.0 * outcome.final.noise
    # An initial state resembles creep, but not the drive of another axis.
    assert outcome.confounded == {"cross_coupling": (), "creep": ("initial_state",)}


@pytest.mark.slow
def test_a_cause_confounded_with_another_effect_keeps_its_size_and_experiment():
    drift = finding_of(drift_alone(), "thermal_drift")
    assert drift.not_separable_from == ("creep",)
    assert drift.size.ci95[0] > 0.5 * drift.size.value
    assert "Not separable" not in drift.explanation
    assert drift.next_experiment == thermal_drift.EFFECT.experiment


@pytest.mark.slow
def test_a_doubtful_cause_is_not_separable_from_structure():
    diagnosis = creep_with_unknown_initial_state(0.004)
    assert causes(diagnosis) == ("initial_state", "creep")
    doubtful = finding_of(diagnosis, "creep")
    assert doubtful.not_separable_from == ("initial_state",)
    assert doubtful.size.ci95[0] == 0.0
    assert doubtful.size.ci95[1] > doubtful.size.value
    assert "Not separable from initial state" in (doubtful.explanation)
    assert doubtful.next_experiment == (
        f"{creep.EFFECT.experiment} For initial state: {initial_state.EFFECT.experiment}"
    )


@pytest.mark.slow
def test_a_certain_cause_is_separable_from_structure():
    diagnosis = creep_with_unknown_initial_state(0.02)
    assert set(causes(diagnosis)) == {"initial_state", "creep"}
    certain, initial = finding_of(diagnosis, "creep"), finding_of(diagnosis, "initial_state")
    assert (certain.not_separable_from, initial.not_separable_from) == ((), ())
    assert certain.size.ci95[0] > 0.5 * certain.size.value
    assert "Not separable" not in certain.explanation
    assert certain.next_experiment == creep.EFFECT.experiment
    for finding in (certain, initial):
        assert finding.held_out_rms_after_m < finding.held_out_rms_before_m
        ratio = finding.held_out_rms_after_m / finding.held_out_rms_before_m
        assert finding.held_out_gain == pytest.approx(1.0 - ratio)
