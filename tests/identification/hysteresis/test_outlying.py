"""Single outliers of a rough fit are excluded; corners of a hysteresis law are none."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.numerics.arrays import Array
from piezoid_datasets.virtual_lab.truths import ZOO
from tests.laws import recorded, triangles

SIZES = (1.0, 0.8, 0.6, 0.9, 0.5, 1.0)
FIELD = np.concatenate([size * (triangles(1, 200) + 1.0) - 1.0 for size in SIZES])
NO_POLES = Rig(amplifier_bandwidth_Hz=None, sensor_bandwidth_Hz=None)
pytestmark = pytest.mark.usefixtures("one_order")
FRICTION_LAWS = ("dahl", "generalised_bouc_wen", "coleman_hodgdon", "wall_pinning")


def outlier_remark(folder: Path, reading_um: Array) -> str:
    recording = recorded(folder, FIELD, reading_um)
    model = estimate_axis([recording], "x", NO_POLES, orders=((2, 0),))
    return " ".join(remark for remark in model.verdict.remarks if "single readings" in remark)


def clean_um(law: str) -> Array:
    ceramic = next(truth for truth in ZOO if truth.name == law).draw(np.random.default_rng(77))
    displacement_um = 30 * sum(ceramic.respond(FIELD, np.array([1.0, -1.0])))
    return np.asarray(
        displacement_um + 0.01 * np.random.default_rng(9).standard_normal(len(FIELD))
    )


@pytest.mark.parametrize("law", FRICTION_LAWS)
def test_the_response_after_a_turn_is_not_an_outlier(law, tmp_path):
    assert outlier_remark(tmp_path, clean_um(law)) == ""


def test_outliers_of_a_hundredth_of_the_range_are_excluded(tmp_path):
    reading_um = clean_um("dahl")
    reading_um[57::113] += 0.8  # within branches, and three samples after a turn
    reading_um[803] -= 0.8
    assert "single readings were excluded (12, " in outlier_remark(tmp_path, reading_um)
