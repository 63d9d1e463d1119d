"""Findings: figure, size and meaning for control of each effect."""

from dataclasses import replace

import numpy as np
import pytest

import piezoid
from piezoid.diagnosis.diagnosis import BudgetPart, NotDetected, Size
from piezoid.diagnosis.diagnosis_statements import diagnosis_statements
from piezoid.diagnosis.effects import effect_named
from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.model import AxisModel, Lag
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid_reports.effect_figures import EffectSimulation, compare_effects
from piezoid_reports.page import Page, rms, traces_of
from piezoid_reports.render import render, render_diagnosis
from piezoid_reports.sections.findings import NO_FIGURE
from tests.reports.anatomy import Anatomy
from tests.reports.known_diagnosis import NAMES, diagnosed, finding
from tests.reports.known_stage import axis_model, recording, stage_model

KNOWN_AXIS = axis_model()


def recording_with(added_m: np.ndarray) -> Recording:
    original = recording()
    channels = [
        Channel(quantity=c.quantity, axis=c.axis, values=c.values + added_m, label=c.label)
        if c.quantity is Quantity.DISPLACEMENT
        else c
        for c in original.channels
    ]
    other_drive_V = 5.0 + 4.0 * np.sin(np.arange(original.samples) / 40.0)
    channels.append(Channel(quantity=Quantity.VOLTAGE, axis="y", values=other_drive_V, label="v"))
    return replace(original, channels=tuple(channels))


def page_of(*findings: object, axis: AxisModel = KNOWN_AXIS) -> Anatomy:
    diagnosis = diagnosed(*findings)
    return Anatomy(render_diagnosis(stage_model(axis), [recording()], diagnosis))


def compared(effect: str, recording: Recording, axis: AxisModel = KNOWN_AXIS) -> EffectSimulation:
    comparisons = compare_effects(axis, traces_of(axis, [recording]), diagnosed(finding(effect)))
    (comparison,) = comparisons[effect]
    return comparison


def test_every_effect_is_listed_with_size_and_meaning():
    wave_m = 5e-8 * np.sin(np.arange(recording().samples) / 30.0)
    diagnosis = diagnosed(*map(finding, NAMES))
    page = Anatomy(
        render_diagnosis(stage_model(axis_model()), [recording_with(wave_m)], diagnosis)
    )
    texts = [e.text for e in page.all("p", "prose")]
    for name in NAMES:
        control = f"For control: {effect_named(name).control}"
        assert any(text.endswith(control) for text in texts), name
    sizes = [e.text for e in page.all("td") if "<b>percent</b> (95 %: 0.400 to 0.600)" in e.text]
    assert len(sizes) == len(NAMES)
    assert all("percent" not in e.text for e in page.all("b"))


def test_the_comparison_of_hum_shows_the_residual_with_and_without():
    original = recording()
    time_s = np.arange(original.samples) / original.sampling_rate_Hz
    with_hum = recording_with(6e-8 * np.sin(2 * np.pi * 50.0 * time_s))
    comparison = compared("mains_interference", with_hum)
    assert rms(comparison.without_m) > 3e-8
    assert rms(comparison.with_m) < 0.3 * rms(comparison.without_m)


def test_an_invisible_mode_has_a_sentence_instead_of_a_figure():
    mode = LinearMode(frequency_Hz=1e6, quality=10.0, participation=0.5)
    axis = replace(axis_model(), extensions=(mode,))
    page = page_of(finding("resonance"), axis=axis)
    assert NO_FIGURE in [e.text for e in page.all("p", "prose")]
    assert not any("residual against frequency" in e.text for e in page.all("figcaption"))


def test_a_modelled_lag_is_removed_for_its_comparison():
    axis = replace(axis_model(), lag=Lag(kind="first_order", time_s=4e-3))
    comparison = compared("lag", recording_with(np.zeros(1)), axis)
    effect_m = comparison.without_m - comparison.with_m
    assert rms(effect_m) > 1e-8
    correlation = np.corrcoef(effect_m, comparison.lookalike_m)[0, 1]
    assert correlation > 0.6


def test_every_axis_has_its_findings_and_an_effect_is_described_once():
    diagnosis_x = diagnosed(finding("delay"))
    diagnosis_y = replace(diagnosed(finding("delay"), finding("creep")), axis="y")
    page = render(
        Page(
            model=stage_model(axis_model(), axis_model("y")),
            diagnoses=(diagnosis_x, diagnosis_y),
            undiagnosed=("axis z is not diagnosed: internal error (ValueError).",),
        )
    )
    headings = [e.text for e in Anatomy(page).all("h3")]
    assert {"Axis x: delay", "Axis y: delay", "Axis y: creep"} <= set(headings)
    assert page.count(effect_named("delay").control) == 1
    assert page.count("axis z is not diagnosed") == 1


def test_confounded_effects_are_marked_and_a_limit_with_their_experiment():
    diagnosis = diagnosed(finding("delay", rivals=("lag",), experiment="Record a chirp."))
    page = render_diagnosis(stage_model(axis_model()), [recording()], diagnosis)
    limits = page.partition('id="limits"')[2].partition("</section>")[0]
    assert limits.count("Record a chirp.") == page.count("Record a chirp.") == 1
    assert "delay (not separable from lag)" in [e.text for e in Anatomy(page).all("td")]


