"""What a linear loop needs to know about hysteresis: a slope sector and a bound of the error."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.design.joint_error import joint_error
from piezoid.design.slope_ratio import (
    envelope_reach_V,
    output_reach_m,
    ratio_sector,
    static_difference,
)
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.operators.worst_case import worst_case
from piezoid.readable import told


@dataclass(frozen=True, kw_only=True)
class HysteresisBounds:
    """Bounds of delta in y = a (u + delta[u]), u being the loop's command.

    form              ``affine`` or ``inverse``
    gain_m_per_V      a, the centre of the sector
    slope_min, slope_max   of d(u + delta)/du, relative to a; their mean is 1
    slope_beyond      what no model of this kind explains changes the slope by, at most
    error_m           sup |a delta| up to a constant, for |u| <= reach_V
    reach_V           largest command for which the bounds hold
    conditions        what must be true for the bounds to hold, whole sentences
    """

    form: str
    gain_m_per_V: float
    slope_min: float
    slope_max: float
    error_m: float
    reach_V: float
    conditions: tuple[str, ...]
    slope_beyond: float = 0.0

    @property
    def increment_gain(self) -> float:
        """eps of |D delta| <= eps |D u|."""
        sector = (self.slope_max - self.slope_min) / (self.slope_max + self.slope_min)
        return sector + self.slope_beyond


def affine_bounds(
    model: ModifiedPrandtlIshlinskii,
    reach_V: float,
    *,
    remainder_m: float,
    remainder_m_per_V: float = 0.0,
) -> HysteresisBounds:
    """Bound what an affine map leaves of a hysteresis model.

        m <= D Gamma / D u <= M,   a = (M + m)/2,   eps = (M - m)/(M + m)
        |Gamma[u] - a u - b| <= int_0^V |s W(r) - c| dr + sup |c gamma(u) - a u|
                                + sup |Psi(h) - s h|,   V = sup |gamma(u)|

    s and a/c are the mid slopes of Psi and gamma. The play states' increments lie between 0 and 1
    and do not grow with the threshold, so Abel summation bounds the slope of H, and those of Psi
    and gamma multiply it; the integral is exact for plays [Brokate & Sprekels 1996].

    remainder_m  what the model itself leaves, for example the 99.9 % quantile of the held-out
                 residual
    remainder_m_per_V  by how much that changes the slope, at most
    """
    least, greatest = model.slope_sector_m_per_V
    gain = 0.5 * (greatest + least)
    middle, bend = _mid_slope(model.dead_zones), _mid_slope(model.envelope)
    scaled = PrandtlIshlinskii(threshold=model.plays.threshold, weight=middle * model.plays.weight)
    line = PrandtlIshlinskii(threshold=np.zeros(1), weight=np.array([gain / bend]))
    static = static_difference(model.dead_zones, middle, output_reach_m(model, reach_V))
    bent = gain / bend * static_difference(model.envelope, bend, reach_V)
    plays = worst_case(scaled, line, envelope_reach_V(model, reach_V)).bound
    error = plays + bent + static + remainder_m
    return HysteresisBounds(
        form="affine",
        gain_m_per_V=gain,
        slope_min=least / gain,
        slope_max=greatest / gain,
        slope_beyond=remainder_m_per_V / gain,
        error_m=error,
        reach_V=reach_V,
        conditions=(
            f"the command stays within {told(reach_V, 'V')} of the model's centre",
            "the stage started de-poled, or has passed an extreme larger than the scan",
            f"the hysteresis model errs by at most {told(remainder_m, 'm')}",
        ),
    )


def inverse_bounds(
    model: ModifiedPrandtlIshlinskii,
    replicates: Sequence[ModifiedPrandtlIshlinskii],
    reach_V: float,
    *,
    gain_m_per_V: float,
    remainder_m: float,
    remainder_m_per_V: float = 0.0,
    confidence: float = 0.95,
) -> HysteresisBounds:
    """Bound what exact inversion of a model leaves, from models refitted to resampled data.

        |Gamma_t[u] - Gamma_m[u]| <= sup over all histories, see ``joint_error``, + rho_max
        m = min D(Gamma_t o Gamma_m^-1),   M = max of the same, see ``slope_ratio``

    The compensation error is the model error at the inverse's output. Each replicate stands for
    the truth once; the quantile ``confidence`` over replicates is reported. All models are in the
    gauge of unit central dead zone.

    gain_m_per_V  a of the linear design, the unit of the command
    remainder_m   rho_max: bounded part that no model of this kind explains
    remainder_m_per_V  by how much that part changes the slope, at most
    """
    reference = model.regauged()
    truths = [replicate.regauged() for replicate in replicates]
    apart = joint_error(reference, truths, reach_V)
    errors = apart.error_m
    sectors = np.array(
        [
            ratio_sector(reference, truth, reach_V, apart, error_m)
            for truth, error_m in zip(truths, errors.tolist(), strict=True)
        ]
    )
    low = float(np.quantile(sectors[:, 0], 1.0 - confidence))
    high = float(np.quantile(sectors[:, 1], confidence))
    centre = 0.5 * (low + high)
    return HysteresisBounds(
        form="inverse",
        gain_m_per_V=gain_m_per_V * centre,
        slope_min=low / centre,
        slope_max=high / centre,
        slope_beyond=remainder_m_per_V / (gain_m_per_V * centre),
        error_m=float(np.quantile(errors, confidence)) + remainder_m,
        reach_V=reach_V,
        conditions=(
            f"the drive stays within {told(reach_V, 'V')} of the model's centre",
            f"the true hysteresis lies within {100.0 * confidence:g} % of {len(truths)} refits",
            f"what no such model explains stays below {told(remainder_m, 'm')}",
        ),
    )


def _mid_slope(zones: DeadZones) -> float:
    return 0.5 * float(zones.slope.min() + zones.slope.max())
