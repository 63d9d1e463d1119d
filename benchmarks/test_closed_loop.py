"""Speed of the closed loop of identified plants and the compiled runtime, on three axes."""

import numpy as np

from piezoid.verification.closed_loop import run_axis
from tests.verification.rig import PLANTS, stage

SAMPLES = 100_000


def test_three_axes_in_closed_loop(benchmark):
    """100,000 samples of X, Y and Z."""
    sine_m = 2e-5 * np.sin(2 * np.pi * 10.0 * np.arange(SAMPLES) / 20e3)
    references = (sine_m, sine_m, np.full(SAMPLES, 1e-9))
    axes = stage().axes

    def run():
        for plant, axis, reference in zip(PLANTS, axes, references, strict=True):
            run_axis(plant, axis, reference, rng=np.random.default_rng(0))

    benchmark(run)
