"""Three axes whose drives act on all: files in, a model, a chapter, a decoupled axis out."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import piezoid
from piezoid.errors import ExcitationError
from piezoid_cli.main import app
from tests.journeys.coupled_stage import AXES, GAIN_M_PER_V, LAB, MODE_HZ, campaign, sweep, written
from tests.plays_alone import fit_one_order, fit_plays_alone

pytestmark = pytest.mark.slow

NO_RATE = LAB.split("[acquisition]")[0]


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Multisines of all axes, and loops of x while the others rest."""
    folder = tmp_path_factory.mktemp("coupled")
    files = campaign(folder, axes=("x",))
    (folder / "lab.toml").write_text(NO_RATE)
    given = (*map(str, files), "--lab", str(folder / "lab.toml"), "--out", str(folder / "out"))
    with pytest.MonkeyPatch.context() as patch:
        fit_plays_alone(patch)
        fit_one_order(patch)
        done = CliRunner().invoke(app, ["fit", *given])
    assert done.exit_code == 0, (done.output, done.exception)
    return folder, " ".join(done.output.split())


@pytest.fixture(scope="module")
def model(stage: tuple[Path, str]) -> piezoid.ActuatorModel:
    return piezoid.load(stage[0] / "out" / "model.json")


def test_the_coupling_is_that_of_the_stage(model):
    assert model.coupled is not None
    # plays make a small drive move more than the gain at rest, each axis alike
    found = model.coupled.coupling_m_per_V
    share = found / np.diag(found)
    np.testing.assert_allclose(share, GAIN_M_PER_V / np.diag(GAIN_M_PER_V), atol=4e-3)
    turned = model.coupled.decoupling @ GAIN_M_PER_V
    np.testing.assert_allclose(turned, np.diag(np.diag(turned)), atol=4e-3 * turned.max())


def test_its_modes_come_back_with_the_axis_that_they_belong_to(model):
    assert model.coupled is not None
    found = model.coupled.mode_frequency_Hz(float(model.coupled.levels_V[0]))
    for mode_Hz in MODE_HZ:
        assert np.abs(found / mode_Hz - 1.0).min() < 2e-3
    dynamics = model["x"].dynamics
    assert dynamics is not None
    assert np.abs(dynamics.mode_frequency_Hz / MODE_HZ[0] - 1.0).min() < 5e-3


def test_left_out_realisations_are_followed_to_two_percent(model):
    assert model.coupled is not None
    assert model.coupled.error_is_left_out
    assert (model.coupled.error_rms_m < 0.02 * model.coupled.moved_rms_m).all()


def test_coupling_that_is_modelled_is_no_cause(stage):
    found = json.loads((stage[0] / "out" / "diagnosis.json").read_bytes())
    assert "cross_coupling" not in {one["effect"] for one in found["findings"]}


def test_words_tell_the_error_and_what_to_record_of_the_other_axes(stage):
    shown = stage[1]
    assert "coupled axes x, y, z: held-out error" in shown
    for axis in ("y", "z"):
        assert f"axis {axis}: it is driven only together with the other coupled axes" in shown


def test_the_report_has_a_section_with_matrix_error_and_modes(stage):
    page = (stage[0] / "out" / "report.html").read_text()
    chapter = page[page.index('id="dynamics"') :]
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", chapter))
    assert "Which drive moves which displacement" in text
    assert "each realisation left out of the fit once" in text
    assert "310" in text
    assert "From the lowest level to the highest the gain changes by +" in text


def test_the_model_decouples_a_recording_it_has_not_seen(model, tmp_path):
    (raw,) = piezoid.read(written(tmp_path / "new.csv", sweep((0, 1, 2), 3), 77))
    seen = model.decoupled(raw)
    truth = model.predict(seen, axis="x")
    error = seen.displacement_m("x") - truth
    bare = raw.displacement_m("x") - truth
    assert (error - error.mean()).std() < 0.1 * (bare - bare.mean()).std()


def test_coupled_axes_without_a_drive_of_all_are_refused_with_what_to_record(tmp_path):
    written(tmp_path / "x.csv", sweep((0,), 1), 3)
    (tmp_path / "lab.toml").write_text(NO_RATE)
    held = piezoid.read(tmp_path / "x.csv", lab=tmp_path / "lab.toml")
    with pytest.raises(ExcitationError, match="the axes x, y, z are coupled, and no recording"):
        piezoid.fit(held, lab=tmp_path / "lab.toml")
    assert held[0].axes == AXES
