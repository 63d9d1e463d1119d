"""Infeasible specifications: location and size of the violation, and the nearest feasible one."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NoReturn, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.certificate import impulse_response
from piezoid.design.plant import Fraction
from piezoid.design.sensitivity import (
    ATTENUATION,
    Template,
    Violation,
    closed_loop_polynomial,
    margins,
    sensitivities,
)
from piezoid.design.specification import BEYOND, CONTROL_EFFORT, Specification
from piezoid.errors import TemplateError
from piezoid.numerics.polynomial import decibel, grid_Hz, product

_BISECTIONS = 4
_STEPS_DOWN, _STEP_DOWN = 20, -0.02  # the step is in ln(bandwidth)
_MAX_RELAXATIONS = 5  # of a default bandwidth
_PER_E_FOLD_dB = 20.0 / np.log(10.0)
_LOWEST_SHARE = 0.01

Attempt = Callable[[Specification], tuple[Violation, ...]]
"""Design for a specification; return what the best candidate violates, worst first."""

Result = TypeVar("Result")


def nearest_feasible_Hz(
    specification: Specification, violations: tuple[Violation, ...], attempt: Attempt
) -> float | None:
    """Bisect the largest bandwidth that meets every limit, on a logarithmic scale.

    The first trial assumes that |Syp| rises with f: an excess of 12 dB needs a quarter of the
    bandwidth. Returns None if not even 1 % of the bandwidth meets every limit.
    """

    def meets(logarithm: float) -> bool:
        share = float(np.exp(logarithm))
        return not attempt(replace(specification, bandwidth_Hz=share * specification.bandwidth_Hz))

    lowest, high = float(np.log(_LOWEST_SHARE)), 0.0
    low = min(max(-violations[0].excess_dB / _PER_E_FOLD_dB, lowest), float(np.log(0.9)))
    if not meets(low):
        high, low = low, lowest
        if not meets(low):
            return None
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if meets(middle) else (low, middle)
    for _ in range(_STEPS_DOWN):
        nearest_Hz = rounded_down(float(np.exp(low)) * specification.bandwidth_Hz)
        # Feasibility by search is not monotone in the bandwidth: the advice itself is verified.
        if meets(float(np.log(nearest_Hz / specification.bandwidth_Hz))):
            return nearest_Hz
        low += _STEP_DOWN
    return None


def refuse(
    axis: str,
    specification: Specification,
    violations: tuple[Violation, ...],
    attempt: Attempt,
    *,
    because: str = "",
) -> NoReturn:
    """Raise ``TemplateError`` with the nearest feasible specification.

    because  property of the plant that causes the violation, a whole sentence
    """
    worst, nearest_Hz = violations[0], nearest_feasible_Hz(specification, violations, attempt)
    relaxation_dB = {v.template: v.excess_dB for v in reversed(violations)}
    margins_set = {
        "modulus margin": ("modulus_margin", specification.modulus_margin),
        "delay margin": ("delay_margin_s", specification.delay_margin_s),
    }
    steps, fixed = [], []
    for name, excess_dB in sorted(relaxation_dB.items(), key=lambda item: -item[1]):
        if name in margins_set:
            key, value = margins_set[name]
            steps.append(f"set {key} = {rounded_down(value / 10.0 ** (excess_dB / 20.0)):g}")
        elif name in (CONTROL_EFFORT, BEYOND):
            fixed.append(f"{name!r} (missed by {excess_dB:.2f} dB)")
        elif name != ATTENUATION:  # which follows from the bandwidth
            steps.append(f"relax '{name}' by {np.ceil(excess_dB * 100.0) / 100.0:.2f} dB")
    # Every violated limit must be relaxed, or none.
    relaxed = "" if fixed else " and ".join(steps)
    of_model = ""
    if fixed:
        of_model = f" {' and '.join(fixed)} follows from the model, not from design.toml."
    if BEYOND in relaxation_dB:
        of_model += " A response recorded to a higher frequency relaxes it."
    if nearest_Hz is None:
        relaxed = f"{relaxed}, or " if relaxed else ""
        remedy = f"No bandwidth helps: {relaxed}describe the plant family more narrowly.{of_model}"
    else:
        relaxed = f", or {relaxed}" if relaxed else ""
        remedy = (
            f"Ask for bandwidth_Hz = {nearest_Hz:g}, which meets every limit{relaxed}.{of_model}"
        )
    raise TemplateError(
        f"axis {axis}, bandwidth {specification.bandwidth_Hz:.6g} Hz: {worst.sentence}"
        f"{'. ' if because else ''}{because}",
        needed="a controller with which every member of the plant family meets every limit",
        remedy=remedy,
        axis=axis,
        template=worst.template,
        member=worst.member,
        frequency_Hz=worst.frequency_Hz,
        excess_dB=worst.excess_dB,
        nearest_bandwidth_Hz=nearest_Hz,
        relaxation_dB=relaxation_dB,
        violations=violations,
    )


def at_feasible_bandwidth(
    design: Callable[[Specification], Result], specification: Specification
) -> Result:
    """Design as requested, or at the nearest feasible bandwidth if that is refused.

    For specifications whose bandwidth was not requested. Raises the refusal if no bandwidth is
    feasible.
    """
    attempted = specification
    for _ in range(_MAX_RELAXATIONS):
        try:
            return design(attempted)
        except TemplateError as refusal:
            nearest_Hz = refusal.numbers["nearest_bandwidth_Hz"]
            if not isinstance(nearest_Hz, float):
                raise
            # The search for the smallest error may end at an infeasible point although the search
            # for any feasible point succeeded.
            bandwidth_Hz = min(nearest_Hz, 0.97 * attempted.bandwidth_Hz)
            attempted = replace(specification, bandwidth_Hz=bandwidth_Hz)
    return design(attempted)


def rounded_down(value: float) -> float:
    """Round down to three digits, so that the stated value remains feasible."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(np.floor(value / unit + 1e-9) * unit)


