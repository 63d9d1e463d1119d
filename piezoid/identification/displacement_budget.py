"""Uncertainty budget of a predicted displacement.

    u_c^2 = residual^2 + parameters^2 + zero^2 + lag^2                   (type A)
            + gain^2 + linearity^2 + tilt^2 + temperature^2 + converter^2    (type B)

Type A comes from the recordings; the residual enters whole, as for a single position: an average
of N positions would divide it by the root of the number of independent ones, never by root N. Type
B is what the laboratory declares in ``[uncertainty]`` of lab.toml; what it does not declare is
named, and the budget is then a lower bound: no nanometre is better than the sensor's certificate.
The sensor's noise is inside the residual and is not counted twice.
"""

import math
from dataclasses import dataclass

import numpy as np

from piezoid.identification.model import AxisModel
from piezoid.numerics.robust import student_quantile
from piezoid.numerics.uncertainty_budget import (
    HEAVY,
    NORMAL,
    Budget,
    Contribution,
    budget_of,
    half_width,
    tail_of,
)
from piezoid.records.lab import Lab

REMAINDER = 0.999  # quantile of the held-out residual that the certificate holds


@dataclass(frozen=True, kw_only=True, eq=False)
class DisplacementBudget:
    """The budget of one axis, in metres, at the end of its range, where it is worst.

    unknown   what no recording shows and nobody declared, as ``[uncertainty]`` calls it
    zero_between_m   standard deviation of the zero from run to run, which is not counted: a
                     displacement begins where the axis is set to zero. None for a single run
    """

    axis: str
    budget: Budget
    unknown: tuple[str, ...]
    zero_between_m: float | None


def displacement_budget(
    axis: AxisModel, lab: Lab | None = None, *, positions: int = 1000
) -> DisplacementBudget:
    """Return the uncertainty of the predicted displacement for drives within the range.

    positions  independent ones, of which the largest error is asked
    """
    declared = Lab() if lab is None else lab
    certificates = declared.certificates
    names = ("sensor_gain_relative", "sensor_linearity_m", "tilt_rad", "temperature_range_K")
    unknown = [name for name in names if getattr(certificates, name) is None]
    if certificates.temperature_range_K is not None and certificates.expansion_m_per_K is None:
        unknown.append("expansion_m_per_K")
    zeros_m = np.array([float(np.mean(start.zero_m)) for start in axis.starts])
    contributions = (*_from_data(axis), *_from_certificates(axis, declared))
    return DisplacementBudget(
        axis=axis.axis,
        budget=budget_of(contributions, positions=positions, seed=1),
        unknown=tuple(unknown),
        zero_between_m=float(np.std(zeros_m, ddof=1)) if len(zeros_m) > 1 else None,
    )


def _from_data(axis: AxisModel) -> list[Contribution]:
    """Return type A: residual, parameters, zero, and the lag at the fastest drive."""
    uncertainty = axis.uncertainty
    freedom = max(uncertainty.blocks - 1, 1)
    rms_m = axis.quality.held_out_rms_m
    # The tail of the held-out residual is from its 99.9 % quantile.
    tail = tail_of(axis.certificate.remainder_m / rms_m, REMAINDER) if rms_m > 0.0 else math.inf
    half_95_m = float(np.max(uncertainty.loading_half_m))
    moved_m = max((float(np.ptp(start.zero_m)) for start in axis.starts), default=0.0)
    contributions = [
        Contribution(
            name="residual on held-out data, sensor noise included",
            kind="A",
            standard=rms_m,
            freedom=freedom,
            shape=NORMAL if math.isinf(tail) else HEAVY,
            tail=tail,
            is_shared=False,
        ),
        Contribution(
            name="parameters of the model",
            kind="A",
            standard=half_95_m / float(student_quantile(0.975, freedom)),
            freedom=freedom,
        ),
        Contribution(
            name="drift of the zero during a recording",
            kind="A",
            standard=moved_m / 2.0 / math.sqrt(3.0),
            shape="rectangular",
        ),
    ]
    if "lag_s" in uncertainty.names and axis.lag.kind != "none":
        index = uncertainty.names.index("lag_s")
        standard_s = math.sqrt(max(float(uncertainty.covariance[index, index]), 0.0))
        reach_V = float(uncertainty.reach_V[-1])
        gain_m_per_V = float(uncertainty.loading_m[-1]) / reach_V if reach_V > 0.0 else 0.0
        speed_m_per_s = axis.certificate.slew_V_per_s * gain_m_per_V
        lag = Contribution(
            name="lag, at the fastest drive of the data",
            kind="A",
            standard=speed_m_per_s * standard_s,
            freedom=freedom,
        )
        contributions.append(lag)
    return contributions


def _from_certificates(axis: AxisModel, lab: Lab) -> list[Contribution]:
    """Return type B: what the laboratory declares, at the end of the range."""
    certificates, acquisition = lab.certificates, lab.acquisition
    at_m = 0.5 * axis.quality.range_m
    contributions: list[Contribution] = []
    if certificates.sensor_gain_relative is not None:
        standard_m = certificates.sensor_gain_relative * at_m
        gain = Contribution(name="gain of the sensor", kind="B", standard=standard_m)
        contributions.append(gain)
    if certificates.sensor_linearity_m is not None:
        half_m = certificates.sensor_linearity_m
        contributions.append(half_width("linearity of the sensor", half_m))
    if certificates.tilt_rad is not None:
        half_m = at_m * (1.0 - math.cos(certificates.tilt_rad))
        contributions.append(half_width("tilt, by its cosine", half_m))
    range_K, expansion_m_per_K = certificates.temperature_range_K, certificates.expansion_m_per_K
    if range_K is not None and expansion_m_per_K is not None:
        half_m = 0.5 * range_K * expansion_m_per_K
        contributions.append(half_width("temperature of the room", half_m))
    range_V, bits = acquisition.input_range_V, acquisition.adc_bits
    gain_V_per_m = lab.sensor_of(axis.axis).gain_V_per_m
    if range_V is not None and bits is not None and gain_V_per_m is not None:
        step_m = abs((range_V[1] - range_V[0]) / 2.0**bits / gain_V_per_m)
        contributions.append(half_width("step of the converter", 0.5 * step_m, is_shared=False))
    return contributions
