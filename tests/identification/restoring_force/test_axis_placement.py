"""A fit says where the hysteresis of an axis stands, and keeps the mode that holds it."""

from dataclasses import replace

import pytest

import piezoid
from piezoid.errors import DesignError
from piezoid.identification.restoring_force.fit import identify_restoring_force
from piezoid.identification.restoring_force.placing import HysteresisPlacement
from tests.identification.restoring_force.test_fit import recorded
from tests.reports.known_stage import axis_model, stage_model

PLACED = HysteresisPlacement(
    place="inside", left_out_rms_m={"inside": 1e-9}, law={"inside": "bouc_wen"},
    without_rms_m=2e-9, mode_Hz=80.0, margin=float("inf"), text="It stands inside.",
)  # fmt: skip


@pytest.fixture(scope="module", params=["bouc_wen", "slip"])
def stage(request: pytest.FixtureRequest) -> piezoid.ActuatorModel:
    swing = identify_restoring_force(recorded(request.param), hold="band_limited")
    axis = replace(axis_model(), placement=PLACED, restoring_force=swing)
    return replace(stage_model(axis), controller_rate_Hz=20e3)


def test_the_mode_and_its_place_come_back_from_model_json(
    stage: piezoid.ActuatorModel, tmp_path: object
) -> None:
    place = f"{tmp_path}/model.json"
    piezoid.save(stage, place)
    back = piezoid.load(place)
    (axis,) = back.axes.values()
    (kept,) = stage.axes.values()
    assert axis.placement == kept.placement
    assert axis.restoring_force is not None
    assert kept.restoring_force is not None
    assert axis.restoring_force.mode == kept.restoring_force.mode
    drive = recorded("none").voltage_V()[:500]
    again, once = (one.restoring_force.simulate(drive, 2000.0) for one in (axis, kept))
    assert (again == once).all()


def test_the_design_refuses_an_axis_whose_hysteresis_stands_inside_a_mode(
    stage: piezoid.ActuatorModel,
) -> None:
    with pytest.raises(DesignError, match="its hysteresis stands inside the mode at"):
        piezoid.design(stage)
