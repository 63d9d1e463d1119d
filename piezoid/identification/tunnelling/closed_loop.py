"""Identify plant and barrier of the junction from records in closed loop.

An open loop cannot be recorded: the tip crashes or is lost. In closed loop the drive responds to
the noise of the current. With u = C (r - y), y = G u + n and gamma^2 the share of the power of the
drive due to the dither r,

    S_yu / S_uu = gamma^2 G - (1 - gamma^2) / C             [Soderstrom & Stoica 1989, ch. 10]

for any length of the record: the naive estimate contains the inverse of the controller. With the
dither as instrument the estimate is consistent: S_yr / S_ur = G.

The plant of a tip is the mean over its records. The spread of the family around it is the sum of
the uncertainty of each record and the variation between records (tip, spot, temperature).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from piezoid.errors import ExcitationError
from piezoid.identification.quality import Confidence, Reason, lowest_grade
from piezoid.identification.tunnelling.instrument_fit import (
    HIGHEST_POLE_SHARE,
    MISFIT,
    InstrumentFit,
    LoopSpectra,
    MIN_POLE_Hz,
    bounds_of_logs,
    fit_with_instrument,
    naive_gain,
    spectra_of_dither,
)
from piezoid.identification.tunnelling.junction_plant import DriveMode, JunctionPlant
from piezoid.identification.tunnelling.loop_files import LoopRecord, LoopRig
from piezoid.identification.tunnelling.loop_noise import LoopNoise, measure_loop_noise
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import NORMAL_95, student_quantile
from piezoid.operators.tunnelling import barrier_of_decay
from piezoid.record_json import Interval

_HIGHEST_SHARE = 0.4  # of the sampling rate: above, hold and logarithm alias
_FLAT_SHARE = 0.02  # of the sampling rate: poles of kilohertz do not matter below
_OPPOSED = 0.5  # of full correlation: noise alone causes far less
_WIDE, _VERY_WIDE = 0.1, 0.3  # relative width of the interval of the gain
_PASSES = 2  # with the recorded drive, then with the drive filtered by the fitted plant
_UNKNOWN_OFFSET_A = 2e-12  # standard deviation: preamplifiers are nulled to a few picoamperes
_MIN_RECORDS = 3  # to estimate the spread between records


@dataclass(frozen=True, kw_only=True)
class LoopSummary:
    """Results of one closed-loop record.

    recording     name
    gain          nepers per volt, and its 95 % interval
    barrier_eV    apparent, and its 95 % interval
    naive_gain    of the transfer function S_yu / S_uu, for comparison only
    naive_reason  explanation of its error
    dither_share  share of the dither in the power of the drive
    period_s      of the dither; None: not periodic
    unrest        motion of the gap; None: the record is too short
    """

    recording: str
    gain: float
    gain_interval: Interval
    barrier_eV: float
    barrier_interval_eV: Interval
    naive_gain: float
    naive_reason: str
    dither_share: float
    period_s: float | None
    unrest: LoopNoise | None

    @property
    def naive_error(self) -> float:
        """Relative error of the naive gain."""
        return self.naive_gain / self.gain - 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedLoopFit(InstrumentFit, LoopSummary):
    """Plant and barrier identified from one record in closed loop.

    sensor_pole_interval_Hz  95 %
    delay_interval_s         95 %
    confidence, reasons      rating and its reasons
    declared_pole_Hz         of the current sensor; None: not declared
    """

    sensor_pole_interval_Hz: Interval
    delay_interval_s: Interval
    confidence: Confidence
    reasons: tuple[str, ...]
    declared_pole_Hz: float | None

    @property
    def summary(self) -> LoopSummary:
        """The results as stored in a model."""
        names = [field.name for field in fields(LoopSummary)]
        return LoopSummary(**{name: getattr(self, name) for name in names})


def identify_closed_loop(
    record: LoopRecord,
    rig: LoopRig,
    *,
    offset_A: tuple[float, float] | None = None,
) -> ClosedLoopFit:
    """Identify gain, sensor pole and delay of a junction under its controller, and the barrier.

        K = k g_z,   phi = (k / 10.246 nm^-1)^2 eV

    record      with an external dither as reference
    rig         declared; its poles have a tolerance of 10 %, which the intervals of delay and gain
                contain. A sensor's pole that is not declared is estimated from the record
    offset_A    of the current and its standard deviation, from sweeps; None: zero within a few
                picoamperes. An unknown offset changes ln K by offset over set point

    Intervals follow from the scatter over periods or blocks with Student's t. The naive estimate
    is the transfer function S_yu / S_uu of the same record, for comparison.
    """
    value_A, standard_A = offset_A or (0.0, _UNKNOWN_OFFSET_A)
    recorded, record = record, replace(record, current_A=record.current_A - value_A)
    rate_Hz, is_declared = record.sampling_rate_Hz, rig.bandwidth_Hz is not None
    through = None
    for _ in range(_PASSES):
        spectra = spectra_of_dither(record, highest_Hz=_HIGHEST_SHARE * rate_Hz, through=through)
        if through is None:
            _reject_falling_current(spectra, record)
        fit = fit_with_instrument(
            spectra,
            amplifier_pole_Hz=rig.amplifier_pole_Hz,
            sensor_pole_Hz=rig.bandwidth_Hz,
            sampling_rate_Hz=rate_Hz,
        )
        through = fit.plant
    # An unknown offset changes ln i of every record by the same amount.
    due_to_offset = np.zeros((3, 3))
    due_to_offset[0, 0] = (standard_A / abs(record.set_point_A)) ** 2
    fit = replace(
        fit, covariance=fit.covariance + due_to_offset, common=fit.common + due_to_offset
    )
    naive, share = naive_gain(
        record, highest_Hz=_HIGHEST_SHARE * rate_Hz, flat_Hz=_FLAT_SHARE * rate_Hz
    )
    half = float(student_quantile(0.975, spectra.blocks - 1)) * np.sqrt(np.diag(fit.covariance))
    low, high = fit.logs - half, fit.logs + half
    if not is_declared and high[1] >= bounds_of_logs(rate_Hz)[1][1]:
        # A pole without an upper end may be a delay: its time constant is added to the delay.
        time_constant = rate_Hz / (2.0 * math.pi * fit.plant.sensor_pole_Hz)
        high[2] = max(float(high[2]), float(fit.logs[2]) + time_constant)
    gain, half_gain = fit.plant.gain_nepers_per_V, float(high[0] - fit.logs[0])
    barrier_eV, barrier_interval_eV = barrier_of_gain(gain, half_gain, rig)
    confidence, reasons = _confidence(fit, half_gain, declared=is_declared)
    return ClosedLoopFit(
        **vars(fit),
        recording=record.label,
        gain=gain,
        gain_interval=(math.exp(low[0]), math.exp(high[0])),
        sensor_pole_interval_Hz=pole_interval(low[1], high[1], rate_Hz, rig.bandwidth_Hz),
        delay_interval_s=(max(float(low[2]), 0.0) / rate_Hz, float(high[2]) / rate_Hz),
        barrier_eV=barrier_eV,
        barrier_interval_eV=barrier_interval_eV,
        naive_gain=naive,
        naive_reason=(
            f"{100.0 * share:.0f} % of the power of the drive is dither; the rest is converter "
            "steps and the response of the controller to noise, which adds minus the "
            "controller's inverse to the naive transfer function: at low frequency the gain is "
            f"off by {100.0 * (naive / gain - 1.0):+.0f} %"
        ),
        dither_share=share,
        period_s=record.period_s,
        unrest=measure_loop_noise(recorded, fit.plant, rig),
        confidence=confidence,
        reasons=reasons,
        declared_pole_Hz=rig.bandwidth_Hz,
    )


def barrier_of_gain(gain: float, half_gain: float, rig: LoopRig) -> tuple[float, Interval]:
    """Return the barrier of a gain in nepers per volt, and its 95 % interval, eV.

    half_gain  half the relative width of the interval of the gain; the barrier's also contains the
               uncertainty of the extension per volt
    """
    decay = gain / rig.drive_gain_m_per_V
    half = math.hypot(half_gain, 1.96 * rig.extension_uncertainty)
    low_eV, high_eV = (barrier_of_decay(decay * math.exp(end)) for end in (-half, half))
    return barrier_of_decay(decay), (low_eV, high_eV)


def _reject_falling_current(spectra: LoopSpectra, record: LoopRecord) -> None:
    """Raise ``ExcitationError`` if the current falls as the drive rises: the drive is inverted."""
    is_flat = spectra.frequency_Hz <= _FLAT_SHARE * record.sampling_rate_Hz
    drive, output = spectra.drive_moment[is_flat], spectra.output_moment[is_flat]
    power = float(np.sqrt(np.sum(np.abs(drive) ** 2) * np.sum(np.abs(output) ** 2)))
    if float(np.sum(drive.conj() * output).real) < -_OPPOSED * power:
        raise ExcitationError(
            f"{record.label}: the current falls as the drive rises",
            needed="a drive counted positive where it extends the tip",
            remedy="Change the sign of the drive's column.",
        )


def pole_interval(
    low: float, high: float, sampling_rate_Hz: float, declared_Hz: float | None
) -> Interval:
    """Return the ends of the interval of a pole from those of its logarithm, Hz.

    A pole that may be too fast to be visible behind a hold has no upper end unless it is declared.
    """
    lowest, highest = (limits[1] for limits in bounds_of_logs(sampling_rate_Hz, declared_Hz))
    is_bounded = high < highest or declared_Hz is not None
    return math.exp(max(low, lowest)), math.exp(high) if is_bounded else math.inf


def _confidence(
    fit: InstrumentFit, half_gain: float, *, declared: bool
) -> tuple[Confidence, tuple[str, ...]]:
    """Return the confidence and the criteria that the fit does not meet.

    half_gain  half the relative width of the interval of the gain
    declared   whether the pole of the current sensor is declared
    """
    reasons: list[Reason] = []
    width = 2.0 * half_gain
    if width > _WIDE:
        grade = Confidence.LOW if width > _VERY_WIDE else Confidence.MEDIUM
        text = f"the gain's 95 % interval is {100.0 * width:.2g} % wide: more dither, or longer"
        reasons.append((grade, text))
    if fit.misfit > MISFIT:
        text = (
            f"the residual of two poles and a delay has {fit.misfit:.2g} times the noise power: "
            "is the amplifier's pole right, does the current saturate?"
        )
        reasons.append((Confidence.MEDIUM, text))
    if fit.mode is not None:
        text = (
            f"the drive shows a mode at {1e-3 * fit.mode.frequency_Hz:.3g} kHz that carries "
            f"{100.0 * fit.mode.share:.2g} % of the extension; the loop stays well below it"
        )
        reasons.append((Confidence.MEDIUM, text))
    pole_Hz = fit.plant.sensor_pole_Hz
    highest_Hz = HIGHEST_POLE_SHARE * fit.plant.sampling_rate_Hz
    if not declared and not 1.01 * MIN_POLE_Hz < pole_Hz < 0.99 * highest_Hz:
        text = f"the sensor pole, {1e-3 * pole_Hz:.3g} kHz, lies at the limit of the search"
        reasons.append((Confidence.MEDIUM, text))
    return lowest_grade(reasons)


@dataclass(frozen=True, kw_only=True)
class LoopPlant:
    """Plant from closed loops, its intervals, and the family of plants.

    plant                    nominal: the mean over the records
    gain_interval            95 % interval of that mean, nepers per volt
    sensor_pole_interval_Hz  95 %; an upper end may be infinite
    delay_interval_s         95 %
    barrier_eV               apparent, and its 95 % interval
    naive_gain               nepers per volt, geometric mean, for comparison only
    naive_reason             explanation of its error, for the record with the largest error
    family                   plants that a controller has to stabilise, nominal first
    family_records           number of records behind the family
    confidence, reasons      rating and its reasons
    axis                     that controls the current
    rig                      declarations of the laboratory; None outside files
    records                  results of each record
    modes                    of the drive, in addition to the plant, of records that show one
    """

    plant: JunctionPlant
    gain_interval: Interval
    sensor_pole_interval_Hz: Interval
    delay_interval_s: Interval
    barrier_eV: float
    barrier_interval_eV: Interval
    naive_gain: float
    naive_reason: str
    family: tuple[JunctionPlant, ...]
    family_records: int
    confidence: Confidence
    reasons: tuple[str, ...]
    axis: str = ""
    rig: LoopRig | None = None
    records: tuple[LoopSummary, ...] = ()
    modes: tuple[DriveMode, ...] = ()


def describe_loop_plant(fits: Sequence[ClosedLoopFit], rig: LoopRig) -> LoopPlant:
    """Combine the fits of the records of one tip into its plant and the family around it.

    The intervals are those of a single record, or follow from the scatter of several records.
    """
    family = spread_family(fits)
    gain, pole_Hz = fits[0].gain_interval, fits[0].sensor_pole_interval_Hz
    delay_s = fits[0].delay_interval_s
    if len(fits) > 1:
        center, half_width = mean_of(fits)
        low, high = center - half_width, center + half_width
        rate_Hz = fits[0].plant.sampling_rate_Hz
        gain = math.exp(low[0]), math.exp(high[0])
        pole_Hz = pole_interval(low[1], high[1], rate_Hz, fits[0].declared_pole_Hz)
        longest_s = max(float(high[2]), 0.0) / rate_Hz
        if not math.isfinite(pole_Hz[1]):  # the pole may then be part of the delay
            longest_s = max(longest_s, *(fit.delay_interval_s[1] for fit in fits))
        delay_s = (max(float(low[2]), 0.0) / rate_Hz, longest_s)
    half_gain = 0.5 * math.log(gain[1] / gain[0])
    barrier_eV, interval_eV = barrier_of_gain(family[0].gain_nepers_per_V, half_gain, rig)
    return LoopPlant(
        plant=family[0],
        gain_interval=gain,
        sensor_pole_interval_Hz=pole_Hz,
        delay_interval_s=delay_s,
        barrier_eV=barrier_eV,
        barrier_interval_eV=interval_eV,
        naive_gain=math.exp(sum(math.log(fit.naive_gain) for fit in fits) / len(fits)),
        naive_reason=max(fits, key=lambda fit: abs(fit.naive_error)).naive_reason,
        family=family,
        family_records=len(fits),
        confidence=max((fit.confidence for fit in fits), key=list(Confidence).index),
        reasons=tuple(
            reason if len(fits) == 1 else f"{fit.recording}: {reason}"
            for fit in fits
            for reason in fit.reasons
        ),
        axis=rig.axis,
        rig=rig,
        records=tuple(fit.summary for fit in fits),
        modes=tuple(fit.mode for fit in fits if fit.mode is not None),
    )


def spread_family(fits: Sequence[ClosedLoopFit]) -> tuple[JunctionPlant, ...]:
    """Return the family of plants that a controller for these junctions has to stabilise.

        Sigma = within + between,   members theta +- q Sigma e_j / sqrt(Sigma_jj)

    fits      of one rig; several spots, tips or days make the family representative
    returned  the nominal plant, then plants of lowest and highest gain, sensor pole and delay,
              with the other parameters following by correlation

    ``q`` is the quantile of Student's t for one further junction. Members are the points at which
    an ellipsoid touches its bounding box: one parameter is extreme and the others follow their
    correlation, within the bounds of pole and delay in the fit, which matter for records that
    cannot separate pole and delay.
    """
    mean = np.mean([fit.logs for fit in fits], axis=0)
    of_record, between, common, reach = _covariances(fits)
    covariance = of_record + common
    if between is not None:
        covariance = between + (between + of_record) / len(fits) + common
    nominal = _plant(mean, fits[0].plant)
    low, high = bounds_of_logs(nominal.sampling_rate_Hz, fits[0].declared_pole_Hz)
    members = [nominal]
    for column in range(3):
        deviation = max(math.sqrt(covariance[column, column]), 1e-300)
        change = reach * covariance[:, column] / deviation
        for step in (-change, change):
            # Correlated pole and delay are shortened together: limited one by one at their bounds
            # they would contradict the record.
            distance = np.where(step > 0.0, np.subtract(high, mean), np.subtract(mean, low))
            share = min(1.0, *distance[1:] / np.maximum(np.abs(step[1:]), 1e-300))
            members.append(_plant(mean + step * np.array([1.0, share, share]), nominal))
    return tuple(members)


def mean_of(fits: Sequence[ClosedLoopFit]) -> tuple[Array, Array]:
    """Return the mean of the logs of several records and half its 95 % interval, (3,) each.

    With too few records for the spread between them, the uncertainty of each is used, or the
    distance of two if it is larger [Birge 1932]. The uncertainty due to declared poles is common
    to all records and does not decrease in the mean.
    """
    logs = np.array([fit.logs for fit in fits])
    of_record, between, common, reach = _covariances(fits)
    if between is None:
        scatter = np.var(logs, axis=0, ddof=min(len(fits) - 1, 1))
        total = np.maximum(np.diag(of_record), scatter)
    else:
        total = np.diag(between + of_record)
    common_part = NORMAL_95**2 * np.diag(common)
    return logs.mean(axis=0), np.sqrt(reach**2 * total / len(fits) + common_part)


def _covariances(fits: Sequence[ClosedLoopFit]) -> tuple[Array, Array | None, Array, float]:
    """Return the covariances of each record, between records, and common to all of a rig.

    The second is the scatter of the estimates minus the first [DerSimonian & Laird 1986, in three
    dimensions]; None with fewer than three records. The last value is the quantile of 95 %
    intervals: Student's t for the number of records if there is a scatter between them.
    """
    common = np.mean([fit.common for fit in fits], axis=0)
    of_record = np.mean([fit.covariance - fit.common for fit in fits], axis=0)
    if len(fits) < _MIN_RECORDS:
        return of_record, None, common, NORMAL_95
    scatter = np.cov([fit.logs for fit in fits], rowvar=False)
    values, vectors = np.linalg.eigh(scatter - of_record)
    between = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return of_record, between, common, float(student_quantile(0.975, len(fits) - 1))


def _plant(logs: Array, nominal: JunctionPlant) -> JunctionPlant:
    return replace(
        nominal,
        gain_nepers_per_V=math.exp(float(logs[0])),
        sensor_pole_Hz=math.exp(float(logs[1])),
        delay_s=max(float(logs[2]), 0.0) / nominal.sampling_rate_Hz,
    )
