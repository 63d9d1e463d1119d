"""Three coupled axes: from files to a model, a report section, and decoupled axes."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import piezoid
from piezoid.errors import ExcitationError
from piezoid_cli.main import app
from tests.journeys.coupled_stage import (
    AXES,
    GAIN_M_PER_V,
    LAB,
    MODE_HZ,
    campaign,
    sweep,
    write_recording,
)
from tests.plays_alone import fit_few_rows, fit_one_order, fit_plays_alone

pytestmark = pytest.mark.slow

NO_RATE = LAB.split("[acquisition]")[0]


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Fit multisines of all axes, and loops of x while the other axes are at rest."""
    folder = tmp_path_factory.mktemp("coupled")
    files = campaign(folder, axes=("x",))
    (folder / "lab.toml").write_text(NO_RATE)
    arguments = (*map(str, files), "--lab", str(folder / "lab.toml"), "--out", str(folder / "out"))
    with pytest.MonkeyPatch.context() as patch:
        fit_plays_alone(patch)
        fit_one_order(patch)
        fit_few_rows(patch)
        result = CliRunner().invoke(app, ["fit", *arguments, "--processes", "1"])
    assert result.exit_code == 0, (result.output, result.exception)
    return folder, " ".join(result.output.split())


@pytest.fixture(scope="module")
def model(stage: tuple[Path, str]) -> piezoid.ActuatorModel:
    return piezoid.load(stage[0] / "out" / "model.json")


def test_the_coupling_of_the_stage_is_identified(model):
    # Plays increase the gain for small drives, equally for all axes.
    coupling = model.coupled.coupling_m_per_V
    relative_coupling = coupling / np.diag(coupling)
    np.testing.assert_allclose(relative_coupling, GAIN_M_PER_V / np.diag(GAIN_M_PER_V), atol=4e-3)
    decoupled = model.coupled.decoupling @ GAIN_M_PER_V
    np.testing.assert_allclose(decoupled, np.diag(np.diag(decoupled)), atol=4e-3 * decoupled.max())


def test_modes_are_identified_and_assigned_to_their_axis(model):
    frequencies_Hz = model.coupled.mode_frequency_Hz(float(model.coupled.levels_V[0]))
    for mode_Hz in MODE_HZ:
        assert np.abs(frequencies_Hz / mode_Hz - 1.0).min() < 2e-3
    dynamics = model["x"].dynamics
    assert np.abs(dynamics.mode_frequency_Hz / MODE_HZ[0] - 1.0).min() < 5e-3


def test_held_out_realisations_are_predicted_to_two_percent(model):
    assert model.coupled.error_is_left_out
    assert (model.coupled.error_rms_m < 0.02 * model.coupled.moved_rms_m).all()


def test_modelled_coupling_is_not_a_finding(stage):
    diagnosis = json.loads((stage[0] / "out" / "diagnosis.json").read_bytes())
    assert "cross_coupling" not in {finding["effect"] for finding in diagnosis["findings"]}


def test_the_output_states_the_error_and_missing_recordings_of_other_axes(stage):
    output = stage[1]
    assert "coupled axes x, y, z: held-out error" in output
    for axis in ("y", "z"):
        assert f"axis {axis}: it is driven only together with the other coupled axes" in output


def test_the_report_has_a_section_on_the_coupling(stage):
    page = (stage[0] / "out" / "report.html").read_text()
    chapter = page[page.index('id="dynamics"') :]
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", chapter))
    assert "Which drive moves which displacement" in text
    assert "each realisation left out of the fit once" in text
    assert "310" in text
    assert "From the lowest level to the highest the gain changes by +" in text


def test_the_model_decouples_a_new_recording(model, tmp_path):
    (raw,) = piezoid.read(write_recording(tmp_path / "new.csv", sweep((0, 1, 2), 3), 77))
    decoupled = model.decoupled(raw)
    truth = model.predict(decoupled, axis="x")
    error = decoupled.displacement_m("x") - truth
    uncorrected = raw.displacement_m("x") - truth
    assert (error - error.mean()).std() < 0.1 * (uncorrected - uncorrected.mean()).std()


def test_coupled_axes_without_a_common_drive_are_refused(tmp_path):
    write_recording(tmp_path / "x.csv", sweep((0,), 1), 3)
    (tmp_path / "lab.toml").write_text(NO_RATE)
    recordings = piezoid.read(tmp_path / "x.csv", lab=tmp_path / "lab.toml")
    with pytest.raises(ExcitationError, match="the axes x, y, z are coupled, and no recording"):
        piezoid.fit(recordings, lab=tmp_path / "lab.toml")
    assert recordings[0].axes == AXES
