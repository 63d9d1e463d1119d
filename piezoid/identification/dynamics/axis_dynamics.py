"""The dynamics of a fitted axis: behind its hysteresis, from recordings that excite them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.identification.dynamics.bandwidth import (
    BandwidthVerdict,
    UNKNOWN_DELAY_s,
    decide_bandwidth,
    unseen,
)
from piezoid.identification.dynamics.behind_hysteresis import (
    excites_dynamics,
    measure_behind_hysteresis,
    measure_from_drive,
)
from piezoid.identification.dynamics.fit_dynamics import Declaration, fit_dynamics
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.joint_fit import fit_jointly
from piezoid.identification.dynamics.maximum_likelihood import resolved_modes
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.modal_basis import Filter, Structure
from piezoid.identification.dynamics.records import JointFit, ResponseFit
from piezoid.identification.dynamics.response_judgement import ResponseJudged, judge_response
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import AxisModel
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.recording import Recording

FEWEST_LINES = 20
MOST_LINES = 150
MOST_COST = 4.0  # over its expected value: a fit that explains less says nothing
TOUCHED = 0.02  # of the rms: an opening of 7 to 15 % would be wrong by a quarter
SAME_MODE = 0.1  # by how much of itself a mode may move in the joint fit
AS_GOOD = 1.25  # a structure whose cost is within this of the least counts as equal
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
    """Split recordings into those that dynamics hardly touch, and those they shape.

    recordings  of one axis, drive and displacement in each
    rig         declared poles, which no recording has to tell

    A linear response is fitted from drive to displacement, hysteresis and all, to the recording
    that excites it furthest. Where it has a mode, a recording belongs to the second kind if that
    response changes it by more than ``TOUCHED`` of its rms: plays would take ringing for loops.
    All are of the first kind where no mode is found, or where none would be left.
    """
    shown = _mode_shown(recordings, axis, rig)
    if shown is None:
        return tuple(recordings), ()
    found = shown[1]
    calm = tuple(r for r in recordings if _touched(r, axis, found) <= TOUCHED)
    if not calm:
        return tuple(recordings), ()
    return calm, tuple(r for r in recordings if r not in calm)


def mode_in(recordings: Sequence[Recording], axis: str, rig: Rig) -> Recording | None:
    """Return the recording that excites an axis furthest, where a mode is resolved in it."""
    shown = _mode_shown(recordings, axis, rig)
    return None if shown is None else shown[0]


def _mode_shown(
    recordings: Sequence[Recording], axis: str, rig: Rig
) -> tuple[Recording, LinearDynamics] | None:
    exciting = excites_dynamics(recordings, axis)
    if not exciting:
        return None
    furthest = max(exciting, key=lambda pair: pair[1])[0]
    try:
        found = _best(measure_from_drive(furthest, axis), rig)
    except (ExcitationError, IdentificationError):
        return None
    return (furthest, found) if resolved_modes(found).any() else None


def _touched(recording: Recording, axis: str, dynamics: LinearDynamics) -> float:
    """Return by which part of its rms the strongest mode that is resolved changes a drive.

    What a linear fit makes of hysteresis at low frequency is no mode, and changes nothing here.
    """
    drive = recording.voltage_V(axis)
    level = drive - drive.mean()
    frequency_Hz = np.fft.rfftfreq(len(level), 1.0 / recording.sampling_rate_Hz)
    peak = np.abs(dynamics.mode_gain_m_per_V[:, 0, 0]) / dynamics.mode_damping
    strongest = int(np.where(resolved_modes(dynamics), peak, -1.0).argmax())
    x = frequency_Hz / dynamics.mode_frequency_Hz[strongest]
    damping = dynamics.mode_damping[strongest]
    change = np.abs(1.0 / (1.0 - x**2 + 2j * damping * x)) - 1.0
    power = np.abs(np.fft.rfft(level * np.hanning(len(level)))) ** 2
    return float(np.sqrt((change**2 * power).sum() / max(power.sum(), 1e-300)))


@dataclass(frozen=True, kw_only=True)
class DynamicsFound:
    """What the recordings of an axis, or its measured response, say of its dynamics.

    dynamics  None where no recording excites them, or none could be fitted
    joint     None where hysteresis and dynamics were not fitted together
    bandwidth what limits the stage first: pole or resonance; None where nothing excites either
              and no bandwidth is stated
    response  where the dynamics are those of a measured frequency response
    remarks   one sentence for every recording that was used, or was tried in vain
    """

    dynamics: LinearDynamics | None
    remarks: tuple[str, ...]
    joint: JointFit | None = None
    bandwidth: BandwidthVerdict | None = None
    response: ResponseFit | None = None


def with_dynamics(
    axis: AxisModel,
    recordings: Sequence[Recording],
    *,
    stated_Hz: float | None = None,
    response: FrequencyResponseRecord | None = None,
) -> AxisModel:
    """Return the axis with the dynamics its recordings show, and what is to be said of them.

    What was said before of dynamics, behind an earlier state of the hysteresis, goes.
    """
    found = fit_axis_dynamics(axis, recordings, stated_Hz=stated_Hz, response=response)
    others = tuple(r for r in axis.verdict.remarks if r not in axis.dynamics_remarks)
    return replace(
        axis,
        dynamics=found.dynamics,
        dynamics_remarks=found.remarks,
        joint=found.joint,
        bandwidth=found.bandwidth,
        response=found.response,
        verdict=replace(axis.verdict, remarks=(*others, *found.remarks)),
    )


def fit_axis_dynamics(
    axis: AxisModel,
    recordings: Sequence[Recording],
    *,
    stated_Hz: float | None = None,
    response: FrequencyResponseRecord | None = None,
) -> DynamicsFound:
    """Fit the dynamics to what tells them best, and name what limits the stage.

    axis        whose hysteresis is known
    recordings  any; those without both channels or with a slow drive are passed over
    stated_Hz   bandwidth of the data sheet, where the laboratory declares one
    response    measured with the axis' own drive: it goes before the recordings, unless it
                contradicts them
    """
    if response is None:
        return _of_recordings(axis, recordings, stated_Hz)
    declared = _declared(axis.rig)
    judged = judge_response(axis, response, declared, _shown_by_recordings(axis, recordings))
    if judged.dynamics is None:
        found = _of_recordings(axis, recordings, stated_Hz)
        return replace(found, remarks=(*judged.remarks, *found.remarks))
    return _of_response(judged, declared, stated_Hz)


def _of_response(
    judged: ResponseJudged, declared: tuple[Filter, ...], stated_Hz: float | None
) -> DynamicsFound:
    assert judged.dynamics is not None
    assert judged.measured is not None
    early_s, late_s = judged.dynamics.delay_interval_s().tolist()
    verdict = decide_bandwidth(
        judged.measured,
        Declaration(hold="band_limited", filters=declared),
        delay_s=(early_s, late_s),
        stated_Hz=stated_Hz,
    )
    found = DynamicsFound(dynamics=judged.dynamics, remarks=judged.remarks, response=judged.record)
    return _with_verdict(found, verdict)


def _shown_by_recordings(
    axis: AxisModel, recordings: Sequence[Recording]
) -> tuple[LinearDynamics, str] | None:
    """Return the dynamics that recordings determine, and the name of the one that does."""
    exciting = excites_dynamics(recordings, axis.axis)
    if not exciting:
        return None
    recording = max(exciting, key=lambda pair: pair[1])[0]
    try:
        found = _best(measure_behind_hysteresis(axis, recording), axis.rig)
    except (ExcitationError, IdentificationError):
        return None
    return (found, recording.name) if is_determined(found) else None


def _of_recordings(
    axis: AxisModel, recordings: Sequence[Recording], stated_Hz: float | None
) -> DynamicsFound:
    """Fit the dynamics to the recording that excites them furthest, and name what limits it."""
    exciting = excites_dynamics(recordings, axis.axis)
    if not exciting:
        return _with_verdict(None, unseen(stated_Hz, "no recording drives fast enough"))
    recording, highest_Hz = max(exciting, key=lambda pair: pair[1])
    try:
        measured = measure_behind_hysteresis(axis, recording)
    except ExcitationError as refusal:
        said = DynamicsFound(dynamics=None, remarks=(f"no linear dynamics: {refusal}",))
        return _with_verdict(said, unseen(stated_Hz, f"{recording.name} holds {refusal.found}"))
    found = _fitted(axis, measured, (recording, highest_Hz), recordings)
    delay_s = UNKNOWN_DELAY_s
    if found.dynamics is not None:
        early_s, late_s = found.dynamics.delay_interval_s().tolist()
        delay_s = (early_s, late_s)
    verdict = decide_bandwidth(
        measured, Declaration(filters=_declared(axis.rig)), delay_s=delay_s, stated_Hz=stated_Hz
    )
    return _with_verdict(found, verdict)


def _with_verdict(found: DynamicsFound | None, verdict: BandwidthVerdict) -> DynamicsFound:
    """Add the verdict; it is a remark where it decides, or where a bandwidth was stated."""
    if found is None and verdict.stated_Hz is None:
        return DynamicsFound(dynamics=None, remarks=())
    found = found or DynamicsFound(dynamics=None, remarks=())
    is_said = verdict.kind != "undecided" or verdict.stated_Hz is not None
    said = (verdict.text,) if is_said else ()
    return replace(found, bandwidth=verdict, remarks=(*found.remarks, *said))


def _fitted(
    axis: AxisModel,
    measured: FrequencyResponse,
    exciting: tuple[Recording, float],
    recordings: Sequence[Recording],
) -> DynamicsFound:
    recording, highest_Hz = exciting
    try:
        dynamics = _best(measured, axis.rig)
    except (ExcitationError, IdentificationError) as refusal:
        return DynamicsFound(dynamics=None, remarks=(f"no linear dynamics: {refusal}",))
    low_Hz, high_Hz = dynamics.band_Hz
    if not is_determined(dynamics):
        text = (
            f"{recording.name} drives up to {highest_Hz:.0f} Hz, but between {low_Hz:.3g} and "
            f"{high_Hz:.4g} Hz it determines no mode and no pole; only the lag stands. Record "
            "a chirp or a multisine through the first resonance"
        )
        return DynamicsFound(dynamics=None, remarks=(text,))
    text = (
        f"{recording.name} drives up to {highest_Hz:.0f} Hz: linear dynamics were fitted "
        f"behind the hysteresis from {low_Hz:.3g} to {high_Hz:.4g} Hz"
    )
    return _jointly(axis, dynamics, recording, recordings, text)


def _jointly(
    axis: AxisModel,
    dynamics: LinearDynamics,
    exciting: Recording,
    recordings: Sequence[Recording],
    text: str,
) -> DynamicsFound:
    """Fit hysteresis and dynamics together; keep them apart where that finds something else."""
    together = fit_jointly(axis, dynamics, exciting, recordings)
    if together is None:
        return DynamicsFound(dynamics=dynamics, remarks=(text,))
    moved = np.abs(np.log(together.dynamics.mode_frequency_Hz / dynamics.mode_frequency_Hz))
    if not (moved < SAME_MODE).all() or not np.isfinite(together.dynamics.shape_covariance).all():
        apart = f"{text}; hysteresis and dynamics fitted together find other modes: kept apart"
        return DynamicsFound(dynamics=dynamics, remarks=(apart,))
    joint = f"{text}, then jointly with it"
    return DynamicsFound(dynamics=together.dynamics, remarks=(joint,), joint=together.record)


def is_determined(dynamics: LinearDynamics) -> bool:
    """Tell whether the fit may be read: it explains its lines, and every number in it is known.

    A mode must be resolved; a lag's pole must lie within twice the band. What a rich structure
    makes of a response without features meets neither, however small its residual.
    """
    poles_known = bool((dynamics.lag_frequency_Hz < 2 * dynamics.band_Hz[1]).all())
    explained = dynamics.cost_ratio <= MOST_COST
    return explained and poles_known and bool(resolved_modes(dynamics).all())


def _best(measured: FrequencyResponse, rig: Rig) -> LinearDynamics:
    """Fit every structure to some lines; keep the smallest that is as good as the best.

    Those that may be read come first: a richer one fits what little hysteresis is left with a
    term that means nothing, and must not cost the modes that are known.
    """
    lines = _some_lines(measured)
    declaration = Declaration(filters=_declared(rig))
    fits = [fit_dynamics(lines, structure, declaration) for structure in _possible(lines)]
    fits = [fit for fit in fits if is_determined(fit)] or fits
    least = min(fit.cost_ratio for fit in fits)
    return next(fit for fit in fits if fit.cost_ratio <= max(1.0, AS_GOOD * least))


def _possible(lines: FrequencyResponse) -> tuple[Structure, ...]:
    """Structures with at most a quarter as many parameters as there are real values."""
    values = 2 * len(lines.frequency_Hz)
    return tuple(s for s in STRUCTURES if 4 * (s.columns + s.shapes) <= values)


def _some_lines(measured: FrequencyResponse) -> FrequencyResponse:
    """Return coherent lines, evenly spaced in the logarithm, few enough for a quick fit."""
    usable = np.flatnonzero(~measured.is_rejected[:, 0])
    if len(usable) < FEWEST_LINES:
        raise ExcitationError(
            f"{len(usable)} of {len(measured.frequency_Hz)} lines are coherent",
            needed=f"at least {FEWEST_LINES}",
            remedy="Record the chirp or multisine longer, or with less noise.",
        )
    frequency_Hz = measured.frequency_Hz[usable]
    wanted_Hz = np.geomspace(frequency_Hz[0], frequency_Hz[-1], MOST_LINES)
    nearest = np.abs(np.log(frequency_Hz[:, None] / wanted_Hz)).argmin(axis=0)
    return measured.at_lines(usable[np.unique(nearest)])


def _declared(rig: Rig) -> tuple[Filter, ...]:
    poles = (("amplifier", rig.amplifier_bandwidth_Hz), ("sensor", rig.sensor_bandwidth_Hz))
    return tuple(Filter(name=name, frequency_Hz=f) for name, f in poles if f is not None)
