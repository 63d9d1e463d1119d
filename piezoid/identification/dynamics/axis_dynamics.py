"""Fit the dynamics of an axis behind its hysteresis, from recordings or a measured response."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.formatting import with_unit
from piezoid.identification.dynamics.bandwidth import (
    BAND_END,
    BandwidthVerdict,
    decide_bandwidth,
    unfitted,
    unmeasured,
)
from piezoid.identification.dynamics.behind_hysteresis import (
    driven_Hz,
    measure_response,
    most_exciting,
    voltage_behind_hysteresis,
)
from piezoid.identification.dynamics.fit_dynamics import (
    fit_dynamics,
    is_identifiable,
    resolved_modes,
)
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.joint_fit import fit_jointly
from piezoid.identification.dynamics.modal import (
    Declaration,
    Filter,
    Hold,
    LinearDynamics,
    Structure,
    filters_of,
)
from piezoid.identification.dynamics.response_validation import validate_response
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import AxisModel
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.recording import Recording

MIN_LINES, MAX_LINES = 20, 150  # of a recording's response
MAX_COST = 4.0  # over its expected value: with a larger cost no parameter is identifiable
QUASI_STATIC = 0.02  # of the rms: an opening of 7 to 15 % is then wrong by up to a quarter
SAME_MODE = 0.1  # largest relative change of a mode in the joint fit
EQUAL_COST = 1.25  # times the lowest cost: costs below count as equal
STRUCTURES = (
    Structure(modes=0, lags=1),
    Structure(modes=1),
    Structure(modes=1, lags=1),
    Structure(modes=2),
    Structure(modes=2, lags=1),
)


def quasi_static(
    recordings: Sequence[Recording], axis: str, rig: Rig
) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Split recordings into quasi-static and dynamic recordings.

    recordings  of one axis, drive and displacement in each
    rig         declared poles, which are not fitted

    A linear response from drive to displacement, hysteresis included, is fitted to the recording
    with the highest excited frequency. If it has a mode, a recording is dynamic if the strongest
    resolved mode changes it by more than ``QUASI_STATIC`` of its rms, because plays would follow
    the ringing as if it were loops. All recordings are quasi-static if no mode is resolved, or if
    all of them would be dynamic.
    """
    recording = most_exciting(recordings, axis)
    if recording is None:
        return tuple(recordings), ()
    try:
        dynamics = _best_fit(measure_response(recording.voltage_V(axis), recording, axis), rig)
    except (ExcitationError, IdentificationError):
        return tuple(recordings), ()
    if not resolved_modes(dynamics).any():
        return tuple(recordings), ()
    # Terms of the linear fit that imitate hysteresis at low frequency are not resolved modes.
    peak = np.abs(dynamics.mode_gain_m_per_V) / dynamics.mode_damping
    strongest = int(np.where(resolved_modes(dynamics), peak, -1.0).argmax())
    damping = dynamics.mode_damping[strongest]
    static = []
    for recording in recordings:
        drive = recording.voltage_V(axis)
        level = drive - drive.mean()
        frequency_Hz = np.fft.rfftfreq(len(level), 1.0 / recording.sampling_rate_Hz)
        x = frequency_Hz / dynamics.mode_frequency_Hz[strongest]
        change = np.abs(1.0 / (1.0 - x**2 + 2j * damping * x)) - 1.0
        power = np.abs(np.fft.rfft(level * np.hanning(len(level)))) ** 2
        share = np.sqrt((change**2 * power).sum() / max(power.sum(), 1e-300))
        if share <= QUASI_STATIC:
            static.append(recording)
    if not static:
        return tuple(recordings), ()
    return tuple(static), tuple(r for r in recordings if r not in static)


