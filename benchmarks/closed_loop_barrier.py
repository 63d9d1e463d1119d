"""Barriers from fifty closed-loop records of virtual junctions, and what the naive estimate says.

    python benchmarks/closed_loop_barrier.py [drive range in volts, default 10]

Each junction has its own barrier, drift, unrest and seed; each record lasts eight seconds at
20 kHz under an integral controller, the set point dithered by 0.15 nepers. Both poles are declared
as data sheets do, within 10 per cent of the true ones. With the drive range
at 10 V the converter's steps are larger than the tip's unrest and excite the plant as well as the
dither; through a 10:1 attenuator (1 V) they do not.
"""

import sys

import numpy as np

from piezoid.identification.tunnelling.closed_loop import ClosedLoopFit, identify_closed_loop
from piezoid.identification.tunnelling.loop_files import LoopRecord, LoopRig
from piezoid.operators.tunnelling import barrier_of_decay
from piezoid_datasets.virtual_lab.junction import (
    Junction,
    JunctionRecord,
    multisine,
    simulate_junctions,
)

RECORDS = 50
PERIOD_SAMPLES = 2000
PERIODS = 81  # one is lost to differencing: eight seconds
LINES = [line for line in range(1, 400, 2) if (10 * line) % 50 and (10 * line) % 60]
DITHER_NEPERS = 0.15
TOLERANCE = 0.1  # of a data sheet's pole
SEED = 20150401


def draw_junctions(drive_range_V: float) -> list[Junction]:
    """Return junctions that differ in barrier, electronics and unrest."""
    rng = np.random.default_rng(SEED)
    return [
        Junction(
            barrier_eV=rng.uniform(1.0, 5.0),
            sensor_pole_Hz=rng.uniform(5000.0, 9000.0),
            latency_s=rng.uniform(15e-6, 45e-6),
            drive_range_V=drive_range_V,
            drift_m_per_s=rng.uniform(-50e-12, 50e-12),
            flicker_m=rng.uniform(1e-12, 3e-12),
        )
        for _ in range(RECORDS)
    ]


def identify(
    record: JunctionRecord, junction: Junction, label: str, rng: np.random.Generator
) -> ClosedLoopFit:
    """Return the fit of one record, knowing only what a laboratory declares."""
    stated = rng.uniform(1.0 - TOLERANCE, 1.0 + TOLERANCE, size=2)
    loop = LoopRecord(
        label=label,
        sampling_rate_Hz=record.sampling_rate_Hz,
        set_point_A=record.set_point_A,
        floor_A=1e-12,
        reference=record.reference_nepers,
        drive_V=record.drive_V,
        current_A=record.current_A,
        period_samples=PERIOD_SAMPLES,
    )
    rig = LoopRig(
        axis="z",
        set_point_A=record.set_point_A,
        floor_A=1e-12,
        amplifier_pole_Hz=junction.amplifier_pole_Hz * stated[0],
        drive_gain_m_per_V=junction.drive_gain_m_per_V,
        bandwidth_Hz=junction.sensor_pole_Hz * stated[1],
        feedback_ohm=None,
        extension_uncertainty=0.0,
    )
    return identify_closed_loop(loop, rig)


def compare(drive_range_V: float) -> str:
    """Return the table of all records."""
    junctions = draw_junctions(drive_range_V)
    dither = multisine(
        PERIOD_SAMPLES,
        PERIODS,
        lines=LINES,
        rms=DITHER_NEPERS,
        rng=np.random.default_rng(SEED + 1),
    )
    records = simulate_junctions(
        junctions, reference_nepers=dither, seeds=range(SEED, SEED + RECORDS)
    )
    rows = [f"drive range {drive_range_V:g} V"]
    rows.append("record  true eV  found eV  95 % interval     error %  held  naive eV  error %")
    errors, naive_errors, held = [], [], 0
    delays_held, delay_widths_s = 0, []
    rng = np.random.default_rng(SEED + 2)
    for n, (record, junction) in enumerate(zip(records, junctions, strict=True)):
        fit = identify(record, junction, f"record {n}", rng)
        early_s, late_s = fit.delay_interval_s
        delays_held += early_s <= junction.latency_s <= late_s
        delay_widths_s.append(late_s - early_s)
        truth = junction.barrier_eV
        low, high = fit.barrier_interval_eV
        naive_eV = barrier_of_decay(fit.naive_gain / junction.drive_gain_m_per_V)
        errors.append(100.0 * (fit.barrier_eV / truth - 1.0))
        naive_errors.append(100.0 * (naive_eV / truth - 1.0))
        held += low <= truth <= high
        rows.append(
            f"{n:6d}  {truth:7.3f}  {fit.barrier_eV:8.3f}  [{low:6.3f}, {high:6.3f}]  "
            f"{errors[-1]:+7.2f}  {'yes' if low <= truth <= high else 'no':>4}  "
            f"{naive_eV:8.3f}  {naive_errors[-1]:+7.1f}"
        )
    size, naive_size = np.abs(errors), np.abs(naive_errors)
    rows.append(
        f"barrier error: median {np.median(size):.2f} %, largest {size.max():.2f} %, "
        f"within 5 %: {np.count_nonzero(size <= 5.0)} of {RECORDS}; interval holds the truth: "
        f"{held} of {RECORDS}"
    )
    rows.append(
        f"naive error:   median {np.median(naive_size):.1f} %, largest {naive_size.max():.1f} %, "
        f"within 5 %: {np.count_nonzero(naive_size <= 5.0)} of {RECORDS}"
    )
    rows.append(
        f"delay: interval holds the truth: {delays_held} of {RECORDS}, median width "
        f"{1e6 * float(np.median(delay_widths_s)):.1f} us"
    )
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    sys.stdout.write(compare(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0))
