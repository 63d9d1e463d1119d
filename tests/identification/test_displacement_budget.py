"""The displacement budget contains every source once and names missing declarations."""

import math
from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.displacement_budget import Contribution, displacement_budget
from piezoid.identification.model import AxisModel, Lag
from piezoid.records.lab import Acquisition, Certificates, Lab, Sensor
from tests.reports.known_stage import axis_model

FULL_LAB = Lab(
    sensor=Sensor(gain_V_per_m=2e5),
    acquisition=Acquisition(adc_bits=16, input_range_V=(-10.0, 10.0)),
    certificates=Certificates(
        sensor_gain_relative=1e-3,
        sensor_linearity_m=6e-9,
        tilt_rad=0.01,
        temperature_range_K=2.0,
        expansion_m_per_K=3e-8,
    ),
)

RESIDUAL = "residual on held-out data, sensor noise included"


def contributions_of(axis: AxisModel, lab: Lab | None = None) -> dict[str, Contribution]:
    return {c.name: c for c in displacement_budget(axis, lab).contributions}


def test_declared_sources_are_type_b_and_have_their_closed_forms():
    contributions = contributions_of(axis_model(), FULL_LAB)
    midrange_m = 0.5 * 2.4e-5
    for name, standard_m in (
        ("gain of the sensor", 1e-3 * midrange_m),
        ("linearity of the sensor", 6e-9 / math.sqrt(3)),
        ("tilt, by its cosine", midrange_m * (1 - math.cos(0.01)) / math.sqrt(3)),
        ("temperature of the room", 3e-8 / math.sqrt(3)),
        ("step of the converter", 20 / 2**16 / 2e5 / math.sqrt(12)),
    ):
        assert contributions[name].kind == "B"
        assert contributions[name].standard == pytest.approx(standard_m)
    assert not displacement_budget(axis_model(), FULL_LAB).unknown


def test_noise_is_independent_at_each_position_and_calibration_errors_are_shared():
    contributions = contributions_of(axis_model(), FULL_LAB)
    independent = {name for name, source in contributions.items() if not source.is_shared}
    assert independent == {RESIDUAL, "step of the converter"}


def test_the_full_residual_contributes_and_sources_from_data_are_type_a():
    contributions = contributions_of(axis_model())
    assert contributions[RESIDUAL].standard == 3e-8
    assert {source.kind for source in contributions.values()} == {"A"}


def test_parameters_contribute_their_largest_uncertainty_of_the_loading_curve():
    axis = axis_model()
    half_m = np.linspace(1e-9, 5e-9, len(axis.uncertainty.loading_half_m))
    axis = replace(axis, uncertainty=replace(axis.uncertainty, blocks=5, loading_half_m=half_m))
    parameters = contributions_of(axis)["parameters of the model"]
    assert parameters.freedom == 4
    assert parameters.standard == pytest.approx(5e-9 / 2.7764, rel=1e-4)  # Student's t at 4


def test_missing_declarations_are_named():
    assert displacement_budget(axis_model()).unknown == (
        "sensor_gain_relative",
        "sensor_linearity_m",
        "tilt_rad",
        "temperature_range_K",
    )
    incomplete = Lab(certificates=Certificates(temperature_range_K=1.0))
    assert "expansion_m_per_K" in displacement_budget(axis_model(), incomplete).unknown


def test_the_lag_contributes_at_the_highest_drive_speed():
    axis = replace(axis_model(), lag=Lag(kind="delay", time_s=1e-5))
    covariance = np.array(axis.uncertainty.covariance)
    covariance[-1, -1] = 1e-6**2
    axis = replace(axis, uncertainty=replace(axis.uncertainty, covariance=covariance))
    uncertainty = axis.uncertainty
    speed_m_per_s = 40.0 * uncertainty.loading_m[-1] / uncertainty.reach_V[-1]
    lag = contributions_of(axis)["lag, at the fastest drive of the fitted samples"]
    assert lag.standard == pytest.approx(1e-6 * speed_m_per_s)


def test_a_larger_remainder_raises_the_largest_error_only():
    axis = axis_model()
    small, large = (
        displacement_budget(
            replace(axis, certificate=replace(axis.certificate, remainder_m=remainder_m))
        )
        for remainder_m in (9e-8, 2e-7)
    )
    assert large.combined == small.combined
    assert large.largest[1] > small.largest[1]
