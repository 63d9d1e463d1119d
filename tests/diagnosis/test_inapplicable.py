"""Where the class of model does not apply, no cause is named: it would stand for the class."""

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.effects import EFFECTS
from tests.laws import LAWS, recorded, triangles

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order")


@pytest.mark.parametrize("law", ["preisach", "dahl"])
def test_a_butterfly_has_a_reason_and_no_causes(tmp_path, law):
    field = triangles(6, 250)
    noise_um = 0.01 * np.random.default_rng(2).standard_normal(len(field))
    strain = LAWS[law](field)
    strain = strain - 0.5 * (strain.max() + strain.min())
    reading_um = 8.0 * strain**2 + 0.4 * field + noise_um
    found = diagnose([recorded(tmp_path, field, reading_um)])
    assert found.names == ()
    assert {one.effect for one in found.not_detected} == {effect.name for effect in EFFECTS}
    assert all("butterfly" in one.reason for one in found.not_detected)


def test_faults_of_the_data_are_named_all_the_same(tmp_path):
    field = triangles(6, 250)
    reading_um = 8.0 * field**2 + 0.01 * np.random.default_rng(2).standard_normal(len(field))
    reading_um[40::97] = 99.0
    found = diagnose([recorded(tmp_path, field, reading_um)])
    assert found.names == ("outliers",)
