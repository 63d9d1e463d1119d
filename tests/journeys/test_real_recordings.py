"""Published recordings: the held-out error is near the noise and below that of simple models."""

from pathlib import Path

import pytest

from piezoid.diagnosis.diagnose import diagnose
from piezoid.identification.fit import fit
from piezoid.identification.fit_statements import fit_statements
from piezoid.identification.model import AxisModel
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab
from tests.diagnosis.bench import finding_of, thinned

ACTUATOR = """
[[recording]]
file = "{file}"
axis = "x"
columns = {{ time = 2, displacement = 3, voltage = 4 }}
units = {{ time = "s", displacement = "um", voltage = "V" }}
start_s = 4.01
"""
FLEXURE = """
[acquisition]
sampling_rate_Hz = 200

[[recording]]
file = "{file}"
axis = "x"
columns = {{ voltage = 1, displacement = 5 }}
units = {{ voltage = "V", displacement = "um" }}
"""


def fitted(recording: Path, lab_text: str, folder: Path, *, every: int = 1) -> AxisModel:
    """Return the model of every n-th sample of a recording."""
    (folder / "lab.toml").write_text(lab_text.format(file=recording))
    lab = read_lab(folder / "lab.toml")
    return fit(thinned(collect([recording], lab).recordings, every), lab=lab)["x"]


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_the_actuator_in_its_steady_state_is_modelled_near_the_noise(realdata, tmp_path):
    recording = realdata / "actuator_150V" / "hysteresis_v_150_1hz.csv"
    model = fitted(recording, ACTUATOR, tmp_path, every=4)
    assert model.verdict.applies
    assert model.quality.held_out_rms_percent < 0.145  # a simple additive model leaves 0.31
    noise_percent = 100 * model.quality.noise_rms_m / model.quality.range_m
    assert noise_percent == pytest.approx(0.12, abs=0.01)


@pytest.mark.usefixtures("one_order")
def test_the_flexure_with_its_drifting_zero_is_modelled(realdata, tmp_path):
    recording = realdata / "flexure" / "Model_Vi_Do.dat"
    model = fitted(recording, FLEXURE, tmp_path)
    assert model.verdict.applies
    # a simple additive model leaves 0.54, plays without loop shape 0.29
    assert model.quality.held_out_rms_percent < 0.22
    assert {"excluded", "baseline_drift"} <= {fact.quantity for fact in fit_statements(model)}


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_the_lagging_positioner_is_not_reported_as_hysteresis(realdata):
    model = fit(collect([realdata / "objective_lag" / "triangles.csv.gz"]).recordings)["x"]
    quality = model.quality
    assert not model.verdict.applies
    assert "phase lag, not hysteresis" in model.verdict.reason
    assert quality.is_lag_ambiguous
    assert min(limit.most for limit in quality.limits) <= 50
    (reason,) = [limit.reason for limit in quality.limits if limit.lack == "speed"]
    assert "alone 0.5" in reason


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_the_hold_of_an_approach_shows_creep(realdata):
    recordings = collect([realdata / "capsensor_hold" / "approach_hold_retract.csv.gz"]).recordings
    diagnosis = diagnose(recordings)
    creep = finding_of(diagnosis, "creep")
    assert 1.0 < creep.size.value < 2.0  # percent of the step per decade
