"""Why a loop is slow and which bound of its error is of use, each stated once with its number."""

from dataclasses import replace

import pytest

import piezoid
from piezoid.design.design import AxisDesign
from piezoid.design.design_statements import (
    bandwidth_limit_Hz,
    design_statements,
    error_parts_m,
    useful_bound_m,
)
from piezoid.identification.dynamics.bandwidth import unmeasured
from piezoid.identification.model import AxisModel
from piezoid.statement import Level
from tests.verification.known_fit import fitted
from tests.verification.rig import RATE_Hz


def designed(axis: AxisModel) -> tuple[AxisDesign, dict[str, Level]]:
    model = replace(fitted(), axes={"x": axis})
    design = piezoid.design(model, sampling_rate_Hz=RATE_Hz)
    facts = design_statements(design, model)
    return design.axis("x"), {fact.quantity: fact.level for fact in facts}


def test_a_loop_without_a_known_resonance_asks_for_a_chirp() -> None:
    axis = replace(fitted()["x"], bandwidth=unmeasured(None, "nothing was recorded"))
    design, levels = designed(axis)
    limit_Hz = bandwidth_limit_Hz(design, axis)
    assert limit_Hz == pytest.approx(200.0 / 60.0)  # lowest possible resonance over its peak
    assert design.recommended.bandwidth_Hz <= limit_Hz
    assert levels["bandwidth"] is Level.ACTION


def test_the_limit_of_the_bandwidth_names_what_is_known_of_the_resonance() -> None:
    unknown = unmeasured(None, "nothing was recorded")
    visible = replace(unknown, kind="resonance", peak_ratio=12.0, peak_Hz=300.0)
    of_bandwidth = {
        "no resonance was recorded": unknown,
        "the resonance near 300 Hz could not be fitted": visible,
        "the stated 630 Hz was not recorded": replace(unknown, stated_Hz=630.0),
        "use a faster recorder": replace(unknown, stated_Hz=RATE_Hz),
    }
    axes = [replace(fitted()["x"], bandwidth=verdict) for verdict in of_bandwidth.values()]
    design = piezoid.design(replace(fitted(), axes={"x": axes[0]}), sampling_rate_Hz=RATE_Hz)
    loop = replace(design.axis("x").recommended, bandwidth_Hz=RATE_Hz)  # near any limit
    design = replace(design, axes=(replace(design.axis("x"), loops=(loop,)),))
    for words, axis in zip(of_bandwidth, axes, strict=True):
        facts = design_statements(design, replace(fitted(), axes={"x": axis}))
        (text,) = (fact.text for fact in facts if fact.quantity == "bandwidth")
        assert words in text


def test_a_resonance_beyond_the_converter_limits_no_bandwidth() -> None:
    design, levels = designed(fitted()["x"])
    assert bandwidth_limit_Hz(design, fitted()["x"]) is None
    assert "bandwidth" not in levels


def test_a_bound_above_a_tenth_of_the_range_is_of_no_use() -> None:
    axis = fitted()["x"]
    design, _ = designed(axis)
    certificate = design.recommended.certificate
    assert certificate is not None
    assert sum(error_parts_m(certificate).values()) == pytest.approx(
        certificate.guaranteed_error_m
    )
    narrow = replace(axis.quality, range_m=9.9 * certificate.guaranteed_error_m)
    wide = replace(axis.quality, range_m=10.1 * certificate.guaranteed_error_m)
    assert useful_bound_m(certificate, replace(axis, quality=narrow)) is None
    assert useful_bound_m(certificate, replace(axis, quality=wide)) is not None
    assert useful_bound_m(None, axis) is None
    _, of_narrow = designed(replace(axis, quality=narrow))
    assert of_narrow["guaranteed_error"] is Level.WARNING
