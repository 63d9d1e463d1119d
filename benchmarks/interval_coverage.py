"""Coverage of the 95 % intervals of a fit with white and correlated noise.

    python -m benchmarks.interval_coverage [DRAWS]

A stage of four plays, two kinks and a lag is fitted with six plays, each time with other noise.
The program counts the intervals of loading curve, loop width and lag that contain the truth.
"""

import itertools
import sys

import numpy as np

from benchmarks.recordings import recording_of
from piezoid.identification.hysteresis.coordinates import Shape, operator_of, to_si_units
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings, search
from piezoid.identification.hysteresis.uncertainty import jackknife, loop_width_m
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii

RATE_Hz = 500.0
REACH_V = np.linspace(0.5, 5.0, 10)
TRUTH = ModifiedPrandtlIshlinskii(
    plays=PrandtlIshlinskii(
        threshold=np.array([0.0, 0.7, 1.5, 2.6, 3.9]),
        weight=np.array([2.0, 0.5, 0.3, 0.2, 0.2]) * 1e-6,
    ),
    dead_zones=from_slopes(np.array([-4e-6, 0.0, 3e-6]), np.array([0.85, 1.0, 1.0, 1.2])),
)


def drive() -> Array:
    """Return sixty half cycles of decreasing and increasing size."""
    sizes = 5.0 * np.concatenate([np.linspace(1, 0.1, 30), np.linspace(0.1, 1, 30)])
    levels = np.concatenate([[0.0], sizes * (-1.0) ** np.arange(60)])
    runs = [np.linspace(a, b, int(30 * abs(b - a)) + 2)[1:] for a, b in itertools.pairwise(levels)]
    return np.concatenate(runs)


def coloured(rng: np.random.Generator, samples: int, memory: float) -> Array:
    """Return first-order autoregressive noise of rms 1."""
    noise = rng.standard_normal(samples) * np.sqrt(1 - memory**2)
    for k in range(1, samples):
        noise[k] += memory * noise[k - 1]
    return noise


def coverage(rng: np.random.Generator, memory: float, noise_m: float) -> Array:
    """Fit once; return whether the intervals of loading curve (10), loop width and lag hold."""
    u = drive()
    y, _ = TRUTH.run(u, TRUTH.virgin_memory())
    recording = recording_of(u, y + noise_m * coloured(rng, len(u), memory), RATE_Hz)
    scales = scales_of([recording], "x")
    settings = Settings(longest_lag_s=0.02, follow_zero=False)
    pieces = pieces_of([recording], "x", scales, Rig())
    fit = search(pieces, Shape(plays=6, below=1, above=1), settings)
    coordinates, theta = fit.task.coordinates, fit.theta
    uncertainty = jackknife(theta, fit.task)

    def quantities(vector: Array) -> Array:
        operator = operator_of(vector, coordinates)
        curve = to_si_units(operator, scales).plays.loading_curve(REACH_V)
        return np.array([*curve, loop_width_m(vector, coordinates, scales), operator.lag_s])

    half = REACH_V - TRUTH.plays.threshold[:, None]
    curve = (np.maximum(half, 0.0) * TRUTH.plays.weight[:, None]).sum(axis=0)
    states = np.clip(scales.voltage_V - TRUTH.plays.threshold, 0.0, TRUTH.plays.threshold)
    half_width = float((TRUTH.plays.weight * states).sum())
    low, high = TRUTH.dead_zones.run(np.array([-half_width, half_width]))
    truth = np.array([*curve, high - low, 0.0])
    return np.asarray(np.abs(quantities(theta) - truth) <= uncertainty.half_width(quantities))


def main() -> None:
    """Print the coverage for each correlation of the noise."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    for memory in (0.0, 0.9, 0.99):
        rng = np.random.default_rng(1)
        covered = np.array([coverage(rng, memory, 20e-9) for _ in range(draws)])
        print(
            f"noise memory {memory:4.2f}: loading curve {covered[:, :10].mean():.1%}, loop width "
            f"{covered[:, 10].mean():.1%}, lag {covered[:, 11].mean():.1%} of {draws} draws"
        )


if __name__ == "__main__":
    main()
