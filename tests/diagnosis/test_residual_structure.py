"""What no effect of the catalogue stands for is admitted, with the coordinate it lives in.

Seeds are drawn anew each time and printed: PIEZOID_SEED=... repeats a run. What is promised of a
stage drawn anew is a rate: where one stage breaks the promise, a second one must keep it. Of 15
runs 14 needed no second one.
"""

import os
import secrets
import sys
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from benchmarks.goldens import artefacts_of
from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import Diagnosis, Finding
from piezoid.diagnosis.residual_structure import NAME
from piezoid.diagnosis.sealed_diagnosis import SCHEMA, read_diagnosis, write_diagnosis
from piezoid.digests import unseal
from piezoid.identification.fit import fit
from piezoid_datasets.virtual_lab.campaign import draw_campaign
from piezoid_datasets.virtual_lab.laboratory import draw_laboratory
from piezoid_datasets.virtual_lab.truths import TRUTHS
from tests.identification.hysteresis.stages import decaying, recording
from tests.identification.hysteresis.test_estimate import stage

from .bench import causes, recorded

SEED = int(os.environ.get("PIEZOID_SEED") or secrets.randbelow(10**6))
PLANS = ("sweep", "check")
HIDDEN = {
    "tone": (1.0, "frequency"),
    "dent": (1.2, "displacement"),
    "every_nth": (1.0, "sample_index"),
}


SECOND = 500  # turns on: the stage that is asked where the first breaks a promise


def twice(promise: Callable[[int], None]) -> None:
    try:
        promise(0)
    except AssertionError as broken:
        sys.stdout.write(f"broken by the first stage: {broken}\n")
        promise(SECOND)


@cache
def diagnosed(
    turn: int, hidden: str = "", percent: float = 0.0, effect: str = "", truth: str | None = None
) -> Diagnosis:
    seed = SEED + 1000 * turn
    sys.stdout.write(f"PIEZOID_SEED={SEED}: stage {seed}, {hidden or effect or 'healthy'}\n")
    campaign = draw_campaign(
        seed,
        truth=truth,
        effects=(effect,) if effect else (),
        plans=(*PLANS, "rates") if effect else PLANS,
        uncatalogued={hidden: percent} if hidden else None,
    )
    recordings, lab = recorded(campaign)
    return diagnose(recordings, lab=lab)


def structure_in(diagnosis: Diagnosis) -> Finding:
    """Return the finding that no effect of the catalogue explains."""
    return next(finding for finding in diagnosis.findings if finding.effect == NAME)


@pytest.mark.parametrize("hidden", HIDDEN)
def test_what_is_in_no_catalogue_is_said_to_be_something_else_with_its_coordinate(hidden):
    percent, coordinate = HIDDEN[hidden]

    def promise(second: int) -> None:
        found = diagnosed(list(HIDDEN).index(hidden) + second, hidden, percent)
        assert set(causes(found)) <= {NAME, "outliers"}  # single samples that are off, as well
        told = next((f for f in found.findings if f.effect == NAME), None)
        assert told is not None
        assert told.coordinate == coordinate
        assert told.p_value <= 0.05
        assert NAME not in {absent.effect for absent in found.not_detected}
        assert found.unexplained is not None
        assert found.unexplained.rms_m > found.noise_floor_rms_m
        assert found.final.rms_m < found.baseline.rms_m

    twice(promise)


def test_the_size_of_a_tone_is_in_its_interval():
    def promise(second: int) -> None:
        tone = structure_in(diagnosed(second, "tone", HIDDEN["tone"][0]))
        stage = draw_campaign(SEED + 1000 * second, plans=PLANS)
        assert tone.size.value == pytest.approx(1e9 * 0.01 * stage.rig.stroke_m, rel=0.05)
        assert "frequency_Hz" in tone.parameters

    twice(promise)


@pytest.mark.parametrize("truth", [truth.name for truth in TRUTHS])
def test_a_healthy_stage_of_any_law_has_nothing_else(truth):
    def promise(second: int) -> None:
        found = diagnosed(10 + [t.name for t in TRUTHS].index(truth) + second, truth=truth)
        assert NAME not in found.names
        assert found.unexplained is not None
        assert 0.0 < found.unexplained.p_value <= 1.0

    twice(promise)


