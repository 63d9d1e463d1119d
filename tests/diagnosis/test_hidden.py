"""Causes hidden by a laboratory that shares nothing with the model are named, and nothing else."""

from functools import cache

import numpy as np

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.sealed_diagnosis import SCHEMA, read_diagnosis, write_diagnosis
from piezoid.digests import unseal
from piezoid_datasets.virtual_lab.campaign import draw_campaign
from piezoid_datasets.virtual_lab.effects import EFFECTS as LABORATORY

from .bench import causes, effects_of, healthy, recorded

DAY = 20261121  # drawn from once, and kept whatever came out
SINGLES = 6
HIDDEN = [effect for effect in LABORATORY if effect.name != "asymmetry"]


def drawn() -> list[tuple[int, tuple[str, ...], tuple[str, ...]]]:
    """Draw seeds, what is hidden in each and recordings that can show it; in the last nothing."""
    chance = np.random.default_rng(DAY)
    chosen = [HIDDEN[int(k)] for k in chance.choice(len(HIDDEN), SINGLES, replace=False)]
    seeds = chance.integers(10_000, 1_000_000, SINGLES + 1).tolist()
    plans = [tuple(dict.fromkeys(("sweep", "check", effect.shown_by[0]))) for effect in chosen]
    singles = [
        (seed, (effect.name,), plan)
        for seed, effect, plan in zip(seeds[:-1], chosen, plans, strict=True)
    ]
    return [*singles, (seeds[-1], (), ("sweep", "check", "rates"))]


@cache
def named(seed: int, hidden: tuple[str, ...], plans: tuple[str, ...]) -> Diagnosis:
    recordings, lab = recorded(draw_campaign(seed, effects=hidden, plans=plans))
    return diagnose(recordings, lab=lab)


def test_drawn_causes_are_named_and_hardly_anything_else():
    *singles, null = drawn()
    found = {
        hidden: [finding.effect for finding in effects_of(named(seed, hidden, plans))]
        for seed, hidden, plans in singles
    }
    hits = sum(hidden[0] in names for hidden, names in found.items())
    false = sum(len(set(names) - set(hidden)) for hidden, names in found.items())
    assert hits >= SINGLES - 1, found
    assert false <= 1, found
    assert causes(named(*null)) == ()


def test_no_limit_lies_below_what_may_be_there_unnamed():
    for case in drawn():
        for silent in named(*case).not_detected:
            if silent.detection_limit_m is None or silent.upper_bound_m is None:
                assert silent.reason
                continue
            assert 0.0 < silent.upper_bound_m <= silent.detection_limit_m


def test_what_is_explained_leaves_less():
    for seed, hidden, plans in drawn()[:-1]:
        found = named(seed, hidden, plans)
        assert 0.0 <= found.explained_fraction <= 1.0
        for finding in found.findings:
            low, high = finding.size.ci95
            assert low <= finding.size.value <= high
        for finding in effects_of(found):
            assert 0.0 <= finding.p_value <= 0.1  # of healthy stages that show evidence at all


def test_a_healthy_stage_has_no_findings_and_a_bound_on_everything():
    recordings, lab = healthy()
    found = diagnose(recordings, lab=lab)
    assert causes(found) == ()
    said = {absent.effect for absent in found.not_detected} | set(found.names)
    assert said == {e.name for e in EFFECTS}
    for absent in found.not_detected:
        assert len(absent.reason) > 20
        assert absent.effect == "asymmetry" or absent.upper_bound_m > 0.0


def test_a_diagnosis_survives_its_file():
    recordings, lab = healthy()
    found = diagnose(recordings, lab=lab)
    written = write_diagnosis(found)
    assert read_diagnosis(written) == found
    content = unseal(written, SCHEMA, "diagnosis.json")
    assert content["final"]["held_out_rms_m"] == found.final.rms_m
