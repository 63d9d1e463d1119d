"""Learn the feedforward table of a periodic motion: from the model, then from recorded periods.

For harmonics at which no linear filter contracts on all plants that the recordings allow, for
example at a mode whose frequency is less certain than its width, the response of the table is
measured from two periods with different tables,

    G_h = (Y_h - Y'_h) / (f_h - f'_h)

A small step, to which no plant of the family responds much, is sufficient. [Kim & Zou 2013] divide
output by input instead of their changes, which is not possible with a loop around the table.
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
from piezoid.numerics.polynomial import Response
from piezoid.record_json import read_sealed, to_json
from piezoid.records.recording import Recording
from piezoid.runtime.controller import Status
from piezoid.targets.waveform import inverse_V
from piezoid.verification.plant import AxisPlant

_MEASURED_SHARE = 0.8  # of the inverse of a measured response
# Relative uncertainty of a measured response, with the sector's width: 0.8 (1 + 0.3) contracts.
_MAX_UNCERTAINTY = 0.3

SCHEMA = "piezoid.learning/1"
_MIN_POINTS = 16  # of a period
_ROUNDS = 8  # on the model; more rounds do not reduce the error, see the waveform target
_MIN_LEARNT_POWER = 0.9  # share of the power of a motion
_TOLERANCE_m = 1e-12  # largest difference of equal references


@dataclass(frozen=True, kw_only=True, eq=False)
class Learned:
    """The table of one axis, its convergence and its errors.

    axis              name
    closed_loop       whether the table is added to the output of the controller, or is the whole
                      voltage
    sampling_rate_Hz  of the points
    wanted_m          (points,)  reference of one period
    table_V           (points,)
    contraction       largest remaining share of the error after a period, at full gain, over the
                      plants that the recordings allow
    worst_plant       plant with that share
    sector            of the hysteresis, half its width over its middle; part of contraction
    learns_to_Hz      frequency of the highest harmonic that is learnt
    model_error_m     rms error of the first table on the identified plant
    errors_m          rms error of each recorded period with its table, oldest first
    noise_m           rms of the sensor's noise in the mean period of the last recording
    gain              of learning, relative to the best gain for the worst plant
    played_V, read_m  (points,)  previous table and its mean recorded period, to measure the
                      response with the next period; empty without a recording
    response_m_per_V  (harmonics, 2)  real and imaginary part of the measured response of the
                      table, 0 for harmonics without one; empty without a recording
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
        # An empty array in a file has lost its shape.
        response = np.reshape(self.response_m_per_V, (-1, 2))
        object.__setattr__(self, "response_m_per_V", response)
        freeze(self, "response_m_per_V", ndim=2)
        if len(self.wanted_m) != len(self.table_V) or len(self.wanted_m) < _MIN_POINTS:
            raise ValueError(
                f"{len(self.wanted_m)} points of the reference, {len(self.table_V)} of the table; "
                f"expected equal numbers of at least {_MIN_POINTS}"
            )
        if not self.sampling_rate_Hz > 0.0 or not self.contraction < 1.0:
            raise ValueError(
                f"rate {self.sampling_rate_Hz} Hz, contraction {self.contraction}; expected > 0 "
                "and < 1"
            )

    @property
    def frequency_Hz(self) -> float:
        """Periods per second."""
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
    """Read ``learning.json``; refuse a changed bit or another schema."""
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
    """Compute the table of a periodic motion by learning on the identified plant.

    parameters  of the controller to whose output the table is added; None: the table is the whole
                voltage

    Raises ``ParameterFileError`` for a reference that the axis cannot follow, and ``DesignError``
    if learning does not contract.
    """
    values = None if parameters is None else parameters.values
    wanted_m = _check_reference(reference_m, plant, parameters, model)
    learner = learning_filter(
        model,
        values,
        points=len(wanted_m),
        sampling_rate_Hz=plant.sampling_rate_Hz,
        gain=gain,
    )
    # of the motion's power, without its mean
    power = np.abs(np.fft.rfft(wanted_m - wanted_m.mean())) ** 2
    share = float(power[learner.learns].sum() / max(power.sum(), np.finfo(float).tiny))
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
        error_m = wanted_m - _simulate_period(model, plant, wanted_m, table_V, parameters)
        if values is None:
            error_m -= error_m.mean()  # the mean drifts in open loop
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
    """Refine a table by a recording of the motion with it.

    period  one period or more of the settled motion, the first row at point 0

    Raises ``RecordingError`` for a recording of another motion, and ``ParameterFileError`` if the
    next table exceeds the limits of the axis.
    """
    learner = learning_filter(
        model,
        None if parameters is None else parameters.values,
        points=len(previous.wanted_m),
        sampling_rate_Hz=previous.sampling_rate_Hz,
        gain=previous.gain,
    )
    points, reference = len(previous.wanted_m), np.fft.rfft(previous.wanted_m)
    is_driven = learner.learns | (np.abs(learner.probe_V_per_m) > 0.0)  # the table may change
    sensed = np.where(is_driven | (reference == 0.0), learner.sensed, 1.0)
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
        change_V, change_m = previous.table_V - previous.played_V, measured_m - previous.read_m
        response = measured_response(change_V, change_m, noise_rms_m, response, learner)
    L = np.where(learner.learns, learner.L_V_per_m, learner.probe_V_per_m)
    is_measured = ~learner.learns & (response != 0.0) & is_driven
    L[is_measured] = _MEASURED_SHARE / response[is_measured]
    share = learning_shares(error, points, noise_rms_m)
    table_V = previous.table_V + np.fft.irfft(share * L * error, points)
    _simulate_period(model, plant, previous.wanted_m, table_V, parameters)
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
    """Refuse another reference, model or loop than the table was learnt for."""
    wanted_m, difference = np.asarray(reference_m, dtype=np.float64), ""
    if wanted_m.shape != previous.wanted_m.shape:
        difference = f"has {wanted_m.size} points, that of the table {len(previous.wanted_m)}"
    elif (difference_m := np.abs(wanted_m - previous.wanted_m)).max() > _TOLERANCE_m:
        largest = with_unit(float(difference_m.max()), "m")
        difference = (
            f"differs from that of the table by up to {largest}, at point "
            f"{int(np.argmax(difference_m))}"
        )
    if difference:
        raise RecordingError(
            f"axis {previous.axis}: the reference {difference}",
            needed="the reference for which the table was learnt",
            remedy="Pass that reference, or start again without --table.",
        )
    if previous.sources != sources or previous.closed_loop != closed_loop:
        loop = f"{'with' if previous.closed_loop else 'without'} a controller"
        raise ParameterFileError(
            f"axis {previous.axis}: the table was learnt "
            + ("of another model" if previous.sources != sources else loop),
            needed="model and loop of the table",
            remedy="Pass these, or start again without a recorded period.",
        )


