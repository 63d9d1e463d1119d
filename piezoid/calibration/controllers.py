"""Assemble, export and verify the controllers of a fitted stage."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from piezoid.design.design import Design
from piezoid.design.design_stage import (
    AxisDesignResult,
    design_of,
    nothing_to_design,
    without_damping,
)
from piezoid.digests import digest_in
from piezoid.errors import PiezoidError, TemplateError
from piezoid.export.bundle import bundle
from piezoid.export.export_stage import export_stage
from piezoid.export.parameter_file import ParameterFile, to_json
from piezoid.formatting import with_unit
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.records.lab import Lab
from piezoid.verification.verification import Verification
from piezoid.verification.verify_stage import Shipping, release

Progress = Callable[[str], None]
REFUSED = "refused"  # folder of the axes that do not ship, for study


@dataclass(frozen=True, kw_only=True)
class Controllers:
    """Result of design, export and verification.

    shipping     of the exported design; None if nothing was exported
    reason       if nothing ships
    refused      whether an axis with a specification does not ship
    has_crashed  whether an internal error ended design, export or verification
    """

    design: Design | None = None
    shipping: Shipping | None = None
    reason: str = ""
    refused: bool = False
    has_crashed: bool = False

    @property
    def parameters(self) -> ParameterFile | None:
        """The parameters that ship."""
        return None if self.shipping is None else self.shipping.parameters

    @property
    def verification(self) -> Verification | None:
        """Verification of the exported controllers."""
        return None if self.shipping is None else self.shipping.verification

    @property
    def passed(self) -> bool:
        """Whether every designed controller ships, with all its verdicts passed."""
        is_verified = self.verification is None or self.verification.passed
        return is_verified and not (self.refused or self.has_crashed)

    @property
    def unshipped(self) -> Mapping[str, str]:
        """Reason of each axis without an exported controller, by axis."""
        if self.parameters is not None:
            return self.parameters.unshipped
        return {} if self.design is None else self.design.refused

    @property
    def shipped(self) -> frozenset[str]:
        """Names of the axes that ship."""
        axes = () if self.parameters is None else self.parameters.axes
        return frozenset(axis.axis for axis in axes)

    @property
    def files(self) -> dict[str, bytes]:
        """Contents of the files of all completed steps, by name."""
        design = {} if self.design is None else {"design.json": self.design.to_json()}
        return design | ({} if self.shipping is None else shipping_files(self.shipping))


def controllers_of(
    model: ActuatorModel,
    model_file: bytes,
    lab: Lab | None,
    progress: Progress,
    *,
    outcomes: Sequence[AxisDesignResult],
    fault: Exception | None = None,
    threads: int = 1,
) -> Controllers:
    """Assemble, export and verify the designed axes; errors become the reason.

    model_file  content of model.json
    outcomes    of the design of each axis
    fault       error that ended the design of an axis
    threads     of the verification; its result does not depend on them

    If an axis damps a mode and fails its verification, the design with a bandwidth below the mode
    is verified as well.
    """
    design = None
    try:
        if fault is not None:
            raise fault
        if not outcomes:
            raise nothing_to_design(model)
        digest = digest_in(model_file)
        design = design_of(outcomes, model_digest=digest, lab=lab, coupled=model.coupled)
        controllers = _verify_design(model, design, lab, progress, threads)
        assert controllers.shipping is not None
        reasons = controllers.shipping.reasons
        undamped = without_damping(outcomes, reasons)
        if undamped == tuple(outcomes):
            return controllers
        progress("trying again below the mode")
        slower = design_of(undamped, model_digest=digest, lab=lab, coupled=model.coupled)
        remarks = tuple(
            f"axis {axis.axis}: a loop of {with_unit(fast.recommended.bandwidth_Hz, 'Hz')} that "
            f"damps the mode did not pass: {reasons[axis.axis]}. This one of "
            f"{with_unit(axis.recommended.bandwidth_Hz, 'Hz')} leaves the mode as it is."
            for axis in slower.axes
            if (fast := design.axis(axis.axis)) is not axis
        )
        slower = replace(slower, remarks=(*slower.remarks, *remarks))
        below_mode = _verify_design(model, slower, lab, progress, threads)
        return below_mode if len(below_mode.shipped) > len(controllers.shipped) else controllers
    except PiezoidError as refusal:
        refused = design is not None or isinstance(refusal, TemplateError)
        return Controllers(design=design, reason=str(refusal), refused=refused)
    except Exception as error:  # an internal error must not cost the lab its model
        reason = f"internal error ({type(error).__name__}: {error})"
        return Controllers(design=design, reason=reason, has_crashed=True)


def _verify_design(
    model: ActuatorModel, design: Design, lab: Lab | None, progress: Progress, threads: int
) -> Controllers:
    digest = digest_in(design.to_json())
    shipping = export_and_verify(
        model, design, design_digest=digest, lab=lab, progress=progress, threads=threads
    )
    return verified_controllers(design, shipping)


def verified_controllers(design: Design | None, shipping: Shipping) -> Controllers:
    """Return the controllers of a design after its export and verification."""
    parameters = shipping.parameters
    reasons = "; ".join(f"axis {axis}: {reason}" for axis, reason in shipping.reasons.items())
    return Controllers(
        design=design,
        shipping=shipping,
        reason="" if parameters is not None else reasons,
        refused=parameters is None or bool(parameters.unshipped),
    )


def export_and_verify(
    model: ActuatorModel,
    design: Design,
    *,
    design_digest: str,
    lab: Lab | None,
    progress: Progress,
    threads: int,
) -> Shipping:
    """Export a design, verify it against the stage, and release the axes that pass.

    design_digest  of design.json, for the chain of digests
    threads        of the verification; its result does not depend on them

    Raises ``ParameterFileError`` or ``LabFileError`` if nothing can be exported.
    """
    progress("exporting")
    parameters = export_stage(model, design, design_digest=design_digest, lab=lab)
    progress("running the compiled controller against the stage")
    return release(parameters, model, lab=lab, threads=threads)


def shipping_files(shipping: Shipping) -> dict[str, bytes]:
    """Return params.json, bundle/, verification.json, and refused/ of axes that do not ship."""
    files = {}
    if shipping.parameters is not None:
        files["params.json"] = to_json(shipping.parameters)
        contents = bundle(shipping.parameters)
        files |= {f"bundle/{name}": content for name, content in contents.items()}
    files["verification.json"] = shipping.verification.to_json()
    if shipping.refused is not None and shipping.refused_verification is not None:
        files[f"{REFUSED}/params.json"] = to_json(shipping.refused)
        files[f"{REFUSED}/verification.json"] = shipping.refused_verification.to_json()
    return files
