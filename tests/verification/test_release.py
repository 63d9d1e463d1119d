"""A controller that fails its verification does not ship; its figures are kept."""

from dataclasses import replace
from json import loads

from piezoid.calibration.controllers import shipping_files
from piezoid.export.parameter_file import from_json
from piezoid.verification.verify_stage import release
from tests.verification.known_fit import junction_model, shipped
from tests.verification.rig import stage


def test_a_stage_that_passes_ships():
    released = release(stage("z"), junction_model())
    assert released.parameters is not None
    assert released.verification.passed
    family = {"identified, axis z", "gain x0.8, axis z", "gain x1.25, axis z"}
    assert family <= set(released.verification.plants)
    assert not released.reasons
    files = shipping_files(released)
    assert {"params.json", "bundle/piezoid_runtime.c", "verification.json"} <= set(files)
    assert not any(name.startswith("refused/") for name in files)


def test_a_failing_stage_ships_only_its_refused_files():
    """The loop of the tip is unstable for a junction of eight times the design gain."""
    released = release(stage("z"), junction_model(ratios=(1.0, 8.0)))
    assert released.parameters is None
    assert "checks" in released.reasons["z"]
    assert "plants the recordings allow" in released.reasons["z"]
    files = shipping_files(released)
    assert set(files) == {"verification.json", "refused/params.json", "refused/verification.json"}
    assert loads(files["verification.json"])["passed"] is False
    assert [axis.axis for axis in from_json(files["refused/params.json"], "p").axes] == ["z"]


def test_a_passing_axis_ships_without_the_failing_axis():
    tip_stage = stage("z")
    within = {"reference_minimum_m": -7e-6, "reference_maximum_m": 1.1e-5}
    file = replace(tip_stage, axes=(shipped("mpi_dob").with_values(within), *tip_stage.axes))
    released = release(file, junction_model(ratios=(1.0, 8.0)))
    assert [axis.axis for axis in released.parameters.axes] == ["x"]
    assert set(released.reasons) == {"z"} == set(released.parameters.unshipped)
    assert released.verification.passed
    assert not released.refused_verification.passed