def _check_reference(
    reference_m: ArrayLike, plant: AxisPlant, parameters: AxisParameters | None, model: AxisModel
) -> Array:
    """Return the reference as an array; refuse a reference that the axis cannot follow."""
    wanted_m = np.asarray(reference_m, dtype=np.float64)
    axis = model.axis
    if wanted_m.ndim != 1 or len(wanted_m) < _MIN_POINTS or not np.isfinite(wanted_m).all():
        raise ParameterFileError(
            f"axis {axis}: a reference of shape {wanted_m.shape} with "
            f"{int(np.sum(~np.isfinite(wanted_m)))} numbers that are not finite",
            needed=f"one period of at least {_MIN_POINTS} finite numbers, one for each sample",
            remedy="Pass the period in metres, at the controller's rate.",
        )
    if parameters is None:  # of the hysteresis between the ends of the recorded drive
        operator, (low_V, high_V) = model.operator, model.voltage_V
        cycle_V = np.array([high_V, low_V, high_V])
        ends_m, _ = operator.run(cycle_V, operator.virgin_memory())
        offset_m = operator.displacement_offset_m
        ends_m = model.polarity * (ends_m[1:] - offset_m) + offset_m
        low_m, high_m = float(ends_m.min()), float(ends_m.max())
    else:
        low_m = float(parameters.values["reference_minimum_m"])
        high_m = float(parameters.values["reference_maximum_m"])
    min_m, max_m = float(wanted_m.min()), float(wanted_m.max())
    if min_m < low_m or max_m > high_m:
        raise ParameterFileError(
            f"axis {axis}: the reference is from {with_unit(min_m, 'm')} to "
            f"{with_unit(max_m, 'm')}",
            needed=f"a reference within {with_unit(low_m, 'm')} to {with_unit(high_m, 'm')}, the "
            "range of the axis",
            remedy="Scale or move the reference.",
        )
    largest_step_m = float(np.abs(np.diff(wanted_m, append=wanted_m[0])).max())
    slew_m_per_s = largest_step_m * plant.sampling_rate_Hz
    allowed_m_per_s = (
        np.inf
        if plant.slew_V_per_s is None
        else (plant.slew_V_per_s * model.operator.slope_sector_m_per_V[1])
    )
    if parameters is not None and float(parameters.values["reference_step_m"]) > 0.0:
        step_m = float(parameters.values["reference_step_m"])
        allowed_m_per_s = min(allowed_m_per_s, step_m * plant.sampling_rate_Hz)
    if slew_m_per_s > allowed_m_per_s:
        raise ParameterFileError(
            f"axis {axis}: the reference moves at up to {with_unit(slew_m_per_s, 'm/s')}, "
            "including the step from its last point to its first",
            needed=f"at most {with_unit(float(allowed_m_per_s), 'm/s')}, the limit of drive and "
            "controller",
            remedy="Move slower or less far, and end the period at its first point.",
        )
    return wanted_m


