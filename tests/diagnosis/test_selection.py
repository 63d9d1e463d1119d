"""Selection of effects: confirmed, dismissed, and not separable."""

from collections.abc import Iterable

import numpy as np
import pytest

from piezoid.diagnosis.candidate import size_of
from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.effects import creep, cross_coupling, initial_state, thermal_drift
from piezoid.diagnosis.selection import search
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

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")

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


@pytest.mark.slow
def test_an_initial_state_below_other_structure_is_dismissed_and_not_separable():
    """A modulated gain leaves more than this initial state; no class represents it."""
    stage = recordings_after(cycled, nearly_cycled, cycled)
    disturbed = map(with_another_axis, creeping(wobbling(stage, 0.006), 0.01))
    coupled = tuple(cross_coupling.EFFECT.inject(recording, 0.004) for recording in disturbed)
    outcome = search(view_of_recordings(coupled))
    assert [cause.effect.name for cause in outcome.causes] == ["cross_coupling", "creep"]
    assert outcome.inseparable == ("initial_state",)
    assert "initial_state" in {candidate.effect.name for candidate in outcome.dismissed}
    assert outcome.final.rms > 2.0 * outcome.final.noise
    # An initial state resembles creep, but not the drive of another axis.
    assert outcome.confounded == {"cross_coupling": (), "creep": ("initial_state",)}


@pytest.mark.slow
def test_a_cause_confounded_with_another_effect_keeps_its_size_and_experiment():
    drift = finding_of(diagnose(drifting()), "thermal_drift")
    assert drift.not_separable_from == ("creep",)
    assert drift.size.ci95[0] > 0.5 * drift.size.value
    assert "Not separable" not in drift.explanation
    assert drift.next_experiment == thermal_drift.EFFECT.experiment


@pytest.mark.slow
def test_a_doubtful_cause_is_not_separable_from_structure():
    diagnosis = diagnose(creeping(recordings_after(cycled, forgotten, cycled), 0.004))
    assert causes(diagnosis) == ("initial_state", "creep")
    doubtful = finding_of(diagnosis, "creep")
    assert doubtful.not_separable_from == ("initial_state",)
    assert doubtful.size.ci95[0] == 0.0
    assert doubtful.size.ci95[1] > doubtful.size.value
    assert "Not separable from initial state" in (doubtful.explanation)
    assert doubtful.next_experiment == (
        f"{creep.EFFECT.experiment} Or, for initial state: {initial_state.EFFECT.experiment}"
    )


@pytest.mark.slow
def test_a_certain_cause_is_separable_from_structure():
    recordings = creeping(recordings_after(cycled, forgotten, cycled), 0.02)
    outcome = search(view_of_recordings(recordings))
    sizes = {cause.effect.name: size_of(cause) for cause in outcome.causes}
    assert set(sizes) == {"initial_state", "creep"}
    assert outcome.confounded == {"creep": ()}
    assert outcome.inseparable == ()
    assert sizes["creep"].ci95[0] > 0.5 * sizes["creep"].value
