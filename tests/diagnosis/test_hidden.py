"""Causes hidden by a laboratory that shares nothing with the model are named, and nothing else."""

import json

import pytest

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import SCHEMA, write_diagnosis
from piezoid.diagnosis.effects import EFFECTS
from piezoid.provenance import unseal
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import healthy, recorded

CASES = {
    "creep": 1005,
    "resonance": 1006,
    "cross_coupling": 1008,
    "mains_interference": 1013,
    "outliers": 1015,
}


@pytest.mark.parametrize("effect", CASES)
def test_a_hidden_cause_is_named_first_and_alone(effect):
    campaign = draw_campaign(CASES[effect], effects=(effect,))
    recordings, lab = recorded(campaign)
    found = diagnose(recordings, lab=lab)
    assert found.names == (effect,)
    finding = found.findings[0]
    assert finding.held_out_rms_after_m < finding.held_out_rms_before_m
    assert found.final.rms_m < found.baseline.rms_m
    assert 0.0 < found.explained_fraction <= 1.0


def test_a_healthy_stage_has_no_findings_and_a_bound_on_everything():
    recordings, lab = healthy()
    found = diagnose(recordings, lab=lab)
    assert found.findings == ()
    assert [absent.effect for absent in found.not_detected] == [e.name for e in EFFECTS]
    for absent in found.not_detected:
        assert len(absent.reason) > 20
        assert absent.effect == "asymmetry" or absent.upper_bound_m > 0.0


def test_a_diagnosis_survives_its_file():
    recordings, lab = healthy()
    found = diagnose(recordings, lab=lab)
    content = unseal(write_diagnosis(found), SCHEMA, "diagnosis.json")
    assert json.loads(json.dumps(found.to_json())).items() <= content.items()
    assert content["final"]["held_out_rms_m"] == found.final.rms_m
