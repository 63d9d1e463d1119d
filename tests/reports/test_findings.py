"""Findings: each effect is drawn where it shows, with its size and its meaning for control."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.diagnosis import NotDetected
from piezoid.diagnosis.effects import effect_named
from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.model import Lag
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid_reports.effect_comparison import compare_effects
from piezoid_reports.page import Page, rms, traces_of
from piezoid_reports.render import render, render_diagnosis
from piezoid_reports.sections.findings import NO_FIGURE
from tests.reports.anatomy import Anatomy
from tests.reports.known_diagnosis import NAMES, diagnosed, finding
from tests.reports.known_stage import axis_model, recording, stage_model


def _with(added_m: np.ndarray) -> Recording:
    made = recording()
    channels = [
        Channel(quantity=c.quantity, axis=c.axis, values=c.values + added_m, label=c.label)
        if c.quantity is Quantity.DISPLACEMENT
        else c
        for c in made.channels
    ]
    other_V = 5.0 + 4.0 * np.sin(np.arange(made.samples) / 40.0)
    channels.append(Channel(quantity=Quantity.VOLTAGE, axis="y", values=other_V, label="v"))
    return replace(made, channels=tuple(channels))


def test_every_effect_can_be_told_with_its_size_gain_and_meaning() -> None:
    wave_m = 5e-8 * np.sin(np.arange(recording().samples) / 30.0)
    found = diagnosed(*map(finding, NAMES))
    page = Anatomy(render_diagnosis(stage_model(axis_model()), [_with(wave_m)], found))
    texts = [e.text for e in page.all("p", "prose")]
    for name in NAMES:
        control = f"For control: {effect_named(name).control}"
        assert any(text.endswith(control) for text in texts), name
    sizes = [e.text for e in page.all("td") if "<b>percent</b> (95 %: 0.400 to 0.600)" in e.text]
    assert len(sizes) == len(NAMES)
    assert all("percent" not in e.text for e in page.all("b"))


def test_the_picture_of_hum_shows_it_without_and_not_with_the_effect() -> None:
    made = recording()
    time_s = np.arange(made.samples) / made.sampling_rate_Hz
    hummed = _with(6e-8 * np.sin(2 * np.pi * 50.0 * time_s))
    axis = axis_model()
    found = diagnosed(finding("mains_interference"))
    (one,) = compare_effects(axis, traces_of(axis, [hummed]), found)["mains_interference"]
    assert rms(one.without_m) > 3e-8
    assert rms(one.with_m) < 0.3 * rms(one.without_m)


def test_a_mode_that_the_fitted_samples_do_not_show_has_a_sentence_for_a_picture() -> None:
    mode = LinearMode(frequency_Hz=1e6, quality=10.0, participation=0.5)
    fast = replace(axis_model(), extensions=(mode,))
    found = diagnosed(finding("resonance"))
    page = Anatomy(render_diagnosis(stage_model(fast), [recording()], found))
    assert NO_FIGURE in [e.text for e in page.all("p", "prose")]
    assert not any("residual against frequency" in e.text for e in page.all("figcaption"))


def test_a_lag_the_model_carries_is_taken_out_to_be_seen() -> None:
    axis = replace(axis_model(), lag=Lag(kind="first_order", time_s=4e-3))
    found = diagnosed(finding("lag"))
    (one,) = compare_effects(axis, traces_of(axis, [_with(np.zeros(1))]), found)["lag"]
    part_m = one.without_m - one.with_m
    assert rms(part_m) > 1e-8
    alike = np.corrcoef(part_m, one.lookalike_m)[0, 1]
    assert alike > 0.6


def test_every_axis_has_its_part_and_an_effect_is_described_once() -> None:
    found = diagnosed(finding("delay"))
    other = replace(diagnosed(finding("delay"), finding("creep")), axis="y")
    page = render(
        Page(
            model=stage_model(axis_model(), axis_model("y")),
            diagnoses=(found, other),
            undiagnosed=("axis z is not diagnosed: internal error (ValueError).",),
        )
    )
    headings = [e.text for e in Anatomy(page).all("h3")]
    assert {"Axis x: delay", "Axis y: delay", "Axis y: creep"} <= set(headings)
    assert page.count(effect_named("delay").control) == 1
    assert page.count("axis z is not diagnosed") == 1


def test_what_cannot_be_separated_is_a_limit_with_its_experiment() -> None:
    found = diagnosed(finding("delay", rivals=("lag",), experiment="Record a chirp."))
    page = render_diagnosis(stage_model(axis_model()), [recording()], found)
    limits = page.partition('id="limits"')[2].partition("</section>")[0]
    assert limits.count("Record a chirp.") == page.count("Record a chirp.") == 1


def test_without_recordings_or_a_model_the_section_still_says_what_was_found() -> None:
    bare = ActuatorModel(stage="stage", axes={}, sources={"sweep.csv": "sha256:" + "0" * 64})
    for model, recordings in ((stage_model(axis_model()), []), (bare, [recording()])):
        page = Anatomy(render_diagnosis(model, recordings, diagnosed(finding("creep"))))
        assert not page.all("figure", "chart")
        assert any("creep" in e.text for e in page.all("td"))
        assert any("piezoid fit" in e.text for e in page.all("p"))


def test_holds_are_told_by_the_time_since_the_drive_stopped() -> None:
    held_V = np.concatenate([np.linspace(0, 5, 100), np.full(400, 5.0)])
    made = Recording(
        name="hold.csv",
        digest="sha256:" + "0" * 64,
        axis="x",
        sampling_rate_Hz=100.0,
        channels=(
            Channel(quantity=Quantity.VOLTAGE, axis="x", values=held_V, label="u"),
            Channel(quantity=Quantity.DISPLACEMENT, axis="x", values=held_V * 1e-6, label="y"),
        ),
    )

    place, way = effect_named("creep").shows.along(made)
    assert np.isnan(place[:100]).all()
    assert place[199] == pytest.approx(0.0, abs=0.01)
    assert (way[100:] == 1.0).all()


def test_a_memory_that_was_wrong_is_shown_against_that_of_a_drive_cycled_before() -> None:
    axis = axis_model()
    found = diagnosed(finding("initial_state"))
    (one,) = compare_effects(axis, traces_of(axis, [recording()]), found)["initial_state"]
    assert rms(one.with_m) < 2.0 * axis.quality.noise_rms_m
    assert rms(one.without_m) > 10.0 * rms(one.with_m)


def test_creep_without_a_hold_is_drawn_over_time_and_says_so() -> None:
    found = diagnosed(finding("creep"))
    page = Anatomy(render_diagnosis(stage_model(axis_model()), [recording()], found))
    (figure,) = page.all("figure", "chart")
    assert "residual against time" in figure.text
    assert effect_named("creep").shows.label in figure.text


def test_a_diagnosis_drawn_on_a_model_in_no_file_names_no_model_json() -> None:
    found = diagnosed(finding("creep"))
    written = write_diagnosis(found)
    page = render_diagnosis(stage_model(axis_model()), [recording()], found, written=written)
    rows = [e.text for e in Anatomy(page).all("tr")]
    assert any(row.startswith("diagnosis.json") for row in rows)
    assert not any(row.startswith("model.json") for row in rows)


def test_a_drift_that_the_fit_follows_is_named_beside_the_bound_of_a_drift() -> None:
    absent = NotDetected(
        effect="thermal_drift",
        upper_bound_m=1e-9,
        detection_limit_m=2e-9,
        reason="not found",
        next_experiment="wait",
    )
    found = replace(diagnosed(), not_detected=(absent,))
    page = Page(model=stage_model(axis_model()), recordings=[recording()], diagnoses=(found,))
    cells = [e.text.replace("\u202f", " ") for e in Anatomy(render(page)).all("td")]
    assert "1.00 nm, 2.00 nm, in addition to the drift in the fit" in cells
