"""Uncertainty budget of a predicted displacement.

    u_c^2 = residual^2 + parameters^2 + zero^2 + lag^2                   (type A)
            + gain^2 + linearity^2 + tilt^2 + temperature^2 + converter^2    (type B)

Type A comes from the recordings. The residual is that of a single position; averaging N positions
would divide it by the root of the number of independent positions, which is smaller than N. Type
B is declared in ``[uncertainty]`` of lab.toml; undeclared contributions are listed, and the budget
is then a lower bound. The sensor noise is part of the residual and is not counted twice.
"""

import math
from dataclasses import dataclass

import numpy as np

from piezoid.identification.model import AxisModel
from piezoid.numerics.robust import student_quantile
from piezoid.numerics.uncertainty_budget import (
    Budget,
    Contribution,
    budget_of,
    half_width,
    tail_of,
)
from piezoid.records.lab import Lab

REMAINDER = 0.999  # quantile of the held-out residual in the certificate


@dataclass(frozen=True, kw_only=True, eq=False)
class DisplacementBudget:
    """Uncertainty budget of one axis, in metres, at the end of its range, where it is largest.

    unknown         undeclared contributions, by their keys in ``[uncertainty]``
    zero_between_m  standard deviation of the zero from run to run, or None for a single run. It is
                    not in the budget, because a displacement is measured from the axis' zero
    """

    axis: str
    budget: Budget
    unknown: tuple[str, ...]
    zero_between_m: float | None


def displacement_budget(axis: AxisModel, lab: Lab | None = None) -> DisplacementBudget:
    """Compute the uncertainty of the predicted displacement for drives within the range."""
    declared = Lab() if lab is None else lab
    certificates = declared.certificates
    names = ("sensor_gain_relative", "sensor_linearity_m", "tilt_rad", "temperature_range_K")
    unknown = [name for name in names if getattr(certificates, name) is None]
    if certificates.temperature_range_K is not None and certificates.expansion_m_per_K is None:
        unknown.append("expansion_m_per_K")
    zeros_m = np.array([float(np.mean(start.zero_m)) for start in axis.starts])
    # Contributions of type B, at the end of the range.
    position_m = 0.5 * axis.quality.range_m
    contributions = _from_data(axis)
    if certificates.sensor_gain_relative is not None:
        standard_m = certificates.sensor_gain_relative * position_m
        gain = Contribution(name="gain of the sensor", kind="B", standard=standard_m)
        contributions.append(gain)
    if certificates.sensor_linearity_m is not None:
        half_m = certificates.sensor_linearity_m
        contributions.append(half_width("linearity of the sensor", half_m))
    if certificates.tilt_rad is not None:
        half_m = position_m * (1.0 - math.cos(certificates.tilt_rad))
        contributions.append(half_width("tilt, by its cosine", half_m))
    range_K, expansion_m_per_K = certificates.temperature_range_K, certificates.expansion_m_per_K
    if range_K is not None and expansion_m_per_K is not None:
        half_m = 0.5 * range_K * expansion_m_per_K
        contributions.append(half_width("temperature of the room", half_m))
    range_V, bits = declared.acquisition.input_range_V, declared.acquisition.adc_bits
    gain_V_per_m = declared.sensor_of(axis.axis).gain_V_per_m
    if range_V is not None and bits is not None and gain_V_per_m is not None:
        step_m = abs((range_V[1] - range_V[0]) / 2.0**bits / gain_V_per_m)
        contributions.append(half_width("step of the converter", 0.5 * step_m, is_shared=False))
    return DisplacementBudget(
        axis=axis.axis,
        budget=budget_of(contributions),
        unknown=tuple(unknown),
        zero_between_m=float(np.std(zeros_m, ddof=1)) if len(zeros_m) > 1 else None,
    )


def _from_data(axis: AxisModel) -> list[Contribution]:
    """Return the contributions of type A: residual, parameters, drift of the zero, and lag."""
    uncertainty = axis.uncertainty
    freedom = max(uncertainty.blocks - 1, 1)
    rms_m = axis.quality.held_out_rms_m
    # The 99.9 % quantile of the held-out residual determines its tail.
    tail = tail_of(axis.certificate.remainder_m / rms_m, REMAINDER) if rms_m > 0.0 else math.inf
    half_95_m = float(np.max(uncertainty.loading_half_m))
    drift_m = max((float(np.ptp(start.zero_m)) for start in axis.starts), default=0.0)
    contributions = [
        Contribution(
            name="residual on held-out data, sensor noise included",
            kind="A",
            standard=rms_m,
            freedom=freedom,
            shape="normal" if math.isinf(tail) else "heavy",
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
            standard=drift_m / 2.0 / math.sqrt(3.0),
            shape="rectangular",
        ),
    ]
    if "lag_s" in uncertainty.names and axis.lag.kind != "none":
        reach_V = float(uncertainty.reach_V[-1])
        gain_m_per_V = float(uncertainty.loading_m[-1]) / reach_V if reach_V > 0.0 else 0.0
        speed_m_per_s = axis.certificate.slew_V_per_s * gain_m_per_V
        lag = Contribution(
            name="lag, at the fastest drive of the fitted samples",
            kind="A",
            standard=speed_m_per_s * uncertainty.standard_error("lag_s"),
            freedom=freedom,
        )
        contributions.append(lag)
    return contributions
