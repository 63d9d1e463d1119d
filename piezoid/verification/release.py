"""Release the axes whose verification passes."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from piezoid.export.parameter_file import ParameterFile
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.records.lab import Lab
from piezoid.verification.criteria import describe_failure
from piezoid.verification.verification import Verification
from piezoid.verification.verify_stage import verify_stage

_MOST_NAMED = 3  # failed verdicts of an axis that its reason names


@dataclass(frozen=True, kw_only=True)
class Shipping:
    """Axes of a parameter file that ship, and those that are refused.

    verification  of the axes that ship; of the refused ones where none does
    parameters    of the axes that ship; None: none does
    refused       parameters of the other axes, for study; None: all ship
    reasons       by axis, why it is refused
    """

    verification: Verification
    parameters: ParameterFile | None = None
    refused: ParameterFile | None = None
    refused_verification: Verification | None = None
    reasons: Mapping[str, str] = field(default_factory=dict)


def release(
    file: ParameterFile, model: ActuatorModel, *, lab: Lab | None = None, threads: int = 1
) -> Shipping:
    """Run a parameter file against the identified stage, and release the axes that pass.

    If the file fails, every axis is run by itself: those that fail are refused, and the remaining
    ones must pass together.
    """
    verification = verify_stage(file, model, lab=lab, threads=threads)
    if verification.passed:
        return Shipping(verification=verification, parameters=file)
    by_axis = {
        axis.axis: verify_stage(replace(file, axes=(axis,)), model, lab=lab, threads=threads)
        for axis in (file.axes if len(file.axes) > 1 else ())
    }
    passed = tuple(
        axis for axis in file.axes if axis.axis in by_axis and by_axis[axis.axis].passed
    )
    if passed and len(passed) < len(file.axes):
        failed = tuple(axis for axis in file.axes if axis not in passed)
        reasons = {axis.axis: _reason(by_axis[axis.axis]) for axis in failed}
        remaining = replace(file, axes=passed, unshipped={**file.unshipped, **reasons})
        together = verify_stage(remaining, model, lab=lab, threads=threads)
        if together.passed:
            return Shipping(
                verification=together,
                parameters=remaining,
                refused=replace(file, axes=failed),
                refused_verification=verification,
                reasons=reasons,
            )
    return Shipping(
        verification=verification,
        refused=file,
        refused_verification=verification,
        reasons={axis.axis: _reason(by_axis.get(axis.axis, verification)) for axis in file.axes},
    )


def _reason(verification: Verification) -> str:
    failed = [describe_failure(verdict) for verdict in verification.verdicts if not verdict.passed]
    described = "; ".join(failed[:_MOST_NAMED])
    omitted = f"; and {len(failed) - _MOST_NAMED} more" if len(failed) > _MOST_NAMED else ""
    if not failed:
        return "it passes alone, and not together with the other axes"
    return (
        f"its own verification failed, {len(failed)} of {len(verification.verdicts)} checks: "
        f"{described}{omitted}. Figures for study are in refused/; read there which scenario "
        "fails, record what the model lacks (a chirp or multisine through the first resonance, at "
        "the controller's rate, and slow full loops), and fit again"
    )
