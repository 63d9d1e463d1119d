"""At one speed dynamics resemble loop width; a loss of sensitivity is still named."""

import re
from pathlib import Path

import numpy as np
import pytest

from piezoid.diagnosis.candidate import size_of
from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.effects import effect_named
from piezoid.diagnosis.findings import not_detected
from piezoid.diagnosis.selection import search
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import relaxed
from piezoid.records.collection import collect
from piezoid.records.frames import from_arrays
from piezoid.records.recording import Recording
from tests.diagnosis.bench import finding_of, view_of_recordings
from tests.laws import LAWS, RATE_Hz, triangles, write

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_order", "few_rows")]

LAG_s = 0.01
GAIN_CHANGE_percent = 5.0
DRIFT_um = 0.6


def lagging_triangles(
    folder: Path, cycles: int, samples: int, gain: float, drift_um: float
) -> Recording:
    """Return triangles with this number of samples per cycle, recorded behind a lag."""
    field = triangles(cycles, samples)
    reading_um = relaxed(10.0 * gain * LAWS["preisach"](field), LAG_s, RATE_Hz)
    reading_um = reading_um + drift_um * np.linspace(0.0, 1.0, len(field)) ** 0.8
    reading_um = reading_um + 0.008 * np.random.default_rng(cycles).standard_normal(len(field))
    return collect([write(folder / f"{samples}.csv", field, reading_um)])[0]


def test_a_lag_is_not_separable_at_similar_speeds(tmp_path):
    first = lagging_triangles(tmp_path, 16, 250, 1.0, DRIFT_um)
    more_sensitive = lagging_triangles(tmp_path, 10, 180, 1.0 + GAIN_CHANGE_percent / 100.0, 0.0)
    outcome = search(view_of_recordings([first, more_sensitive]))
    causes = {cause.effect.name: cause for cause in outcome.causes}
    assert set(causes) == {"thermal_drift", "gain_change"}
    assert size_of(causes["gain_change"]).value == pytest.approx(GAIN_CHANGE_percent, abs=1.0)
    for name, rival in (("lag", "delay"), ("delay", "lag"), ("rate_dependence", "lag")):
        absent = not_detected(effect_named(name), outcome)
        assert absent.upper_bound_m is None
        assert absent.reason.startswith("not separable from hysteresis")
        assert rival in absent.reason
        assert "half the speed" in absent.next_experiment


def test_loop_shape_of_a_single_loop_is_not_separable_from_a_lag(tmp_path):
    ramp = np.linspace(-1.0, 1.0, 1000)
    field = np.concatenate([ramp, ramp[-2::-1]])
    cycled = np.concatenate([field, field])
    reading_um = relaxed(10.0 * LAWS["preisach"](cycled)[len(field) :], LAG_s, RATE_Hz)
    reading_um = reading_um + 0.002 * np.random.default_rng(3).standard_normal(len(field))
    diagnosis = diagnose(collect([write(tmp_path / "loop.csv", field, reading_um)]).recordings)
    shape = finding_of(diagnosis, "loop_shape")
    assert {"lag", "creep", "thermal_drift", "initial_state"} <= set(shape.not_separable_from)
    assert "ten times slower" in shape.next_experiment


CYCLES, SAMPLES, CYCLES_RATE_Hz = 60, 60, 60.0  # one cycle per second
LOSS = 0.013  # of the sensitivity, over all cycles
NOISE_M = 5e-9
LAG_S = 0.02


def lagged(displacement_m: Array) -> Array:
    share, lagged_m = 1.0 - np.exp(-1.0 / (CYCLES_RATE_Hz * LAG_S)), displacement_m.copy()
    for k in range(1, len(displacement_m)):
        lagged_m[k] = lagged_m[k - 1] + share * (displacement_m[k] - lagged_m[k - 1])
    return lagged_m


def test_a_loss_of_sensitivity_is_named_with_dropouts_and_a_lag():
    rng, field = np.random.default_rng(3), triangles(CYCLES + 3, SAMPLES)
    displacement_m = 2e-5 * LAWS["bouc_wen"](field)[3 * SAMPLES :]
    displacement_m = displacement_m * (1.0 - LOSS * np.linspace(0.0, 1.0, len(displacement_m)))
    displacement_m = lagged(displacement_m) + NOISE_M * rng.standard_normal(len(displacement_m))
    displacement_m[rng.integers(0, len(displacement_m), 12)] = 0.0
    diagnosis = diagnose(
        [
            from_arrays(
                voltage_V=50.0 + 50.0 * field[3 * SAMPLES :],
                displacement_m=displacement_m,
                sampling_rate_Hz=CYCLES_RATE_Hz,
                axis="x",
                name="cycles",
            )
        ]
    )
    findings = {finding.effect: finding for finding in diagnosis.findings}
    assert "gain_change" in findings
    assert set(findings) <= {"gain_change", "loop_shape", "outliers"}
    size = findings["gain_change"].size
    assert size.value == pytest.approx(-100.0 * LOSS, rel=0.1)
    remarks = " ".join(diagnosis.model.verdict.remarks)
    stated = re.search(r"the sensitivity changes by (\S+) %", remarks)
    assert float(stated.group(1)) == pytest.approx(size.value, rel=0.1)
    assert diagnosis.final.rms_m < 1.5 * NOISE_M
