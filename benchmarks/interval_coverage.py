"""How often the 95 % intervals of a fit hold the truth, noise white or correlated.

    python benchmarks/interval_coverage.py [DRAWS]

A stage made of four plays, two kinks and a lag is fitted with six plays again and again, each
time with new noise; the intervals of the loading curve, the loop's width and the lag are counted.
"""

import itertools
import sys

import numpy as np

from piezoid.identification.hysteresis.coordinates import Shape, operator_of, to_si_units
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings, search
from piezoid.identification.hysteresis.uncertainty import jackknife, loop_width_m
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.records.recording import Channel, Quantity, Recording

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
    """Thirty cycles of falling and rising size, with minor loops among them."""
    sizes = 5.0 * np.concatenate([np.linspace(1, 0.1, 30), np.linspace(0.1, 1, 30)])
    levels = np.concatenate([[0.0], sizes * (-1.0) ** np.arange(60)])
    runs = [np.linspace(a, b, int(30 * abs(b - a)) + 2)[1:] for a, b in itertools.pairwise(levels)]
    return np.concatenate(runs)


def coloured(rng: np.random.Generator, samples: int, memory: float) -> Array:
    """First-order autoregressive noise of rms 1."""
    white = rng.standard_normal(samples) * np.sqrt(1 - memory**2)
    noise = np.empty(samples)
    last = 0.0
    for k, value in enumerate(white):
        last = memory * last + value
        noise[k] = last
    return noise


def recording(voltage_V: Array, displacement_m: Array) -> Recording:
    """Wrap two columns."""
    channels = (
        Channel(quantity=Quantity.VOLTAGE, axis="x", values=voltage_V, label="u"),
        Channel(quantity=Quantity.DISPLACEMENT, axis="x", values=displacement_m, label="y"),
    )
    return Recording(name="a", digest="", axis="x", sampling_rate_Hz=RATE_Hz, channels=channels)


def hits(rng: np.random.Generator, memory: float, noise_m: float) -> Array:
    """Fit once; return which of loading curve (10), loop width and lag hold the truth."""
    u = drive()
    y, _ = TRUTH.run(u, TRUTH.virgin_memory())
    one = recording(u, y + noise_m * coloured(rng, len(u), memory))
    scales = scales_of([one], "x")
    settings = Settings(longest_lag_s=0.02, follow_zero=False)
    fitted = search(
        pieces_of([one], "x", scales, Rig()), Shape(plays=6, below=1, above=1), settings
    )
    coordinates, theta = fitted.task.coordinates, fitted.theta
    found = jackknife(theta, fitted.task)

    def asked(vector: Array) -> Array:
        operator = operator_of(vector, coordinates)
        curve = to_si_units(operator, scales).plays.loading_curve(REACH_V)
        return np.array([*curve, loop_width_m(vector, coordinates, scales), operator.lag_s])

    half = REACH_V - TRUTH.plays.threshold[:, None]
    curve = (np.maximum(half, 0.0) * TRUTH.plays.weight[:, None]).sum(axis=0)
    states = np.clip(scales.voltage_V - TRUTH.plays.threshold, 0.0, TRUTH.plays.threshold)
    open_h = float((TRUTH.plays.weight * states).sum())
    low, high = TRUTH.dead_zones.run(np.array([-open_h, open_h]))
    truth = np.array([*curve, high - low, 0.0])
    return np.asarray(np.abs(asked(theta) - truth) <= found.half_width(asked))


def main() -> None:
    """Print coverage by noise colour."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    for memory in (0.0, 0.9, 0.99):
        rng = np.random.default_rng(1)
        held = np.array([hits(rng, memory, 20e-9) for _ in range(draws)])
        print(
            f"noise memory {memory:4.2f}: loading curve {held[:, :10].mean():.1%}, "
            f"loop width {held[:, 10].mean():.1%}, lag {held[:, 11].mean():.1%} of {draws} draws"
        )


if __name__ == "__main__":
    main()
