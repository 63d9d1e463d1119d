"""What could hide in recordings is bounded as it is in the stage."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.detection_limits import not_detected
from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import NotDetected
from piezoid.diagnosis.effects import gain_change
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.selection import Outcome
from piezoid.diagnosis.signals import with_displacement
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import causes, healthy_view, recorded

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plays_alone")]

DRIFT_m = 1e-8  # at the end, of 46 um


def test_a_drift_beside_a_single_sweep_is_bounded_as_it_is_and_not_as_it_shows() -> None:
    (recording,), lab = recorded(draw_campaign(21, truth="preisach", plans=("sweep",)))
    slow_m = DRIFT_m * np.linspace(-1.0, 1.0, recording.samples)
    drifting = with_displacement(recording, recording.displacement_m() + slow_m)
    diagnosis = diagnose([drifting], lab=lab)
    assert causes(diagnosis) == ()
    (drift,) = (absent for absent in diagnosis.not_detected if absent.effect == "thermal_drift")
    assert drift.upper_bound_m is not None
    assert float(np.std(slow_m)) < drift.upper_bound_m < 3.0 * float(np.std(slow_m))


def test_an_effect_that_hysteresis_absorbs_up_to_the_range_has_no_bound() -> None:
    view = healthy_view()
    test = score_test(gain_change.EFFECT, view)
    assert test is not None

    def absent(absorption: float) -> NotDetected:
        outcome = Outcome(
            first=view,
            clean=view,
            final=view,
            faults={},
            causes=(),
            confounded={},
            screened={"gain_change": replace(test, absorption=absorption)},
        )
        return not_detected(gain_change.EFFECT, outcome)

    assert absent(1.0).upper_bound_m is not None
    assert absent(1e9).upper_bound_m is None
    assert "hysteresis absorbs it" in absent(1e9).reason
