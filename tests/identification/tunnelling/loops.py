"""Closed-loop records of virtual junctions."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from piezoid.identification.tunnelling.closed_loop import ClosedLoopFit, identify_closed_loop
from piezoid.identification.tunnelling.loop_files import LoopRecord, LoopRig
from piezoid_datasets.virtual_lab.junction import Junction, multisine, simulate_junctions

PERIOD_SAMPLES = 2000
LINES = [line for line in range(1, 400, 2) if (10 * line) % 50 and (10 * line) % 60]
BARRIERS = tuple(
    Junction(barrier_eV=barrier_eV, drive_range_V=1.0)
    for barrier_eV in np.linspace(1.0, 5.0, 20).tolist()
)
NOISELESS_JUNCTION = Junction(flicker_m=0.0, vibration_m=0.0, mains_gap_m=0.0, mains_current_A=0.0)
SLOW_SENSOR = Junction(latency_s=40e-6, sensor_pole_Hz=5000.0)
FAST_SENSOR = replace(SLOW_SENSOR, sensor_pole_Hz=18e3)
ATTENUATED_DRIVE = Junction(drive_range_V=1.0)
STRONGLY_ATTENUATED_DRIVE = Junction(drive_range_V=0.1)
DRIFTING_JUNCTION = Junction(drift_m_per_s=60e-12, wander_m_per_root_s=5e-12)
HUMMING_JUNCTION = Junction(mains_Hz=60.0, mains_gap_m=6e-12)
HUMLESS_JUNCTION = Junction(mains_gap_m=0.0, mains_current_A=0.0)
VIBRATING_JUNCTION = Junction(vibration_m=8e-12, wander_m_per_root_s=0.0)
JUNCTIONS = (
    *(*BARRIERS, Junction(), NOISELESS_JUNCTION, SLOW_SENSOR, FAST_SENSOR, ATTENUATED_DRIVE),
    *(
        STRONGLY_ATTENUATED_DRIVE,
        DRIFTING_JUNCTION,
        HUMMING_JUNCTION,
        HUMLESS_JUNCTION,
        VIBRATING_JUNCTION,
    ),
)


@cache
def _long_records() -> Mapping[Junction, LoopRecord]:
    """Simulate all junctions at once, which takes as long as a single junction."""
    records = loop_records(JUNCTIONS, periods=41, seed=1)
    return dict(zip(JUNCTIONS, records, strict=True))


def record_of(junction: Junction, periods: int = 41) -> LoopRecord:
    """Return the first periods of the record of a junction."""
    record, samples = _long_records()[junction], PERIOD_SAMPLES * periods
    return replace(
        record,
        reference=record.reference[:samples],
        drive_V=record.drive_V[:samples],
        current_A=record.current_A[:samples],
    )


def loop_records(
    junctions: Sequence[Junction],
    *,
    periods: int,
    seed: int,
    rms: float = 0.15,
    periodic: bool = True,
    in_drive: bool = False,
) -> tuple[LoopRecord, ...]:
    """Simulate records with one dither, in nepers or (``in_drive``) volts; aperiodic: noise."""
    rng = np.random.default_rng(seed)
    if periodic:
        dither = multisine(PERIOD_SAMPLES, periods, lines=LINES, rms=rms, rng=rng)
    else:
        dither = rms * rng.standard_normal(PERIOD_SAMPLES * periods)
    none = np.zeros_like(dither)
    nepers, volts = (none, dither) if in_drive else (dither, none)
    seeds = range(seed, seed + len(junctions))
    return tuple(
        LoopRecord(
            label=f"junction {n}",
            sampling_rate_Hz=record.sampling_rate_Hz,
            set_point_A=record.set_point_A,
            floor_A=1e-12,
            reference=dither,
            drive_V=record.drive_V,
            current_A=record.current_A,
            period_samples=PERIOD_SAMPLES if periodic else None,
        )
        for n, record in enumerate(
            simulate_junctions(
                junctions, reference_nepers=nepers, drive_dither_V=volts, seeds=seeds
            )
        )
    )


def rig_of(junction: Junction, **declared: float | None) -> LoopRig:
    """Return the declarations of a laboratory, by default without a pole of the sensor."""
    rig = LoopRig(
        axis="z",
        set_point_A=1e-9,
        floor_A=1e-12,
        amplifier_pole_Hz=junction.amplifier_pole_Hz,
        drive_gain_m_per_V=junction.drive_gain_m_per_V,
        bandwidth_Hz=None,
        feedback_ohm=None,
        extension_uncertainty=0.0,
    )
    return replace(rig, **declared)


def identified(record: LoopRecord, junction: Junction, **declared: float | None) -> ClosedLoopFit:
    """Fit a record with the declarations of its laboratory."""
    return identify_closed_loop(record, rig_of(junction, **declared))