def unmet(
    members: Sequence[Fraction],
    R: ArrayLike,
    S: ArrayLike,
    specification: Specification,
    *,
    templates: Sequence[Template] | None = None,
) -> tuple[Violation, ...]:
    """Return the requirements that members of the family do not meet, on a fine grid, worst first.

    templates  the templates to check; None: all templates of the specification
    """
    templates = specification.all_templates if templates is None else templates
    unmet_limits: list[Violation] = []
    for member in members:
        m, rate_Hz = margins(member, R, S), member.sampling_rate_Hz
        delay_Hz, delay_s = m.delay_Hz or m.modulus_Hz, m.delay_margin_s
        rows = []  # name, frequency, value, limit, unit and excess in dB of each requirement
        for name, f_Hz, value, limit, unit in (
            ("modulus margin", m.modulus_Hz, m.modulus_margin, specification.modulus_margin, "1"),
            ("delay margin", delay_Hz, delay_s, specification.delay_margin_s, "s"),
        ):
            if value is not None:
                excess_dB = float(decibel(limit / max(value, 1e-6 * limit)))
                rows.append((name, f_Hz, value, limit, unit, excess_dB))
        for template in templates:
            lowest_Hz = min(1.0, float(template.frequency_Hz[0]))
            grid = grid_Hz(rate_Hz, lowest_Hz=lowest_Hz, count=2000)
            f = np.union1d(grid, template.frequency_Hz[template.frequency_Hz < 0.5 * rate_Hz])
            f = f[np.isfinite(template.limit_dB(f))]
            if f.size:
                magnitude = np.abs(getattr(sensitivities(member, R, S, f), template.function))
                level_dB, limit_dB = decibel(magnitude), template.limit_dB(f)
                worst = int(np.argmax(level_dB - limit_dB))
                level, limit = float(level_dB[worst]), float(limit_dB[worst])
                rows.append((template.name, float(f[worst]), level, limit, "dB", level - limit))
        limit_rms = specification.noise_limit_rms
        if limit_rms is not None:
            rms = noise_rms(member, R, S, specification) if m.is_stable else 1e3 * limit_rms
            excess_dB = float(decibel(rms / limit_rms))
            rows.append(("noise budget", 0.5 * rate_Hz, rms, limit_rms, "rms", excess_dB))
        unmet_limits += [
            Violation(
                template=name,
                member=member.label,
                frequency_Hz=f_Hz,
                found=value,
                limit=limit,
                unit=unit,
                excess_dB=excess_dB,
            )
            for name, f_Hz, value, limit, unit, excess_dB in rows
            if excess_dB > 0.0
        ]
    return tuple(sorted(unmet_limits, key=lambda violation: -violation.excess_dB))


def severity(violations: tuple[Violation, ...]) -> float:
    """Return the excess of the worst limit in dB; 0 if all limits are met."""
    return violations[0].excess_dB if violations else 0.0


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
