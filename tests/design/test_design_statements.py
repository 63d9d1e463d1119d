"""Statements about the limit of the bandwidth and the bound of the error."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import piezoid
from piezoid.design.design import Design
from piezoid.design.design_statements import (
    bandwidth_limit_Hz,
    design_statements,
    error_parts_m,
    useful_bound_m,
)
from piezoid.design.lateral_task import lateral_task
from piezoid.diagnosis.planning.candidate_drives import MULTISINE_BAND
from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid.digests import digest_in
from piezoid.formatting import with_unit
from piezoid.identification.dynamics.bandwidth import unmeasured
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.store import write_model
from piezoid.statement import Level, Statement
from tests.cli.calls import invoke
from tests.design.designed import known_design
from tests.reports.known_diagnosis import diagnosed, finding
from tests.verification.known_fit import fitted
from tests.verification.rig import RATE_Hz

pytestmark = pytest.mark.usefixtures("brief_designs")

UNKNOWN = unmeasured(None, "nothing was recorded")


def model_of(axis: AxisModel) -> piezoid.ActuatorModel:
    return replace(fitted(), axes={"x": axis})


def levels_of(design: Design, axis: AxisModel) -> dict[str, Level]:
    return {fact.quantity: fact.level for fact in design_statements(design, model_of(axis))}


@cache
def fast_design() -> Design:
    """Return a design for an unknown resonance, with a loop near any limit of its bandwidth."""
    axis_design = known_design().axis("x")
    loop = replace(axis_design.recommended, bandwidth_Hz=RATE_Hz)
    axis = replace(fitted()["x"], bandwidth=UNKNOWN)
    specification = lateral_task(axis, RATE_Hz, forms=("inverse",)).specification
    limited = replace(axis_design, loops=(loop,), specification=specification)
    return replace(known_design(), axes=(limited,))


def bandwidth_statement(design: Design, model: piezoid.ActuatorModel) -> Statement:
    (statement,) = (f for f in design_statements(design, model) if f.quantity == "bandwidth")
    return statement


def test_a_loop_without_a_known_resonance_asks_for_a_chirp_with_band_amplitude_and_rate():
    axis = replace(fitted()["x"], bandwidth=UNKNOWN)
    limit_Hz = bandwidth_limit_Hz(fast_design().axis("x"), axis)
    assert limit_Hz == pytest.approx(200.0 / 60.0)  # lowest possible resonance over its peak
    statement = bandwidth_statement(fast_design(), model_of(axis))
    assert statement.level is Level.ACTION
    amplitude_V = 0.02 * (axis.voltage_V[1] - axis.voltage_V[0])
    for number in (
        f"up to {with_unit(RATE_Hz / 3.0, 'Hz', 2)}",
        f"about {with_unit(amplitude_V, 'V', 2)}",
        f"sampled at {with_unit(RATE_Hz, 'Hz', 2)}",
    ):
        assert number in statement.text


def test_the_bandwidth_limit_states_the_knowledge_of_the_resonance():
    visible = replace(UNKNOWN, kind="resonance", peak_ratio=12.0, peak_Hz=300.0)
    verdicts = {
        "no resonance was recorded": UNKNOWN,
        "the resonance near 300 Hz could not be fitted": visible,
        "the stated 630 Hz was not recorded": replace(UNKNOWN, stated_Hz=630.0),
        "use a faster recorder": replace(UNKNOWN, stated_Hz=RATE_Hz),
    }
    for words, verdict in verdicts.items():
        model = model_of(replace(fitted()["x"], bandwidth=verdict))
        assert words in bandwidth_statement(fast_design(), model).text


def test_a_plan_states_the_chirp_that_it_does_not_write(tmp_path):
    model = model_of(replace(fitted()["x"], bandwidth=UNKNOWN))
    content = write_model(model)
    design = replace(fast_design(), model_digest=digest_in(content))
    creep = diagnosed(finding("creep", rivals=("thermal_drift",)))
    (tmp_path / "model.json").write_bytes(content)
    (tmp_path / "design.json").write_bytes(design.to_json())
    (tmp_path / "diagnosis.json").write_bytes(write_diagnosis(creep))
    result = invoke("plan", tmp_path, "--rate", RATE_Hz)
    assert result.exit_code == 0, result.output
    output = " ".join(result.output.split())
    limit = bandwidth_statement(design, model).text
    assert "Record a small chirp" in limit
    assert output.startswith(limit)
    highest = with_unit(MULTISINE_BAND * RATE_Hz, "Hz", 2)
    assert f"they end at {highest}" in output.removeprefix(limit)


@pytest.mark.parametrize(("noise_m", "is_visible"), [(1e-11, True), (1e-7, False)])
def test_the_chirp_beyond_an_identified_mode_avoids_it_and_ends_in_the_noise(noise_m, is_visible):
    """Motion of a mode f0 above it: amplitude gain / ((f / f0)^2 - 1), visible above 4 noises."""
    mode_Hz, top_Hz, axis = 400.0, RATE_Hz / 3.0, fitted()["x"]
    extension = LinearMode(frequency_Hz=mode_Hz, quality=20.0)
    axis = replace(
        axis,
        lag=Lag(kind="none", time_s=0.0),
        rig=Rig(),
        extensions=(extension,),
        quality=replace(axis.quality, noise_rms_m=noise_m),
    )
    specification = lateral_task(axis, RATE_Hz, forms=("inverse",)).specification
    (axis_design,) = fast_design().axes
    design = replace(fast_design(), axes=(replace(axis_design, specification=specification),))
    limit = bandwidth_statement(design, model_of(axis))
    assert limit.level is (Level.ACTION if is_visible else Level.NOTE)
    assert ("Record a small chirp" in limit.text) == is_visible
    if not is_visible:
        return
    start_Hz, end_Hz = (
        float(number) * {"Hz": 1.0, "kHz": 1e3}[unit]
        for number, unit in re.findall(r"([0-9.]+) (k?Hz)(?= to|, sampled)", limit.text)
    )
    slow_m = 0.02 * (axis.voltage_V[1] - axis.voltage_V[0]) * axis.operator.middle_slope_m_per_V
    assert start_Hz == pytest.approx(mode_Hz * np.sqrt(1.0 + 1.0 / 1.2), rel=0.02)
    visible_Hz = mode_Hz * np.sqrt(1.0 + slow_m / (4.0 * noise_m))
    assert end_Hz == pytest.approx(min(visible_Hz, top_Hz), rel=0.03)


def test_a_plan_repeats_the_chirp_through_a_resonance_that_could_not_be_fitted(tmp_path):
    verdict = replace(UNKNOWN, kind="resonance", peak_ratio=12.0, peak_Hz=300.0, text="A chirp.")
    model = model_of(replace(fitted()["x"], bandwidth=verdict))
    (tmp_path / "model.json").write_bytes(write_model(model))
    creep = diagnosed(finding("creep", rivals=("thermal_drift",)))
    (tmp_path / "diagnosis.json").write_bytes(write_diagnosis(creep))
    result = invoke("plan", tmp_path, "--rate", RATE_Hz)
    assert result.output.startswith("A chirp.")


def test_a_resonance_above_the_nyquist_frequency_is_no_limit():
    assert bandwidth_limit_Hz(known_design().axis("x"), fitted()["x"]) is None
    assert "bandwidth" not in levels_of(known_design(), fitted()["x"])


def test_a_bound_above_a_tenth_of_the_range_is_a_warning():
    axis = fitted()["x"]
    certificate = known_design().axis("x").recommended.certificate
    assert certificate is not None
    assert sum(error_parts_m(certificate).values()) == pytest.approx(
        certificate.guaranteed_error_m
    )
    narrow = replace(axis.quality, range_m=9.9 * certificate.guaranteed_error_m)
    wide = replace(axis.quality, range_m=10.1 * certificate.guaranteed_error_m)
    assert useful_bound_m(certificate, replace(axis, quality=narrow)) is None
    assert useful_bound_m(certificate, replace(axis, quality=wide)) is not None
    assert useful_bound_m(None, axis) is None
    of_narrow = levels_of(known_design(), replace(axis, quality=narrow))
    assert of_narrow["guaranteed_error"] is Level.WARNING
