"""Errors of a closed loop as the report states them: simulated, and guaranteed."""

from piezoid.design.design_statements import guaranteed_error_m
from piezoid.identification.model import AxisModel
from piezoid.verification.scenarios import spiral_speed_m_per_s
from piezoid_reports.page import Page
from piezoid_reports.quantities import number

TRACKED_Hz = 10.0  # of the spirals that the verification compares


def tracking_error(page: Page, axis: str) -> str:
    """Return the rms error of the shipped controller on the spiral; empty if none was run."""
    verification = page.verification
    if verification is None:
        return ""
    for row in verification.comparison:
        if (row.method, row.frequency_Hz) == (verification.methods.get(axis), TRACKED_Hz):
            return number(row.rms_m, "m")
    return ""


def guarantee(page: Page, axis: AxisModel) -> str:
    """Return the guaranteed error of the loop of an axis, or why there is none of use."""
    loop, verification = page.loop_of(axis.axis), page.verification
    certificate = None if loop is None else loop.certificate
    bound_m = guaranteed_error_m(certificate, axis, is_verified=page.ships(axis.axis))
    if isinstance(bound_m, str):
        return bound_m
    assert certificate is not None
    assert verification is not None
    speed_m_per_s = spiral_speed_m_per_s(TRACKED_Hz, verification.radius_m)
    slow_m = certificate.guaranteed_at(speed_m_per_s)
    fastest = number(certificate.reference_slew_m_per_s, "m/s")
    limit = f"{number(bound_m, 'm')} up to {fastest}; faster: not covered"
    return f"{number(slow_m, 'm')} at {TRACKED_Hz:g} Hz, {limit}" if slow_m < bound_m else limit


def guaranteed_limit(page: Page, axis: AxisModel) -> str:
    """Return the guaranteed error at every covered speed, or why there is none of use."""
    loop = page.loop_of(axis.axis)
    certificate = None if loop is None else loop.certificate
    bound_m = guaranteed_error_m(certificate, axis, is_verified=page.ships(axis.axis))
    return bound_m if isinstance(bound_m, str) else number(bound_m, "m")
