"""Closed-loop records of virtual junctions, as a laboratory would hand them over."""

from collections.abc import Sequence

import numpy as np

from piezoid.identification.tunnelling.closed_loop import ClosedLoopFit, identify_closed_loop
from piezoid.identification.tunnelling.loop_files import LoopRecord
from piezoid_datasets.virtual_lab.junction import Junction, multisine, simulate_junctions

PERIOD_SAMPLES = 2000
LINES = [line for line in range(1, 400, 2) if (10 * line) % 50 and (10 * line) % 60]


def loop_records(
    junctions: Sequence[Junction],
    *,
    periods: int,
    seed: int,
    rms: float = 0.15,
    periodic: bool = True,
) -> tuple[LoopRecord, ...]:
    """Records under one dither; without a period it is held noise."""
    rng = np.random.default_rng(seed)
    if periodic:
        dither = multisine(PERIOD_SAMPLES, periods, lines=LINES, rms=rms, rng=rng)
    else:
        dither = rms * rng.standard_normal(PERIOD_SAMPLES * periods)
    seeds = range(seed, seed + len(junctions))
    return tuple(
        LoopRecord(
            label=f"junction {n}",
            sampling_rate_Hz=record.sampling_rate_Hz,
            set_point_A=record.set_point_A,
            floor_A=1e-12,
            reference=record.reference_nepers,
            drive_V=record.drive_V,
            current_A=record.current_A,
            period_samples=PERIOD_SAMPLES if periodic else None,
        )
        for n, record in enumerate(
            simulate_junctions(junctions, reference_nepers=dither, seeds=seeds)
        )
    )


def identified(record: LoopRecord, junction: Junction) -> ClosedLoopFit:
    """The fit of one record from what a laboratory declares."""
    return identify_closed_loop(
        record,
        amplifier_pole_Hz=junction.amplifier_pole_Hz,
        drive_gain_m_per_V=junction.drive_gain_m_per_V,
    )
