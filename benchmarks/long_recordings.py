"""How long the diagnosis of six recordings of 100,000 samples takes, and what it finds.

    python -m benchmarks.long_recordings [SEED] [EFFECT,EFFECT,...] [SAMPLES] [THREADS]

The recordings are those of a laboratory that lets its plans run on: sweeps, random levels and a
staircase at 1 and 2 kHz, loops at several rates and a chirp at the converter's clock. Every step
of the search is printed with its time, as ``piezoid diagnose`` tells it.
"""

import os
import sys
import time
from collections.abc import Callable

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from benchmarks.zoo.score import read_campaign
from piezoid.diagnosis.diagnose import diagnose
from piezoid_datasets.virtual_lab import drives
from piezoid_datasets.virtual_lab.campaign import draw_campaign
from piezoid_datasets.virtual_lab.plans import Plan, Shapes
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.signals import Array

SLOW_Hz, MIDDLE_Hz = 1000.0, 2000.0
Shape = Callable[[float, np.random.Generator], Array]


def _swells(rate_Hz: float, _: np.random.Generator) -> Array:
    falling = drives.decaying_sweep(rate_Hz, 1.1, 10, triangle=False)
    repeated = drives.decaying_sweep(rate_Hz, 1.1, 4, keep=1.0)
    return np.concatenate((falling, repeated))


# Name, sampling rate (None: the clock of the converter), and shape of a recording.
PLANS: tuple[tuple[str, float | None, Shape], ...] = (
    ("sweep", SLOW_Hz, lambda rate_Hz, _: drives.decaying_sweep(rate_Hz, 0.4, 12)),
    ("swells", MIDDLE_Hz, _swells),
    ("levels", SLOW_Hz, lambda rate_Hz, rng: drives.random_levels(rate_Hz, 0.7, 60, rng)),
    ("staircase", SLOW_Hz, lambda rate_Hz, rng: drives.staircase(rate_Hz, 0.05, 3.0, 30, rng)),
    ("rates", None, lambda rate_Hz, _: drives.rates(rate_Hz, ((2.3, 2), (11.0, 10), (61.0, 60)))),
    ("chirp", None, lambda rate_Hz, _: drives.chirp(rate_Hz, 5.0, 900.0, 1.6, 0.1)),
)


def plans(samples: int) -> tuple[Plan, ...]:
    """Return six plans that go on until they have so many samples."""

    def plan(name: str, stated_Hz: float | None, shape_of: Shape) -> Plan:
        def shape(rig: Rig, rng: np.random.Generator) -> Shapes:
            rate_Hz = stated_Hz or rig.clock_Hz
            parts = [shape_of(rate_Hz, rng)]
            while sum(map(len, parts)) < samples:
                parts.append(shape_of(rate_Hz, rng))
            return rate_Hz, np.concatenate(parts)[:samples], {}

        return Plan(name=name, shape=shape)

    return tuple(plan(*row) for row in PLANS)


def main(seed: int, effects: tuple[str, ...], samples: int, threads: int) -> None:
    """Draw, write, read and diagnose one campaign."""
    campaign = draw_campaign(seed, effects=effects, plans=plans(samples))
    recordings, lab = read_campaign(campaign)
    start_s, start_cpu_s = time.perf_counter(), time.process_time()

    def report(step: str) -> None:
        print(f"{time.perf_counter() - start_s:7.1f} s  {step}", flush=True)

    diagnosis = diagnose(recordings, lab=lab, progress=report, threads=threads)
    report("done")
    print(
        f"{campaign.answer.truth}: hidden {', '.join(effects) or 'nothing'}, "
        f"named {', '.join(diagnosis.names) or 'nothing'}; "
        f"{time.perf_counter() - start_s:.1f} s, "
        f"processor {time.process_time() - start_cpu_s:.1f} s, "
        f"remaining {1e9 * diagnosis.envelope_rms_m:.3g} nm, "
        f"noise {1e9 * diagnosis.noise_floor_rms_m:.3g} nm"
    )


if __name__ == "__main__":
    given = [*sys.argv[1:], *("1", "lag,creep", "100000", "2")[len(sys.argv) - 1 :]]
    main(int(given[0]), tuple(n for n in given[1].split(",") if n), int(given[2]), int(given[3]))
