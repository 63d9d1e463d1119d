"""export_stage: a model and a design in, the parameter file of all axes that can ship out."""

from piezoid.design.design import AxisDesign, Design
from piezoid.design.junction_task import loop_plant_of
from piezoid.errors import ParameterFileError, PiezoidError
from piezoid.export.parameter_file import AxisParameters, Decoupled, ParameterFile
from piezoid.export.runtime_parameters import lateral_axis, tunnelling_axis
from piezoid.export.tip_guards import tip_guards
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.records.lab import Lab

# A sensor is stuck if it shows one number for so long while the drive moves by this share of its
# range.
_STUCK_s = 1e-3
_STUCK_SHARE = 0.02
# The observer runs on the model alone for so long: five times the loss of 20 ms that verification
# runs, and before creep, which grows with the logarithm of time, moves what it cannot see.
_BLIND_s = 0.1


def export_stage(
    model: ActuatorModel, design: Design, *, design_digest: str, lab: Lab | None = None
) -> ParameterFile:
    """Return the parameters of each designed axis: the recommended loop, and others to compare.

    An axis that cannot ship does not prevent the others; the file states the reason.

    design_digest  of the design's file, for the chain of digests
    lab            that of the design, but for what guards a tip

    Raises ``ParameterFileError`` where lab.toml declares another rig than the design was made for,
    and what stands in the way of the first axis where none can ship, as ``LabFileError`` with
    the line to write for a tip whose guards are not declared.
    """
    declared = lab or Lab()
    if declared.rig_digest != design.rig_digest:
        raise ParameterFileError(
            f"{declared.place} declares another rig than the design was made for",
            needed="the converters, amplifiers and set point of the design",
            remedy="Run `piezoid design` again, then everything that follows it.",
        )
    shipped: list[AxisParameters] = []
    refused: dict[str, PiezoidError] = {}
    for axis in design.axes:
        try:
            shipped.append(_axis(model, axis, declared))
        except PiezoidError as refusal:
            refused[axis.axis] = refusal
    if not shipped:
        raise next(iter(refused.values()))
    unshipped = {name: str(refusal) for name, refusal in refused.items()}
    decoupling, decoupled = design.decoupling, None
    if decoupling is not None and {axis.axis for axis in shipped} & set(decoupling.axes):
        decoupled = Decoupled(axes=decoupling.axes, matrix=decoupling.matrix)
    return ParameterFile(
        name=model.stage,
        axes=tuple(shipped),
        sources={
            "model": design.model_digest,
            "design": design_digest,
            "lab": declared.digest,
            "control": declared.control_digest,
        },
        unshipped={**design.refused, **unshipped},
        decoupled=decoupled,
    )


def _axis(model: ActuatorModel, design: AxisDesign, lab: Lab) -> AxisParameters:
    specification = design.specification
    rate_Hz = design.recommended.members[0].sampling_rate_Hz
    if design.output_unit != "m":
        if model.tunnelling is None:
            raise ParameterFileError(
                f"axis {design.axis} regulates a current, and model.json has no junction",
                needed="the junction this controller was designed for",
                remedy="Fit again with the recordings of the tip.",
            )
        loop = loop_plant_of(model.tunnelling)
        return tunnelling_axis(design, tip_guards(lab, specification, rate_Hz, loop))
    watch = {
        "blind_samples": max(round(_BLIND_s * rate_Hz), 1),
        "stuck_samples": max(round(_STUCK_s * rate_Hz), 1),
        "stuck_voltage_V": _STUCK_SHARE
        * (specification.voltage_max_V - specification.voltage_min_V),
    }
    return lateral_axis(model[design.axis], design, watch)
