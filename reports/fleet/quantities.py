"""Quantities that are compared between stages."""

from collections.abc import Callable
from dataclasses import dataclass

from piezoid.design.design import AxisDesign
from piezoid.identification.model import AxisModel
from piezoid.numerics.robust import student_quantile


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One number of an axis that is compared between stages.

    name    in JSON and Parquet, ending with its unit
    label   on the page
    unit    SI
    of      computes the number from an axis and its design, or None without one
    cause   possible causes of an outlier
    error   computes its standard error, or None if unknown
    ratio   stages are compared by ratio and not by difference: quantities that cannot fall below
            zero have a long tail upwards
    """

    name: str
    label: str
    unit: str
    of: Callable[[AxisModel, AxisDesign | None], float | None]
    cause: str
    error: Callable[[AxisModel], float | None] = lambda _: None
    ratio: bool = False


def _sensitivity(axis: AxisModel, _: AxisDesign | None) -> float | None:
    loading_m, reach_V = axis.uncertainty.loading_m[-1], axis.uncertainty.reach_V[-1]
    return float(loading_m / reach_V) if reach_V > 0.0 else None


def _quantile(axis: AxisModel) -> float:
    """Return half a 95 % interval in standard errors."""
    return float(student_quantile(0.975, max(axis.uncertainty.blocks - 1, 1)))


def _sensitivity_error(axis: AxisModel) -> float | None:
    reach_V = float(axis.uncertainty.reach_V[-1])
    half_m = float(axis.uncertainty.loading_half_m[-1])
    return half_m / reach_V / _quantile(axis) if reach_V > 0.0 else None


def _loop_width_error(axis: AxisModel) -> float | None:
    return 100.0 * axis.uncertainty.loop_width_m[1] / axis.quality.range_m / _quantile(axis)


def _lag_error(axis: AxisModel) -> float | None:
    names, covariance = axis.uncertainty.names, axis.uncertainty.covariance
    if "lag_s" not in names:
        return None
    k = names.index("lag_s")
    return float(max(covariance[k, k], 0.0) ** 0.5)


QUANTITIES = (
    Quantity(
        name="sensitivity_m_per_V",
        label="sensitivity",
        unit="m/V",
        of=_sensitivity,
        error=_sensitivity_error,
        cause="another ceramic, a cracked stack, a wrong preload, a wrong sensor gain",
    ),
    Quantity(
        name="loop_width_percent",
        label="loop width, of the range",
        unit="%",
        of=lambda axis, _: 100.0 * axis.uncertainty.loop_width_m[0] / axis.quality.range_m,
        error=_loop_width_error,
        cause="another ceramic, a depoled stack, friction, or a lag that looks like hysteresis",
    ),
    Quantity(
        name="held_out_rms_percent",
        label="held-out error, of the range",
        unit="%",
        of=lambda axis, _: axis.quality.held_out_rms_percent,
        cause="an effect outside the model: read the diagnosis of that stage",
        ratio=True,
    ),
    Quantity(
        name="noise_rms_m",
        label="sensor noise",
        unit="m",
        of=lambda axis, _: axis.quality.noise_rms_m,
        cause="a misaligned sensor, a cable, a ground loop",
        ratio=True,
    ),
    Quantity(
        name="lag_s",
        label="lag beyond the declared poles",
        unit="s",
        of=lambda axis, _: axis.lag.time_s,
        error=_lag_error,
        cause="an undeclared filter, another capacitance, channels sampled at different times",
    ),
    Quantity(
        name="error_bound_m",
        label="certified error bound",
        unit="m",
        of=lambda axis, _: axis.certificate.bound_m,
        cause="too little data of that stage, or a large residual",
        ratio=True,
    ),
    Quantity(
        name="bandwidth_Hz",
        label="closed-loop bandwidth",
        unit="Hz",
        of=lambda _, design: None if design is None else design.recommended.bandwidth_Hz,
        cause="a mode or a delay that limits only this stage",
    ),
    Quantity(
        name="modulus_margin",
        label="modulus margin, worst member",
        unit="",
        of=lambda _, design: None if design is None else design.recommended.worst_modulus_margin,
        cause="a wider plant family than that of the other stages",
    ),
)
