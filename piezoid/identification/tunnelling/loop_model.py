"""LoopPlant: what a model carries on of a closed loop, over all of its records."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from piezoid.identification.tunnelling.closed_loop import ClosedLoopFit, pole_interval
from piezoid.identification.tunnelling.confidence import Confidence
from piezoid.identification.tunnelling.family import PlantFamily, mean_of
from piezoid.identification.tunnelling.junction_plant import DriveMode, JunctionPlant
from piezoid.identification.tunnelling.loop_files import LoopRig
from piezoid.identification.tunnelling.loop_noise import LoopNoise, MainsLine, NoiseSource
from piezoid.numerics.arrays import Array
from piezoid.operators.tunnelling import barrier_of_decay
from piezoid.record_json import Interval

_GRADES = (Confidence.LOW, Confidence.MEDIUM, Confidence.HIGH)


@dataclass(frozen=True, kw_only=True)
class GapUnrest:
    """What moved the gap during one record, and what limits its resolution.

    drift_m_per_s        > 0 where the gap opens, and its 95 % interval
    mains                harmonics found
    bandwidth_Hz         of the figures below
    gap_rms_m            of the disturbance, drift taken out
    sources              shot, johnson, adc_step, drive_step, gap; 0 where nothing is known of one
    limiting_source      the largest of all
    limiting_electronics the largest but for the gap's own unrest
    """

    drift_m_per_s: float
    drift_interval_m_per_s: Interval
    mains: tuple[MainsLine, ...]
    bandwidth_Hz: float
    gap_rms_m: float
    sources: tuple[NoiseSource, ...]
    limiting_source: str
    limiting_electronics: str


@dataclass(frozen=True, kw_only=True)
class LoopSummary:
    """One closed-loop record.

    recording     its name
    gain          nepers per volt, and its 95 % interval
    barrier_eV    apparent, and its 95 % interval
    naive_gain    of a plain transfer function, for comparison only
    naive_reason  why it differs
    dither_share  how much of the drive's power is dither
    period_s      of the dither; None where it does not repeat itself
    unrest        None where the record is too short for it
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
    unrest: GapUnrest | None


@dataclass(frozen=True, kw_only=True)
class LoopPlant:
    """From a closed loop: the plant, its intervals, the naive gain, and the family.

    plant                    nominal: the mean over the records
    gain_interval            95 % of that mean, nepers per volt
    sensor_pole_interval_Hz  95 %; an upper end may be infinite
    delay_interval_s         95 %
    barrier_eV               apparent, and its 95 % interval
    naive_gain               nepers per volt, geometric mean, for comparison only
    naive_reason             why it differs, of the record where it differs most
    family                   the plants a controller has to hold, nominal first
    family_records           how many records the family rests on
    confidence, reasons      how far to trust it
    modes                    of the drive, beside the plant, of every record that shows one
    axis                     that regulates the current
    rig                      what the laboratory declared of it; None outside files
    records                  one by one
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


def describe_loop_plant(
    fits: Sequence[ClosedLoopFit],
    family: PlantFamily,
    *,
    drive_gain_m_per_V: float,
    drive_gain_relative_uncertainty: float = 0.0,
    rig: LoopRig | None = None,
    records: Sequence[LoopSummary] = (),
) -> LoopPlant:
    """Take from the fits of one tip's records and the family around them what a model carries on.

    A single record's own intervals are kept; those of a mean rest on the scatter of the records.
    """
    nominal = family.members[0]
    gain, pole_Hz, delay_s = _intervals(fits)
    decay = nominal.gain_nepers_per_V / drive_gain_m_per_V
    half = math.hypot(0.5 * math.log(gain[1] / gain[0]), 1.96 * drive_gain_relative_uncertainty)
    worst = max(fits, key=lambda fit: abs(fit.naive_error))
    return LoopPlant(
        plant=nominal,
        gain_interval=gain,
        sensor_pole_interval_Hz=pole_Hz,
        delay_interval_s=delay_s,
        barrier_eV=barrier_of_decay(decay),
        barrier_interval_eV=(
            barrier_of_decay(decay * math.exp(-half)),
            barrier_of_decay(decay * math.exp(half)),
        ),
        naive_gain=math.exp(sum(math.log(fit.naive_gain) for fit in fits) / len(fits)),
        naive_reason=worst.naive_reason,
        family=family.members,
        family_records=family.records,
        confidence=min((fit.confidence for fit in fits), key=_GRADES.index),
        reasons=_reasons(fits),
        axis="" if rig is None else rig.axis,
        rig=rig,
        records=tuple(records),
        modes=tuple(fit.mode.mode for fit in fits if fit.mode is not None),
    )


def summarise_record(
    fit: ClosedLoopFit, noise: LoopNoise | None, period_s: float | None
) -> LoopSummary:
    """Take from one record's fit and noise what a model carries on."""
    return LoopSummary(
        recording=fit.label,
        gain=fit.plant.gain_nepers_per_V,
        gain_interval=fit.gain_interval,
        barrier_eV=fit.barrier_eV,
        barrier_interval_eV=fit.barrier_interval_eV,
        naive_gain=fit.naive_gain,
        naive_reason=fit.naive_reason,
        dither_share=fit.dither_share,
        period_s=period_s,
        unrest=None if noise is None else _unrest(noise),
    )


def _intervals(fits: Sequence[ClosedLoopFit]) -> tuple[Interval, Interval, Interval]:
    if len(fits) == 1:
        one = fits[0]
        return one.gain_interval, one.sensor_pole_interval_Hz, one.delay_interval_s
    center, half = mean_of(fits)
    period_s = 1.0 / fits[0].plant.sampling_rate_Hz
    ends: list[Array] = [center - half, center + half]
    gain = (math.exp(ends[0][0]), math.exp(ends[1][0]))
    pole_Hz = pole_interval(
        ends[0][1], ends[1][1], fits[0].plant.sampling_rate_Hz, fits[0].declared_pole_Hz
    )
    longest_s = max(float(ends[1][2]), 0.0) * period_s
    if not math.isfinite(pole_Hz[1]):  # then the pole may be a delay of its own
        longest_s = max(longest_s, *(fit.delay_interval_s[1] for fit in fits))
    delay_s = (max(float(ends[0][2]), 0.0) * period_s, longest_s)
    return gain, pole_Hz, delay_s


def _reasons(fits: Sequence[ClosedLoopFit]) -> tuple[str, ...]:
    if len(fits) == 1:
        return tuple(reason.text for reason in fits[0].reasons)
    return tuple(f"{fit.label}: {reason.text}" for fit in fits for reason in fit.reasons)


def _unrest(noise: LoopNoise) -> GapUnrest:
    return GapUnrest(
        drift_m_per_s=noise.drift_m_per_s,
        drift_interval_m_per_s=noise.drift_interval_m_per_s,
        mains=noise.mains,
        bandwidth_Hz=noise.bandwidth_Hz,
        gap_rms_m=noise.gap_rms_m,
        sources=noise.sources,
        limiting_source=noise.limiting_source,
        limiting_electronics=noise.limiting_electronics,
    )
