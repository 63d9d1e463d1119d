"""Structure outside the catalogue is something else, with the coordinate of its residual.

Seeds are fixed; PIEZOID_SEED=... draws the hidden structures and the healthy stages anew.
"""

import os
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose, view_on
from piezoid.diagnosis.diagnosis import SOMETHING_ELSE, Diagnosis, Finding, Unexplained
from piezoid.diagnosis.residual_structure import ResidualStructure, locate_structure
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.sealed_diagnosis import SCHEMA, read_diagnoses, write_diagnosis
from piezoid.diagnosis.selection import search, search_all
from piezoid.digests import unseal
from piezoid.identification.fit import fit
from piezoid.numerics.executor import SERIAL
from piezoid_datasets.virtual_lab.campaign import draw_campaign
from tests.identification.hysteresis.stages import decaying, recording
from tests.identification.hysteresis.test_estimate import stage
from tests.laws import LAWS, triangles
from tests.plays_alone import fit_few_rows

from .bench import (
    causes,
    finding_of,
    read_campaign,
    recorded_zoo_stage,
    single_axis_recording,
    thinned,
    view_of_recordings,
    with_fewer_rows,
)

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plays_alone", "few_rows")]

SEED = int(os.environ.get("PIEZOID_SEED", "1"))
PLANS = ("sweep", "check")
# Name: percent of the stroke, coordinate. Tones: tests/journeys/test_diagnose.py.
HIDDEN = {"dent": (1.2, "displacement"), "every_nth": (1.0, "sample_index")}


@cache
def diagnosed(index: int, hidden: str = "", percent: float = 0.0, truth: str = "") -> Diagnosis:
    is_in_samples = hidden == "every_nth"
    campaign = draw_campaign(
        SEED + 1000 * index,
        truth=truth or None,
        plans=PLANS[:1] if is_in_samples else PLANS,
        uncatalogued={hidden: percent} if hidden else None,
    )
    recordings, lab = read_campaign(campaign)
    return diagnose(recordings if is_in_samples else thinned(recordings, 20), lab=lab)


def with_hidden(hidden: str) -> Diagnosis:
    return diagnosed(1 + list(HIDDEN).index(hidden), hidden, HIDDEN[hidden][0])


def structure_in(diagnosis: Diagnosis) -> Finding:
    """Return the finding of structure outside the catalogue."""
    return finding_of(diagnosis, SOMETHING_ELSE)


@pytest.mark.usefixtures("one_order")
@pytest.mark.parametrize("hidden", HIDDEN)
def test_structure_outside_the_catalogue_is_something_else_with_its_coordinate(hidden):
    diagnosis = with_hidden(hidden)
    # Every n-th sample may also count as outliers.
    assert set(causes(diagnosis)) <= {SOMETHING_ELSE, "outliers"}
    structure = structure_in(diagnosis)
    assert structure.coordinate == HIDDEN[hidden][1]
    assert structure.p_value <= 0.05
    assert SOMETHING_ELSE not in {absent.effect for absent in diagnosis.not_detected}
    assert diagnosis.unexplained.rms_m > diagnosis.noise_floor_rms_m


def with_tone(law: str) -> View:
    """Return a sweep whose reading has a tone near the third harmonic of the drive."""
    drive = triangles(6, 500)
    noise = np.random.default_rng(0).standard_normal(len(drive))
    tone = 0.02 * np.sin(2.0 * np.pi * 2.83 * np.arange(len(drive)) / 500.0)
    reading_m = 1e-5 * (LAWS[law](drive) + tone + 8e-4 * noise)
    return view_of_recordings([single_axis_recording("sweep", 500.0, 5.0 * drive, reading_m)])


@cache
def located_tone(law: str) -> tuple[Unexplained, ResidualStructure]:
    unexplained, (structure,) = locate_structure(search(with_tone(law)))
    return unexplained, structure


@pytest.mark.parametrize("law", ["bouc_wen", "dahl"])
def test_a_tone_near_a_harmonic_of_the_drive_is_located_by_its_frequency(law):
    """Beside tangents that explain no more than their placebos, the distance fitted better."""
    unexplained, structure = located_tone(law)
    assert unexplained.coordinate == structure.score.coordinate == "frequency"