def test_what_healthy_stages_leave_as_often_is_nothing_else():
    """A curve along one coordinate helps here, and of 49 healthy stages six leave more."""
    seed = 1224001
    laboratory = draw_laboratory(np.random.default_rng([seed, 9]))
    campaign = draw_campaign(seed, truth="krasnoselskii_pokrovskii", laboratory=laboratory)
    recordings, lab = recorded(campaign)
    found = diagnose(recordings, lab=lab)
    assert found.unexplained is not None
    assert found.unexplained.p_value > 0.05
    assert NAME not in found.names


@pytest.mark.parametrize("effect", ["mains_interference"])
def test_an_effect_of_the_catalogue_raises_nothing_else(effect):
    def promise(second: int) -> None:
        assert NAME not in diagnosed(20 + second, effect=effect).names

    twice(promise)


def test_a_delay_is_named_though_a_curve_along_the_speed_leaves_less_of_the_class():
    """With a model at hand, which is then better with the name than with the curve."""
    made = artefacts_of((2, "delay", "preisach"))["stage 2/diagnosis.json"]
    findings = [f["effect"] for f in unseal(made, SCHEMA, "diagnosis.json")["findings"]]
    assert [name for name in findings if name != "loop_shape"] == ["delay"]


def test_a_reading_that_ends_is_told_with_its_level():
    campaign = draw_campaign(401, truth="bouc_wen", plans=PLANS, uncatalogued={"range_end": 4.0})
    recordings, lab = recorded(campaign)
    found = diagnose(recordings, lab=lab)
    assert causes(found) == (NAME,)
    assert structure_in(found).coordinate == "reading"
    level_um = 0.96e6 * campaign.rig.stroke_m
    assert structure_in(found).law.startswith("reading = min(displacement, ")
    said_um = float(structure_in(found).law.split(", ")[1].split()[0])
    assert said_um == pytest.approx(level_um, rel=1e-2)


@pytest.fixture(scope="module")
def dented() -> Diagnosis:
    recordings, lab = recorded(draw_campaign(1001, plans=PLANS, uncatalogued={"dent": 1.2}))
    return diagnose(recordings, lab=lab)


def test_something_else_survives_its_file(dented):
    written = write_diagnosis(dented)
    assert read_diagnosis(written) == dented
    content = unseal(written, SCHEMA, "diagnosis.json")
    assert set(content["unexplained"]) >= {"rms_m", "share", "p_value"}
    entry = next(entry for entry in content["findings"] if entry["effect"] == NAME)
    assert entry["coordinate"] == "displacement"
    assert len(entry["seen"]["place"]) == len(entry["seen"]["fitted_m"])


def test_its_picture_shows_where_the_reading_is_wrong(dented):
    seen = structure_in(dented).seen
    assert seen is not None
    at = int(np.argmax(np.abs(seen.fitted_m)))
    assert abs(seen.median_m[at]) > 0.3 * abs(seen.fitted_m[at])


def test_what_the_simulation_follows_is_not_taken_off_its_recordings():
    """Of 700 samples the search's class leaves a remainder that the fitted model does not have."""
    drive = decaying(7, per_unit=20)
    made = recording(drive, stage(drive, np.random.default_rng(5)))
    model = fit([made])["x"]
    found = diagnose([made], model=model)
    assert NAME not in found.names
    assert found.model is not None
    assert found.model.quality.rms_m < 1.1 * model.quality.rms_m


def test_an_end_of_the_range_is_told_where_the_class_does_not_foretell_the_rest():
    """The readings beyond it are left out, so that no foretelling of them is asked for."""
    campaign = draw_campaign(407, truth="duhem", plans=PLANS, uncatalogued={"range_end": 16.0})
    recordings, lab = recorded(campaign)
    found = diagnose(recordings, lab=lab)
    assert causes(found) == (NAME,)
    assert structure_in(found).coordinate == "reading"
