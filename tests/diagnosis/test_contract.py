"""What every effect promises, run over all of them: a new one needs no test file to be held to."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import piezoid.diagnosis.effects as folder
from piezoid.diagnosis.candidate import evaluate, structural_candidate
from piezoid.diagnosis.effect import HEADINGS, Effect, Filter
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.refinement import initial_guess, refine
from piezoid.diagnosis.score_test import score_test
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import healthy, healthy_view, recorded, view_of_recordings

NAMES = [effect.name for effect in EFFECTS]
# asymmetry is part of the simulation and can be missing from nothing
COMPARED = ("asymmetry", "loop_shape")  # with the class of the model, not with a column
FOUND = [effect for effect in EFFECTS if effect.name not in COMPARED]
# one recording alone does not know at which bias of the whole range it lies; and products with
# the drive are in a Bouc-Wen ceramic by themselves
TOGETHER = ("non_congruence",)


def speaks(effect: Effect, view) -> bool:
    if effect.fault is not None:
        return effect.fault.find(view) is not None
    found = score_test(effect, view)
    if found is None:
        return False
    if effect.structural is not None:
        _, structure = structural_candidate(effect, view)
        return structure.is_significant
    one, there = refine(
        initial_guess(effect, found.trial, float(found.cv.coefficient[0])), view, []
    )
    return evaluate(one, there, view, test=found).is_significant


def test_every_file_of_the_folder_is_registered_under_its_own_name():
    files = {path.stem for path in Path(folder.__path__[0]).glob("*.py")} - {"__init__"}
    assert files == set(NAMES)


@pytest.mark.parametrize("effect", EFFECTS, ids=NAMES)
def test_an_effect_explains_itself_in_five_headings(effect):
    lines = effect.explanation.splitlines()
    places = [lines.index(heading) for heading in HEADINGS]
    assert places == sorted(places)
    assert len(effect.experiment) > 40
    assert set(effect.confounded) <= set(NAMES)


def filter_cases() -> list[tuple[str, Filter, dict[str, float]]]:
    """Return every filter of the catalogue with the parameters of one of its trials."""
    return [
        (effect.name, passed, dict(effect.trials(healthy_view())[0].parameters))
        for effect in EFFECTS
        for passed in (effect.drive_filter, effect.response_filter)
        if passed is not None and effect.trials is not None
    ]


@pytest.mark.parametrize("samples", [0, 1, 2])
def test_a_filter_takes_signals_of_any_length(samples):
    signal = np.linspace(0.0, 1.0, samples)
    for name, passed, parameters in filter_cases():
        assert len(passed(signal, 1e-9, parameters)) == samples, name
        assert len(passed(signal, 1e4, parameters)) == samples, name


@pytest.mark.parametrize("effect", EFFECTS, ids=NAMES)
def test_an_effect_says_nothing_of_a_healthy_stage(effect):
    assert not speaks(effect, healthy_view())


@pytest.mark.parametrize("effect", FOUND, ids=[e.name for e in FOUND])
def test_an_effect_speaks_at_twice_the_size_it_declares(effect):
    if effect.name in TOGETHER:
        percent = {effect.name: 200.0 * effect.detectable_share}
        hidden = draw_campaign(20, truth="preisach", plans=("sweep", "check"), effects=percent)
        assert speaks(effect, view_of_recordings(*recorded(hidden)))
        return
    recordings, lab = healthy()
    widest_V = max(float(np.ptp(r.voltage_V())) for r in recordings)
    struck = list(recordings)
    for k, recording in enumerate(recordings):
        # a clip of the full range is not met by small motions; a gain changes at one instant
        full = np.ptp(recording.voltage_V()) > 0.9 * widest_V
        met = {"amplifier_saturation": full, "gain_change": k == 0}
        if met.get(effect.name, True):
            struck[k] = effect.inject(recording, 2.0 * effect.detectable_share)
    assert speaks(effect, view_of_recordings(tuple(struck), lab))


@pytest.mark.parametrize("effect", EFFECTS, ids=NAMES)
def test_an_injected_effect_changes_the_displacement_and_nothing_else(effect):
    recording = healthy()[0][0]
    if effect.name == "cross_coupling":
        recording = healthy()[0][-1]
    struck = effect.inject(recording, 0.01)
    change_m = struck.displacement_m() - recording.displacement_m()
    stroke_m = float(np.ptp(recording.displacement_m()))
    assert 1e-4 * stroke_m < float(np.abs(change_m).max()) < 0.5 * stroke_m
    assert np.array_equal(struck.voltage_V(), recording.voltage_V())
    assert replace(struck, channels=recording.channels).name == recording.name