def _simulate_period(
    model: AxisModel,
    plant: AxisPlant,
    wanted_m: Array,
    table_V: Array,
    parameters: AxisParameters | None,
) -> Array:
    """Simulate a table on the plant without noise; return the position in a settled period, m.

    Raises ``ParameterFileError`` if it exceeds the limits of the drive or of the recordings.
    """
    noiseless = replace(plant, noise_rms=0.0, hums=(), reading_step=0.0)
    values = None if parameters is None else parameters.values
    played = play(noiseless, wanted_m, table_V, values=values, rng=np.random.default_rng(0))
    low_V, high_V = float(played.voltage_V.min()), float(played.voltage_V.max())
    limited = Status(int(played.status[-1])) & LIMITED
    slack_V = 1e-9 * (model.voltage_V[1] - model.voltage_V[0])
    is_recorded = low_V >= model.voltage_V[0] - slack_V and high_V <= model.voltage_V[1] + slack_V
    if is_recorded and not limited:
        return played.position
    names = [(flag.name or "").lower().replace("_", " ") for flag in LIMITED if flag in limited]
    raise ParameterFileError(
        f"axis {model.axis}: the period takes {low_V:.4g} V to {high_V:.4g} V"
        + (f", and the controller met its limits ({', '.join(names)})" if names else ""),
        needed=f"the whole period within the recorded {model.voltage_V[0]:.4g} V to "
        f"{model.voltage_V[1]:.4g} V, and within the slew of the drive",
        remedy="Scale the reference down, or scan slower.",
    )


def measured_response(
    change_V: Array,
    change_m: Array,
    noise_rms_m: float,
    previous: Response,
    learner: LearningFilter,
) -> Response:
    """Measure the response of each harmonic from two tables and their mean periods, (harmonics,).

    change_V, change_m  (points,)  differences of the tables and of the periods
    noise_rms_m         of one reading of a mean period
    previous            (harmonics,)  earlier result, or 0; returned for harmonics whose new result
                        is uncertain
    """
    points = len(change_V)
    df, dy = np.fft.rfft(change_V), np.fft.rfft(change_m) / learner.sensed
    # Noise of both means, and the power that the hysteresis converts from other harmonics.
    noise = np.sqrt(2.0 * points) * noise_rms_m
    converted = learner.sector * np.sqrt(np.mean(np.abs(dy) ** 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        uncertainty = np.hypot(noise, converted) / np.abs(dy)
        response = dy / df
    is_certain = np.isfinite(response) & (uncertainty < _MAX_UNCERTAINTY) & (response != 0.0)
    return np.where(is_certain, response, previous)