def with_dynamics(
    axis: AxisModel,
    recordings: Sequence[Recording],
    *,
    stated_Hz: float | None = None,
    response: FrequencyResponseRecord | None = None,
) -> AxisModel:
    """Return the axis with its fitted dynamics, its bandwidth verdict, and remarks on both.

    axis        with its hysteresis; earlier dynamics and their remarks are replaced
    recordings  any; recordings without both channels or with a slow drive are skipped
    stated_Hz   bandwidth of the data sheet, if the laboratory declares it
    response    of the axis to its own drive, from a file; preferred to the recordings unless it
                contradicts them
    """
    remarks = tuple(r for r in axis.verdict.remarks if r not in axis.dynamics_remarks)
    axis = replace(
        axis,
        dynamics=None,
        dynamics_remarks=(),
        joint=None,
        bandwidth=None,
        response=None,
        verdict=replace(axis.verdict, remarks=remarks),
    )
    if response is None:
        return _with_recorded_dynamics(axis, recordings, stated_Hz)
    declared, recorded = _declared(axis.rig), None
    recording = most_exciting(recordings, axis.axis)
    if recording is not None:
        drive_V = voltage_behind_hysteresis(axis, recording)
        try:
            dynamics = _best_fit(measure_response(drive_V, recording, axis.axis), axis.rig)
            recorded = None if _obstacle(dynamics) else (dynamics, recording.name)
        except (ExcitationError, IdentificationError):
            pass  # the recordings do not determine the dynamics
    validated = validate_response(axis, response, declared, recorded)
    if isinstance(validated, str):
        return _with_recorded_dynamics(_with_remark(axis, validated), recordings, stated_Hz)
    text, dynamics, measured, record = validated
    axis = replace(_with_remark(axis, text), dynamics=dynamics, response=record)
    verdict = decide_bandwidth(
        measured,
        Declaration(hold="band_limited", filters=declared),
        delay_s=dynamics.delay_interval_s().tolist(),
        stated_Hz=stated_Hz,
    )
    return _with_bandwidth(axis, verdict)


def _with_remark(axis: AxisModel, remark: str) -> AxisModel:
    return replace(
        axis,
        dynamics_remarks=(*axis.dynamics_remarks, remark),
        verdict=replace(axis.verdict, remarks=(*axis.verdict.remarks, remark)),
    )


def _with_bandwidth(axis: AxisModel, verdict: BandwidthVerdict) -> AxisModel:
    """Add the verdict, and a remark if it decides or if a bandwidth was stated."""
    axis = replace(axis, bandwidth=verdict)
    if verdict.kind == "undecided" and verdict.stated_Hz is None:
        return axis
    return _with_remark(axis, verdict.text)


def _obstacle(dynamics: LinearDynamics) -> str:
    """Return why a fit does not explain its lines or determine its parameters, or ''.

    Modes must be resolved; the poles of lags must lie within twice the band. A rich structure on a
    response without features meets neither condition, however small its residual.
    """
    low, high = (with_unit(edge_Hz, "Hz") for edge_Hz in dynamics.band_Hz)
    band = f"between {low} and {high}"
    if dynamics.cost_ratio > MAX_COST:
        text = (
            f"{band} the best model misses the response by {np.sqrt(dynamics.cost_ratio):.2g} "
            f"times its uncertainty, at most {np.sqrt(MAX_COST):.2g} times are accepted"
        )
        if dynamics.delay_s > 0.0:
            return text
        return f"{text}. Its delay lies on 0, as if the drive were not held between samples"
    if not resolved_modes(dynamics).all():
        return f"the lines {band} do not determine frequency and damping of a mode"
    return "" if is_identifiable(dynamics) else f"the pole lies far above the lines {band}"


