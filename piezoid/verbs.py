"""Verbs of ``import piezoid``: each takes records and returns one record.

``lab`` is the path of a lab.toml, a ``Lab`` or None. ``progress`` is called with one sentence
whenever a new step begins.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from piezoid.calibration import calibrate as pipeline
from piezoid.calibration.calibrate import Calibration
from piezoid.calibration.controllers import (
    Controllers,
    export_and_verify,
    verified_controllers,
)
from piezoid.design.design import Design
from piezoid.design.design_stage import SpecificationText, controller_rate_Hz, design_stage
from piezoid.diagnosis import diagnose as engine
from piezoid.diagnosis import experiment
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.experiment import Plan
from piezoid.errors import ParameterFileError, RecordingError
from piezoid.export.parameter_file import ParameterFile
from piezoid.identification import fit as identification
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.coupled.from_recordings import as_single_axes
from piezoid.identification.model import AxisModel
from piezoid.learning.learn import Learned, first_table, next_table, refuse_changed
from piezoid.numerics.executor import on_one_thread
from piezoid.raw_counts import errors_in_counts, refuse_counts, texts_in_counts
from piezoid.records import lab as laboratory
from piezoid.records.checks import refuse_unusable
from piezoid.records.collection import Collection, collect, collection_of
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording, counted_in
from piezoid.records.table import RawTable
from piezoid.sealed_files import Place, digest_of, path_of, sealed
from piezoid.verification.axis_simulation import (
    Controller,
    axis_parameters,
    parameters_of,
    simulate_axis,
)
from piezoid.verification.closed_loop import LoopRecord
from piezoid.verification.criteria import limits_from_toml
from piezoid.verification.plant import lateral_plant
from piezoid.verification.release import Shipping
from piezoid.verification.verification import Verification
from piezoid.verification.verify_stage import plant_of, verify_stage

Recordings = Recording | Collection | Iterable[Recording]
Progress = Callable[[str], None] | None


def read(*files: Place, lab: Lab | Place | None = None) -> Collection:
    """Read recordings of one stage from files of any supported format.

    files  paths; one file may hold several recordings
    lab    columns, units and sections to use

    Raises ``UnreadableFileError``, ``UnitError``, ``RecordingError`` or ``LabFileError`` for files
    that cannot be used. Conditions that do not prevent a fit are in each recording's
    ``statements``.

    >>> [recording.name for recording in piezoid.read("sweep.csv", "check.csv", lab="lab.toml")]
    ['sweep.csv', 'check.csv']
    """
    if not files:
        raise RecordingError(
            "no file is given",
            needed="one recording or more",
            remedy="Name its file, as in piezoid.read('sweep.csv').",
        )
    return collect([path_of(file) for file in files], _lab(lab))


def read_lab(path: Place) -> Lab:
    """Read a lab.toml; raise ``LabFileError`` with the line or table that cannot be used.

    >>> piezoid.read_lab("lab.toml").acquisition.dac_bits
    16
    """
    return laboratory.read_lab(path_of(path))


@on_one_thread
def fit(
    recordings: Recordings,
    *,
    lab: Lab | Place | None = None,
    sweeps: Sequence[RawTable] = (),
    responses: Sequence[FrequencyResponseRecord] = (),
    progress: Progress = None,
) -> ActuatorModel:
    """Fit the hysteresis and dynamics of every axis, and the junction of a tunnelling tip.

    recordings  of one stage
    sweeps      current against height, in addition to those of a ``Collection``
    responses   measured frequency responses, in addition to those of a ``Collection``

    Raises ``RecordingError`` for two recordings of the same name and ``ExcitationError`` if the
    recordings determine no model. If the model class does not apply, the model is returned with
    ``applies`` False.

    >>> fitted = piezoid.fit(recordings["sweep.csv"], lab="lab.toml")
    >>> fitted.applies, fitted["x"].quality.held_out_rms_percent < 1.0
    (True, True)
    """
    collection = collection_of(recordings)
    with errors_in_counts(counted_in(collection.recordings)):
        model = identification.fit(
            collection.recordings,
            lab=_lab(lab),
            sweeps=(*collection.sweeps, *sweeps),
            responses=(*collection.responses, *responses),
            progress=_callback(progress),
        )
    return replace(model, axes={n: texts_in_counts(axis) for n, axis in model.axes.items()})


@on_one_thread
def diagnose(
    recordings: Recordings,
    *,
    model: ActuatorModel | None = None,
    axis: str | None = None,
    lab: Lab | Place | None = None,
    threads: int = 1,
    progress: Progress = None,
) -> Diagnosis:
    """Find the effects that explain the error of a simulation with hysteresis alone, for one axis.

    model    fitted model, or None to fit the axis first; ``model.extended(diagnosis)`` contains
             the effects
    axis     default: the first
    threads  number of threads; the result does not depend on it

    Raises ``RecordingError`` if the recordings contradict each other and ``ExcitationError`` if
    drive or displacement does not move.

    >>> diagnosis = piezoid.diagnose(recordings["check.csv"], lab="lab.toml")
    >>> diagnosis.axis, diagnosis.model.axis
    ('x', 'x')
    """
    declared = _lab(lab)
    coupled = None if model is None else model.coupled
    axis_recordings = as_single_axes(collection_of(recordings).recordings, declared, coupled)
    refuse_unusable(axis_recordings)
    selected_axis = axis or (next(iter(model.axes), None) if model is not None else None)
    with errors_in_counts(counted_in(axis_recordings)):
        diagnosis = engine.diagnose(
            axis_recordings,
            axis=selected_axis,
            lab=declared,
            model=None if model is None else _axis_of(model, selected_axis, axis_recordings),
            progress=_callback(progress),
            threads=threads,
        )
    return texts_in_counts(diagnosis)


@on_one_thread
def plan(
    model: ActuatorModel,
    diagnosis: Diagnosis,
    *,
    lab: Lab | Place | None = None,
    recordings: Recordings = (),
    effect: str | None = None,
    clock_Hz: float | None = None,
    seed: int = 0,
) -> Plan:
    """Choose the drive of the next experiment: the one that best resolves an open question.

    recordings  the diagnosed ones, to compare the new drive with
    effect      effect to resolve; default: the least certain one
    clock_Hz    rate of the converters, if neither lab nor model states it
    seed        of the random drives

    Raises ``ExcitationError`` if no drive would show the effect.

    >>> next_drive = piezoid.plan(model, diagnosis, lab="lab.toml", clock_Hz=1000.0)
    >>> next_drive.drive.voltage_V.max() <= model["x"].voltage_V[1]
    np.True_
    """
    return experiment.plan(
        model,
        diagnosis,
        lab=_lab(lab),
        recordings=collection_of(recordings).recordings,
        effect=effect,
        clock_Hz=clock_Hz,
        seed=seed,
    )


@on_one_thread
def design(
    model: ActuatorModel,
    *,
    lab: Lab | Place | None = None,
    sampling_rate_Hz: float | None = None,
    specification: Place | None = None,
    progress: Progress = None,
) -> Design:
    """Design controllers with proven margins for every axis that is known well enough.

    sampling_rate_Hz  of the controller; default: as declared in lab.toml at the fit
    specification     path of a design.toml, which replaces defaults of the specification

    Raises ``TemplateError`` if no controller meets the specification and ``DesignError`` if too
    little is known about every axis.

    >>> [(axis.axis, axis.recommended.method) for axis in design.axes]
    [('x', 'mpi_dob')]
    """
    path = None if specification is None else path_of(specification)
    requested = None if path is None else SpecificationText(text=_text(path), source=path.name)
    return design_stage(
        model,
        model_digest=digest_of(model),
        sampling_rate_Hz=sampling_rate_Hz,
        lab=_lab(lab),
        asked=requested,
        progress=_callback(progress),
    )


@on_one_thread
def export(
    model: ActuatorModel,
    design: Design,
    *,
    lab: Lab | Place | None = None,
    threads: int = 1,
    progress: Progress = None,
) -> Shipping:
    """Convert a design into parameters for firmware, verify them, and keep the axes that pass.

    returned  ``parameters`` of the axes that ship, or None; ``verification``; ``reasons`` by axis
              why it does not ship

    Raises ``ParameterFileError`` if the design belongs to another model or lab.toml and
    ``LabFileError`` for a tunnelling tip without its limits of current.

    >>> shipping = piezoid.export(model, design, lab="lab.toml")
    >>> shipping.verification.passed, shipping.reasons
    (True, {})
    """
    if design.model_digest != digest_of(model):
        raise ParameterFileError(
            f"the design was made from the model {design.model_digest[:19]}..., this one is "
            f"{digest_of(model)[:19]}...",
            needed="the model from which the design was made",
            remedy="Design controllers for this model, or load the model of the design.",
        )
    return export_and_verify(
        model,
        design,
        design_digest=digest_of(design),
        lab=_lab(lab),
        progress=_callback(progress),
        threads=threads,
    )


@on_one_thread
def verify(
    parameters: ParameterFile | Shipping,
    model: ActuatorModel,
    *,
    lab: Lab | Place | None = None,
    limits: Place | None = None,
    seed: int = 0,
    threads: int = 1,
    design: Design | None = None,
    bounds: bool = False,
) -> Verification:
    """Simulate the compiled controller on the identified stage and compare it with all limits.

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
        parameters_of(parameters, model, _lab(lab)),
        model,
        lab=_lab(lab),
        limits=None if path is None else limits_from_toml(_text(path), path.name),
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
    lab: Lab | Place | None = None,
    seed: int = 0,
) -> LoopRecord:
    """Simulate the compiled controller on this stage, from rest in the middle of its range.

    reference_m  (samples,)  m in the coordinates of the sensor, at the sampling rate of the
                 controller; ``zero_m`` of an axis is near the middle of its range
    controller   ``Design``, result of ``export``, or ``ParameterFile``
    lab          of the design
    seed         of the sensor noise

    A reference beyond the range of the controller is limited; ``status`` then reports it.

    >>> reference_m = model["x"].zero_m + 1e-6 * np.sin(2e-3 * np.arange(8000))
    >>> loop = piezoid.simulate_loop(model, reference_m, design, lab="lab.toml")
    >>> loop.after(2000).rms_error < 50e-9
    True
    """
    return simulate_axis(model, controller, reference_m, axis=axis, lab=_lab(lab), seed=seed)


