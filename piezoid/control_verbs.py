"""Verbs of ``import piezoid`` for controllers: each takes records and returns one record.

``lab`` is the path of a lab.toml, a ``Lab`` or None. ``progress`` is called with one sentence
at the start of each step.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from piezoid.calibration.controllers import export_and_verify
from piezoid.design.design import Design
from piezoid.design.design_stage import SpecificationText, controller_rate_Hz, design_stage
from piezoid.errors import ParameterFileError, RecordingError
from piezoid.export.export_stage import export_stage
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.learning.learn import Learned, first_table, next_table, refuse_changed
from piezoid.numerics.executor import on_one_thread
from piezoid.raw_counts import refuse_counts
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from piezoid.sealed_files import FilePath, digest_of, lab_of, path_of
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.criteria import limits_from_toml
from piezoid.verification.plant import lateral_plant
from piezoid.verification.tracking import LoopRecord
from piezoid.verification.verification import Verification
from piezoid.verification.verify_stage import Shipping, plant_of, verify_stage

Progress = Callable[[str], None] | None
Controller = Design | Shipping | ParameterFile


@on_one_thread
def design(
    model: ActuatorModel,
    *,
    lab: Lab | FilePath | None = None,
    sampling_rate_Hz: float | None = None,
    specification: FilePath | None = None,
    progress: Progress = None,
) -> Design:
    """Design controllers with proven margins for every axis with sufficient recordings.

    sampling_rate_Hz  of the controller; default: as declared in lab.toml at the fit
    specification     path of a design.toml, which replaces defaults of the specification

    Raises ``TemplateError`` if no controller meets the specification and ``DesignError`` if the
    recordings are insufficient for every axis.

    >>> [(axis.axis, axis.recommended.method) for axis in design.axes]
    [('x', 'mpi_dob')]
    """
    path = None if specification is None else path_of(specification)
    requested = (
        None
        if path is None
        else SpecificationText(text=path.read_text(encoding="utf-8-sig"), source=path.name)
    )
    return design_stage(
        model,
        model_digest=digest_of(model),
        sampling_rate_Hz=sampling_rate_Hz,
        lab=lab_of(lab),
        requested=requested,
        progress=progress or (lambda _: None),
    )


@on_one_thread
def export(
    model: ActuatorModel,
    design: Design,
    *,
    lab: Lab | FilePath | None = None,
    threads: int = 1,
    progress: Progress = None,
) -> Shipping:
    """Convert a design into parameters for firmware, verify them, and keep the axes that pass.

    returned  ``parameters`` of the axes that ship, or None; ``verification``; ``reasons`` of each
              axis that does not ship

    Raises ``ParameterFileError`` if the design belongs to another model or lab.toml and
    ``LabFileError`` for a tunnelling tip without current limits.

    >>> shipping = piezoid.export(model, design, lab="lab.toml")
    >>> shipping.verification.passed, shipping.reasons
    (True, {})
    """
    if design.model_digest != digest_of(model):
        raise ParameterFileError(
            f"the design was made from the model {design.model_digest[:19]}..., but this model is "
            f"{digest_of(model)[:19]}...",
            needed="the model from which the design was made",
            remedy="Design controllers for this model, or load the model of the design.",
        )
    return export_and_verify(
        model,
        design,
        design_digest=digest_of(design),
        lab=lab_of(lab),
        progress=progress or (lambda _: None),
        threads=threads,
    )


@on_one_thread
def verify(
    parameters: ParameterFile | Shipping,
    model: ActuatorModel,
    *,
    lab: Lab | FilePath | None = None,
    limits: FilePath | None = None,
    seed: int = 0,
    threads: int = 1,
    design: Design | None = None,
    bounds: bool = False,
) -> Verification:
    """Simulate the compiled controller on the identified stage and check all limits.

    parameters  result of ``export``, or a ``ParameterFile``
    limits      path of a limits.toml; default: [verification] of lab.toml
    seed        of sensor noise and simulated stages
    design      the exported design; required for ``bounds``
    bounds      also bound the largest error

    >>> piezoid.verify(shipping, model, lab="lab.toml", seed=1).passed
    True
    """
    path = None if limits is None else path_of(limits)
    return verify_stage(
        _parameters_of(parameters, model, lab_of(lab)),
        model,
        lab=lab_of(lab),
        limits=None
        if path is None
        else limits_from_toml(path.read_text(encoding="utf-8-sig"), path.name),
        seed=seed,
        threads=threads,
        design=design,
        bounds=bounds,
    )


def simulate_loop(
    model: ActuatorModel,
    reference_m: ArrayLike,
    controller: Controller,
    *,
    axis: str | None = None,
    lab: Lab | FilePath | None = None,
    seed: int = 0,
) -> LoopRecord:
    """Simulate the compiled controller on the identified stage, from rest at mid-range.

    reference_m  (samples,)  m in the coordinates of the sensor, at the sampling rate of the
                 controller; ``zero_m`` of an axis is near the middle of its range
    controller   ``Design``, result of ``export``, or ``ParameterFile``
    axis         default: the only axis; for a tunnelling axis the reference is a current, A
    lab          of the design
    seed         of the sensor noise

    A reference outside the range of the controller is limited, and ``status`` reports it. Raises
    ``ParameterFileError`` for an axis without a controller.

    >>> reference_m = model["x"].zero_m + 1e-6 * np.sin(2e-3 * np.arange(8000))
    >>> loop = piezoid.simulate_loop(model, reference_m, design, lab="lab.toml")
    >>> loop.after(2000).rms_error < 50e-9
    True
    """
    declared = lab_of(lab)
    parameters = _axis_parameters(controller, model, declared, axis)
    reference = np.asarray(reference_m, dtype=np.float64)
    if reference.ndim != 1 or not len(reference) or not np.isfinite(reference).all():
        raise ParameterFileError(
            f"axis {parameters.axis}: a reference of shape {reference.shape} with "
            f"{int(np.sum(~np.isfinite(reference)))} numbers that are not finite",
            needed="one finite number for each sample, shape (samples,)",
            remedy="Pass the reference of one axis, in metres.",
        )
    return run_axis(
        plant_of(parameters, model, declared or Lab()),
        replace(parameters, alternatives=()),
        reference,
        rng=np.random.default_rng(seed),
    )


@on_one_thread
def learn(
    model: ActuatorModel,
    reference_m: ArrayLike,
    *,
    controller: Controller | None = None,
    axis: str | None = None,
    lab: Lab | FilePath | None = None,
    previous: Learned | None = None,
    period: Recording | None = None,
    sampling_rate_Hz: float | None = None,
    gain: float = 1.0,
) -> Learned:
    """Compute a feedforward table for a periodic motion, and refine it from recorded periods.

        f <- f + Q L E,   max |1 - Q L G| + rho max |Q L G| < 1 on every plant of the family

    f is the table, E the error of the recorded period, G the displacement per volt of the table,
    and rho half the width of the slope sector of the hysteresis over its middle
    [Norrlof & Gunnarsson 2002].

    reference_m       (points,)  one period, m, at the sampling rate of the controller
    controller        its output is added to the table; None: the table is the total voltage
    previous, period  previous table, and the motion recorded with it, starting at point 0
    sampling_rate_Hz  without a controller; default: as declared in lab.toml at the fit
    gain              learning gain relative to the optimum for the worst plant

    Raises ``DesignError`` if the learning filter does not contract, ``ParameterFileError`` if the
    reference exceeds range or slew rate, and ``RecordingError`` if the recording has another
    period, sampling rate or reference.

    >>> phase = 2 * np.pi * np.arange(2000) / 2000
    >>> reference_m = model["x"].zero_m + 2e-6 * np.sin(phase)
    >>> table = piezoid.learn(model, reference_m, controller=shipping)
    >>> table.closed_loop, table.contraction < 1.0
    (True, True)
    """
    declared = lab_of(lab)
    parameters = (
        None if controller is None else _axis_parameters(controller, model, declared, axis)
    )
    axis_model = model[axis or (next(iter(model.axes)) if parameters is None else parameters.axis)]
    refuse_counts(axis_model.axis, axis_model.counted)
    sources = {"model": digest_of(model)}
    if parameters is None:
        rate_Hz = controller_rate_Hz(model, sampling_rate_Hz)
        plant = lateral_plant(axis_model, sampling_rate_Hz=rate_Hz)
    else:
        plant = plant_of(parameters, model, declared or Lab())
    if (previous is None) != (period is None):
        raise RecordingError(
            f"{'no table' if previous is None else 'no recording'} is given",
            needed="a recorded period and the table that was active during the recording",
            remedy="Pass both, or neither for the first table.",
        )
    if previous is None or period is None:
        return first_table(
            axis_model, plant, reference_m, parameters=parameters, gain=gain, sources=sources
        )
    refuse_changed(previous, reference_m, sources=sources, closed_loop=parameters is not None)
    return next_table(previous, axis_model, plant, period, parameters=parameters)


def _axis_parameters(
    controller: Controller, model: ActuatorModel, lab: Lab | None, axis: str | None
) -> AxisParameters:
    """Return the runtime parameters of an axis; None selects the only axis."""
    file = _parameters_of(controller, model, lab)
    if axis is None and len(file.axes) > 1:
        raise ParameterFileError(
            f"no axis named; there are controllers for {', '.join(a.axis for a in file.axes)}",
            needed="one axis",
            remedy="Name the axis, as in axis='x'.",
        )
    return file.axes[0] if axis is None else file.axis(axis)


def _parameters_of(controller: Controller, model: ActuatorModel, lab: Lab | None) -> ParameterFile:
    """Return the runtime parameters in a controller record; a design need not be verified."""
    if isinstance(controller, ParameterFile):
        return controller
    if isinstance(controller, Shipping):
        if controller.parameters is None:
            reasons = "; ".join(f"axis {a}: {why}" for a, why in controller.reasons.items())
            raise ParameterFileError(
                f"no controller ships: {reasons}",
                needed="a controller that passed its verification",
                remedy="Read the reasons, or examine .refused.",
            )
        return controller.parameters
    if not isinstance(controller, Design):
        raise ParameterFileError(
            f"a controller of type {type(controller).__name__}",
            needed="a Design, the result of export, or a ParameterFile",
            remedy="Pass the result of piezoid.design(model).",
        )
    return export_stage(model, controller, design_digest=digest_of(controller), lab=lab)
