"""Verbs of ``import piezoid`` for recordings and models: each returns one record.

``lab`` is the path of a lab.toml, a ``Lab`` or None. ``progress`` is called with one sentence
at the start of each step.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from piezoid.calibration import calibrate as pipeline
from piezoid.calibration.calibrate import Calibration
from piezoid.calibration.controllers import Controllers, verified_controllers
from piezoid.design.design import Design
from piezoid.diagnosis import diagnose as engine
from piezoid.diagnosis import experiment
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.experiment import Plan
from piezoid.errors import RecordingError
from piezoid.identification import fit as identification
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.coupled.from_recordings import as_single_axes
from piezoid.numerics.executor import on_one_thread
from piezoid.raw_counts import errors_in_counts, texts_in_counts
from piezoid.records import lab as laboratory
from piezoid.records.checks import refuse_unusable
from piezoid.records.collection import Collection, collect, collection_of
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording, counted_in
from piezoid.records.table import RawTable
from piezoid.sealed_files import FilePath, lab_of, path_of, sealed
from piezoid.verification.verify_stage import Shipping

Recordings = Recording | Collection | Iterable[Recording]
Progress = Callable[[str], None] | None


def read(*files: FilePath, lab: Lab | FilePath | None = None) -> Collection:
    """Read recordings of one stage from files of any supported format.

    files  paths; one file may hold several recordings
    lab    columns, units and sections to use

    Raises ``UnreadableFileError``, ``UnitError``, ``RecordingError`` or ``LabFileError`` for files
    that cannot be used. Problems that do not prevent a fit are in the ``statements`` of each
    recording.

    >>> [recording.name for recording in piezoid.read("sweep.csv", "check.csv", lab="lab.toml")]
    ['sweep.csv', 'check.csv']
    """
    if not files:
        raise RecordingError(
            "no file is given",
            needed="one recording or more",
            remedy="Name a file, as in piezoid.read('sweep.csv').",
        )
    return collect([path_of(file) for file in files], lab_of(lab))


def read_lab(path: FilePath) -> Lab:
    """Read a lab.toml; raise ``LabFileError`` with the line or table that cannot be used.

    >>> piezoid.read_lab("lab.toml").acquisition.dac_bits
    16
    """
    return laboratory.read_lab(path_of(path))


@on_one_thread
def fit(
    recordings: Recordings,
    *,
    lab: Lab | FilePath | None = None,
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
            lab=lab_of(lab),
            sweeps=(*collection.sweeps, *sweeps),
            responses=(*collection.responses, *responses),
            progress=progress or (lambda _: None),
        )
    return replace(model, axes={n: texts_in_counts(axis) for n, axis in model.axes.items()})


@on_one_thread
def diagnose(
    recordings: Recordings,
    *,
    model: ActuatorModel | None = None,
    axis: str | None = None,
    lab: Lab | FilePath | None = None,
    threads: int = 1,
    progress: Progress = None,
) -> Diagnosis:
    """Find the effects that explain the error of hysteresis alone on one axis.

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
    declared = lab_of(lab)
    coupled = None if model is None else model.coupled
    axis_recordings = as_single_axes(collection_of(recordings).recordings, declared, coupled)
    refuse_unusable(axis_recordings)
    selected_axis = axis or (next(iter(model.axes), None) if model is not None else None)
    axis_model = None
    if model is not None:
        axis_model = model[selected_axis or ""]
        if any(model.sources.get(r.name) != r.digest for r in axis_recordings):
            axis_model = replace(axis_model, starts=())  # initial states are of other recordings
    with errors_in_counts(counted_in(axis_recordings)):
        diagnosis = engine.diagnose(
            axis_recordings,
            axis=selected_axis,
            lab=declared,
            model=axis_model,
            progress=progress or (lambda _: None),
            threads=threads,
        )
    return texts_in_counts(diagnosis)


@on_one_thread
def plan(
    model: ActuatorModel,
    diagnosis: Diagnosis,
    *,
    lab: Lab | FilePath | None = None,
    recordings: Recordings = (),
    effect: str | None = None,
    clock_Hz: float | None = None,
    seed: int = 0,
) -> Plan:
    """Choose the drive of the next experiment, which best resolves an open question.

    recordings  of the diagnosis, to compare the new drive with
    effect      effect to resolve; default: the least certain effect
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
        lab=lab_of(lab),
        recordings=collection_of(recordings).recordings,
        effect=effect,
        clock_Hz=clock_Hz,
        seed=seed,
    )


def report(
    model: ActuatorModel,
    recordings: Recordings = (),
    *,
    diagnoses: Sequence[Diagnosis] = (),
    design: Design | None = None,
    shipping: Shipping | None = None,
    lab: Lab | FilePath | None = None,
) -> str:
    """Return the report of a stage as one self-contained HTML page.

    recordings  of the fit, for loops and residuals
    lab         of the fit
    diagnoses, design, shipping  contents of sections; None omits the section

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
    calibration = Calibration(
        model=model,
        diagnoses=tuple(diagnoses),
        undiagnosed=(),
        controllers=controllers,
        has_crashed=False,
        files={name: sealed(record) for name, record in records.items() if record is not None},
    )
    reported = _with_report(calibration, collection_of(recordings), lab_of(lab))
    return reported.files["report.html"].decode()


@on_one_thread
def calibrate(
    recordings: Recordings | FilePath | Sequence[FilePath],
    *,
    lab: Lab | FilePath | None = None,
    threads: int = 1,
    progress: Progress = None,
) -> Calibration:
    """Fit, diagnose, design, verify and report a stage, as ``piezoid fit`` does.

    recordings  paths, or the result of ``read``
    returned    ``save(folder)`` writes all files, including ``report.html``

    >>> piezoid.calibrate("sweep.csv").model.applies
    True
    """
    declared = lab_of(lab)
    files = recordings if isinstance(recordings, list | tuple) else [recordings]
    if files and isinstance(files[0], str | Path):
        collection = collect([path_of(file) for file in files], declared)
    else:
        collection = collection_of(recordings)
    calibration = pipeline.calibrate(
        collection, declared, progress or (lambda _: None), threads=threads
    )
    return _with_report(calibration, collection, declared)


def _with_report(calibration: Calibration, collection: Collection, lab: Lab | None) -> Calibration:
    """Add the report, whose room depends on this library."""
    reports = import_module("piezoid_reports.render")
    reported: Calibration = reports.with_report(calibration, collection, lab)
    return reported
