"""What no effect of the catalogue stands for is admitted, with the coordinate it lives in.

Seeds are fixed; PIEZOID_SEED=... draws the hidden structures and the healthy stages anew.
"""

import os
from functools import cache

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose, view_on
from piezoid.diagnosis.diagnosis import SOMETHING_ELSE, Diagnosis, Finding
from piezoid.diagnosis.residual_structure import search_all
from piezoid.diagnosis.sealed_diagnosis import SCHEMA, read_diagnoses, write_diagnosis
from piezoid.digests import unseal
from piezoid.identification.fit import fit
from piezoid.numerics.executor import SERIAL
from piezoid_datasets.virtual_lab.campaign import draw_campaign
from tests.identification.hysteresis.stages import decaying, recording
from tests.identification.hysteresis.test_estimate import stage

from .bench import causes, recorded, recorded_zoo_stage, thinned

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plays_alone")]

SEED = int(os.environ.get("PIEZOID_SEED", "1"))
PLANS = ("sweep", "check")
EVERY = 10  # samples of readings that end, whatever their rate
# Name: percent of the stroke, coordinate. For a tone: tests/journeys/test_something_else.py.
HIDDEN = {"dent": (1.2, "displacement"), "every_nth": (1.0, "sample_index")}


@cache
def diagnosed(turn: int, hidden: str = "", percent: float = 0.0, truth: str = "") -> Diagnosis:
    campaign = draw_campaign(
        SEED + 1000 * turn,
        truth=truth or None,
        plans=PLANS,
        uncatalogued={hidden: percent} if hidden else None,
    )
    recordings, lab = recorded(campaign)
    is_in_samples = hidden == "every_nth"
    return diagnose(recordings if is_in_samples else thinned(recordings, 6), lab=lab)


def with_hidden(hidden: str) -> Diagnosis:
    return diagnosed(1 + list(HIDDEN).index(hidden), hidden, HIDDEN[hidden][0])


def structure_in(diagnosis: Diagnosis) -> Finding:
    """Return the finding that no effect of the catalogue explains."""
    return next(finding for finding in diagnosis.findings if finding.effect == SOMETHING_ELSE)


@pytest.mark.usefixtures("one_order")
@pytest.mark.parametrize("hidden", HIDDEN)
def test_what_is_in_no_catalogue_is_said_to_be_something_else_with_its_coordinate(hidden):
    diagnosis = with_hidden(hidden)
    assert set(causes(diagnosis)) <= {
        SOMETHING_ELSE,
        "outliers",
    }  # single samples that are off, as well
    structure = structure_in(diagnosis)
    assert structure.coordinate == HIDDEN[hidden][1]
    assert structure.p_value <= 0.05
    assert SOMETHING_ELSE not in {absent.effect for absent in diagnosis.not_detected}
    assert diagnosis.unexplained is not None
    assert diagnosis.unexplained.rms_m > diagnosis.noise_floor_rms_m


@pytest.mark.usefixtures("one_order")
def test_the_final_error_is_smaller_than_that_of_the_model_without_the_structure():
    diagnosis = with_hidden("every_nth")
    assert diagnosis.final.rms_m < diagnosis.baseline.rms_m


@pytest.mark.usefixtures("one_order")
def test_a_reading_that_ends_is_told_with_its_level():
    campaign = draw_campaign(401, truth="bouc_wen", plans=PLANS, uncatalogued={"range_end": 4.0})
    recordings, lab = recorded(campaign)
    found = diagnose(thinned(recordings, EVERY), lab=lab)
    assert causes(found) == (SOMETHING_ELSE,)
    assert structure_in(found).coordinate == "reading"
    level_um = 0.96e6 * campaign.rig.stroke_m
    assert structure_in(found).law.startswith("reading = min(displacement, ")
    said_um = float(structure_in(found).law.split(", ")[1].split()[0])
    assert said_um == pytest.approx(level_um, rel=1e-2)


@pytest.mark.usefixtures("one_order")
def test_something_else_survives_its_file_and_its_picture_shows_where_the_reading_is_wrong():
    dented = with_hidden("dent")
    written = write_diagnosis(dented)
    assert read_diagnoses(written)[0] == dented
    content = unseal(written, SCHEMA, "diagnosis.json")
    assert set(content["unexplained"]) >= {"rms_m", "share", "p_value"}
    entry = next(entry for entry in content["findings"] if entry["effect"] == SOMETHING_ELSE)
    assert entry["coordinate"] == "displacement"
    assert len(entry["seen"]["place"]) == len(entry["seen"]["fitted_m"])
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
    assert SOMETHING_ELSE not in found.names
    assert found.model is not None
    assert found.model.quality.rms_m < 1.1 * model.quality.rms_m


@pytest.mark.usefixtures("one_order")
def test_an_end_of_the_range_is_told_where_the_class_does_not_foretell_the_rest():
    """The readings beyond it are left out, so that no foretelling of them is asked for."""
    campaign = draw_campaign(407, truth="duhem", plans=PLANS, uncatalogued={"range_end": 16.0})
    recordings, lab = recorded(campaign)
    found = diagnose(thinned(recordings, 2 * EVERY), lab=lab)
    assert causes(found) == (SOMETHING_ELSE,)
    assert structure_in(found).coordinate == "reading"


def test_coarse_steps_of_the_readings_are_found_beside_other_structure() -> None:
    """Steps of 443 nm: readings minus a curve are no multiples, and a curve may be the steps."""
    recordings, lab, _ = recorded_zoo_stage("wall_pinning", "triple", 25808154)
    two = [recording for recording in recordings if recording.name in ("sweep.csv", "check.csv")]
    result = search_all(view_on(two, axis="x", lab=lab), SERIAL)
    assert result.outcome.faults["quantisation"].value == pytest.approx(443.0, rel=0.01)
    assert result.structure is None or result.structure.score.coordinate != "reading"
