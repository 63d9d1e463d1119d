"""A new effect: with one file and one line in the catalogue, every verb supports it."""

import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import piezoid
from piezoid.diagnosis import effects
from piezoid.diagnosis.sealed_diagnosis import read_diagnoses, write_diagnosis
from piezoid.formatting import words
from piezoid.identification.store import read_model, write_model
from piezoid.operators.linear import sample
from piezoid.verification.plant import lateral_plant
from piezoid_reports.effect_figures import compare_effects
from piezoid_reports.page import rms, traces_of
from tests.diagnosis.bench import effects_of, thinned
from tests.plays_alone import fit_few_rows, fit_one_order, fit_plays_alone
from tests.reports.anatomy import Anatomy

pytestmark = pytest.mark.slow

SHARE, TIME_s = 0.03, 0.4
FILE = '''"""Charge leak: what was moved fast goes too far, and comes back.

What you see
    After a step the stage is too far out, and returns within a second.
Why it happens
    A charge amplifier is a charge source at high frequency and a voltage source at low frequency.
How it is detected
    The quick part of the static response explains what static hysteresis cannot.
What the extension adds
    A high-pass part of the response, y = m + c (m - x),  tau dx/dt = m - x.
Source
    Fleming & Leang (2014)
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezoid.diagnosis.effect import (
    Appearance,
    Effect,
    Parameters,
    Tangent,
    Trial,
    unsigned,
    without_part,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import filtered_change, with_extension
from piezoid.identification.extensions.extension import (
    Extension,
    Free,
    LoopEffect,
    Where,
    free,
)
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import relaxed
from piezoid.operators.linear import ContinuousSystem

TIMES_s = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)


@dataclass(frozen=True, kw_only=True)
class ChargeLeak(Extension):
    """y = m + c (m - x),  tau dx/dt = m - x."""

    kind: ClassVar[str] = "charge_leak"
    fitted: ClassVar[tuple[str, ...]] = ("share", "time_s")

    share: float
    time_s: float

    def response(self, displacement: Array, where: Where) -> Array:
        """Return the response with its quick part."""
        return displacement + self.share * quick_part(displacement, self.time_s, where.rate_Hz)

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the high-pass part in series with the stage."""
        c, per_s = np.array([[self.share]]), np.array([[1.0 / self.time_s]])
        return LoopEffect(system=ContinuousSystem(A=-per_s, B=per_s, C=-c, D=1.0 + c))

    def free(self) -> Free:
        """Return share and time, with bounds and steps."""
        return free((self.share, self.time_s), (0.0, 0.01), (0.5, 10.0), (1e-4, 1e-3))


def quick_part(signal: Array, time_s: float, rate_Hz: float) -> Array:
    """Return the part of a signal that a high-pass filter lets pass."""
    return np.asarray(signal - relaxed(signal, time_s, rate_Hz))


def _leaking(response: Array, rate_Hz: float, parameters: Parameters) -> Array:
    return response + quick_part(response, parameters["time_s"], rate_Hz)


def _columns(view: View, parameters: Parameters) -> Array:
    return filtered_change(view, _leaking, parameters)


def _trials(view: View) -> list[Trial]:
    return [
        Trial(
            columns=_columns(view, {"time_s": time_s}),
            parameters={"time_s": time_s},
            coefficient_range=(0.002, 0.3),
            free={"time_s": 1.3},
        )
        for time_s in TIMES_s
    ]


EFFECT = Effect(
    name="charge_leak",
    explanation=__doc__ or "",
    unit="percent of a step",
    experiment="Record steps over the range, held for ten times the time in which they return.",
    control="A quick inverse overshoots: let the feedforward carry the same leak.",
    shows=Appearance(
        label="quick part of the drive",
        unit="V",
        kind="classes",
        along=lambda r: unsigned(quick_part(r.voltage_V(), 0.4, r.sampling_rate_Hz)),
        reading="A leak: a straight line through zero.",
    ),
    tangent=Tangent(
        columns=lambda drive, _: quick_part(drive.static_m, 0.4, drive.rate_Hz)[:, None]
    ),
    trials=_trials,
    columns=_columns,
    size=lambda _, __, coefficient: 100.0 * float(coefficient[0]),
    inject=lambda recording, share: with_extension(recording, ChargeLeak(share=share, time_s=0.4)),
    extend=lambda estimate, _: (
        ChargeLeak(share=estimate.first_coefficient, time_s=estimate.parameters["time_s"]),
    ),
    without=without_part(ChargeLeak),
)
'''