def _with_recorded_dynamics(
    axis: AxisModel, recordings: Sequence[Recording], stated_Hz: float | None
) -> AxisModel:
    """Fit the dynamics to the recording of the highest frequency, and decide the bandwidth.

    They are fitted behind the hysteresis, then jointly with it unless that changes the modes.
    """
    recording = most_exciting(recordings, axis.axis)
    if recording is None:
        verdict = unmeasured(stated_Hz, "no recording is fast enough")
        return axis if stated_Hz is None else _with_bandwidth(axis, verdict)
    drive_V = voltage_behind_hysteresis(axis, recording)
    measured = measure_response(drive_V, recording, axis.axis)
    declaration = Declaration(filters=_declared(axis.rig))
    try:
        dynamics = _best_fit(measured, axis.rig)
        obstacle = _obstacle(dynamics)
    except (ExcitationError, IdentificationError) as refusal:
        obstacle = f"{refusal.found}, needed {refusal.needed}"
    if obstacle:
        verdict = decide_bandwidth(measured, declaration, stated_Hz=stated_Hz)
        verdict = unfitted(verdict, recording.name, obstacle, has_mode=axis.has_dynamics)
        return _with_remark(replace(axis, bandwidth=verdict), verdict.text)

    low, high = (with_unit(edge_Hz, "Hz") for edge_Hz in dynamics.band_Hz)
    text = (
        f"{recording.name}: linear dynamics were fitted behind the hysteresis from {low} to {high}"
    )
    end_Hz = driven_Hz(recording.voltage_V(axis.axis), recording.sampling_rate_Hz)
    if dynamics.band_Hz[1] < BAND_END * end_Hz:
        text += (
            f" (the drive reaches {with_unit(end_Hz, 'Hz', 2)}, but the coherence above {high} is "
            f"below {measured.least_coherence:g}: more amplitude there extends the band)"
        )
    joint = fit_jointly(axis, dynamics, recording, recordings)
    record = None
    if joint is not None:
        joint_dynamics, joint_record = joint
        change = np.abs(np.log(joint_dynamics.mode_frequency_Hz / dynamics.mode_frequency_Hz))
        if (change >= SAME_MODE).any() or not np.isfinite(joint_dynamics.shape_covariance).all():
            text += "; a joint fit of hysteresis and dynamics finds other modes and is not used"
        else:
            text += ", then jointly with it"
            dynamics, record = joint_dynamics, joint_record
    axis = replace(_with_remark(axis, text), dynamics=dynamics, joint=record)
    delay_s = dynamics.delay_interval_s().tolist()
    return _with_bandwidth(
        axis, decide_bandwidth(measured, declaration, delay_s=delay_s, stated_Hz=stated_Hz)
    )


def _best_fit(measured: FrequencyResponse, rig: Rig) -> LinearDynamics:
    """Return the smallest structure that fits a selection of lines as well as the best.

    The drive is taken as held between samples, unless the delay then lies on 0 and the fit is
    better without a hold: the drive then came from a generator, or was measured.

    Structures have at most a quarter as many parameters as there are real values. Determined fits
    are preferred: a richer structure follows the remaining hysteresis by a meaningless term, at
    the cost of modes that are well determined.
    """
    usable = np.flatnonzero(~measured.is_rejected)
    if len(usable) < MIN_LINES:
        raise ExcitationError(
            f"{len(usable)} of {len(measured.frequency_Hz)} lines are coherent",
            needed=f"at least {MIN_LINES}",
            remedy="Record the chirp or multisine longer, or with less noise.",
        )
    frequency_Hz = measured.frequency_Hz[usable]
    grid_Hz = np.geomspace(frequency_Hz[0], frequency_Hz[-1], MAX_LINES)
    nearest = np.abs(np.log(frequency_Hz[:, None] / grid_Hz)).argmin(axis=0)
    lines = measured.at_lines(usable[np.unique(nearest)])
    fits_by_hold = []
    holds: tuple[Hold, ...] = ("zero_order", "band_limited")
    for hold in holds:
        declaration = Declaration(hold=hold, filters=_declared(rig))
        fits = [
            fit_dynamics(lines, structure, declaration)
            for structure in STRUCTURES
            if 4 * (structure.columns + structure.shapes) <= 2 * len(lines.frequency_Hz)
        ]
        fits = [fit for fit in fits if not _obstacle(fit)] or fits
        lowest_cost = min(fit.cost_ratio for fit in fits)
        accepted = max(1.0, EQUAL_COST * lowest_cost)
        fits_by_hold.append(next(fit for fit in fits if fit.cost_ratio <= accepted))
        if fits_by_hold[0].delay_s > 0.0:
            break
    return min(fits_by_hold, key=lambda fit: fit.cost_ratio)


def _declared(rig: Rig) -> tuple[Filter, ...]:
    return filters_of(amplifier=rig.amplifier_bandwidth_Hz, sensor=rig.sensor_bandwidth_Hz)
