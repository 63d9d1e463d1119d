"""Whether a finished controller meets its specification, on every member, by fresh computation."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.certificate import impulse_response
from piezoid.design.plant import Fraction
from piezoid.design.sensitivity import closed_loop_polynomial, margins
from piezoid.design.specification import Specification
from piezoid.design.templates import Violation, violations
from piezoid.numerics.frequency import decibel
from piezoid.numerics.polynomial import product


def unmet(
    members: Sequence[Fraction], R: ArrayLike, S: ArrayLike, specification: Specification
) -> tuple[Violation, ...]:
    """Return everything the specification asks and some member does not reach, worst first."""
    found = list(
        violations(
            members,
            R,
            S,
            templates=specification.all_templates,
            modulus_margin=specification.modulus_margin,
            delay_margin_s=specification.delay_margin_s,
        )
    )
    limit = specification.noise_limit_rms
    if limit is not None:
        found += [
            violation
            for violation in (_noise(member, R, S, specification, limit) for member in members)
            if violation.excess_dB > 0.0
        ]
    return tuple(sorted(found, key=lambda violation: -violation.excess_dB))


def severity(found: tuple[Violation, ...]) -> float:
    """Return by how many dB the worst limit is missed; 0 if none is."""
    return found[0].excess_dB if found else 0.0


def noise_rms(member: Fraction, R: ArrayLike, S: ArrayLike, specification: Specification) -> float:
    """Return the output's rms due to white sensor noise and converter steps.

    sigma^2 = ||B R / P||_2^2 sigma_n^2 + ||B S / P||_2^2 step^2 / 12     (impulse responses)
    """
    P = closed_loop_polynomial(member, R, S)
    sensor = (impulse_response(product(member.B, R), P) ** 2).sum()
    converter = (impulse_response(product(member.B, S), P) ** 2).sum()
    return float(
        np.sqrt(
            sensor * specification.sensor_noise_rms**2
            + converter * specification.voltage_step_V**2 / 12.0
        )
    )


def _noise(
    member: Fraction, R: ArrayLike, S: ArrayLike, specification: Specification, limit: float
) -> Violation:
    reached = margins(member, R, S)
    found = noise_rms(member, R, S, specification) if reached.is_stable else 1e3 * limit
    return Violation(
        template="noise budget",
        member=member.label,
        frequency_Hz=0.5 * member.sampling_rate_Hz,
        found=found,
        limit=limit,
        unit="rms",
        excess_dB=float(decibel(found / limit)),
    )
