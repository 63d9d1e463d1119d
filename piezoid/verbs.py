"""The verbs of ``import piezoid``: each from records to one record, as the command line does it.

Wherever a ``lab`` is asked for, a path, a ``Lab`` or None will do. ``progress`` is told what is
being done, a sentence each time.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from piezoid.calibration import calibrate as whole_way
from piezoid.calibration.calibrate import Calibration
from piezoid.calibration.controllers import shipped
from piezoid.design.design import Design
from piezoid.design.design_stage import SpecificationText, controller_rate_Hz, design_stage
from piezoid.diagnosis import diagnose as engine
from piezoid.diagnosis import experiment
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.experiment import Plan
from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid.errors import ParameterFileError, RecordingError
from piezoid.export import parameter_file
from piezoid.export.parameter_file import ParameterFile
from piezoid.identification import fit as identification
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.coupled.from_recordings import as_single_axes
from piezoid.identification.model import AxisModel
from piezoid.identification.store import write_model
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
from piezoid.sealed_files import Place, digest_of, path_of
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
    """Read recordings of one stage, in any format ``piezoid inspect`` knows.

    files  paths; one file may hold several recordings
    lab    what the laboratory knows: columns, units, parts to use

    Raises ``UnreadableFileError``, ``UnitError``, ``RecordingError`` or ``LabFileError``; what is
    merely odd is in each recording's ``problems``.

    >>> [one.name for one in piezoid.read("sweep.csv", "check.csv", lab="lab.toml")]
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
    """Read a lab.toml; raises ``LabFileError`` with the line or table that cannot be used.

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
    """Fit hysteresis and dynamics of every axis, and the junction of a tunnelling tip.

    recordings  one or more of one stage
    sweeps      tables of the current over the height; a Collection brings its own
    responses   measured frequency responses; a Collection brings its own

    Raises ``RecordingError`` for two of one name, ``ExcitationError`` where nothing can be
    fitted. A model that does not apply is returned, and ``applies`` is False.

    >>> fitted = piezoid.fit(recordings["sweep.csv"], lab="lab.toml")
    >>> fitted.applies, fitted["x"].quality.held_out_rms_percent < 1.0
    (True, True)
    """
    held = collection_of(recordings)
    with errors_in_counts(counted_in(held.recordings)):
        model = identification.fit(
            held.recordings,
            lab=_lab(lab),
            sweeps=(*held.sweeps, *sweeps),
            responses=(*held.responses, *responses),
            progress=_told(progress),
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
    """Name what a simulation with hysteresis alone gets wrong about one axis, and how much.

    model    of a fit; ``model.extended(diagnosis)`` holds what was found. None: the axis is fitted
             first
    axis     default: the first
    threads  so many search; what they find does not depend on it

    Raises ``RecordingError`` where recordings do not fit each other, ``ExcitationError`` where
    nothing moves.

    >>> found = piezoid.diagnose(recordings["check.csv"], lab="lab.toml")
    >>> found.axis, found.model.axis
    ('x', 'x')
    """
    declared = _lab(lab)
    coupled = None if model is None else model.coupled
    held = as_single_axes(collection_of(recordings).recordings, declared, coupled)
    refuse_unusable(held)
    wanted = axis or (next(iter(model.axes), None) if model is not None else None)
    with errors_in_counts(counted_in(held)):
        diagnosis = engine.diagnose(
            held,
            axis=wanted,
            lab=declared,
            model=None if model is None else _known(model, wanted, held),
            progress=_told(progress),
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
    """Choose the drive of the next experiment, which tells best what a diagnosis left open.

    recordings  those that were diagnosed, to say how much better than now it will be
    effect      ask about this one; default: what was left most open
    clock_Hz    of the converters, where neither lab nor model says it
    seed        of what a drive leaves to chance

    Raises ``ExcitationError`` where no drive shows any of it.

    >>> next_drive = piezoid.plan(model, found, lab="lab.toml", clock_Hz=1000.0)
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
    """Design the controllers of a stage with proven margins, every axis of which enough is known.

    sampling_rate_Hz  of the controller; default: what lab.toml said at the fit
    specification     path of a design.toml: what is asked for, over the defaults

    Raises ``TemplateError`` where no controller meets what is asked, ``DesignError`` where too
    little is known of every axis.

    >>> [(axis.axis, axis.recommended.method) for axis in design.axes]
    [('x', 'mpi_dob')]
    """
    place = None if specification is None else path_of(specification)
    asked = None if place is None else SpecificationText(text=_text(place), source=place.name)
    return design_stage(
        model,
        model_digest=digest_of(model),
        sampling_rate_Hz=sampling_rate_Hz,
        lab=_lab(lab),
        asked=asked,
        progress=_told(progress),
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
    """Make what firmware needs of a design, run it against the stage, keep the axes that pass.

    returned  ``parameters`` that ship, None where none do; ``verification``; ``reasons`` by axis

    Raises ``ParameterFileError`` for a design of another model or rig, ``LabFileError`` for a tip
    without guards.

    >>> shipping = piezoid.export(model, design, lab="lab.toml")
    >>> shipping.verification.passed, shipping.reasons
    (True, {})
    """
    if design.model_digest != digest_of(model):
        raise ParameterFileError(
            f"the design was made from the model {design.model_digest[:19]}..., this one is "
            f"{digest_of(model)[:19]}...",
            needed="design and model of one another",
            remedy="Design the controllers of this model, or load the one of the design.",
        )
    return shipped(
        model,
        design,
        design_digest=digest_of(design),
        lab=_lab(lab),
        told=_told(progress),
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
    """Run the compiled controller against the stage in every scenario, and judge what happens.

    parameters  what ``export`` returned, or a ParameterFile
    limits      path of a limits.toml; default: those of [verification] in lab.toml
    seed        of sensor noise and drawn stages
    design      that was exported; needed for bounds
    bounds      bound the largest errors as well

    >>> piezoid.verify(shipping, model, lab="lab.toml", seed=1).passed
    True
    """
    place = None if limits is None else path_of(limits)
    return verify_stage(
        parameters_of(parameters, model, _lab(lab)),
        model,
        lab=_lab(lab),
        limits=None if place is None else limits_from_toml(_text(place), place.name),
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
    """Run the compiled controller against this stage, from rest in the middle of its range.

    reference_m  (samples,)  m, as the sensor shows it, at the controller's rate; ``zero_m``
                 of an axis is about the middle
    controller   a Design, what ``export`` returned, or a ParameterFile
    lab          a path or a Lab, of the design
    seed         of the sensor's noise

    What goes wrong: a reference outside the range the controller keeps is limited there, which
    ``status`` says.

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
    """Learn the drive of a periodic motion: from the model first, then from each recorded period.

        f <- f + Q L E,   max |1 - Q L G| + rho max |Q L G| < 1 on every plant of the family

    E is the error of the recorded period, G what a volt of the table moves, rho half the width of
    the hysteresis' slope sector over its middle [Norrlof & Gunnarsson 2002].

    reference_m       (points,)  one period, m, at the controller's rate
    controller        the table goes on top of it; None: the table is all of the voltage
    before, period    the table that was played, and what was recorded then, point 0 first
    sampling_rate_Hz  without a controller; default: what lab.toml said at the fit
    gain              of learning, over the best for the worst plant

    Raises ``DesignError`` for a learning filter that does not contract, ``ParameterFileError``
    for a reference beyond range or slew, ``RecordingError`` for a recording that is not the
    period, of another rate, or with a changed reference.

    >>> turns = 2 * np.pi * np.arange(2000) / 2000
    >>> wanted_m = model["x"].zero_m + 2e-6 * np.sin(turns)
    >>> table = piezoid.learn(model, wanted_m, controller=shipping)
    >>> table.closed_loop, table.contraction < 1.0
    (True, True)
    """
    declared = _lab(lab)
    own = None if controller is None else axis_parameters(controller, model, declared, axis)
    known = model[axis or (next(iter(model.axes)) if own is None else own.axis)]
    refuse_counts(known.axis, known.counted)
    sources = {"model": digest_of(model)}
    if own is None:
        asked_Hz = controller_rate_Hz(model, sampling_rate_Hz)
        plant = lateral_plant(known, sampling_rate_Hz=asked_Hz)
    else:
        plant = plant_of(own, model, declared or Lab())
    if (before is None) != (period is None):
        raise RecordingError(
            f"{'no table' if before is None else 'no recording'} is given",
            needed="a recorded period and the table that was played then",
            remedy="Pass both, or neither for the first table.",
        )
    if before is None or period is None:
        return first_table(known, plant, reference_m, parameters=own, gain=gain, sources=sources)
    refuse_changed(before, reference_m, sources=sources, closed_loop=own is not None)
    return next_table(before, known, plant, period, parameters=own)


def report(
    model: ActuatorModel,
    recordings: Recordings = (),
    *,
    diagnoses: Sequence[Diagnosis] = (),
    design: Design | None = None,
    shipping: Shipping | None = None,
    lab: Lab | Place | None = None,
) -> str:
    """Return the page of a stage, HTML in one piece, with what is at hand.

    recordings  those of the fit, to draw loops and residuals

    >>> page = piezoid.report(model, recordings, diagnoses=[found])
    >>> page.startswith("<!DOCTYPE html>")
    True
    """
    held = collection_of(recordings)
    files = {"model.json": write_model(model)}
    if diagnoses:
        files["diagnosis.json"] = write_diagnosis(diagnoses[0], others=diagnoses[1:])
    if design is not None:
        files["design.json"] = design.to_json()
    unshipped: Mapping[str, str] = {} if design is None else design.refused
    if shipping is not None:
        files["verification.json"] = shipping.verification.to_json()
        unshipped = shipping.reasons
        if shipping.parameters is not None:
            files["params.json"] = parameter_file.to_json(shipping.parameters)
            unshipped = shipping.parameters.unshipped
    page: str = _reports().render(
        model,
        held.recordings,
        held.sweeps,
        design,
        "" if design is not None else "no design was passed to the report.",
        diagnoses=tuple(diagnoses),
        verification=None if shipping is None else shipping.verification,
        unshipped=unshipped,
        files=files,
        lab=_lab(lab),
        responses=held.responses,
    )
    return page


@on_one_thread
def calibrate(
    recordings: Recordings | Place | Sequence[Place],
    *,
    lab: Lab | Place | None = None,
    threads: int = 1,
    progress: Progress = None,
) -> Calibration:
    """Do all of it, as ``piezoid fit`` does: model, diagnoses, controllers, verification, report.

    recordings  paths, or what ``read`` returned
    returned    ``save(folder)`` writes every file, ``report.html`` among them

    >>> piezoid.calibrate("sweep.csv").model.applies
    True
    """
    declared = _lab(lab)
    held = _collected(recordings, declared)
    found = whole_way.calibrate(held, declared, _told(progress), threads=threads)
    made: Calibration = _reports().with_report(found, held, declared)
    return made


def _known(model: ActuatorModel, axis: str | None, held: Sequence[Recording]) -> AxisModel:
    """Return an axis, without the memory of recordings other than these."""
    known = model[axis or ""]
    own = all(model.sources.get(recording.name) == recording.digest for recording in held)
    return known if own else replace(known, starts=())


def _collected(given: object, lab: Lab | None) -> Collection:
    if isinstance(given, str | Path):
        return collect([path_of(given)], lab)
    if isinstance(given, list | tuple) and given and isinstance(given[0], str | Path):
        return collect([path_of(one) for one in given], lab)
    return collection_of(given)


def _lab(given: object) -> Lab | None:
    return given if given is None or isinstance(given, Lab) else read_lab(path_of(given))


def _text(place: Path) -> str:
    return place.read_text(encoding="utf-8-sig")


def _told(progress: Progress) -> Callable[[str], None]:
    return progress or (lambda _: None)


def _reports() -> Any:
    """Return what renders reports, which stand on this library and not under it."""
    return import_module("piezoid_reports.render")
