"""What needs time is a width of the loop at one speed, whatever else goes on meanwhile."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose
from piezoid.operators.filters import relaxed
from piezoid.records.collection import collect
from piezoid.records.recording import Recording
from tests.diagnosis.bench import causes
from tests.laws import LAWS, RATE_Hz, triangles, write

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_order")]

LAG_s = 0.01
GREW_percent = 5.0
DRIFT_um = 0.6


def late(folder: Path, cycles: int, samples: int, gain: float, drift_um: float) -> Recording:
    """Return triangles of so many samples a cycle of a stage whose reading is late."""
    field = triangles(cycles, samples)
    reading_um = relaxed(10.0 * gain * LAWS["preisach"](field), LAG_s, RATE_Hz)
    reading_um = reading_um + drift_um * np.linspace(0.0, 1.0, len(field)) ** 0.8
    reading_um = reading_um + 0.008 * np.random.default_rng(cycles).standard_normal(len(field))
    return collect([write(folder / f"{samples}.csv", field, reading_um)])[0]


def test_a_lag_is_no_cause_where_speeds_hardly_differ(tmp_path: Path) -> None:
    first = late(tmp_path, 16, 250, 1.0, DRIFT_um)
    grown = late(tmp_path, 10, 180, 1.0 + GREW_percent / 100.0, 0.0)
    found = diagnose([first, grown])
    assert set(causes(found)) == {"thermal_drift", "gain_change"}
    size = next(one.size for one in found.findings if one.effect == "gain_change")
    assert size.value == pytest.approx(GREW_percent, abs=1.0)
    for name, others in (("lag", "delay"), ("delay", "lag"), ("rate_dependence", "lag")):
        unseen = next(one for one in found.not_detected if one.effect == name)
        assert unseen.upper_bound_m is None
        assert unseen.reason.startswith("not separable from hysteresis")
        assert others in unseen.reason
        assert "half the speed" in unseen.next_experiment


def test_loop_shape_of_a_single_loop_is_not_told_from_a_lag(tmp_path: Path) -> None:
    ramp = np.linspace(-1.0, 1.0, 1500)
    field = np.concatenate([ramp, ramp[-2::-1]])
    cycled = np.concatenate([field, field])
    reading_um = relaxed(10.0 * LAWS["preisach"](cycled)[len(field) :], LAG_s, RATE_Hz)
    reading_um = reading_um + 0.002 * np.random.default_rng(3).standard_normal(len(field))
    found = diagnose(collect([write(tmp_path / "loop.csv", field, reading_um)]).recordings)
    (shape,) = [one for one in found.findings if one.effect == "loop_shape"]
    assert {"lag", "creep", "thermal_drift", "initial_state"} <= set(shape.not_separable_from)
    assert "ten times slower" in shape.next_experiment
