"""Simulate one axis under its compiled controller along any reference."""

from dataclasses import replace
from json import loads

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.design import Design
from piezoid.errors import ParameterFileError
from piezoid.export.export_stage import export_stage
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.records.lab import Lab
from piezoid.verification.closed_loop import LoopRecord, run_axis
from piezoid.verification.release import Shipping
from piezoid.verification.verify_stage import plant_of

Controller = Design | Shipping | ParameterFile


def parameters_of(controller: Controller, model: ActuatorModel, lab: Lab | None) -> ParameterFile:
    """Return the runtime parameters of a stage, or of a design even if it may not ship.

    Raises ``ParameterFileError`` where nothing of what was exported ships, and for anything else.
    """
    if isinstance(controller, ParameterFile):
        return controller
    if isinstance(controller, Shipping):
        if controller.parameters is None:
            reasons = "; ".join(f"axis {a}: {why}" for a, why in controller.reasons.items())
            raise ParameterFileError(
                f"nothing ships: {reasons}",
                needed="a controller that passed its verification",
                remedy="Read the reasons, or take .refused for study.",
            )
        return controller.parameters
    if not isinstance(controller, Design):
        raise ParameterFileError(
            f"a controller of type {type(controller).__name__}",
            needed="a Design, what export returned, or a ParameterFile",
            remedy="Pass the result of piezoid.design(model).",
        )
    digest = str(loads(controller.to_json())["digest"])
    return export_stage(model, controller, design_digest=digest, lab=lab)


def axis_parameters(
    controller: Controller, model: ActuatorModel, lab: Lab | None, axis: str | None
) -> AxisParameters:
    """Return the runtime parameters of one axis; None: the only one.

    Raises ``ParameterFileError`` for an axis without a controller.
    """
    file = parameters_of(controller, model, lab)
    if axis is None and len(file.axes) > 1:
        raise ParameterFileError(
            f"no axis named, there are controllers of {', '.join(a.axis for a in file.axes)}",
            needed="one axis",
            remedy="Name it, as in axis='x'.",
        )
    return file.axes[0] if axis is None else file.axis(axis)


def simulate_axis(
    model: ActuatorModel,
    controller: Controller,
    reference_m: ArrayLike,
    *,
    axis: str | None = None,
    lab: Lab | None = None,
    seed: int = 0,
) -> LoopRecord:
    """Run the compiled controller of one axis against the identified plant, from rest.

    controller   whose C is stepped, with the numbers that ship
    reference_m  (samples,)  m, as the sensor shows it; a tunnelling axis follows a current, A.
                 At the controller's rate
    axis         default: the only one there is
    lab          of the design
    seed         of the sensor's noise

    Raises ``ParameterFileError`` for an axis without a controller. What goes wrong: a reference
    outside the range the controller keeps is limited there, which ``status`` says.
    """
    parameters = axis_parameters(controller, model, lab, axis)
    reference = np.asarray(reference_m, dtype=np.float64)
    if reference.ndim != 1 or not len(reference) or not np.isfinite(reference).all():
        raise ParameterFileError(
            f"axis {parameters.axis}: a reference of shape {reference.shape}, "
            f"{int(np.sum(~np.isfinite(reference)))} of its numbers not finite",
            needed="one finite number for each sample, shape (samples,)",
            remedy="Pass the reference of one axis, in metres.",
        )
    plant = plant_of(parameters, model, lab or Lab())
    return run_axis(
        plant, replace(parameters, alternatives=()), reference, rng=np.random.default_rng(seed)
    )
