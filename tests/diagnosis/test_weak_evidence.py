"""A cause with weak evidence is not named if the model predicts as well without it."""

from dataclasses import replace
from importlib import import_module

import pytest

from .bench import thinned
from .play_stage import clean, recording

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plays_alone")]


@pytest.mark.parametrize("is_weak", [False, True])
def test_a_cause_that_the_model_does_not_need_is_named_only_with_strong_evidence(
    is_weak: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = import_module("piezoid.diagnosis.diagnose")
    monkeypatch.setattr(module, "ALPHA", 0.0 if is_weak else 0.05)
    monkeypatch.setattr(module, "CLEARLY_WORSE", 10.0)
    gains = {"before": ("sweep", 1.0), "after": ("sweep", 1.02), "waves": ("waves", 1.02)}
    recordings = [
        replace(recording(kind, gain * clean(kind)[2]), name=name)
        for name, (kind, gain) in gains.items()
    ]
    diagnosis = module.diagnose(thinned(recordings, 3))
    assert ("gain_change" in diagnosis.names) != is_weak
    assert ("gain_change" in {absent.effect for absent in diagnosis.not_detected}) == is_weak
