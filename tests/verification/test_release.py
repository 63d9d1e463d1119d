"""Nothing ships that fails its own verification; its figures stay for study."""

from dataclasses import replace
from json import loads

from piezoid.calibration.controllers import shipping_files
from piezoid.export.parameter_file import from_json
from piezoid.verification.verify_stage import release
from tests.verification.known_fit import junction_model, shipped
from tests.verification.rig import stage


def test_what_passes_ships_and_nothing_is_refused():
    found = release(stage("z"), junction_model())
    assert found.parameters is not None
    assert found.verification.passed
    family = {"identified, axis z", "gain x0.8, axis z", "gain x1.25, axis z"}
    assert family <= set(found.verification.plants)
    assert not found.reasons
    files = shipping_files(found)
    assert {"params.json", "bundle/piezoid_runtime.c", "verification.json"} <= set(files)
    assert not any(name.startswith("refused/") for name in files)


def test_what_fails_leaves_neither_parameters_nor_a_bundle_but_its_figures():
    """The tip's loop cannot hold a junction whose gain is eight times the one it is made for."""
    found = release(stage("z"), junction_model(ratios=(1.0, 8.0)))
    assert found.parameters is None
    assert "checks" in found.reasons["z"]
    assert "plants the recordings allow" in found.reasons["z"]
    files = shipping_files(found)
    assert set(files) == {"verification.json", "refused/params.json", "refused/verification.json"}
    assert loads(files["verification.json"])["passed"] is False
    assert [axis.axis for axis in from_json(files["refused/params.json"], "p").axes] == ["z"]


def test_an_axis_that_passes_alone_ships_without_the_one_that_fails():
    tip = stage("z")
    within = {"reference_minimum_m": -7e-6, "reference_maximum_m": 1.1e-5}
    both = replace(tip, axes=(shipped("mpi_dob").with_values(within), *tip.axes))
    found = release(both, junction_model(ratios=(1.0, 8.0)))
    assert [axis.axis for axis in found.parameters.axes] == ["x"]
    assert set(found.reasons) == {"z"} == set(found.parameters.unshipped)
    assert found.verification.passed
    assert not found.refused_verification.passed
