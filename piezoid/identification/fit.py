"""Fit one ActuatorModel of the whole stage to recordings."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.errors import ExcitationError, RecordingError
from piezoid.identification.actuator_model import ActuatorModel, SourceFile
from piezoid.identification.coupled.from_recordings import (
    as_single_axes,
    decoupled_responses,
    driven_axes,
    identify_coupled,
)
from piezoid.identification.discrepancy import with_discrepancy
from piezoid.identification.dynamics.axis_dynamics import quasi_static, with_dynamics
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.loop_shape_fit import with_loop_shape
from piezoid.identification.minor_loops_fit import with_minor_loops
from piezoid.identification.model import AxisModel
from piezoid.identification.tunnelling.junction import fit_junction, remarks_on_currents
from piezoid.identification.tunnelling.loop_files import is_loop
from piezoid.records.checks import check_set, refuse_unusable
from piezoid.records.checks.command_range import MAY_BE_HIGH_VOLTAGE
from piezoid.records.checks.consistency import MIN_RANGE, copies
from piezoid.records.checks.joined_recordings import JOINED
from piezoid.records.checks.plausibility import is_held_throughout
from piezoid.records.clock import CONTROLLER_RATE
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording, counted_in
from piezoid.records.table import RawTable


def fit(
    recordings: Sequence[Recording],
    *,
    lab: Lab | None = None,
    sweeps: Sequence[RawTable] = (),
    responses: Sequence[FrequencyResponseRecord] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> ActuatorModel:
    """Fit every axis that has a drive and a displacement, and the junction of a tunnelling tip.

    recordings  of one stage with any number of axes, each with a name of its own
    lab         declarations of the laboratory; declared poles are not fitted
    sweeps      Z spectroscopies: the current over the height
    responses   measured frequency responses, from which the dynamics of their axes are fitted
    progress    called with a message at the beginning of each step

    Raises ``RecordingError`` for a duplicate name, and ``ExcitationError`` if no recording has
    both a drive and a displacement and there are neither sweeps nor closed loops.
    """

    def progress_of(axis: str) -> Callable[[str], None]:
        return lambda text: progress(f"axis {axis}: {text}")

    declared = lab or Lab()
    inputs = prepare_fit(recordings, declared, sweeps, responses, progress=progress)
    progress("fitting the tunnelling current")
    tunnelling = fit_junction(sweeps, inputs.recordings, declared)
    axes = {
        axis: fit_axis(
            inputs.recordings,
            axis,
            declared,
            response=response_of(inputs.responses, axis, inputs.axes),
            progress=progress_of(axis),
        )
        for axis in inputs.axes
    }
    return replace(inputs.stage, axes=axes, tunnelling=tunnelling)


@dataclass(frozen=True, kw_only=True)
class FitInputs:
    """Inputs of the fits of all axes.

    stage       model without axes; with the model of the coupling if axes are coupled
    recordings  of single axes, in decoupled coordinates
    responses   measured frequency responses, including those of decoupled axes
    axes        to be fitted; a coupled axis without a drive in these recordings is not
    """

    stage: ActuatorModel
    recordings: Sequence[Recording]
    responses: Sequence[FrequencyResponseRecord]
    axes: tuple[str, ...]


def prepare_fit(
    recordings: Sequence[Recording],
    lab: Lab,
    sweeps: Sequence[RawTable],
    responses: Sequence[FrequencyResponseRecord],
    *,
    progress: Callable[[str], None],
) -> FitInputs:
    """Identify the coupling if lab.toml names coupled axes, and separate the data of single axes.

    Raises as ``unfitted_stage`` and ``identify_coupled`` do.
    """
    coupled = identify_coupled(recordings, lab, progress=progress)
    if coupled is None:
        stage = unfitted_stage(recordings, lab, sweeps, responses)
        axes = axes_of(recordings)
        return FitInputs(stage=stage, recordings=recordings, responses=responses, axes=axes)
    single = as_single_axes(recordings, lab, coupled)
    if axes_of(single) or sweeps:
        stage = unfitted_stage(single, lab, sweeps, responses)
    else:  # no hysteresis is fitted to the recordings: remarks on their loops do not matter
        stage = replace(unfitted_stage(recordings, lab, sweeps, responses), remarks=())
    driven = {axis for recording in single for axis in driven_axes(recording, coupled.inputs)}
    axes = tuple(a for a in axes_of(single) if a in driven or a not in coupled.inputs)
    remarks = tuple(
        f"axis {axis}: it is driven only together with the other coupled axes, by periodic "
        "drives; these identify the coupling but not its hysteresis. Record a slow sweep of "
        f"{axis} over its range, the other axes at rest, to get its hysteresis and a controller."
        for axis in coupled.outputs
        if axis not in axes
    )
    return FitInputs(
        stage=replace(
            stage,
            coupled=coupled,
            sources={r.name: r.digest for r in recordings} | dict(stage.sources),
            remarks=(*stage.remarks, *remarks),
        ),
        recordings=single,
        responses=(*responses, decoupled_responses(recordings, coupled, lab.coupled)),
        axes=axes,
    )


def unfitted_stage(
    recordings: Sequence[Recording],
    lab: Lab,
    sweeps: Sequence[RawTable] = (),
    responses: Sequence[FrequencyResponseRecord] = (),
) -> ActuatorModel:
    """Return a stage without axes and junction, with the remarks on its recordings.

    Raises ``ExcitationError`` as ``fit`` does, and ``RecordingError`` for recordings that
    contradict each other.
    """
    refuse_duplicate_names(recordings, sweeps, responses)
    refuse_unusable_responses(recordings, responses)
    refuse_unusable(recordings)
    statements = check_set(recordings)
    if not axes_of(recordings) and not sweeps and not any(map(is_loop, recordings)):
        raise missing_channels_error(
            recordings,
            "a drive voltage and a displacement of the same axis, or the drive, current "
            "and reference of a tunnelling loop",
        )
    files: list[SourceFile] = [*recordings, *sweeps, *responses]
    remarked = {statement.recording for statement in statements}
    unremarked = [file for file in files if file.name not in remarked] or files
    return ActuatorModel(
        stage=lab.name or unremarked[0].name.partition(".")[0],
        axes={},
        sources={file.name: file.digest for file in files},
        lab=lab.digest or None,
        tunnelling=None,
        remarks=(
            *remarks_on_currents(recordings),
            *(s.text for s in statements),
            # A loop of a tip is recorded at every tick of its controller.
            *remarks_about([r for r in recordings if not is_loop(r)], CONTROLLER_RATE),
            *remarks_about(recordings, MAY_BE_HIGH_VOLTAGE),
            *remarks_about(recordings, JOINED),
            *(() if lab.coupled.axes else remarks_about(recordings, "coupled_drives")[:1]),
        ),
        controller_rate_Hz=lab.acquisition.sampling_rate_Hz,
    )


def remarks_about(recordings: Sequence[Recording], quantity: str) -> tuple[str, ...]:
    """Return the texts of the statements about one quantity, each with its recording."""
    return tuple(
        f"{recording.name}: {statement.text}"
        for recording in recordings
        for statement in recording.statements
        if statement.quantity == quantity
    )


def response_of(
    responses: Sequence[FrequencyResponseRecord], axis: str, axes: Sequence[str]
) -> FrequencyResponseRecord | None:
    """Return the response of an axis to its own drive, under the name of the axis.

    A response that names no axis belongs to the only axis of a stage.
    """
    matching = [r for r in responses if axis in r.axes and (r.axis_is_named or axes == (axis,))]
    if matching:
        return matching[0]
    nameless = [r for r in responses if not r.axis_is_named] if len(axes) == 1 else []
    return nameless[0].renamed(axis) if nameless else None


def refuse_unusable_responses(
    recordings: Sequence[Recording], responses: Sequence[FrequencyResponseRecord]
) -> None:
    """Refuse responses of an axis without a recording, without a name, or of one axis twice."""
    axes = axes_of(recordings)
    names_by_response = [r.axes if r.axis_is_named else axes[:1] for r in responses]
    for response, names in zip(responses, names_by_response, strict=True):
        if not axes or not set(names) & set(axes):
            of = f" of axis {', '.join(names)}" if names else ""
            raise ExcitationError(
                f"{response.name}: a frequency response{of}, and no recording{of} over time shows "
                "its hysteresis",
                needed="also a slow sweep over the whole range: a response at one small drive "
                "shows modes and delay, but no loop",
                remedy="Add a sweep, or show the contents of the response with piezoid inspect.",
            )
        if not response.axis_is_named and len(axes) > 1:
            raise RecordingError(
                f"{response.name}: a frequency response that names no axis, with recordings of "
                f"{', '.join(axes)}",
                needed="the axis that was driven and measured",
                remedy="Write into lab.toml:\n\n[[recording]]\n"
                f'file = "{response.name}"\naxis = "..."\n',
            )
    counts = Counter(axis for names in names_by_response for axis in names)
    duplicates = [axis for axis, count in counts.items() if count > 1]
    if duplicates:
        listed = ", ".join(response.name for response in responses)
        raise RecordingError(
            f"{listed}: more than one frequency response of axis {', '.join(duplicates)}",
            needed="one response of each axis",
            remedy="Keep the response to the smallest drive that is still coherent.",
        )


def missing_channels_error(recordings: Sequence[Recording], needed: str) -> ExcitationError:
    """Return the error for recordings without the channels that are needed."""
    listed = sorted({c.quantity.name.lower() for r in recordings for c in r.channels})
    names = ", ".join(r.name for r in recordings) or "no recording over time"
    return ExcitationError(
        f"{names}: only {', '.join(listed)} is recorded" if listed else f"{names} is given",
        needed=needed,
        remedy="Record both, or name the columns in lab.toml.",
    )


def fit_axis(
    recordings: Sequence[Recording],
    axis: str,
    lab: Lab,
    *,
    response: FrequencyResponseRecord | None = None,
    has_loop_shape: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> AxisModel:
    """Fit one axis: its hysteresis, then its dynamics where a recording excites them.

    recordings  any; recordings without drive and displacement of the axis are ignored. Recordings
                dominated by a mode are used for the dynamics only, unless there are no others
    response    measured frequency response of the axis, from which the dynamics are then fitted
    has_loop_shape  whether loop shape is fitted; a diagnosis fits it to the extended model

    Raises ``ExcitationError`` if drive or displacement is constant.
    """
    rig = rig_of(lab, axis)
    slow, resonant = quasi_static(driven_recordings(recordings, axis), axis, rig)
    static_model = estimate_axis(slow, axis, rig, progress=progress)
    model = with_dynamics(
        static_model, recordings, stated_Hz=lab.actuator_of(axis).bandwidth_Hz, response=response
    )
    if resonant:
        names = ", ".join(recording.name for recording in resonant)
        remark = f"{names}: used for the dynamics only, because a mode dominates the motion"
        remarks = (remark, *model.verdict.remarks)
        model = replace(model, verdict=replace(model.verdict, remarks=remarks))
    model = with_discrepancy(model, slow)
    if has_loop_shape:
        progress("loop shape")
        model = with_loop_shape(model, slow)
    return replace(model, counted=counted_in(recordings))


def complete_extended(
    axis: AxisModel,
    recordings: Sequence[Recording],
    lab: Lab,
    response: FrequencyResponseRecord | None,
) -> AxisModel:
    """Fit dynamics, minor loops, discrepancy and loop shape of an axis that a diagnosis extended.

    Dynamics that could not be identified with the previous hysteresis may be identifiable now, and
    the residual has changed.
    """
    if axis.dynamics is None:
        stated_Hz = lab.actuator_of(axis.axis).bandwidth_Hz
        axis = with_dynamics(axis, recordings, stated_Hz=stated_Hz, response=response)
    driven = driven_recordings(recordings, axis.axis)
    return with_loop_shape(with_discrepancy(with_minor_loops(axis, driven), driven), driven)


def refuse_duplicate_names(
    recordings: Sequence[Recording],
    sweeps: Sequence[RawTable] = (),
    responses: Sequence[FrequencyResponseRecord] = (),
) -> None:
    """Refuse duplicate names: digests and initial states are stored by name.

    One file may hold several recordings if each is of another axis.
    """
    keys = Counter((r.name, axis) for r in recordings for axis in axes_of([r]))
    tables: list[RawTable | FrequencyResponseRecord] = [*sweeps, *responses]
    keys.update((table.name, "") for table in tables)
    digests = {(r.name, r.digest) for r in recordings} | {(t.name, t.digest) for t in tables}
    files = Counter(name for name, _ in digests)
    duplicates = {name for (name, _), count in keys.items() if count > 1}
    duplicates |= {name for name, count in files.items() if count > 1}
    if duplicates:
        raise RecordingError(
            f"more than one recording is named {', '.join(sorted(duplicates))}",
            needed="a name of its own for each recording of an axis: results are stored by name",
            remedy="Rename one of the files, or leave out the duplicate.",
        )


def rig_of(lab: Lab, axis: str) -> Rig:
    """Return the declared poles in front of and behind the hysteresis of an axis."""
    return Rig(
        amplifier_bandwidth_Hz=lab.amplifier_of(axis).bandwidth_Hz,
        sensor_bandwidth_Hz=lab.sensor_of(axis).bandwidth_Hz,
    )


def axes_of(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the axes with both drive and displacement in at least one recording."""
    return tuple(sorted({axis for r in recordings for axis in r.axes if _has_both(r, axis)}))


def driven_recordings(recordings: Sequence[Recording], axis: str) -> tuple[Recording, ...]:
    """Return the recordings of an axis in which its drive moves it.

    If feedback holds the sensor, the drive compensates creep and drift, and shows no loop; such
    recordings are used only if there are no others.
    """
    candidates = recordings_of_axis(recordings, axis)
    widest_V = max(float(np.ptp(r.voltage_V(axis))) for r in candidates)
    driven = tuple(r for r in candidates if np.ptp(r.voltage_V(axis)) > MIN_RANGE * widest_V)
    open_loop = tuple(r for r in driven if not is_held_throughout(r, axis))
    return open_loop or driven or candidates


def recordings_of_axis(recordings: Sequence[Recording], axis: str) -> tuple[Recording, ...]:
    """Return the recordings with drive and displacement of an axis, without copies."""
    copied = copies(recordings)
    return tuple(r for r in recordings if _has_both(r, axis) and r.name not in copied)


def _has_both(recording: Recording, axis: str) -> bool:
    return all(
        recording.find(quantity, axis) is not None
        for quantity in (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
    )
