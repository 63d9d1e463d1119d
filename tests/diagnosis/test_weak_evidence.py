"""Causes that the model does not need are not named."""

from dataclasses import replace
from functools import cache
from importlib import import_module

import numpy as np
import pytest

from piezoid.diagnosis import residual_structure
from piezoid.diagnosis.diagnosis import SOMETHING_ELSE
from piezoid.diagnosis.residual_structure import SensorRangeEnd
from piezoid.identification.fit import fit
from piezoid.identification.loop_shape_blocks import Errors
from piezoid.identification.loop_shape_columns import zero_loop_shape
from piezoid.numerics.executor import SERIAL
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording

from .bench import thinned
from .play_stage import clean, recording

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plays_alone", "one_order")]

diagnose_module = import_module("piezoid.diagnosis.diagnose")


def recorded(every: int, **gains: float) -> tuple[Recording, ...]:
    """Return a sweep, the same sweep again, and waves, each with its own gain."""
    kinds = {"before": "sweep", "after": "sweep", "waves": "waves"}
    recordings = [
        replace(recording(kind, gains.get(name, 1.0) * clean(kind)[2]), name=name)
        for name, kind in kinds.items()
    ]
    return thinned(recordings, every)


@cache
def changed_gain():
    """Return recordings with a gain that changed, their model, and the effects found in them."""
    recordings = recorded(6, after=1.02, waves=1.02)
    model = fit(recordings)["x"]
    selection = diagnose_module._select_effects(
        recordings, "x", model, Lab(), SERIAL, is_rejected=False
    )
    return recordings, model, selection


@pytest.mark.parametrize(
    ("evidence_p_value", "max_ratio", "error_without_m", "is_named"),
    [
        (lambda _: 0.0, 10.0, 0.0, False),
        (lambda _: 1.0, 10.0, np.inf, False),
        (lambda _: 1.0, 0.0, np.inf, True),
        (lambda strength: float(np.isfinite(strength)), 10.0, np.inf, True),
    ],
    ids=[
        "loop shape fits as well without",
        "weak evidence, the model does as well without",
        "weak evidence, the model needs it",
        "evidence that is weak in the search and strong beside loop shape",
    ],
)
def test_a_doubtful_cause_is_named_only_if_the_model_needs_it(
    evidence_p_value, max_ratio, error_without_m, is_named, monkeypatch
):
    recordings, model, selection = changed_gain()
    errors_m = Errors(explained=error_without_m, held_out=error_without_m)
    monkeypatch.setattr(diagnose_module, "evidence_p_value", evidence_p_value)
    monkeypatch.setattr(diagnose_module, "errors_with_loop_shape_m", lambda *_: errors_m)
    monkeypatch.setattr(diagnose_module, "CLEARLY_WORSE", max_ratio)
    monkeypatch.setattr(diagnose_module, "_select_effects", lambda *_, **__: selection)
    diagnosis = diagnose_module.diagnose(recordings, model=model)
    assert ("gain_change" in diagnosis.names) == is_named
    reasons = [a.reason for a in diagnosis.not_detected if a.effect == "gain_change"]
    assert len(reasons) == (not is_named)
    assert all("the model predicts left-out data about as well" in reason for reason in reasons)


def test_a_cause_is_compared_with_loop_shape_at_equal_regularisation(monkeypatch):
    """The final model is regularised more strongly, so that its errors are no reference."""
    recordings, _, selection = changed_gain()
    plays = selection.errors.model
    final = replace(plays, loop_shape=zero_loop_shape(plays))
    error_m = final.quality.rms_m

    def errors_m(axis, _):
        ratio = 0.1 if axis.extensions == plays.extensions else 0.2
        return Errors(explained=ratio * error_m, held_out=ratio * error_m)

    monkeypatch.setattr(diagnose_module, "evidence_p_value", lambda _: 0.0)
    monkeypatch.setattr(diagnose_module, "MAX_TESTED_STRENGTH", np.inf)
    monkeypatch.setattr(diagnose_module, "errors_with_loop_shape_m", errors_m)
    reduced, _ = diagnose_module._drop_doubtful_causes(
        selection, lambda _: final, recordings, SERIAL
    )
    assert "gain_change" in {cause.effect.name for cause in reduced.result.outcome.causes}


@pytest.mark.usefixtures("few_rows")
def test_an_end_of_the_range_that_the_model_explains_is_not_named(monkeypatch):
    """The class of the search does not represent readings that the model represents."""
    find_structure = residual_structure._sensor_range_structure

    def false_range_end(view, _):
        error = [np.zeros(len(track.response)) for track in view.tracks]
        error[0][-150:] = -1.0
        return SensorRangeEnd(error=tuple(error), level=0.5, side=1)

    def unexplained_structure(outcome):
        structure = find_structure(outcome)
        return replace(structure, residual=structure.residual + structure.score.fitted)

    monkeypatch.setattr(residual_structure, "find_sensor_range_end", false_range_end)
    monkeypatch.setattr(residual_structure, "_sensor_range_structure", unexplained_structure)
    monkeypatch.setattr(residual_structure, "MIN_NOISE_RATIO", 0.0)
    monkeypatch.setattr("piezoid.diagnosis.selection.MAX_SECOND_RATIO", 10.0)
    assert SOMETHING_ELSE not in diagnose_module.diagnose(recorded(10)).names
