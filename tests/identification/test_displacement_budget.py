"""The budget of a displacement: every source once, its size known, and what nobody declared."""

import math
from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.displacement_budget import displacement_budget
from piezoid.identification.model import Lag
from piezoid.records.lab import Acquisition, Certificates, Lab, Sensor
from tests.reports.known_stage import axis_model

EVERYTHING = Lab(
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


def by_name(lab: Lab | None = None) -> dict[str, tuple[str, float]]:
    found = displacement_budget(axis_model(), lab)
    return {one.name: (one.kind, one.standard) for one in found.budget.contributions}


def test_declared_sources_are_type_b_and_have_their_closed_forms():
    held = by_name(EVERYTHING)
    at_m = 0.5 * 2.4e-5
    for name, standard_m in (
        ("gain of the sensor", 1e-3 * at_m),
        ("linearity of the sensor", 6e-9 / math.sqrt(3)),
        ("tilt, by its cosine", at_m * (1 - math.cos(0.01)) / math.sqrt(3)),
        ("temperature of the room", 3e-8 / math.sqrt(3)),
        ("step of the converter", 20 / 2**16 / 2e5 / math.sqrt(12)),
    ):
        assert held[name] == ("B", pytest.approx(standard_m))
    assert not displacement_budget(axis_model(), EVERYTHING).unknown


def test_noise_is_new_at_each_position_and_what_was_calibrated_once_is_not():
    parts = displacement_budget(axis_model(), EVERYTHING).budget.contributions
    new = {one.name for one in parts if not one.is_shared}
    assert new == {"residual on held-out data, sensor noise included", "step of the converter"}


def test_the_residual_enters_whole_and_sources_from_data_are_type_a():
    held = by_name()
    assert held["residual on held-out data, sensor noise included"] == ("A", 3e-8)
    assert {kind for kind, _ in held.values()} == {"A"}


def test_the_parameters_count_where_the_loading_curve_is_known_worst():
    axis = axis_model()
    half_m = np.linspace(1e-9, 5e-9, len(axis.uncertainty.loading_half_m))
    axis = replace(axis, uncertainty=replace(axis.uncertainty, blocks=5, loading_half_m=half_m))
    held = {one.name: one for one in displacement_budget(axis).budget.contributions}
    found = held["parameters of the model"]
    assert found.freedom == 4
    assert found.standard == pytest.approx(5e-9 / 2.7764, rel=1e-4)  # Student's t at 4


def test_what_nobody_declared_is_named():
    assert displacement_budget(axis_model()).unknown == (
        "sensor_gain_relative",
        "sensor_linearity_m",
        "tilt_rad",
        "temperature_range_K",
    )
    half = Lab(certificates=Certificates(temperature_range_K=1.0))
    assert "expansion_m_per_K" in displacement_budget(axis_model(), half).unknown


def test_the_zero_from_run_to_run_is_told_and_not_counted():
    axis = axis_model()
    alone = replace(axis, starts=axis.starts[:1])
    assert displacement_budget(alone).zero_between_m is None
    found = displacement_budget(axis)
    assert found.zero_between_m == pytest.approx(math.sqrt(0.5) * 1e-6)
    assert found.budget.combined < found.zero_between_m


def test_the_lag_counts_at_the_fastest_drive_of_the_data():
    axis = replace(axis_model(), lag=Lag(kind="delay", time_s=1e-5))
    covariance = np.array(axis.uncertainty.covariance)
    covariance[-1, -1] = 1e-6**2
    axis = replace(axis, uncertainty=replace(axis.uncertainty, covariance=covariance))
    held = {one.name: one for one in displacement_budget(axis).budget.contributions}
    known = axis.uncertainty
    speed_m_per_s = 40.0 * known.loading_m[-1] / known.reach_V[-1]
    lag = held["lag, at the fastest drive of the fitted samples"]
    assert lag.standard == pytest.approx(1e-6 * speed_m_per_s)


def test_a_heavier_remainder_makes_the_largest_error_larger_and_not_the_usual_one():
    axis = axis_model()
    calm = replace(axis, certificate=replace(axis.certificate, remainder_m=9e-8))
    wild = replace(axis, certificate=replace(axis.certificate, remainder_m=2e-7))
    first, second = (displacement_budget(one).budget for one in (calm, wild))
    assert second.combined == first.combined
    assert second.largest[1] > first.largest[1]
