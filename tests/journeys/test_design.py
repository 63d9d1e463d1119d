"""`piezoid design` on a fitted stage, and the controllers that `piezoid fit` designs itself."""

from dataclasses import replace
from pathlib import Path

import pytest

from piezoid.design.design import design_from_json
from piezoid.errors import DesignError, TemplateError
from piezoid.identification.dynamics.bandwidth import unmeasured
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.store import write_model
from piezoid_reports.page import Page
from piezoid_reports.quantities import significant
from piezoid_reports.render import render
from tests.journeys.command import piezoid, run
from tests.reports.known_stage import axis_model, recording, stage_model

MODEL = replace(
    stage_model(
        replace(
            axis_model(),
            rig=Rig(amplifier_bandwidth_Hz=4e3, sensor_bandwidth_Hz=8.5e3),
            bandwidth=unmeasured(12e3, "nothing was recorded"),  # of the data sheet
        )
    ),
    controller_rate_Hz=20e3,
)


def stage_in(place: Path) -> Path:
    folder = place / "stage"
    folder.mkdir()
    (folder / "model.json").write_bytes(write_model(MODEL))
    (folder / "report.html").write_text("the fit's own report")
    return folder


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    return stage_in(tmp_path)


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Design for a stage whose lab.toml states another rate since the fit."""
    stage = stage_in(tmp_path_factory.mktemp("designed"))
    (stage / "lab.toml").write_text("[acquisition]\nsampling_rate_Hz = 5000\n")
    status, shown = run("design", stage)
    assert status == 0
    return stage, " ".join(shown.split())


def test_a_fitted_stage_gets_both_forms_and_keeps_its_other_files(designed):
    stage, shown = designed
    assert "mpi_dob" in shown
    found = design_from_json((stage / "design.json").read_bytes())
    assert [loop.method for loop in found.axis("x").loops] == ["mpi_dob", "dob"]
    assert (stage / "report.html").read_text() == "the fit's own report"
    loop = found.axis("x").recommended
    page = (stage / "design.html").read_text().replace("\u202f", " ")
    assert f"<td>{significant(loop.worst_modulus_margin)}</td>" in page
    for words in ('id="controllers"', "modulus margin", "the declared poles (4.00 kHz, 8.50 kHz)"):
        assert words in page
    undesigned = render(
        Page(
            model=MODEL, recordings=[recording()], design=found, undesigned="ceiling_A is missing"
        )
    )
    assert undesigned.count("ceiling_A is missing") == 1


def test_a_rate_that_lab_toml_states_after_the_fit_is_not_passed_for_the_one_designed_for(
    designed,
):
    stage, shown = designed
    design = design_from_json((stage / "design.json").read_bytes())
    assert design.axis("x").sampling_rate_Hz == 20e3
    assert "lab.toml differs from that of the fit" in shown
    assert "fit again" in shown


def test_what_cannot_be_met_is_refused_and_nothing_is_written(stage, tmp_path):
    spec = tmp_path / "design.toml"
    spec.write_text("[x]\nbandwidth_Hz = 5000\n")
    error = piezoid("design", stage, "--spec", spec).exception
    assert isinstance(error, TemplateError)
    assert error.exit_status == 4
    assert not (stage / "design.json").exists()


def test_where_one_of_two_axes_cannot_be_met_the_other_is_written(stage, tmp_path):
    both = replace(MODEL, axes={"x": MODEL["x"], "y": replace(MODEL["x"], axis="y")})
    (stage / "model.json").write_bytes(write_model(both))
    spec = tmp_path / "design.toml"
    spec.write_text("[x]\nbandwidth_Hz = 100\n[y]\nbandwidth_Hz = 5000\n")
    status, shown = run("design", stage, "--spec", spec)
    assert status == 1
    assert "axis y does not ship" in shown
    found = design_from_json((stage / "design.json").read_bytes())
    assert [axis.axis for axis in found.axes] == ["x"]
    assert found.axis("x").specification.bandwidth_Hz == 100.0
    page = render(
        Page(model=MODEL, recordings=[recording()], design=found, unshipped=found.refused)
    )
    assert page.count("axis y, bandwidth 5000 Hz") == 1
    assert "axis y has no controller" in page


def test_the_rate_may_be_given_where_the_model_has_none(stage):
    (stage / "model.json").write_bytes(write_model(replace(MODEL, controller_rate_Hz=None)))
    error = piezoid("design", stage).exception
    assert isinstance(error, DesignError)
    status, _ = run("design", stage, "--rate", "10000")
    assert status == 0
    found = design_from_json((stage / "design.json").read_bytes())
    assert found.axis("x").recommended.members[0].sampling_rate_Hz == 10e3


@pytest.mark.parametrize("rate", ["0", "1e-300", "1e300", "inf"])
def test_a_rate_at_which_no_controller_runs_is_refused(stage, rate):
    error = piezoid("design", stage, "--rate", rate).exception
    assert isinstance(error, DesignError)
    assert "a rate from 1 to 10000000 Hz" in str(error)
