"""Plant of a tip from all closed-loop records, and the family around it.

The spread of the family is the sum of the uncertainty of each record and the variation between
records (tip, spot, temperature).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.tunnelling.closed_loop import (
    ClosedLoopFit,
    LoopSummary,
    barrier_of_gain,
    pole_interval,
)
from piezoid.identification.tunnelling.confidence import Confidence
from piezoid.identification.tunnelling.instrument_fit import bounds_of_logs
from piezoid.identification.tunnelling.junction_plant import DriveMode, JunctionPlant
from piezoid.identification.tunnelling.loop_files import LoopRig
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import NORMAL_95, student_quantile
from piezoid.record_json import Interval

_GRADES = (Confidence.LOW, Confidence.MEDIUM, Confidence.HIGH)
_MIN_RECORDS = 3  # to estimate the spread between records


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
        confidence=min((fit.confidence for fit in fits), key=_GRADES.index),
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
    of_record, between, common = _covariances(fits)
    covariance, reach = of_record + common, NORMAL_95
    if between is not None:
        covariance = between + (between + of_record) / len(fits) + common
        reach = float(student_quantile(0.975, len(fits) - 1))
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
    of_record, between, common = _covariances(fits)
    if between is None:
        reach = NORMAL_95
        scatter = np.var(logs, axis=0, ddof=min(len(fits) - 1, 1))
        total = np.maximum(np.diag(of_record), scatter)
    else:
        reach = float(student_quantile(0.975, len(fits) - 1))
        total = np.diag(between + of_record)
    common_part = NORMAL_95**2 * np.diag(common)
    return logs.mean(axis=0), np.sqrt(reach**2 * total / len(fits) + common_part)


def _covariances(fits: Sequence[ClosedLoopFit]) -> tuple[Array, Array | None, Array]:
    """Return the covariances of each record, between records, and common to all of a rig.

    The second is the scatter of the estimates minus the first [DerSimonian & Laird 1986, in three
    dimensions]; None with fewer than three records.
    """
    common = np.mean([fit.common for fit in fits], axis=0)
    of_record = np.mean([fit.covariance - fit.common for fit in fits], axis=0)
    if len(fits) < _MIN_RECORDS:
        return of_record, None, common
    scatter = np.cov([fit.logs for fit in fits], rowvar=False)
    values, vectors = np.linalg.eigh(scatter - of_record)
    return of_record, (vectors * np.maximum(values, 0.0)) @ vectors.T, common


def _plant(logs: Array, nominal: JunctionPlant) -> JunctionPlant:
    return replace(
        nominal,
        gain_nepers_per_V=math.exp(float(logs[0])),
        sensor_pole_Hz=math.exp(float(logs[1])),
        delay_s=max(float(logs[2]), 0.0) / nominal.sampling_rate_Hz,
    )
