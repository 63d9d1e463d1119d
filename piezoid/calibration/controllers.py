"""From a model to what ships: designed, exported, and run against the stage it was made from."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from json import loads
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezoid.calibration.stage_jobs import Designed
    from piezoid.design.design import Design
    from piezoid.design.design_stage import AxisDesignResult
    from piezoid.export.parameter_file import ParameterFile
    from piezoid.identification.actuator_model import ActuatorModel
    from piezoid.records.lab import Lab
    from piezoid.verification.release import Shipping
    from piezoid.verification.verification import Verification

Progress = Callable[[str], None]
REFUSED = "refused"


@dataclass(frozen=True, kw_only=True)
class Controllers:
    """What became of the way from a model to what ships.

    reason    why it ended before anything shipped
    refused   a controller was sought for an axis, and none of it may ship
    stumbled  a fault of ours ended the way
    failed    the axes whose own verification failed, and what it showed: for study
    """

    design: "Design | None" = None
    parameters: "ParameterFile | None" = None
    verification: "Verification | None" = None
    failed: "tuple[ParameterFile, Verification] | None" = None
    reason: str = ""
    refused: bool = False
    stumbled: bool = False

    @property
    def passed(self) -> bool:
        """Whether every controller that was sought ships, with all its verdicts passed."""
        verified = self.verification is None or self.verification.passed
        return verified and not (self.refused or self.stumbled)

    @property
    def unshipped(self) -> Mapping[str, str]:
        """By axis, why it has no controller beside the others."""
        if self.parameters is not None:
            return self.parameters.unshipped
        return {} if self.design is None else self.design.refused

    @property
    def shipped(self) -> frozenset[str]:
        """The axes that ship."""
        if self.parameters is None:
            return frozenset()
        return frozenset(axis.axis for axis in self.parameters.axes)


def controllers_of(
    model: "ActuatorModel",
    content: bytes,
    lab: "Lab | None",
    progress: Progress,
    *,
    designed: "Sequence[Designed] | None" = None,
    threads: int = 1,
) -> Controllers:
    """Return the controllers and what became of them, or why there are none.

    model     and the ``content`` of its file
    designed  what came of designing its axes; None: they are designed here
    threads   so many verify; what they find does not depend on it

    An axis that damps a mode and fails its own verification is tried once more below the mode.
    Whatever stands in their way, model and report are there without them; a controller that could
    not be verified does not ship.
    """
    from piezoid.design.design_stage import (
        design_axes,
        design_of,
        nothing_to_design,
        without_damping,
    )
    from piezoid.errors import PiezoidError, TemplateError

    design = None
    try:
        digest = loads(content)["digest"]
        outcomes = (
            design_axes(model, lab=lab, progress=progress)
            if designed is None
            else _outcomes(designed)
        )
        if not outcomes:
            raise nothing_to_design(model)
        design = design_of(outcomes, model_digest=digest, lab=lab, coupled=model.coupled)
        controllers, reasons = _verified(model, design, lab, progress, threads)
        slower = without_damping(outcomes, reasons)
        if slower == outcomes:
            return controllers
        progress("trying again below the mode")
        below = design_of(slower, model_digest=digest, lab=lab, coupled=model.coupled)
        below = replace(below, remarks=(*below.remarks, *_not_damped(design, below, reasons)))
        undamped, _ = _verified(model, below, lab, progress, threads)
        return undamped if len(undamped.shipped) > len(controllers.shipped) else controllers
    except PiezoidError as refusal:
        sought = design is not None or isinstance(refusal, TemplateError)
        return Controllers(design=design, reason=str(refusal), refused=sought)
    except Exception as error:  # an internal error must not cost the lab its model
        reason = f"internal error ({type(error).__name__}: {error})"
        return Controllers(design=design, reason=reason, stumbled=True)


def _outcomes(designed: "Sequence[Designed]") -> "tuple[AxisDesignResult, ...]":
    for axis in designed:
        if axis.fault is not None:
            raise axis.fault
    return tuple(outcome for axis in designed for outcome in axis.outcomes)


def _not_damped(design: "Design", below: "Design", reasons: Mapping[str, str]) -> "Iterator[str]":
    """Yield what became of loops that were to damp a mode, whole sentences."""
    for axis in below.axes:
        tried = design.axis(axis.axis)
        if tried is not axis:
            yield (
                f"axis {axis.axis}: a loop of {tried.recommended.bandwidth_Hz:.4g} Hz that damps "
                f"the mode did not pass: {reasons[axis.axis]}. This one of "
                f"{axis.recommended.bandwidth_Hz:.4g} Hz leaves the mode as it is."
            )


def _verified(
    model: "ActuatorModel", design: "Design", lab: "Lab | None", progress: Progress, threads: int
) -> tuple[Controllers, Mapping[str, str]]:
    """Return what ships of a design, what its run against the stage showed, why axes failed."""
    digest = loads(design.to_json())["digest"]
    shipping = shipped(
        model, design, design_digest=digest, lab=lab, progress=progress, threads=threads
    )
    reasons = "; ".join(f"axis {axis}: {reason}" for axis, reason in shipping.reasons.items())
    controllers = Controllers(
        design=design,
        parameters=shipping.parameters,
        verification=shipping.verification,
        failed=failed_of(shipping),
        reason="" if shipping.parameters is not None else reasons,
        refused=shipping.parameters is None or bool(shipping.parameters.unshipped),
    )
    return controllers, shipping.reasons


def shipped(
    model: "ActuatorModel",
    design: "Design",
    *,
    design_digest: str,
    lab: "Lab | None",
    progress: Progress = lambda _: None,
    threads: int = 1,
) -> "Shipping":
    """Export a design, run it against the stage, and return which axes may ship.

    design_digest  of the design's file, for the chain of digests
    threads        so many verify; what they find does not depend on it

    Raises ``ParameterFileError`` or ``LabFileError`` where nothing can be exported.
    """
    from piezoid.export.export_stage import export_stage
    from piezoid.verification.release import release

    progress("exporting")
    parameters = export_stage(model, design, design_digest=design_digest, lab=lab)
    progress("running the compiled controller against the stage")
    return release(parameters, model, lab=lab, threads=threads)


def failed_of(shipping: "Shipping") -> "tuple[ParameterFile, Verification] | None":
    """Return what did not pass its own verification, and what that showed."""
    if shipping.refused is None or shipping.refused_verification is None:
        return None
    return shipping.refused, shipping.refused_verification


def files_of(controllers: Controllers) -> dict[str, bytes]:
    """Return name and bytes of everything that came of it, as far as it came."""
    from piezoid.export.bundle import bundle
    from piezoid.export.parameter_file import to_json

    files = {}
    if controllers.design is not None:
        files["design.json"] = controllers.design.to_json()
    if controllers.parameters is not None:
        files["params.json"] = to_json(controllers.parameters)
        contents = bundle(controllers.parameters).files
        files |= {f"bundle/{name}": text for name, text in contents.items()}
    if controllers.verification is not None:
        files["verification.json"] = controllers.verification.to_json()
    return files | failed_files(controllers.failed)


def failed_files(failed: "tuple[ParameterFile, Verification] | None") -> dict[str, bytes]:
    """Return what stays of axes that may not ship, for study: nothing a firmware could take."""
    from piezoid.export.parameter_file import to_json

    if failed is None:
        return {}
    file, verification = failed
    return {
        f"{REFUSED}/params.json": to_json(file),
        f"{REFUSED}/verification.json": verification.to_json(),
    }
