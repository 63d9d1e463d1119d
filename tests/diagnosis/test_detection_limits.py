"""What could hide in recordings is bounded as it is in the stage."""

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.signals import with_displacement
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import causes, recorded

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plays_alone", "one_order")]

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
