"""Decay, barrier and directions of a recorded Z spectroscopy, every sweep of it, none selected.

python benchmarks/barrier_of_sweeps.py FILE
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from piezoid.identification.tunnelling.approach import (
    ApproachCurve,
    Direction,
    read_z_spectroscopy,
)
from piezoid.identification.tunnelling.barrier_fit import BarrierFit, fit_barrier
from piezoid.identification.tunnelling.sweep_pairs import compare_directions
from piezoid.records.readers import read_table


def row(name: str, fit: BarrierFit) -> str:
    """Return one line of the table."""
    low, high = (1e-9 * end for end in fit.decay_interval_per_m)
    shallow, steep = fit.barrier_interval_eV
    reasons = "; ".join(fit.reasons)
    return (
        f"{name:<28} {1e-9 * fit.decay_per_m:7.3f} [{low:6.3f}, {high:6.3f}]  "
        f"{fit.barrier_eV:6.3f} [{shallow:6.3f}, {steep:6.3f}]  "
        f"{1e12 * fit.offset_A:+8.4f} +- {1e12 * fit.offset_standard_A:6.4f}  "
        f"{1e12 * fit.floor_A:6.4f}  {1e12 * fit.gap_jitter_m:5.2f}  "
        f"{fit.confidence.value} {reasons}"
    )


def compare(curves: Sequence[ApproachCurve]) -> str:
    """Return the table of single sweeps, of both directions, and their difference."""
    lines = [
        f"{'sweep':<28} {'k /nm':>7} {'95 %':>16}  {'phi eV':>6} {'95 %':>16}  "
        f"{'offset pA':>18}  floor   jitter pm"
    ]
    lines += [row(curve.label.split(": ")[-1], fit_barrier([curve])) for curve in curves]
    ways = {
        way: fit_barrier([curve for curve in curves if curve.direction is way])
        for way in Direction
        if any(curve.direction is way for curve in curves)
    }
    lines += [row(f"all {way.value}", fit) for way, fit in ways.items()]
    if len(ways) == len(Direction):
        shift = compare_directions(ways[Direction.FORWARD], ways[Direction.BACKWARD])
        low_m, high_m = shift.shift_interval_m
        low, high = shift.decay_change_interval
        lines.append(
            f"backward minus forward at {1e12 * shift.reference_current_A:.2f} pA: "
            f"{1e12 * shift.shift_m:+.2f} pm [{1e12 * low_m:+.2f}, {1e12 * high_m:+.2f}]; decay "
            f"{100 * shift.decay_change:+.2f} % [{100 * low:+.2f}, {100 * high:+.2f}]"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(compare(read_z_spectroscopy(read_table(Path(sys.argv[1])))))
