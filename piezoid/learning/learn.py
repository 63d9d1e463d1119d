"""Learn the feedforward table of a periodic motion: from the model, then from recorded periods.

Where no linear filter contracts on all plants that recordings allow, for example at a mode whose
frequency is less certain than the mode is wide, the response of the table is measured from two
periods with different tables,

    G_h = (Y_h - Y'_h) / (f_h - f'_h)

A small step, to which no plant of the family responds much, is enough. [Kim & Zou 2013] divide
output by input instead of their changes, which a loop around the table does not allow.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from piezoid.digests import seal
from piezoid.errors import DesignError, ParameterFileError, RecordingError
from piezoid.export.parameter_file import AxisParameters
from piezoid.formatting import with_unit
from piezoid.identification.model import AxisModel
from piezoid.learning.contraction import LearningFilter, learning_filter
from piezoid.learning.period import LIMITED, learning_shares, mean_period, play
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.frequency import Response
from piezoid.record_json import read_sealed, to_json
from piezoid.records.recording import Recording
from piezoid.targets.waveform import inverse_V
from piezoid.verification.plant import AxisPlant

SHARE_OF_MEASURED = 0.8
# Relative uncertainty of a response, with the sector's width: 0.8 (1 + 0.3) contracts
_MAX_UNCERTAINTY = 0.3

SCHEMA = "piezoid.learning/1"
_MIN_POINTS = 16  # points of a period
_ROUNDS = 8  # on the model; more changed nothing, see the waveform target
_MIN_LEARNT_POWER = 0.9  # of the power of a motion
_SAME_m = 1e-12  # two references are one where no point differs by more


@dataclass(frozen=True, kw_only=True, eq=False)
class Learned:
    """The table of one axis, its convergence and its errors.

    axis              its name
    closed_loop       whether it goes on top of the controller, or is all of the voltage
    sampling_rate_Hz  at which points follow each other
    wanted_m          (points,)  the period, m
    table_V           (points,)  V
    contraction       a period leaves at most this share of the error, at full gain, on every
                      plant that the recordings allow
    worst_plant       the one that leaves so much
    sector            of the hysteresis, half its width over its middle; part of contraction
    learns_to_Hz      highest harmonic that is learnt
    model_error_m     rms on the identified plant, what the first table leaves there
    errors_m          rms of the recorded periods, oldest first, each with the table of then
    noise_m           rms of the sensor's noise in the mean of the last recording's periods
    gain              of learning, over the best for the worst plant
    played_V, read_m  (points,)  the table before this one and its mean recorded period, from which
                      the next period shows the response; empty before there was one
    response_m_per_V  (harmonics, 2)  real and imaginary part of the measured response of the
                      table, 0 where no two periods have shown it; empty likewise
    sources           digests of model and parameters
    """

    axis: str
    closed_loop: bool
    sampling_rate_Hz: float
    wanted_m: Array
    table_V: Array
    contraction: float
    worst_plant: str
    sector: float
    learns_to_Hz: float
    model_error_m: float
    errors_m: tuple[float, ...] = ()
    noise_m: float | None = None
    gain: float = 1.0
    sources: Mapping[str, str] = field(default_factory=dict)
    played_V: Array = field(default_factory=lambda: np.zeros(0))
    read_m: Array = field(default_factory=lambda: np.zeros(0))
    response_m_per_V: Array = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        freeze(self, "wanted_m", "table_V", "played_V", "read_m")
        response = np.reshape(self.response_m_per_V, (-1, 2))  # a file has no shape of none
        object.__setattr__(self, "response_m_per_V", response)
        freeze(self, "response_m_per_V", ndim=2)
        if len(self.wanted_m) != len(self.table_V) or len(self.wanted_m) < _MIN_POINTS:
            raise ValueError(
                f"{len(self.wanted_m)} points wanted, {len(self.table_V)} in the table; expected "
                f"as many of each, at least {_MIN_POINTS}"
            )
        if not self.sampling_rate_Hz > 0.0 or not self.contraction < 1.0:
            raise ValueError(
                f"rate {self.sampling_rate_Hz} Hz, contraction {self.contraction}; expected > 0 "
                "and < 1"
            )

    @property
    def frequency_Hz(self) -> float:
        """Periods a second."""
        return self.sampling_rate_Hz / len(self.wanted_m)

    def to_json(self) -> bytes:
        """Return ``learning.json``, sealed.

        >>> turns = 2 * np.pi * np.arange(2000) / 2000
        >>> wanted_m = model["x"].zero_m + 1e-6 * np.sin(turns)
        >>> table = piezoid.learn(model, wanted_m, controller=shipping)
        >>> table.to_json()[:1]
        b'{'
        """
        return seal(SCHEMA, to_json(self))


def learned_from_json(content: bytes, source: str) -> Learned:
    """Read ``learning.json`` back, or refuse it."""
    return read_sealed(
        Learned, content, SCHEMA, source, remedy="Learn again from the reference and the periods."
    )


def first_table(
    model: AxisModel,
    plant: AxisPlant,
    reference_m: ArrayLike,
    *,
    parameters: AxisParameters | None,
    gain: float = 1.0,
    sources: Mapping[str, str] | None = None,
) -> Learned:
    """Compute the periodic drive that has converged on the identified plant.

    parameters  of the controller it goes on top of; None: it is all of the voltage

    Raises ``ParameterFileError`` for a reference that the axis cannot follow, ``DesignError``
    where learning would not contract.
    """
    values = None if parameters is None else parameters.values
    wanted_m = _checked(reference_m, plant, parameters, model)
    learner = learning_filter(
        model,
        values,
        points=len(wanted_m),
        sampling_rate_Hz=plant.sampling_rate_Hz,
        gain=gain,
    )
    share = learner.share_learnt(wanted_m)
    if share < _MIN_LEARNT_POWER:
        raise DesignError(
            f"axis {model.axis}: learning contracts up to "
            f"{with_unit(learner.learns_to_Hz, 'Hz')} only, where {100 * share:.3g} % of the "
            "motion's power lies",
            needed=f"at least {100 * _MIN_LEARNT_POWER:g} %",
            remedy="Record a chirp or multisine so that more of the response is known and fit "
            "again, or scan slower.",
        )
    table_V = inverse_V(plant, wanted_m) if values is None else np.zeros(len(wanted_m))
    best_V, smallest_m = table_V, np.inf
    for _ in range(_ROUNDS):
        error_m = wanted_m - _simulated(model, plant, wanted_m, table_V, parameters)
        if values is None:
            error_m -= error_m.mean()  # nothing corrects a drift in open loop
        rms_m = float(np.sqrt(np.mean(error_m**2)))
        if rms_m < smallest_m:
            best_V, smallest_m = table_V, rms_m
        change = np.fft.rfft(error_m) * learner.model_V_per_m
        table_V = table_V + np.fft.irfft(change, len(wanted_m))
    return Learned(
        axis=model.axis,
        closed_loop=values is not None,
        sampling_rate_Hz=plant.sampling_rate_Hz,
        wanted_m=wanted_m,
        table_V=best_V,
        contraction=learner.contraction,
        worst_plant=learner.worst,
        sector=learner.sector,
        learns_to_Hz=learner.learns_to_Hz,
        model_error_m=smallest_m,
        gain=gain,
        sources=dict(sources or {}),
    )


def next_table(
    previous: Learned,
    model: AxisModel,
    plant: AxisPlant,
    period: Recording,
    *,
    parameters: AxisParameters | None,
) -> Learned:
    """Refine a table by a recording of the motion under it.

    period  one period or more of the settled motion, the first row at point 0

    Raises ``RecordingError`` for what is no period of this motion, ``ParameterFileError`` where
    the next table would leave the axis' limits.
    """
    learner = learning_filter(
        model,
        None if parameters is None else parameters.values,
        points=len(previous.wanted_m),
        sampling_rate_Hz=previous.sampling_rate_Hz,
        gain=previous.gain,
    )
    points, reference = len(previous.wanted_m), np.fft.rfft(previous.wanted_m)
    sensed = np.where(learner.moves | (reference == 0.0), learner.sensed, 1.0)
    measured_m, noise_rms_m = mean_period(
        period,
        previous.axis,
        np.fft.irfft(reference * sensed, points),
        sampling_rate_Hz=previous.sampling_rate_Hz,
        noise_rms_m=plant.noise_rms,
    )
    error = reference - np.fft.rfft(measured_m) / sensed
    error_m = np.fft.irfft(error, points)
    if not previous.closed_loop:
        error_m -= error_m.mean()
    response = np.zeros(len(learner.learns), dtype=complex)
    if len(previous.response_m_per_V):
        response = previous.response_m_per_V @ np.array([1.0, 1.0j])
    if len(previous.played_V):
        changed_V, moved_m = previous.table_V - previous.played_V, measured_m - previous.read_m
        response = measured_response(changed_V, moved_m, noise_rms_m, response, learner)
    L = np.where(learner.learns, learner.L_V_per_m, learner.probe_V_per_m)
    is_measured = ~learner.learns & (response != 0.0) & (np.abs(learner.probe_V_per_m) > 0.0)
    L[is_measured] = SHARE_OF_MEASURED / response[is_measured]
    share = learning_shares(error, points, noise_rms_m)
    table_V = previous.table_V + np.fft.irfft(share * L * error, points)
    _simulated(model, plant, previous.wanted_m, table_V, parameters)
    return replace(
        previous,
        table_V=table_V,
        played_V=previous.table_V,
        read_m=measured_m,
        response_m_per_V=np.stack([response.real, response.imag], axis=1),
        errors_m=(*previous.errors_m, float(np.sqrt(np.mean(error_m**2)))),
        noise_m=noise_rms_m,
    )


def refuse_changed(
    previous: Learned, reference_m: ArrayLike, *, sources: Mapping[str, str], closed_loop: bool
) -> None:
    """Refuse another reference, model or loop than the table's, with where it differs most."""
    wanted_m, difference = np.asarray(reference_m, dtype=np.float64), ""
    if wanted_m.shape != previous.wanted_m.shape:
        difference = f"has {wanted_m.size} points, that of the table {len(previous.wanted_m)}"
    elif (difference_m := np.abs(wanted_m - previous.wanted_m)).max() > _SAME_m:
        largest = with_unit(float(difference_m.max()), "m")
        difference = (
            f"differs from that of the table by up to {largest}, at point "
            f"{int(np.argmax(difference_m))}"
        )
    if difference:
        raise RecordingError(
            f"axis {previous.axis}: the reference {difference}",
            needed="the reference for which the table was learnt",
            remedy="Begin anew without --table, or pass that reference.",
        )
    if previous.sources != sources or previous.closed_loop != closed_loop:
        loop = f"{'with' if previous.closed_loop else 'without'} a controller"
        raise ParameterFileError(
            f"axis {previous.axis}: the table was learnt "
            + ("of another model" if previous.sources != sources else loop),
            needed="model and loop of the table that was played",
            remedy="Pass those, or begin anew without a recorded period.",
        )