@on_one_thread
def learn(
    model: ActuatorModel,
    reference_m: ArrayLike,
    *,
    controller: Controller | None = None,
    axis: str | None = None,
    lab: Lab | Place | None = None,
    before: Learned | None = None,
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
    controller        the table is added to its output; None: the table is the whole voltage
    before, period    the last table, and the recording of the motion with it, from point 0 on
    sampling_rate_Hz  without a controller; default: as declared in lab.toml at the fit
    gain              learning gain relative to the optimum for the worst plant

    Raises ``DesignError`` if the learning filter does not contract, ``ParameterFileError`` if the
    reference exceeds range or slew rate, and ``RecordingError`` if the recording is not of this
    period, of another rate or of another reference.

    >>> phase = 2 * np.pi * np.arange(2000) / 2000
    >>> reference_m = model["x"].zero_m + 2e-6 * np.sin(phase)
    >>> table = piezoid.learn(model, reference_m, controller=shipping)
    >>> table.closed_loop, table.contraction < 1.0
    (True, True)
    """
    declared = _lab(lab)
    parameters = None if controller is None else axis_parameters(controller, model, declared, axis)
    axis_model = model[axis or (next(iter(model.axes)) if parameters is None else parameters.axis)]
    refuse_counts(axis_model.axis, axis_model.counted)
    sources = {"model": digest_of(model)}
    if parameters is None:
        rate_Hz = controller_rate_Hz(model, sampling_rate_Hz)
        plant = lateral_plant(axis_model, sampling_rate_Hz=rate_Hz)
    else:
        plant = plant_of(parameters, model, declared or Lab())
    if (before is None) != (period is None):
        raise RecordingError(
            f"{'no table' if before is None else 'no recording'} is given",
            needed="a recorded period and the table that was active during the recording",
            remedy="Pass both, or neither for the first table.",
        )
    if before is None or period is None:
        return first_table(
            axis_model, plant, reference_m, parameters=parameters, gain=gain, sources=sources
        )
    refuse_changed(before, reference_m, sources=sources, closed_loop=parameters is not None)
    return next_table(before, axis_model, plant, period, parameters=parameters)


def report(
    model: ActuatorModel,
    recordings: Recordings = (),
    *,
    diagnoses: Sequence[Diagnosis] = (),
    design: Design | None = None,
    shipping: Shipping | None = None,
    lab: Lab | Place | None = None,
) -> str:
    """Return the report of a stage as one self-contained HTML page.

    recordings  of the fit, for loops and residuals
    lab         of the fit
    diagnoses, design, shipping  sections of the report; those of None are left out

    >>> page = piezoid.report(model, recordings, diagnoses=[diagnosis])
    >>> page.startswith("<!DOCTYPE html>")
    True
    """
    missing = "no design was passed to the report." if design is None else ""
    controllers = Controllers(design=design, reason=missing)
    if shipping is not None:
        controllers = verified_controllers(design, shipping)
    records = {
        "model.json": model,
        "diagnosis.json": tuple(diagnoses) or None,
        "design.json": design,
        "verification.json": controllers.verification,
        "params.json": controllers.parameters,
    }
    text: str = _reports().report_of(
        model,
        collection_of(recordings),
        controllers,
        diagnoses=diagnoses,
        files={name: sealed(record) for name, record in records.items() if record is not None},
        lab=_lab(lab),
    )
    return text


@on_one_thread
def calibrate(
    recordings: Recordings | Place | Sequence[Place],
    *,
    lab: Lab | Place | None = None,
    threads: int = 1,
    progress: Progress = None,
) -> Calibration:
    """Fit, diagnose, design, verify and report a stage, as ``piezoid fit`` does.

    recordings  paths, or the result of ``read``
    returned    ``save(folder)`` writes all files, including ``report.html``

    >>> piezoid.calibrate("sweep.csv").model.applies
    True
    """
    declared = _lab(lab)
    collection = _collected(recordings, declared)
    calibration = pipeline.calibrate(collection, declared, _callback(progress), threads=threads)
    reported: Calibration = _reports().with_report(calibration, collection, declared)
    return reported


def _axis_of(model: ActuatorModel, axis: str | None, recordings: Sequence[Recording]) -> AxisModel:
    """Return one axis of the model; its initial states only if they belong to these recordings."""
    axis_model = model[axis or ""]
    is_same = all(model.sources.get(r.name) == r.digest for r in recordings)
    return axis_model if is_same else replace(axis_model, starts=())


def _collected(recordings: object, lab: Lab | None) -> Collection:
    files = recordings if isinstance(recordings, list | tuple) else [recordings]
    if files and isinstance(files[0], str | Path):
        return collect([path_of(file) for file in files], lab)
    return collection_of(recordings)


def _lab(given: object) -> Lab | None:
    return given if given is None or isinstance(given, Lab) else read_lab(path_of(given))


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8-sig")


def _callback(progress: Progress) -> Callable[[str], None]:
    return progress or (lambda _: None)


def _reports() -> Any:
    """Import the renderer of reports, which depends on this library."""
    return import_module("piezoid_reports.render")
