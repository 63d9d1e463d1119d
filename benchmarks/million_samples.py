"""A million samples fitted in memory, thresholds included: time in units of the run, and memory.

    python -m benchmarks.million_samples [SAMPLES]

The stage is made of 16 plays and 12 dead zones and drives at 2 Hz; the fit starts from the
recording alone: a search on thinned rows, then Jacobians of all rows. Times are processor time.
"""

import resource
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.speed.loops import numpy_sum
from benchmarks.speed.stopwatch import Stopwatch, used_s
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.gauss_newton import HysteresisFit, Task, minimise, rms_of
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings, search
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.records.recording import Channel, Quantity, Recording

RATE_Hz = 20_000.0
NOISE_m = 10e-9
LOOPED = 20_000  # samples of the NumPy loop
PATIENT = Stopwatch()
SHAPE = Shape(plays=16, below=6, above=6)
SETTINGS = Settings(longest_lag_s=2e-3, rows=40_000, follow_zero=False)
PLAYS = PrandtlIshlinskii(
    threshold=np.arange(17) * 0.29,
    weight=np.concatenate([[2e-6], 1.5e-7 * np.exp(-np.arange(16) / 9)]),
)
ZONES = from_slopes(
    np.linspace(-12e-6, 12e-6, 13),
    np.concatenate([np.linspace(0.85, 0.98, 6), [1.0, 1.0], np.linspace(0.99, 0.9, 6)]),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """The search on thinned rows, what all rows made of it, and the time until each."""

    thinned: HysteresisFit
    whole: HysteresisFit
    thinned_s: float
    total_s: float


def drive_V(samples: int) -> Array:
    """Return a swelling and falling sine at 2 Hz: all levels, both directions."""
    t = np.arange(samples) / RATE_Hz
    swell = 0.05 + 0.95 * np.abs(np.cos(np.pi * t / t[-1] * 3))
    return np.asarray(5.0 * swell * np.sin(2 * np.pi * 2.0 * t))


def recording(samples: int) -> Recording:
    """Return what the stage made of the drive, and noise."""
    u_V = drive_V(samples)
    h_m, _ = PLAYS.run(u_V, PLAYS.virgin_memory())
    y_m = ZONES.run(h_m) + NOISE_m * np.random.default_rng(1).standard_normal(samples)
    return Recording(
        name="a",
        digest="",
        axis="x",
        sampling_rate_Hz=RATE_Hz,
        channels=(
            Channel(quantity=Quantity.VOLTAGE, axis="x", values=u_V, label="u"),
            Channel(quantity=Quantity.DISPLACEMENT, axis="x", values=y_m, label="y"),
        ),
    )


def fitted(one: Recording) -> Found:
    """Fit a recording from nothing."""
    begun_s = used_s()
    pieces = pieces_of([one], "x", scales_of([one], "x"), Rig())
    thinned = search(pieces, SHAPE, SETTINGS)
    thinned_s = used_s() - begun_s
    whole = minimise(thinned.theta, every_sample(thinned.task), iterations=4)
    return Found(thinned=thinned, whole=whole, thinned_s=thinned_s, total_s=used_s() - begun_s)


def every_sample(task: Task) -> Task:
    return replace(task, samples=[piece.fitted_samples() for piece in task.pieces])


def loop_s(watch: Stopwatch, one: Recording) -> float:
    """Return how long NumPy takes to run the plays once, sample by sample."""
    part = one.voltage_V()[:LOOPED]
    took_s = watch.cpu_s(lambda: numpy_sum(part, PLAYS, PLAYS.virgin_memory()))
    return took_s * one.samples / len(part)


def peak_megabytes() -> float:
    """Return the largest memory this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(words: Sequence[str] | None = None, *, watch: Stopwatch = PATIENT) -> None:
    """Print the figures."""
    asked = sys.argv[1:] if words is None else words
    one = recording(int(asked[0]) if asked else 1_000_000)
    before = peak_megabytes()
    found = fitted(one)
    after, task = peak_megabytes(), every_sample(found.thinned.task)
    forward_s = watch.cpu_s(lambda: rms_of(found.whole.theta, task))
    residual_nm = 1e9 * found.whole.rms * abs(scales_of([one], "x").displacement_m)
    print(f"{one.samples} samples, 16 plays and 12 dead zones, thresholds included:")
    print(f"  the fit takes as long as {found.total_s / forward_s:.0f} forward runs of its model,")
    print(
        f"  or {found.total_s / loop_s(watch, one):.2g} runs of its plays alone in a NumPy loop,"
    )
    print(f"  {found.thinned_s / found.total_s:.0%} of it before all rows count, then")
    print(f"  {found.total_s:.1f} s here")
    print(f"  residual {residual_nm:.2f} nm, noise {1e9 * NOISE_m:.0f} nm")
    print(f"  peak memory {after:.0f} MB, {before:.0f} MB before the fit")


if __name__ == "__main__":
    main()