def _checked(
    reference_m: ArrayLike, plant: AxisPlant, parameters: AxisParameters | None, model: AxisModel
) -> Array:
    """Return the reference as an array; refuse one that the axis cannot follow."""
    wanted_m = np.asarray(reference_m, dtype=np.float64)
    axis = model.axis
    if wanted_m.ndim != 1 or len(wanted_m) < _MIN_POINTS or not np.isfinite(wanted_m).all():
        raise ParameterFileError(
            f"axis {axis}: a reference of shape {wanted_m.shape}, "
            f"{int(np.sum(~np.isfinite(wanted_m)))} of its numbers not finite",
            needed=f"one period, {_MIN_POINTS} finite numbers or more, one for each sample",
            remedy="Pass the period in metres, at the controller's rate.",
        )
    low_m, high_m = (
        _reach_m(model)
        if parameters is None
        else tuple(
            float(parameters.values[f"reference_{end}_m"]) for end in ("minimum", "maximum")
        )
    )
    least_m, most_m = float(wanted_m.min()), float(wanted_m.max())
    if least_m < low_m or most_m > high_m:
        raise ParameterFileError(
            f"axis {axis}: the reference goes from {with_unit(least_m, 'm')} to "
            f"{with_unit(most_m, 'm')}",
            needed=f"all of it within {with_unit(low_m, 'm')} to {with_unit(high_m, 'm')}, the "
            "range of the axis",
            remedy="Scale or move the reference.",
        )
    fastest = float(np.abs(np.diff(wanted_m, append=wanted_m[0])).max())
    fastest_m_per_s = fastest * plant.sampling_rate_Hz
    allowed_m_per_s = (
        np.inf
        if plant.slew_V_per_s is None
        else (plant.slew_V_per_s * model.operator.slope_sector_m_per_V[1])
    )
    if parameters is not None and float(parameters.values["reference_step_m"]) > 0.0:
        step_m = float(parameters.values["reference_step_m"])
        allowed_m_per_s = min(allowed_m_per_s, step_m * plant.sampling_rate_Hz)
    if fastest_m_per_s > allowed_m_per_s:
        raise ParameterFileError(
            f"axis {axis}: the reference moves by up to {with_unit(fastest_m_per_s, 'm/s')}, from "
            "its last point to its first included",
            needed=f"at most {with_unit(float(allowed_m_per_s), 'm/s')}, as drive and controller "
            "allow",
            remedy="Move slower or less far, and let the period end where it begins.",
        )
    return wanted_m


