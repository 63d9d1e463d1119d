"""A million samples: the kernel against a NumPy loop, the fit's time and its peak memory.

    python benchmarks/million_samples.py [SAMPLES]

Every figure of speed is a ratio within this run. The stage is made of 16 plays and 12 dead zones
behind a lag; the fit starts from the recording alone, thresholds included.
"""

import resource
import sys
import time
from dataclasses import replace

import numpy as np

from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.gauss_newton import minimise
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings, search
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.play import play_columns
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.records.recording import Channel, Quantity, Recording

RATE_Hz = 20_000.0
NOISE_m = 10e-9
PLAYS = PrandtlIshlinskii(
    threshold=np.arange(17) * 0.29,
    weight=np.concatenate([[2e-6], 1.5e-7 * np.exp(-np.arange(16) / 9)]),
)
ZONES = from_slopes(
    np.linspace(-12e-6, 12e-6, 13),
    np.concatenate([np.linspace(0.85, 0.98, 6), [1.0, 1.0], np.linspace(0.99, 0.9, 6)]),
)


def drive(samples: int) -> Array:
    """A swelling and falling sine at 2 Hz, all levels, both directions."""
    t = np.arange(samples) / RATE_Hz
    swell = 0.05 + 0.95 * np.abs(np.cos(np.pi * t / t[-1] * 3))
    return np.asarray(5.0 * swell * np.sin(2 * np.pi * 2.0 * t))


def numpy_loop(u: Array, threshold: Array) -> Array:
    """The definition, one sample at a time, all plays at once."""
    z = np.zeros(len(threshold))
    columns = np.empty((len(u), len(threshold)))
    for k, value in enumerate(u):
        z = np.minimum(np.maximum(z, value - threshold), value + threshold)
        columns[k] = z
    return columns


def kernel_ratio(u: Array) -> tuple[float, float]:
    """Return nanoseconds per sample of the kernel and how much longer the loop takes."""
    threshold = PLAYS.threshold[1:]
    part = u[:100_000]
    start = time.perf_counter()
    expected = numpy_loop(part, threshold)
    loop_s = time.perf_counter() - start
    times = []
    for _ in range(20):
        start = time.perf_counter()
        columns, _ = play_columns(part, threshold, np.zeros(16))
        times.append(time.perf_counter() - start)
    np.testing.assert_array_equal(columns, expected)
    kernel_s = float(np.median(times))
    return 1e9 * kernel_s / len(part), loop_s / kernel_s


def main() -> None:
    """Print the figures."""
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    u = drive(samples)
    per_sample_ns, ratio = kernel_ratio(u)
    print(f"play columns, 16 plays: {per_sample_ns:.1f} ns a sample, NumPy loop {ratio:.0f} times")
    h, _ = PLAYS.run(u, PLAYS.virgin_memory())
    noise = NOISE_m * np.random.default_rng(1).standard_normal(samples)
    channels = (
        Channel(quantity=Quantity.VOLTAGE, axis="x", values=u, label="u"),
        Channel(quantity=Quantity.DISPLACEMENT, axis="x", values=ZONES.run(h) + noise, label="y"),
    )
    one = Recording(name="a", digest="", axis="x", sampling_rate_Hz=RATE_Hz, channels=channels)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    start = time.perf_counter()
    scales = scales_of([one], "x")
    settings = Settings(longest_lag_s=2e-3, rows=40_000, follow_zero=False)
    thinned = search(
        pieces_of([one], "x", scales, Rig()), Shape(plays=16, below=6, above=6), settings
    )
    thin_s = time.perf_counter() - start
    whole = minimise(thinned.minimum.theta, replace(thinned.task, stride=1), iterations=4)
    total_s = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    residual_m = whole.rms * abs(scales.displacement_m)
    print(f"{samples} samples, 16 plays + 12 dead zones, thresholds included:")
    print(
        f"  {thin_s:.1f} s thinned, {total_s:.1f} s with {whole.iterations} Jacobians of all rows"
    )
    print(f"  residual {1e9 * residual_m:.2f} nm, noise {1e9 * NOISE_m:.0f} nm")
    print(f"  peak memory {after:.0f} MB, {before:.0f} MB before the fit")


if __name__ == "__main__":
    main()