@dataclass(frozen=True)
class LeakingStage:
    """A stage with a charge leak and the results of the verbs."""

    effect: effects.Effect
    recordings: tuple[piezoid.Recording, ...]
    model: piezoid.ActuatorModel
    diagnosis: piezoid.Diagnosis


def with_leak(recording: piezoid.Recording) -> piezoid.Recording:
    """Return a recording with the leak, computed by another formula than in the file."""
    pole = np.exp(-1.0 / (TIME_s * recording.sampling_rate_Hz))
    m = recording.displacement_m()
    quick = lfilter([1.0, -1.0], [1.0, -pole], m - m[0])
    channels = tuple(
        replace(channel, values=m + SHARE * quick) if channel.quantity.value == "m" else channel
        for channel in recording.channels
    )
    return replace(recording, channels=channels)


@pytest.fixture(scope="module")
def leaking(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LeakingStage]:
    """Write the file, add it to the catalogue, and run the verbs on the stage."""
    file: Path = tmp_path_factory.mktemp("effects") / "charge_leak.py"
    file.write_text(FILE)
    spec = importlib.util.spec_from_file_location("charge_leak", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(effects, "EFFECTS", (*effects.EFFECTS, module.EFFECT))
        fit_plays_alone(patch)
        fit_one_order(patch)
        fit_few_rows(patch)
        stage = piezoid.simulate(3, drives=("sweep", "staircase"), truth="bouc_wen")
        recordings = tuple(with_leak(recording) for recording in thinned(stage.recordings, 6))
        model = piezoid.fit(recordings, lab=stage.lab)
        diagnosis = piezoid.diagnose(recordings, model=model, lab=stage.lab)
        yield LeakingStage(module.EFFECT, recordings, model.extended(diagnosis), diagnosis)


def test_the_diagnosis_names_a_new_effect_and_estimates_its_size(leaking):
    (finding,) = effects_of(leaking.diagnosis)
    assert finding.effect == "charge_leak"
    assert finding.size.ci95[0] < 100.0 * SHARE < finding.size.ci95[1]
    assert finding.held_out_gain > 0.3
    assert finding.explanation.startswith("Charge leak: what was moved fast")
    assert read_diagnoses(write_diagnosis(leaking.diagnosis))[0].names == leaking.diagnosis.names


def test_the_model_contains_a_new_effect_and_survives_its_file(leaking):
    (leak,) = (e for e in leaking.model["x"].extensions if e.kind == "charge_leak")
    share, time_s = leak.free().value
    assert share == pytest.approx(SHARE, abs=3.0 * leak.std[0])
    assert time_s == pytest.approx(TIME_s, abs=3.0 * leak.std[1])
    restored = read_model(write_model(leaking.model))["x"]
    assert restored.extensions == leaking.model["x"].extensions


def test_an_experiment_is_planned_for_a_new_effect(leaking):
    plan = piezoid.plan(
        leaking.model,
        leaking.diagnosis,
        recordings=leaking.recordings,
        effect="charge_leak",
        clock_Hz=1e3,
    )
    assert plan.question.effects == ("charge_leak",)
    assert plan.planned.errors[0] < plan.recorded.errors[0]


def test_the_plant_of_verification_contains_a_new_effect(leaking):
    plant = lateral_plant(leaking.model["x"], sampling_rate_Hz=1000.0)
    assert plant.measured is not None
    displacement, _ = sample(plant.measured, 1000.0).run(np.ones(5000))
    assert displacement[100:].max() / displacement[-1] == pytest.approx(1.0 + SHARE, abs=0.01)
    assert np.argmax(displacement) < 100


def test_the_report_plots_a_new_effect_and_states_its_meaning(leaking):
    report = piezoid.report(leaking.model, leaking.recordings, diagnoses=[leaking.diagnosis])
    page = Anatomy(report)
    prose = [element.text for element in page.all("p", "prose")]
    assert any(text.endswith(f"For control: {leaking.effect.control}") for text in prose)
    assert any(f"Axis x: {words('charge_leak')}" in element.text for element in page.all("h3"))
    axes = [element.text for element in page.all("text", "axis-name")]
    assert any(name.startswith("quick part of the drive") for name in axes)
    captions = [element.text for element in page.all("figcaption")]
    assert any("A leak: a straight line through zero." in caption for caption in captions)
    axis = leaking.model["x"]
    comparisons = compare_effects(axis, traces_of(axis, leaking.recordings), leaking.diagnosis)
    for comparison in comparisons["charge_leak"]:
        assert rms(comparison.without_m) > 1.2 * rms(comparison.with_m)