def _reach_m(model: AxisModel) -> tuple[float, float]:
    """Return the range of the hysteresis between the ends of the recorded drive."""
    operator = model.operator
    low_V, high_V = model.voltage_V
    displacement_m, _ = operator.run(np.array([high_V, low_V, high_V]), operator.virgin_memory())
    ends_m = model.polarity * (displacement_m[1:] - operator.displacement_offset_m)
    ends_m = ends_m + operator.displacement_offset_m
    return float(ends_m.min()), float(ends_m.max())


def _simulated(
    model: AxisModel,
    plant: AxisPlant,
    wanted_m: Array,
    table_V: Array,
    parameters: AxisParameters | None,
) -> Array:
    """Return a settled period under a table on the plant without noise, (points,), m.

    Raises ``ParameterFileError`` if it exceeds the limits of the drive or of the recordings.
    """
    noiseless = replace(plant, noise_rms=0.0, hums=(), reading_step=0.0)
    values = None if parameters is None else parameters.values
    played = play(noiseless, wanted_m, table_V, values=values, rng=np.random.default_rng(0))
    low_V, high_V = float(played.voltage_V.min()), float(played.voltage_V.max())
    limited = played.status & LIMITED
    slack_V = 1e-9 * (model.voltage_V[1] - model.voltage_V[0])
    is_recorded = low_V >= model.voltage_V[0] - slack_V and high_V <= model.voltage_V[1] + slack_V
    if is_recorded and not limited:
        return np.asarray(played.position_m[0])
    names = [(flag.name or "").lower().replace("_", " ") for flag in LIMITED if flag in limited]
    raise ParameterFileError(
        f"axis {model.axis}: the period takes {low_V:.4g} V to {high_V:.4g} V"
        + (f", and the controller met its limits ({', '.join(names)})" if names else ""),
        needed=f"all of it within {model.voltage_V[0]:.4g} V to {model.voltage_V[1]:.4g} V, as "
        "recorded, and within the slew of the drive",
        remedy="Scale the reference down, or scan slower.",
    )


def measured_response(
    changed_V: Array,
    moved_m: Array,
    noise_rms_m: float,
    earlier: Response,
    learner: LearningFilter,
) -> Response:
    """Return the response of every harmonic that is certain enough, (harmonics,).

    changed_V, moved_m  (points,)  between two tables and their mean periods
    noise_rms_m         of one reading of a mean period
    earlier             (harmonics,)  measured before, or 0; kept where this one is uncertain
    """
    points = len(changed_V)
    df, dy = np.fft.rfft(changed_V), np.fft.rfft(moved_m) / learner.sensed
    # Noise of both means, and the power that the hysteresis converts from other harmonics.
    noise = np.sqrt(2.0 * points) * noise_rms_m
    converted = learner.sector * np.sqrt(np.mean(np.abs(dy) ** 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        uncertainty = np.hypot(noise, converted) / np.abs(dy)
        response = dy / df
    is_certain = np.isfinite(response) & (uncertainty < _MAX_UNCERTAINTY) & (response != 0.0)
    return np.where(is_certain, response, earlier)
