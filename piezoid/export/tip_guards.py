"""What lab.toml says to keep a tip from the surface, as the runtime takes it."""

from piezoid.design.from_junction import missing_line, set_point_A
from piezoid.design.specification import Specification
from piezoid.errors import LabFileError
from piezoid.export.from_design import TunnellingGuards
from piezoid.records.lab import Lab


def tip_guards(lab: Lab, asked: Specification, rate_Hz: float) -> TunnellingGuards:
    """Return the guards of the tunnelling axis.

    asked    its voltage limits
    rate_Hz  of the controller

    Without ``retract_V`` the tip goes to the lowest command: a rising drive extends it.

    Raises ``LabFileError`` with the line to write where set point, floor or ceiling is missing,
    and where they do not follow each other or the tip would retract out of range.
    """
    declared = lab.tunnelling
    reference_A = set_point_A(lab)
    if declared.floor_A is None:
        raise missing_line(lab, "floor_A = 1e-11", "the current below which the tip is lost")
    if declared.ceiling_A is None:
        raise missing_line(lab, "ceiling_A = 1e-8", "the current from which the tip retracts")
    if not declared.floor_A < reference_A < declared.ceiling_A:
        raise _useless(
            lab,
            f"floor_A, set_point_A and ceiling_A are {declared.floor_A:g}, {reference_A:g} and "
            f"{declared.ceiling_A:g} A",
            "a floor below the set point and a ceiling above it",
        )
    retract_V = asked.voltage_min_V if declared.retract_V is None else declared.retract_V
    if not asked.voltage_min_V <= retract_V <= asked.voltage_max_V:
        raise _useless(
            lab,
            f"retract_V is {retract_V:g}",
            f"a voltage from {asked.voltage_min_V:g} to {asked.voltage_max_V:g} V",
        )
    return TunnellingGuards(
        reference_A=reference_A,
        floor_A=declared.floor_A,
        ceiling_A=declared.ceiling_A,
        retract_voltage_V=retract_V,
        retract_samples=max(round(declared.retract_s * rate_Hz), 1),
        bad_samples=max(round(declared.lost_s * rate_Hz), 1),
    )


def _useless(lab: Lab, found: str, needed: str) -> LabFileError:
    return LabFileError(
        f"{lab.place}: {found}",
        needed=needed,
        remedy=f"Correct [tunnelling] in {lab.place} and export again.",
    )
