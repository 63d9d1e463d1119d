"""The dynamics of a fitted axis: behind its hysteresis, from recordings that excite them.

    u -> H -> v = (H[u] - y_off) / a -> G(s) -> y

H is the static operator found before, so that G sees a drive without hysteresis whatever the
amplitude; a, the middle of the operator's slope sector, only gives v the unit of a volt.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.identification.dynamics.coherence_estimate import estimate_response_by_coherence
from piezoid.identification.dynamics.confidence import resolved_modes
from piezoid.identification.dynamics.fit_dynamics import Declaration, fit_dynamics
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.hammerstein import fit_jointly
from piezoid.identification.dynamics.hammerstein_record import JointFit
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.modal_basis import Filter, Structure
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Quantity, Recording

BROAD_dB = -40.0  # of the strongest band: weaker ones are leakage and harmonics of slow drives
BROAD_DECADES = 1.5  # between harmonics of a triangle there are empty bands
HIGHEST_Hz = 50.0  # a drive that ends below shows hysteresis and creep, not dynamics
BANDS_PER_DECADE = 6
WINDOWS = 5  # a segment is at most this part of the recording: nine half-overlapping windows
FEWEST_LINES = 20
MOST_LINES = 150
MOST_COST = 4.0  # over its expected value: a fit that explains less says nothing
SAME_MODE = 0.1  # by how much of itself a mode may move in the joint fit
AS_GOOD = 1.25  # a structure whose cost is within this of the least counts as equal
STRUCTURES = (
    Structure(modes=0, lags=1),
    Structure(modes=1),
    Structure(modes=1, lags=1),
    Structure(modes=2),
    Structure(modes=2, lags=1),
)


@dataclass(frozen=True, kw_only=True)
class DynamicsFound:
    """What the recordings of an axis say of its dynamics.

    dynamics  None where no recording excites them, or none could be fitted
    joint     None where hysteresis and dynamics were not fitted together
    remarks   one sentence for every recording that was used, or was tried in vain
    """

    dynamics: LinearDynamics | None
    remarks: tuple[str, ...]
    joint: JointFit | None = None


def with_dynamics(axis: AxisModel, recordings: Sequence[Recording]) -> AxisModel:
    """Return the axis with the dynamics its recordings show, and what is to be said of them."""
    found = fit_axis_dynamics(axis, recordings)
    verdict = replace(axis.verdict, remarks=(*axis.verdict.remarks, *found.remarks))
    return replace(axis, dynamics=found.dynamics, joint=found.joint, verdict=verdict)


def fit_axis_dynamics(axis: AxisModel, recordings: Sequence[Recording]) -> DynamicsFound:
    """Fit the dynamics to the recording that excites them furthest.

    axis        whose hysteresis is known
    recordings  any; those without both channels or with a slow drive are passed over
    """
    exciting = excites_dynamics(recordings, axis.axis)
    for recording, highest_Hz in sorted(exciting, key=lambda pair: -pair[1]):
        try:
            dynamics = _best(measure_behind_hysteresis(axis, recording), axis)
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
    return DynamicsFound(dynamics=None, remarks=())


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
    said = f"{text}, then jointly with it. {together.record.structure.text}"
    return DynamicsFound(dynamics=together.dynamics, remarks=(said,), joint=together.record)


def is_determined(dynamics: LinearDynamics) -> bool:
    """Tell whether the fit may be read: it explains its lines, and every number in it is known.

    A mode must be resolved; a lag's pole must lie within twice the band. What a rich structure
    makes of a response without features meets neither, however small its residual.
    """
    poles_known = bool((dynamics.lag_frequency_Hz < 2 * dynamics.band_Hz[1]).all())
    explained = dynamics.cost_ratio <= MOST_COST
    return explained and poles_known and bool(resolved_modes(dynamics).all())


def excites_dynamics(
    recordings: Sequence[Recording], axis: str
) -> tuple[tuple[Recording, float], ...]:
    """Return the recordings whose drive is broad and fast, with the highest frequency in it.

    Broad means: neighbouring sixths of a decade, together at least one and a half decades, hold
    power densities within 40 dB; fast, that they reach 50 Hz.
    """
    both = [r for r in recordings if _has_both(r, axis)]
    bands = [(r, _band_Hz(r.voltage_V(axis), r.sampling_rate_Hz)) for r in both]
    return tuple(
        (recording, high_Hz)
        for recording, (low_Hz, high_Hz) in bands
        if high_Hz >= HIGHEST_Hz and high_Hz >= 10.0**BROAD_DECADES * low_Hz
    )


def measure_behind_hysteresis(axis: AxisModel, recording: Recording) -> FrequencyResponse:
    """Return the response from the hysteresis' output, as a drive, to the displacement.

    Lines that the drive did not reach or that are not coherent are marked as rejected.
    """
    samples = recording.samples
    segment = 2 ** int(np.log2(max(samples // WINDOWS, 2)))
    return estimate_response_by_coherence(
        voltage_behind_hysteresis(axis, recording),
        recording.displacement_m(axis.axis),
        sampling_rate_Hz=recording.sampling_rate_Hz,
        segment_samples=segment,
        inputs=(axis.axis,),
        outputs=(axis.axis,),
    )


def voltage_behind_hysteresis(axis: AxisModel, recording: Recording) -> Array:
    """Return v, (samples,) V; memory starts as the fit found it, or de-poled."""
    operator = axis.hysteresis
    starts = [s for s in axis.starts if s.recording == recording.name]
    memory_V = starts[0].memory_V if starts else operator.virgin_memory()
    moved_m, _ = operator.run(recording.voltage_V(axis.axis), memory_V)
    return np.asarray((moved_m - operator.displacement_offset_m) / middle_slope_m_per_V(axis))


def middle_slope_m_per_V(axis: AxisModel) -> float:
    """Return a, the middle of the slope sector."""
    return 0.5 * sum(axis.hysteresis.slope_sector_m_per_V)


def _best(measured: FrequencyResponse, axis: AxisModel) -> LinearDynamics:
    """Fit every structure to some lines; keep the smallest that is as good as the best."""
    lines = _some_lines(measured)
    declaration = Declaration(filters=_declared(axis))
    fits = [fit_dynamics(lines, structure, declaration) for structure in _possible(lines)]
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


def _declared(axis: AxisModel) -> tuple[Filter, ...]:
    poles = (
        ("amplifier", axis.rig.amplifier_bandwidth_Hz),
        ("sensor", axis.rig.sensor_bandwidth_Hz),
    )
    return tuple(Filter(name=name, frequency_Hz=f) for name, f in poles if f is not None)


def _has_both(recording: Recording, axis: str) -> bool:
    wanted = (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
    return all(recording.find(quantity, axis) is not None for quantity in wanted)


def _band_Hz(voltage_V: Array, sampling_rate_Hz: float) -> tuple[float, float]:
    """Return the ends of the broadest band in which the drive is strong throughout."""
    level = voltage_V - voltage_V.mean()
    power = np.abs(np.fft.rfft(level * np.hanning(len(level)))) ** 2
    frequency_Hz = np.fft.rfftfreq(len(level), 1.0 / sampling_rate_Hz)
    decades = np.log10(0.5 * sampling_rate_Hz / frequency_Hz[1]) if len(power) > 2 else 0.0
    count = int(BANDS_PER_DECADE * decades)
    if count < 2 or not power.any():
        return 1.0, 0.0
    edges = np.geomspace(frequency_Hz[1], 0.5 * sampling_rate_Hz, count + 1)
    place = np.clip(np.searchsorted(edges, frequency_Hz[1:], side="right") - 1, 0, count - 1)
    total = np.bincount(place, power[1:], count) / np.maximum(
        np.bincount(place, minlength=count), 1
    )
    strong = total >= 10.0 ** (BROAD_dB / 10.0) * total.max()
    runs = np.flatnonzero(np.diff(np.concatenate([[False], strong, [False]]).astype(int)))
    first, after = max(zip(runs[::2], runs[1::2], strict=True), key=lambda run: run[1] - run[0])
    return float(edges[first]), float(edges[after])
