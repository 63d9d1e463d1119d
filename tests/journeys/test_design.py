"""`piezoid design` on a fitted stage, and the controllers designed by `piezoid fit`."""

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

pytestmark = pytest.mark.usefixtures("brief_designs")

MODEL = replace(
    stage_model(
        replace(
            axis_model(),
            rig=Rig(amplifier_bandwidth_Hz=4e3, sensor_bandwidth_Hz=8.5e3),
            bandwidth=unmeasured(12e3, "nothing was recorded"),  # from the data sheet
        )
    ),
    controller_rate_Hz=20e3,
)


def write_stage(parent: Path) -> Path:
    folder = parent / "stage"
    folder.mkdir()
    (folder / "model.json").write_bytes(write_model(MODEL))
    (folder / "report.html").write_text("the fit's own report")
    return folder


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    return write_stage(tmp_path)


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Design for a stage whose lab.toml was changed to another rate after the fit."""
    stage = write_stage(tmp_path_factory.mktemp("designed"))
    (stage / "lab.toml").write_text("[acquisition]\nsampling_rate_Hz = 5000\n")
    status, output = run("design", stage)
    assert status == 0
    return stage, " ".join(output.split())


def test_a_fitted_stage_gets_both_controller_forms_and_keeps_its_other_files(designed):
    stage, output = designed
    assert "mpi_dob" in output
    design = design_from_json((stage / "design.json").read_bytes())
    assert [loop.method for loop in design.axis("x").loops] == ["mpi_dob", "dob"]
    assert (stage / "report.html").read_text() == "the fit's own report"
    loop = design.axis("x").recommended
    page = (stage / "design.html").read_text().replace("\u202f", " ")
    assert f"<td>{significant(loop.worst_modulus_margin)}</td>" in page
    for words in ('id="controllers"', "modulus margin", "the declared poles (4.00 kHz, 8.50 kHz)"):
        assert words in page
    undesigned = render(
        Page(
            model=MODEL, recordings=[recording()], design=design, undesigned="ceiling_A is missing"
        )
    )
    assert undesigned.count("ceiling_A is missing") == 1


def test_a_rate_changed_in_lab_toml_after_the_fit_is_not_used(designed):
    stage, output = designed
    design = design_from_json((stage / "design.json").read_bytes())
    assert design.axis("x").sampling_rate_Hz == 20e3
    assert "lab.toml differs from that of the fit" in output
    assert "fit again" in output


def test_an_infeasible_specification_is_refused_and_nothing_is_written(stage, tmp_path):
    spec = tmp_path / "design.toml"
    spec.write_text("[x]\nbandwidth_Hz = 5000\n")
    error = piezoid("design", stage, "--spec", spec).exception
    assert isinstance(error, TemplateError)
    assert error.exit_status == 4
    assert not (stage / "design.json").exists()


def test_an_infeasible_axis_does_not_prevent_the_design_of_the_other(stage, tmp_path):
    two_axes = replace(MODEL, axes={"x": MODEL["x"], "y": replace(MODEL["x"], axis="y")})
    (stage / "model.json").write_bytes(write_model(two_axes))
    spec = tmp_path / "design.toml"
    spec.write_text("[x]\nbandwidth_Hz = 100\n[y]\nbandwidth_Hz = 5000\n")
    status, output = run("design", stage, "--spec", spec)
    assert status == 1
    assert "axis y does not ship" in output
    design = design_from_json((stage / "design.json").read_bytes())
    assert [axis.axis for axis in design.axes] == ["x"]
    assert design.axis("x").specification.bandwidth_Hz == 100.0
    page = render(
        Page(model=MODEL, recordings=[recording()], design=design, unshipped=design.refused)
    )
    assert page.count("axis y, bandwidth 5000 Hz") == 1
    assert "axis y has no controller" in page


def test_a_rate_may_be_given_for_a_model_without_one(stage):
    (stage / "model.json").write_bytes(write_model(replace(MODEL, controller_rate_Hz=None)))
    error = piezoid("design", stage).exception
    assert isinstance(error, DesignError)
    status, _ = run("design", stage, "--rate", "10000")
    assert status == 0
    design = design_from_json((stage / "design.json").read_bytes())
    assert design.axis("x").recommended.members[0].sampling_rate_Hz == 10e3


@pytest.mark.parametrize("rate", ["0", "1e-300", "1e300", "inf"])
def test_an_impossible_rate_is_refused(stage, rate):
    error = piezoid("design", stage, "--rate", rate).exception
    assert isinstance(error, DesignError)
    assert "a rate from 1 to 10000000 Hz" in str(error)