def test_a_lag_and_a_delay_are_the_same_for_slow_loops():
    delay = replace(
        finding("delay", rivals=("lag",)), size=Size(value=100.0, unit="µs", ci95=(99.0, 101.0))
    )
    (fact,) = (f for f in diagnosis_statements(diagnosed(delay)) if "separated" in f.text)
    # at 320 Hz a lag of 0.1 ms has a gain of 0.98, and a phase that differs by 0.15 degrees
    assert "a loop below 320 Hz" in fact.text
    lag = 1.0 / (1.0 + 2j * np.pi * 320.0 * 1e-4)
    assert abs(lag) == pytest.approx(0.98, abs=0.002)
    phase_deg = np.degrees(np.angle(lag * np.exp(2j * np.pi * 320.0 * 1e-4)))
    assert phase_deg == pytest.approx(0.15, abs=0.01)
    for rivals in (("rate_dependence",), ("lag", "resonance")):
        others = diagnosis_statements(diagnosed(finding("delay", rivals=rivals)))
        assert not any("a loop below" in other.text for other in others)


def test_findings_are_listed_without_recordings_or_model():
    empty_model = ActuatorModel(
        stage="stage", axes={}, sources={"sweep.csv": "sha256:" + "0" * 64}
    )
    for model, recordings in ((stage_model(axis_model()), []), (empty_model, [recording()])):
        page = Anatomy(render_diagnosis(model, recordings, diagnosed(finding("creep"))))
        assert not page.all("figure", "chart")
        assert any("creep" in e.text for e in page.all("td"))
        assert any("piezoid fit" in e.text for e in page.all("p"))


def test_creep_is_drawn_over_the_time_since_the_drive_stopped():
    drive_V = np.concatenate([np.linspace(0, 5, 100), np.full(400, 5.0)])
    hold = piezoid.from_arrays(
        voltage_V=drive_V, displacement_m=1e-6 * drive_V, sampling_rate_Hz=100.0
    )
    log_time, weight = effect_named("creep").shows.along(hold)
    assert np.isnan(log_time[:100]).all()
    assert log_time[199] == pytest.approx(0.0, abs=0.01)
    assert (weight[100:] == 1.0).all()


def test_an_initial_state_is_compared_with_a_cycled_drive():
    comparison = compared("initial_state", recording())
    assert rms(comparison.with_m) < 2.0 * axis_model().quality.noise_rms_m
    assert rms(comparison.without_m) > 10.0 * rms(comparison.with_m)


def test_creep_without_a_hold_is_drawn_over_time():
    page = page_of(finding("creep"))
    (figure,) = page.all("figure", "chart")
    assert "residual against time" in figure.text
    assert effect_named("creep").shows.label in figure.text


def test_a_model_without_a_file_is_not_in_the_provenance():
    diagnosis = diagnosed(finding("creep"))
    content = write_diagnosis(diagnosis)
    page = render_diagnosis(stage_model(axis_model()), [recording()], diagnosis, written=content)
    rows = [e.text for e in Anatomy(page).all("tr")]
    assert any(row.startswith("diagnosis.json") for row in rows)
    assert not any(row.startswith("model.json") for row in rows)


def test_the_bound_of_drift_mentions_the_drift_in_the_fit():
    absent = NotDetected(
        effect="thermal_drift",
        upper_bound_m=1e-9,
        detection_limit_m=2e-9,
        reason="not found",
        next_experiment="wait",
    )
    diagnosis = replace(diagnosed(), not_detected=(absent,))
    page = Page(model=stage_model(axis_model()), recordings=[recording()], diagnoses=(diagnosis,))
    cells = [e.text.replace("\u202f", " ") for e in Anatomy(render(page)).all("td")]
    assert "1.00 nm" in cells
    assert "2.00 nm, in addition to the drift in the fit" in cells


def test_a_page_without_findings_states_what_every_fit_contains():
    lag = BudgetPart(part="lag", rms_m=5e-9, is_explained=True, text="Lag, modelled.")
    diagnosis = replace(diagnosed(), budget=(lag, *diagnosed().budget))
    page = Anatomy(render_diagnosis(stage_model(axis_model()), [recording()], diagnosis))
    text = "No effect was found. The error budget contains lag of the fit."
    assert text in [e.text for e in page.all("p", "prose")]
    assert any("Lag comes from the fit" in e.text for e in page.all("p", "caption"))


def test_a_finding_that_does_not_reduce_the_error_says_so():
    creep = finding("creep")
    larger = replace(creep, held_out_rms_before_m=144.7e-9, held_out_rms_after_m=152.7e-9)
    texts = [e.text.replace("\u202f", " ") for e in page_of(larger).all("p", "prose")]
    assert any("no better with it (152.7 nm) than without it (144.7 nm)" in t for t in texts)
    assert not any("no better with it" in e.text for e in page_of(creep).all("p", "prose"))


def test_an_interval_that_includes_zero_is_stated():
    size = Size(value=153.0, unit="nm, rms", ci95=(0.0, 258.0))
    page = page_of(replace(finding("loop_shape"), size=size))
    assert any("the effect may be absent" in e.text for e in page.all("p", "prose"))
