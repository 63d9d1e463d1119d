"""Uncertainty budget of a predicted displacement, and of any sum of contributions.

    u_c^2 = residual^2 + parameters^2 + zero^2 + lag^2                   (type A)
            + gain^2 + linearity^2 + tilt^2 + temperature^2 + converter^2    (type B)
    nu_eff = u_c^4 / sum (u_i^4 / nu_i),   U = t(0.975, nu_eff) u_c

by the Guide [JCGM 100:2008], annex G (Welch-Satterthwaite), for contributions that are independent
and already in the unit of the result. Where shapes are far from normal, and for the largest of
many errors, the distribution is propagated by draws instead [JCGM 101:2008].

Type A comes from the recordings. The residual is that of a single position; averaging N positions
would divide it by the root of the number of independent positions, which is smaller than N. Type
B is declared in ``[uncertainty]`` of lab.toml; undeclared contributions are listed, and the budget
is then a lower bound. The sensor noise is part of the residual and is not counted twice.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import ndtr

from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import normal_quantile, student_quantile
from piezoid.records.lab import Lab

REMAINDER = 0.999  # quantile of the held-out residual in the certificate
CONFIDENCE = 0.95
DRAWS = 200_000
SEED = 1
QUANTILE_KNOTS = 4000  # linear interpolation between so many quantiles has an error of 1e-5


@dataclass(frozen=True, kw_only=True)
class Contribution:
    """One contribution to the uncertainty of a result.

    name       shown in tables
    kind       ``A``: from the spread of data; ``B``: from a certificate or a data sheet
    standard   standard uncertainty, in the unit of the result
    freedom    degrees of freedom of ``standard``; infinite for most of type B
    shape      ``normal``, ``rectangular``, or ``heavy``: Student's t of ``tail`` degrees of
               freedom, scaled to ``standard``
    tail       > 2, for ``heavy`` only
    is_shared  True: the same at every position of a scan (a wrong gain); False: independent
    """

    name: str
    kind: Literal["A", "B"]
    standard: float
    freedom: float = math.inf
    shape: Literal["normal", "rectangular", "heavy"] = "normal"
    tail: float = math.inf
    is_shared: bool = True


@dataclass(frozen=True, kw_only=True, eq=False)
class Budget:
    """The sum of all contributions, all in the unit of the result.

    A displacement is measured from the zero of its axis: the zero is no contribution.

    combined         u_c
    freedom          nu_eff
    coverage_factor  k, from Student's t at nu_eff
    expanded         U = k u_c, 95 %
    propagated       half width of the 95 % interval of a single error, from draws
    positions        number of positions of the largest error
    largest          (2,)  2.5 % and 97.5 % quantile of the largest error of these positions
    unknown          undeclared contributions, by their keys in ``[uncertainty]`` of lab.toml
    """

    contributions: tuple[Contribution, ...]
    combined: float
    freedom: float
    coverage_factor: float
    expanded: float
    propagated: float
    positions: int
    largest: tuple[float, float]
    unknown: tuple[str, ...] = ()

    def share(self, contribution: Contribution) -> float:
        """Return the share of a contribution in the variance."""
        return (contribution.standard / self.combined) ** 2 if self.combined > 0.0 else 0.0


def displacement_budget(axis: AxisModel, lab: Lab | None = None) -> Budget:
    """Compute the uncertainty of the predicted displacement for drives within the range, m.

    The position is at the end of the range, where the uncertainty is largest.
    """
    declared = Lab() if lab is None else lab
    certificates = declared.certificates
    names = ("sensor_gain_relative", "sensor_linearity_m", "tilt_rad", "temperature_range_K")
    unknown = [name for name in names if getattr(certificates, name) is None]
    if certificates.temperature_range_K is not None and certificates.expansion_m_per_K is None:
        unknown.append("expansion_m_per_K")
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
    return replace(budget_of(contributions), unknown=tuple(unknown))


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
            standard=half_95_m / uncertainty.coverage,
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


def half_width(name: str, half: float, *, is_shared: bool = True) -> Contribution:
    """Return a rectangular contribution within plus and minus ``half``: standard half / sqrt 3."""
    return Contribution(
        name=name,
        kind="B",
        standard=half / math.sqrt(3.0),
        shape="rectangular",
        is_shared=is_shared,
    )


def budget_of(
    contributions: Sequence[Contribution],
    *,
    positions: int = 1000,
    draws: int = DRAWS,
) -> Budget:
    """Return the budget of independent contributions.

    positions  number of independent positions of the largest error; at least 2
    draws      of the propagation; 1e5 give two digits of a 95 % interval

    The largest of n independent values lies at the probability U^(1/n), and the smallest of the
    others at U^(1/n) (1 - V^(1/(n-1))), with U and V uniform, so that single positions need not be
    drawn. Contributions that are not shared are replaced by one of the same total variance and of
    the heaviest tail among them.
    """
    combined_variance = sum(contribution.standard**2 for contribution in contributions)
    combined = math.sqrt(combined_variance)
    loss = sum(contribution.standard**4 / contribution.freedom for contribution in contributions)
    freedom = combined_variance**2 / loss if loss > 0.0 else math.inf
    factor = float(student_quantile(0.5 + CONFIDENCE / 2, freedom))

    rng = np.random.default_rng(SEED)
    shared = np.zeros(draws)
    for contribution in contributions:
        if contribution.is_shared:
            shared = shared + _draw(contribution, draws, rng)
    single = largest = np.abs(shared)
    local = [contribution for contribution in contributions if not contribution.is_shared]
    if local:
        single = np.abs(shared + sum(_draw(contribution, draws, rng) for contribution in local))
        standard = math.sqrt(sum(contribution.standard**2 for contribution in local))
        tails = [contribution.tail for contribution in local if contribution.shape == "heavy"]
        tail = min(tails, default=math.inf)
        top = rng.uniform(size=draws) ** (1.0 / positions)
        low = top * -np.expm1(np.log(rng.uniform(size=draws)) / (positions - 1))
        extremes = []
        for probability in (top, low):
            score = normal_quantile(np.clip(probability, 1e-15, 1.0 - 1e-15))
            if math.isinf(tail):
                extremes.append(np.abs(shared + standard * score))
                continue
            # Quantiles of t are a smooth function of the normal score.
            knots = np.linspace(score.min(), score.max(), QUANTILE_KNOTS)
            quantile = np.interp(score, knots, student_quantile(ndtr(knots), tail))
            quantile = quantile * math.sqrt((tail - 2.0) / tail)
            extremes.append(np.abs(shared + standard * quantile))
        largest = np.maximum(*extremes)
    ends = np.quantile(largest, (0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2))
    return Budget(
        contributions=tuple(contributions),
        combined=combined,
        freedom=freedom,
        coverage_factor=factor,
        expanded=factor * combined,
        propagated=float(np.quantile(single, CONFIDENCE)),
        positions=positions,
        largest=(float(ends[0]), float(ends[1])),
    )


def tail_of(quantile_ratio: float, probability: float = 0.999) -> float:
    """Return the degrees of freedom of the t distribution with this quantile over its rms.

        t(1/2 + p/2, nu) sqrt((nu - 2) / nu) = ratio

    quantile_ratio  quantile of the size of the errors, over their rms
    returned        nu, at least 2.2; infinite where the tail is no heavier than normal
    """
    upper = 0.5 + probability / 2
    if quantile_ratio <= normal_quantile(upper):
        return math.inf
    nu = np.geomspace(2.2, 1e3, 400)
    reached = student_quantile(upper, nu) * np.sqrt((nu - 2) / nu)
    falling = int(np.argmax(reached))  # for smaller nu a few extreme draws dominate the variance
    first = np.searchsorted(-reached[falling:], -quantile_ratio)
    return float(nu[min(falling + int(first), len(nu) - 1)])


def _draw(contribution: Contribution, draws: int, rng: np.random.Generator) -> Array:
    """Draw a contribution, from Student's t if it has finite degrees of freedom."""
    if contribution.shape == "rectangular":
        return contribution.standard * math.sqrt(3.0) * rng.uniform(-1.0, 1.0, draws)
    if contribution.shape == "heavy" and math.isfinite(contribution.tail):
        scale = contribution.standard * math.sqrt((contribution.tail - 2.0) / contribution.tail)
        return np.asarray(scale * rng.standard_t(contribution.tail, draws))
    if math.isfinite(contribution.freedom):
        return np.asarray(contribution.standard * rng.standard_t(contribution.freedom, draws))
    return np.asarray(contribution.standard * rng.standard_normal(draws))