def test_spikes_of_a_subtracted_curve_are_no_outliers(monkeypatch):
    unexplained, structure = located_tone("dahl")
    (curve,) = structure.curve
    spiky = replace(structure, curve=(curve + 0.2 * (np.arange(len(curve)) % 300 == 150),))
    monkeypatch.setattr(
        "piezoid.diagnosis.selection.locate_structure", lambda _: (unexplained, [spiky])
    )
    monkeypatch.setattr("piezoid.diagnosis.selection.MAX_SECOND_RATIO", 100.0)
    result = search_all(with_tone("dahl"), SERIAL)
    assert result.structure is spiky
    assert "outliers" not in result.outcome.faults


@pytest.mark.usefixtures("one_order")
def test_structure_in_the_model_reduces_the_final_error():
    diagnosis = with_hidden("every_nth")
    assert diagnosis.final.rms_m < diagnosis.baseline.rms_m


@pytest.mark.usefixtures("one_order")
def test_something_else_survives_its_file_and_locates_the_error():
    diagnosis = with_hidden("dent")
    written = write_diagnosis(diagnosis)
    assert read_diagnoses(written)[0] == diagnosis
    content = unseal(written, SCHEMA, "diagnosis.json")
    assert set(content["unexplained"]) >= {"rms_m", "share", "p_value"}
    entry = next(entry for entry in content["findings"] if entry["effect"] == SOMETHING_ELSE)
    assert entry["coordinate"] == "displacement"
    assert len(entry["seen"]["place"]) == len(entry["seen"]["fitted_m"])
    trace = structure_in(diagnosis).seen
    peak = int(np.argmax(np.abs(trace.fitted_m)))
    assert abs(trace.median_m[peak]) > 0.3 * abs(trace.fitted_m[peak])


def test_structure_that_the_model_represents_is_not_a_finding():
    """With 700 samples the search class leaves a residual that the fitted model does not have."""
    drive = decaying(7, per_unit=20)
    loops = recording(drive, stage(drive, np.random.default_rng(5)))
    model = fit([loops])["x"]
    diagnosis = diagnose([loops], model=model)
    assert SOMETHING_ELSE not in diagnosis.names
    assert diagnosis.model.quality.rms_m < 1.1 * model.quality.rms_m


@pytest.mark.usefixtures("one_order")
@pytest.mark.parametrize(
    ("law", "seed", "percent", "every", "rows", "rel"),
    [("bouc_wen", 401, 4.0, 10, 12_000, 1e-2), ("duhem", 407, 16.0, 20, 3000, 3e-2)],
    ids=["bouc_wen", "poorly predicted duhem"],
)
def test_the_end_of_the_sensor_range_is_named_with_its_level(
    law, seed, percent, every, rows, rel, monkeypatch
):
    """Readings beyond the end are excluded and need no prediction."""
    fit_few_rows(monkeypatch, rows)
    campaign = draw_campaign(seed, truth=law, plans=PLANS, uncatalogued={"range_end": percent})
    recordings, lab = read_campaign(campaign)
    diagnosis = diagnose(thinned(recordings, every), lab=lab)
    assert causes(diagnosis) == (SOMETHING_ELSE,)
    structure = structure_in(diagnosis)
    assert structure.coordinate == "reading"
    level_um = (1.0 - percent / 100.0) * 1e6 * campaign.rig.stroke_m
    assert structure.law.startswith("reading = min(displacement, ")
    assert float(structure.law.split(", ")[1].split()[0]) == pytest.approx(level_um, rel=rel)


def test_quantisation_of_the_readings_is_found_with_other_structure():
    """Steps of 443 nm; the residual has no lattice, and a smooth curve may absorb the steps."""
    recordings, lab, _ = recorded_zoo_stage("wall_pinning", "triple", 25808154)
    loops = [recording for recording in recordings if recording.name in ("sweep.csv", "check.csv")]
    view = with_fewer_rows(view_on(loops, axis="x", lab=lab), 3)
    result = search_all(view, SERIAL)
    assert result.outcome.faults["quantisation"].value == pytest.approx(443.0, rel=0.01)
    assert result.structure is None or result.structure.score.coordinate != "reading"
