"""Where the model class does not apply, no effect is named."""

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.effects import EFFECTS
from tests.laws import LAWS, recorded, triangles

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")


def test_a_butterfly_has_a_reason_and_no_findings(tmp_path):
    field = triangles(6, 250)
    noise_um = 0.01 * np.random.default_rng(2).standard_normal(len(field))
    strain = LAWS["preisach"](field)
    strain = strain - 0.5 * (strain.max() + strain.min())
    reading_um = 8.0 * strain**2 + 0.4 * field + noise_um
    diagnosis = diagnose([recorded(tmp_path, field, reading_um)])
    assert diagnosis.names == ()
    assert {absent.effect for absent in diagnosis.not_detected} == {
        effect.name for effect in EFFECTS
    }
    assert all("butterfly" in absent.reason for absent in diagnosis.not_detected)


def test_faults_of_the_data_are_named_for_a_butterfly(tmp_path):
    field = triangles(6, 250)
    reading_um = 8.0 * field**2 + 0.01 * np.random.default_rng(2).standard_normal(len(field))
    reading_um[40::97] = 99.0
    diagnosis = diagnose([recorded(tmp_path, field, reading_um)])
    assert diagnosis.names == ("outliers",)
