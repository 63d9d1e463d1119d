"""PlantFamily: the junctions a controller has to hold, from the spread the data show.

Two spreads add: what each record leaves uncertain, and what truly differs from record to record
(tip, spot, temperature). The second is the scatter of the estimates less the first [DerSimonian
& Laird 1986, in three dimensions]. With fewer than three records it cannot be seen, and is said
to be missing rather than taken as zero.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.identification.tunnelling.closed_loop import ClosedLoopFit
from piezoid.identification.tunnelling.instrument_fit import bounds_of_logs
from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import NORMAL_95, student_quantile
from piezoid.operators.tunnelling import barrier_of_decay

_FEWEST_RECORDS = 3


@dataclass(frozen=True, kw_only=True)
class Spread:
    """A quantity over the family: lowest, nominal, highest; 95 % of junctions lie between."""

    low: float
    nominal: float
    high: float


@dataclass(frozen=True, kw_only=True)
class PlantFamily:
    """The nominal junction and the extreme ones.

    members          nominal first, then the lowest and highest gain, sensor pole and delay, each
                     with the others where the data put them in that case
    gain             nepers per volt
    sensor_pole_Hz   of the current sensor
    delay_s          of the loop
    barrier_eV       apparent
    records          how many the family rests on
    between_records  whether the spread from record to record could be seen
    """

    members: tuple[JunctionPlant, ...]
    gain: Spread
    sensor_pole_Hz: Spread
    delay_s: Spread
    barrier_eV: Spread
    records: int
    between_records: bool


def spread_family(fits: Sequence[ClosedLoopFit], *, drive_gain_m_per_V: float) -> PlantFamily:
    """Return the family of plants that a controller for these junctions has to hold.

        Sigma = within + between,   members theta +- q Sigma e_j / sqrt(Sigma_jj)

    fits                of one rig; several spots, tips or days make the family honest
    drive_gain_m_per_V  extension per volt, for the barrier

    ``q`` is Student's for one further junction. A member is where an ellipsoid touches its
    bounding box: there gain, pole or delay is extreme and the others follow their correlation, no
    further than a pole and a delay are ever sought: a record that cannot tell one from the other
    allows neither to be anything.
    """
    logs = np.array([fit.logs for fit in fits])
    covariance, seen = _covariance_of_next(fits, logs)
    center = logs.mean(axis=0)
    reach = _quantile(len(fits)) if seen else NORMAL_95
    nominal = _plant(center, fits[0].plant)
    members = [nominal]
    spreads = []
    for place in range(3):
        arm = reach * covariance[:, place] / max(math.sqrt(covariance[place, place]), 1e-300)
        bounds = bounds_of_logs(nominal.sampling_rate_Hz, fits[0].declared_pole_Hz)
        steps = (_within_bounds(center, sign * arm, bounds) for sign in (-1.0, 1.0))
        ends = [_plant(center + step, nominal) for step in steps]
        members += ends
        spreads.append(ends)
    (gain_low, gain_high), (pole_low, pole_high), (delay_low, delay_high) = spreads
    gain = Spread(
        low=gain_low.gain_nepers_per_V,
        nominal=nominal.gain_nepers_per_V,
        high=gain_high.gain_nepers_per_V,
    )
    return PlantFamily(
        members=tuple(members),
        gain=gain,
        sensor_pole_Hz=Spread(
            low=pole_low.sensor_pole_Hz,
            nominal=nominal.sensor_pole_Hz,
            high=pole_high.sensor_pole_Hz,
        ),
        delay_s=Spread(low=delay_low.delay_s, nominal=nominal.delay_s, high=delay_high.delay_s),
        barrier_eV=Spread(
            low=barrier_of_decay(gain.low / drive_gain_m_per_V),
            nominal=barrier_of_decay(gain.nominal / drive_gain_m_per_V),
            high=barrier_of_decay(gain.high / drive_gain_m_per_V),
        ),
        records=len(fits),
        between_records=seen,
    )


def mean_of(fits: Sequence[ClosedLoopFit]) -> tuple[Array, Array]:
    """Return the mean of several records' logs and half its 95 % interval, (3,) each.

    Where the spread between records cannot be seen, what each leaves uncertain counts, or the
    distance of two where that is more [Birge 1932]. What the declared poles leave open is the same
    in all of them and does not average.
    """
    logs = np.array([fit.logs for fit in fits])
    own, between = _covariances(fits, logs)
    seen = between is not None
    total = np.diag(own if between is None else between + own)
    reach = _quantile(len(fits)) if seen else NORMAL_95
    if not seen:
        total = np.maximum(total, np.var(logs, axis=0, ddof=min(len(fits) - 1, 1)))
    alike = NORMAL_95**2 * np.diag(_common(fits))
    return logs.mean(axis=0), np.sqrt(reach**2 * total / len(fits) + alike)


def _covariance_of_next(fits: Sequence[ClosedLoopFit], logs: Array) -> tuple[Array, bool]:
    """Covariance of one further junction about the mean, and whether spread could be seen."""
    own, between = _covariances(fits, logs)
    if between is None:
        return own + _common(fits), False
    return between + (between + own) / len(fits) + _common(fits), True


def _common(fits: Sequence[ClosedLoopFit]) -> Array:
    """Covariance that all records of the rig have alike."""
    common: Array = np.mean([fit.common for fit in fits], axis=0)
    return common


def _covariances(fits: Sequence[ClosedLoopFit], logs: Array) -> tuple[Array, Array | None]:
    """Covariance of a record's own, and between records where there are enough to see it."""
    own = np.mean([fit.covariance - fit.common for fit in fits], axis=0)
    if len(fits) < _FEWEST_RECORDS:
        return own, None
    scatter = np.cov(logs, rowvar=False)
    values, vectors = np.linalg.eigh(scatter - own)
    return own, (vectors * np.maximum(values, 0.0)) @ vectors.T


def _quantile(records: int) -> float:

    return float(student_quantile(0.975, records - 1))


def _within_bounds(center: Array, step: Array, bounds: tuple[list[float], list[float]]) -> Array:
    """Return the step of gain whole, those of pole and delay together as far as bounds allow.

    Where pole and delay look alike, one goes up as the other goes down: cut one by one they would
    leave that line, and with it what the record does know.
    """
    low, high = bounds
    ahead = np.where(step > 0.0, np.subtract(high, center), np.subtract(center, low))
    share = min(1.0, *(float(room) for room in ahead[1:] / np.maximum(np.abs(step[1:]), 1e-300)))
    return np.asarray(step * np.array([1.0, share, share]), dtype=np.float64)


def _plant(logs: Array, like: JunctionPlant) -> JunctionPlant:
    return JunctionPlant(
        gain_nepers_per_V=math.exp(float(logs[0])),
        sensor_pole_Hz=math.exp(float(logs[1])),
        delay_s=max(float(logs[2]), 0.0) / like.sampling_rate_Hz,
        amplifier_pole_Hz=like.amplifier_pole_Hz,
        sampling_rate_Hz=like.sampling_rate_Hz,
    )
