"""Recordings of users: a file in, the verdict of a physicist out."""

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

import piezoid as piezoid_library
from piezoid.design.lateral_task import lateral_task
from piezoid.diagnosis.diagnose import diagnose
from piezoid.errors import ExcitationError
from piezoid.identification.fit import fit
from piezoid.identification.fit_statements import Grade, fit_statements, grade_of
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import IN_SAMPLE
from piezoid.numerics.arrays import Array
from piezoid_datasets.virtual_lab.signals import first_order
from tests.journeys.command import piezoid
from tests.laws import LAWS, RATE_Hz, recorded, swept_um, triangles, write

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plays_alone")]


def output_of(result: Result) -> str:
    return " ".join(result.output.split())


def noise_um(samples: int) -> Array:
    return np.asarray(0.008 * np.random.default_rng(4).standard_normal(samples))


def facts_of(axis: AxisModel) -> set[str]:
    """Return the quantities of the statements about the fit."""
    return {fact.quantity for fact in fit_statements(axis)}


def fitted(folder: Path, field: Array, reading_um: Array) -> AxisModel:
    """Return the model of one recording, fitted without the command line."""
    return fit([recorded(folder, field, reading_um)])["x"]


def test_a_single_loop_is_modelled_and_stated_to_be_untested(tmp_path):
    field = triangles(1, 600)
    sweep = write(tmp_path / "sweep.csv", field, 10 * LAWS["preisach"](field) + noise_um(600))
    lab = tmp_path / "lab.toml"
    lab.write_text(
        "[acquisition]\nsampling_rate_Hz = 20000\n[amplifier]\nbandwidth_Hz = 1000\n"
        "[actuator]\nbandwidth_Hz = 500\n"
    )
    model = piezoid_library.fit(piezoid_library.read(sweep, lab=lab), lab=lab)
    facts = {fact.quantity: fact.text for fact in fit_statements(model["x"])}
    assert "only one loop was recorded" in facts["loop"].lower()
    assert grade_of(model["x"]) is Grade.POOR
    assert model["x"].quality.held_out_kind == IN_SAMPLE
    assert model["x"].quality.held_out_rms_percent < 0.3
    assert not lateral_task(model["x"], 20e3).bounds  # so no controller has a certificate


def test_noise_at_constant_drive_is_not_a_sweep(tmp_path):
    rng = np.random.default_rng(7)
    constant_drive = write(
        tmp_path / "rest.csv", 1e-5 * rng.standard_normal(4000), 5 + noise_um(4000)
    )
    result = piezoid("fit", constant_drive, "--out", tmp_path / "stage")
    assert isinstance(result.exception, ExcitationError)
    assert "never changes but for the noise of its reading" in str(result.exception)
    output = output_of(piezoid("diagnose", constant_drive, "--out", tmp_path / "diagnosis"))
    assert "at constant drive" in output
    assert "hysteresis" not in output


@pytest.mark.parametrize(
    ("field", "law", "lag_s", "slip_um", "quantities", "grades"),
    [
        (np.linspace(-1.0, 0.0, 125), "wall_pinning", 0.0, 0.0, {"branch"}, {Grade.POOR}),
        (triangles(6, 500), "duhem", 0.02, 0.0, {"speed"}, {Grade.LIMITED}),
        (
            triangles(8, 300),
            "preisach",
            0.0,
            0.9,
            {"speed", "zero_jump"},
            {Grade.POOR, Grade.LIMITED},
        ),
    ],
    ids=["half a stroke", "one speed may be lag", "a step of the zero at one speed"],
)
def test_missing_data_and_irregularities_of_a_recording_are_stated(
    tmp_path, field, law, lag_s, slip_um, quantities, grades
):
    displacement_um = 10 * LAWS[law](field)
    if lag_s:
        displacement_um = first_order(displacement_um, lag_s, RATE_Hz, -10.0)
    step_um = slip_um * (np.arange(len(field)) >= 1000)
    axis = fitted(tmp_path, field, displacement_um + step_um + noise_um(len(field)))
    facts = {fact.quantity: fact.text for fact in fit_statements(axis)}
    assert quantities <= set(facts)
    assert grade_of(axis) in grades
    assert not lag_s or "ten times slower" in facts["speed"]


def test_a_random_drive_has_a_reversal_at_nearly_every_sample(tmp_path):
    field = np.random.default_rng(5).uniform(-1.0, 1.0, 2000)
    axis = fitted(tmp_path, field, 10 * LAWS["preisach"](field) + noise_um(2000))
    assert not {"branch", "loop", "speed", "amplitude"} & facts_of(axis)
    assert grade_of(axis) in (Grade.GOOD, Grade.LIMITED)
    inspection = piezoid("inspect", tmp_path / "sweep.csv").output
    assert int(re.search(r"(\d+)\s+reversals", inspection)[1]) > 500


@pytest.mark.usefixtures("one_order")
@pytest.mark.parametrize(("law", "drift_um"), [("dahl", 0.0), ("duhem", 2.0)])
def test_the_model_error_of_another_law_is_not_drift(law, drift_um, tmp_path):
    """With triangles of decreasing size, the model error shifts the zero from size to size."""
    field, reading_um = swept_um(law)
    warming_um = drift_um * np.linspace(0.0, 1.0, len(field)) ** 0.5
    axis = diagnose([recorded(tmp_path, field, reading_um + warming_um)]).model
    assert axis is not None
    assert ("baseline_drift" in facts_of(axis)) == (drift_um > 0.0)


def test_noise_without_a_repeated_period_is_stated_as_a_bound(tmp_path):
    """Random drive of a law outside the model class, with 8 nm of noise."""
    field = np.random.default_rng(5).uniform(-1.0, 1.0, 1500)
    axis = fitted(tmp_path, field, 10 * LAWS["duhem"](field) + noise_um(1500))
    (noise,) = [fact for fact in fit_statements(axis) if fact.quantity == "noise"]
    assert "at most" in noise.text
    repeated = np.tile(field, 2)
    axis = fitted(tmp_path, repeated, 10 * LAWS["duhem"](repeated) + noise_um(3000))
    assert "noise" not in facts_of(axis)
    assert 0.9 < axis.quality.noise_rms_m / 8e-9 < 1.1


def test_the_order_is_selected_with_a_first_order_lag(tmp_path):
    """With a delay no order helps; an order selected with a delay left 9 to 20 nm."""
    field = np.concatenate([triangles(2, 500), triangles(3, 150), triangles(2, 900)])
    lagged_um = first_order(10 * LAWS["wall_pinning"](field), 0.02, RATE_Hz, -10.0)
    axis = fitted(tmp_path, field, lagged_um + noise_um(len(field)))
    assert axis.quality.held_out_rms_m < 1.2 * 8e-9
    assert axis.lag.kind == "first_order"
    assert 0.0195 < axis.lag.time_s < 0.0205
