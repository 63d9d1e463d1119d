"""Coverage of the 95 % intervals of parameters that are fitted to a frequency response.

    python -m benchmarks.response_coverage [SEEDS] [FIRST]

Each seed draws a stage: one or two modes of quality 5 to 100 between 150 Hz and 3 kHz, a delay of
0 to 300 us, creep of 0 to 0.3 dB per decade. It also draws the lines and the noise, which is
proportional to the response, constant, or both with a coherence that has gaps. The program prints
the coverage of each quantity, and the numbers of rejected responses and of those with another
number of modes.
"""

import sys
from collections import Counter

import numpy as np

from piezoid.identification.dynamics.response_fit import FittedResponse, fit_response
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.records.frequency_response import FrequencyResponseRecord, ResponsePath

GAIN_m_per_V = 2e-7
AVERAGES = 16  # of the analyser
GAP = 0.1  # of the lines, with low coherence


def stage(rng: np.random.Generator) -> dict:
    """Draw modes (frequency, quality, share), delay and creep of one stage."""
    first_Hz = float(np.exp(rng.uniform(np.log(150.0), np.log(1500.0))))
    modes = [(first_Hz, float(np.exp(rng.uniform(np.log(5.0), np.log(100.0)))), 1.0)]
    if rng.random() < 0.5:
        second_Hz = min(first_Hz * float(rng.uniform(1.6, 3.0)), 3000.0)
        share = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.4))
        modes.append((second_Hz, float(np.exp(rng.uniform(np.log(5.0), np.log(100.0)))), share))
    return {
        "modes": modes,
        "delay_s": float(rng.uniform(0.0, 3e-4)),
        "slope_dB": -float(rng.choice([0.0, rng.uniform(0.02, 0.3)])),
    }


def response(frequency_Hz: Array, truth: dict) -> ComplexArray:
    """Return the response of the stage at each frequency."""
    s = 2j * np.pi * frequency_Hz
    total = np.zeros(len(s), dtype=np.complex128)
    for f, quality, share in truth["modes"]:
        w = 2.0 * np.pi * f
        total += share * w**2 / (s**2 + w / quality * s + w**2)
    alpha = -truth["slope_dB"] / 20.0
    creep = (1j * frequency_Hz / truth["modes"][0][0]) ** -alpha
    return np.asarray(GAIN_m_per_V * total * np.exp(-s * truth["delay_s"]) * creep)


def measure(rng: np.random.Generator, truth: dict) -> FrequencyResponseRecord:
    """Return the record of an analyser with noise."""
    lines = int(rng.integers(250, 900))
    highest_Hz = min(2.5 * truth["modes"][-1][0], 6000.0)
    if rng.random() < 0.7:
        f = np.geomspace(rng.choice([0.5, 1.0, 5.0]), highest_Hz, lines)
    else:
        f = np.arange(1, lines + 1) * highest_Hz / lines
    exact = response(f, truth)
    kind, relative = rng.choice(["relative", "constant", "coherence"]), rng.uniform(0.002, 0.02)
    size = np.abs(exact) if kind == "relative" else np.full(len(f), GAIN_m_per_V)
    coherence = None
    if kind == "coherence":
        size = np.hypot(np.abs(exact), GAIN_m_per_V)
        size[rng.integers(0, lines) :][: int(GAP * lines)] *= 60.0
    std = relative * size
    noise = (rng.standard_normal(lines) + 1j * rng.standard_normal(lines)) / np.sqrt(2.0)
    if kind == "coherence":
        true = 1.0 / (1.0 + AVERAGES * std**2 / np.abs(exact) ** 2)
        estimate = (1.0 - true) * rng.chisquare(2 * AVERAGES - 2, lines) / (2 * AVERAGES - 2)
        coherence = np.clip(1.0 - estimate, 0.0, 1.0)
    return FrequencyResponseRecord(
        name="response.csv",
        digest="none",
        frequency_Hz=f,
        paths=(
            ResponsePath(
                output="x",
                drive="x",
                response_m_per_V=exact + std * noise,
                coherence=coherence,
            ),
        ),
    )


def coverage(fit: FittedResponse, truth: dict) -> dict[str, bool]:
    """Return whether the interval of each quantity contains the truth."""
    dynamics = fit.dynamics
    covered: dict[str, bool] = {}
    for number, (f, quality, _) in enumerate(truth["modes"]):
        k = int(np.argmin(np.abs(dynamics.mode_frequency_Hz - f)))
        low, high = dynamics.mode_frequency_interval_Hz()[k]
        covered[f"frequency of mode {number + 1}"] = bool(low <= f <= high)
        low, high = 0.5 / dynamics.mode_damping_interval()[k][::-1]
        covered[f"quality of mode {number + 1}"] = bool(low <= quality <= high)
    low, high = dynamics.delay_interval_s()
    covered["delay"] = bool(low <= truth["delay_s"] <= high)
    if fit.slow is not None:
        low, high = fit.slow.slope_ci95
        covered["slope of creep"] = bool(low <= truth["slope_dB"] <= high)
    return covered


def main() -> None:
    """Fit the responses of all seeds and print the coverage."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    covered, total, states = Counter(), Counter(), Counter()
    for seed in range(first, first + seeds):
        rng = np.random.default_rng([seed, 77])
        truth = stage(rng)
        fit = fit_response(measure(rng, truth), "x", ())
        is_resolved = len(fit.dynamics.mode_frequency_Hz) == len(truth["modes"])
        states["not used" if not fit.is_determined else "used"] += 1
        if not fit.is_determined or not is_resolved:
            states["with another number of modes"] += fit.is_determined
            print(seed, truth, fit.dynamics.mode_frequency_Hz, f"{fit.residual:.3f}", flush=True)
            continue
        intervals = coverage(fit, truth)
        total.update(intervals.keys())
        covered.update(name for name, is_covered in intervals.items() if is_covered)
    print(dict(states))
    for name, count in sorted(total.items()):
        print(f"{name:24} {covered[name]:4} of {count}: {100.0 * covered[name] / count:.1f} %")


if __name__ == "__main__":
    main()
