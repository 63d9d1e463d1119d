"""The contract of effects, checked for every effect of the catalogue."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import piezoid.diagnosis.effects as folder
from piezoid.diagnosis.candidate import MINIMUM_Z, evaluate, structural_candidate
from piezoid.diagnosis.effect import HEADINGS, Effect, Filter
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.refinement import initial_guess, refine
from piezoid.diagnosis.score_test import score_test
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import healthy, healthy_view, read_campaign, view_of_recordings, with_fewer_rows

NAMES = [effect.name for effect in EFFECTS]
# Compared with the class of the model instead of with a column.
CLASS_EFFECTS = ("asymmetry", "loop_shape")
INJECTABLE = [effect for effect in EFFECTS if effect.name not in CLASS_EFFECTS]
# A single recording does not know its bias in the full range, and a Bouc-Wen ceramic itself
# contains products with the drive.
CAMPAIGN_EFFECTS = ("non_congruence",)


def reason_against(effect: Effect, view) -> str:
    """Return why an effect is not named; empty if it is named."""
    if effect.fault is not None:
        return "" if effect.fault.find(view) is not None else "the fault is not found"
    test = score_test(effect, view)
    if test is None:
        return "no physical trial has columns that are not zero"
    if effect.structural is not None:
        _, candidate = structural_candidate(effect, view)
    else:
        guess = initial_guess(effect, test.trial, float(test.cv.coefficient[0]))
        (selected,), refitted = refine([guess], view)
        candidate = evaluate(selected, refitted, view, test=test)
    if candidate.is_significant:
        return ""
    gain, z = candidate.cv.gain, candidate.cv.z
    return (
        f"gain {gain:.3g} of {effect.minimum_gain}, z {z:.3g} of {MINIMUM_Z}, physical: "
        f"{candidate.physical}, above its placebo: {candidate.beats_placebo}, absorption "
        f"{test.absorption:.3g}"
    )


def test_every_file_of_the_folder_is_registered_under_its_name():
    files = {path.stem for path in Path(folder.__path__[0]).glob("*.py")} - {"__init__"}
    assert files == set(NAMES)


@pytest.mark.parametrize("effect", EFFECTS, ids=NAMES)
def test_an_effect_explains_itself_in_five_headings(effect):
    lines = effect.explanation.splitlines()
    rows = [lines.index(heading) for heading in HEADINGS]
    assert rows == sorted(rows)
    assert len(effect.experiment) > 40
    assert set(effect.confounded) <= set(NAMES)


def filter_cases() -> list[tuple[str, Filter, dict[str, float]]]:
    """Return every filter of the catalogue with the parameters of its first trial."""
    return [
        (effect.name, filter_, dict(effect.trials(healthy_view())[0].parameters))
        for effect in EFFECTS
        for filter_ in (effect.drive_filter, effect.response_filter)
        if filter_ is not None and effect.trials is not None
    ]


@pytest.mark.parametrize("samples", [0, 1, 2])
def test_a_filter_takes_signals_of_any_length(samples):
    signal = np.linspace(0.0, 1.0, samples)
    for name, filter_, parameters in filter_cases():
        assert len(filter_(signal, 1e-9, parameters)) == samples, name
        assert len(filter_(signal, 1e4, parameters)) == samples, name


@pytest.mark.parametrize("effect", EFFECTS, ids=NAMES)
def test_an_effect_is_not_named_on_a_healthy_stage(effect):
    assert reason_against(effect, healthy_view()), f"{effect.name} is named"


@pytest.mark.parametrize("effect", INJECTABLE, ids=[e.name for e in INJECTABLE])
def test_an_effect_is_named_at_twice_its_detectable_size(effect):
    if effect.name in CAMPAIGN_EFFECTS:
        percent = {effect.name: 200.0 * effect.detectable_share}
        campaign = draw_campaign(20, truth="preisach", plans=("sweep", "check"), effects=percent)
        assert reason_against(effect, view_of_recordings(*read_campaign(campaign))) == ""
        return
    recordings, lab = healthy()
    widest_V = max(float(np.ptp(r.voltage_V())) for r in recordings)
    faulty = list(recordings)
    for k, recording in enumerate(recordings):
        # Small motions do not reach a limit; a gain changes at one instant.
        is_full_range = np.ptp(recording.voltage_V()) > 0.9 * widest_V
        is_affected = {"amplifier_saturation": is_full_range, "gain_change": k == 0}
        if is_affected.get(effect.name, True):
            faulty[k] = effect.inject(recording, 2.0 * effect.detectable_share)
    view = with_fewer_rows(view_of_recordings(tuple(faulty), lab), 2)
    assert reason_against(effect, view) == ""


@pytest.mark.parametrize("effect", EFFECTS, ids=NAMES)
def test_an_injected_effect_changes_the_displacement_only(effect):
    recording = healthy()[0][0]
    if effect.name == "cross_coupling":
        recording = healthy()[0][-1]
    faulty = effect.inject(recording, 0.01)
    change_m = faulty.displacement_m() - recording.displacement_m()
    stroke_m = float(np.ptp(recording.displacement_m()))
    assert 1e-4 * stroke_m < float(np.abs(change_m).max()) < 0.5 * stroke_m
    assert np.array_equal(faulty.voltage_V(), recording.voltage_V())
    assert replace(faulty, channels=recording.channels).name == recording.name
