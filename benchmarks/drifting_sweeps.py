"""How often the 95 % interval of the barrier from sweeps holds the truth, on junctions that drift.

    python -m benchmarks.drifting_sweeps [junctions, default 120] [first seed, default 1]

Every seed is a junction of its own: barrier 1 to 5 eV, set point 0.05 to 2 nA, one to three
sweeps to and fro of 0.1 to 5 s, drift of up to 100 pm/s that slowly dies away, hysteresis of the
height, a restless gap, hum, a preamplifier with pole, noise, offset of a few picoamperes and
16 bits. A second table clips the current at 1.2 nA, a third keeps the forward sweeps only.
"""

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from piezoid.identification.tunnelling.barrier_fit import GapLaw
from piezoid.identification.tunnelling.junction import fit_junction
from piezoid.numerics.arrays import Array
from piezoid.operators.tunnelling import decay_of_barrier
from piezoid.records.readers import read_table

RATE_Hz = 20000.0
CLIPPED_A = 1.2e-9
_ELECTRON_C = 1.602176634e-19
_JOHNSON_A2_PER_Hz = 4.0 * 1.380649e-23 * 293.0 / 1e9  # of one gigaohm


@dataclass(frozen=True, kw_only=True)
class SweptJunction:
    """One junction and the habits of its laboratory."""

    barrier_eV: float
    peak_A: float
    travel_m: float
    rows: int
    to_and_fro_s: float
    pairs: int
    drift_m_per_s: float
    drift_left_s: float
    hysteresis: float
    flicker_m: float
    hum_m: float
    hum_A: float
    offset_A: float
    pole_Hz: float
    polarity: float


def draw(rng: np.random.Generator) -> SweptJunction:
    """Return a junction as laboratories have them."""
    barrier_eV = float(rng.uniform(1.0, 5.0))
    decades = rng.uniform(5.0, 12.0)
    return SweptJunction(
        barrier_eV=barrier_eV,
        peak_A=float(np.exp(rng.uniform(math.log(0.05e-9), math.log(2e-9)))),
        travel_m=float(decades / decay_of_barrier(barrier_eV)),
        rows=int(rng.integers(100, 401)),
        to_and_fro_s=float(np.exp(rng.uniform(math.log(0.1), math.log(5.0)))),
        pairs=int(rng.integers(1, 4)),
        drift_m_per_s=float(rng.uniform(-100e-12, 100e-12)),
        drift_left_s=float(rng.uniform(20.0, 200.0)),
        hysteresis=float(rng.uniform(0.0, 0.03)) * bool(rng.random() < 0.5),
        flicker_m=float(rng.uniform(0.2e-12, 2e-12)),
        hum_m=float(rng.uniform(0.0, 2e-12)) * bool(rng.random() < 0.5),
        hum_A=float(rng.uniform(0.0, 3e-12)) * bool(rng.random() < 0.5),
        offset_A=float(3e-12 * rng.standard_normal()),
        pole_Hz=float(rng.uniform(2e3, 20e3)),
        polarity=float(rng.choice([-1.0, 1.0])),
    )


def record(junction: SweptJunction, rng: np.random.Generator, range_A: float) -> str:
    """Return a Z spectroscopy of the junction as Nanonis writes it."""
    columns, start_s = [], 0.0
    for _ in range(junction.pairs):
        columns += _to_and_fro(junction, rng, range_A, start_s)
        start_s += junction.to_and_fro_s + 0.2
    height_m = np.linspace(0.0, junction.travel_m, junction.rows)
    many = junction.pairs > 1
    names = [
        f"Current{f' [{n + 1:05d}]' if many else ''}{way} (A)"
        for n in range(junction.pairs)
        for way in ("", " [bwd]")
    ]
    rows = "\n".join(
        "\t".join(f"{value:.9e}" for value in row) for row in zip(height_m, *columns, strict=True)
    )
    return (
        f"Experiment\tZ spectroscopy\t\nBias>Bias (V)\t{0.05 * junction.polarity:g}\t\n\n[DATA]\n"
        + "\t".join(["Z rel (m)", *names])
        + f"\n{rows}\n"
    )


def _to_and_fro(
    junction: SweptJunction, rng: np.random.Generator, range_A: float, start_s: float
) -> tuple[Array, Array]:
    """One sweep: sampled at 20 kHz, averaged over each row's share of the time."""
    rows = junction.rows
    each = max(round(0.5 * junction.to_and_fro_s * RATE_Hz / rows), 1)
    samples = 2 * rows * each
    time_s = np.arange(samples) / RATE_Hz
    step = np.repeat(np.concatenate([np.arange(rows), np.arange(rows)[::-1]]), each)
    share = step / (rows - 1.0)
    back = np.arange(samples) >= rows * each
    opened = junction.hysteresis * share * (1.0 - share) * np.where(back, 1.0, -1.0)
    left_s = junction.drift_left_s
    decayed = np.exp(-start_s / left_s) * -np.expm1(-time_s / left_s)
    gap_m = junction.travel_m * (share + opened) + junction.drift_m_per_s * left_s * decayed
    gap_m = gap_m + junction.flicker_m * _flicker(rng, samples)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    hum = np.sin(2.0 * np.pi * 50.0 * time_s + phase)
    gap_m = gap_m + junction.hum_m * hum
    current_A = junction.peak_A * np.exp(-decay_of_barrier(junction.barrier_eV) * gap_m)
    half_Hz = 0.5 * RATE_Hz
    noise_A = np.sqrt((2.0 * _ELECTRON_C * current_A + _JOHNSON_A2_PER_Hz) * half_Hz)
    current_A = current_A + noise_A * rng.standard_normal(samples) + junction.hum_A * hum
    current_A = _low_pass(current_A, min(junction.pole_Hz, 0.4 * RATE_Hz))
    read_A = np.clip(junction.polarity * current_A + junction.offset_A, -range_A, range_A)
    read_A = np.round(read_A / (10e-9 / 2**15)) * (10e-9 / 2**15)
    means = read_A.reshape(2 * rows, each).mean(axis=1)
    return means[:rows], means[rows:][::-1]


def _flicker(rng: np.random.Generator, samples: int) -> Array:
    """Noise of a power that falls with the frequency, rms 1 within a second."""
    spectrum = np.fft.rfft(rng.standard_normal(samples))
    frequency_Hz = np.fft.rfftfreq(samples, 1.0 / RATE_Hz)
    frequency_Hz[0] = frequency_Hz[1]
    shaped = np.fft.irfft(spectrum / np.sqrt(frequency_Hz), samples)
    scale = math.sqrt(np.sum(1.0 / frequency_Hz) / len(frequency_Hz))
    return np.asarray((shaped - shaped[0]) / scale)


def _low_pass(signal: Array, pole_Hz: float) -> Array:
    from scipy.signal import lfilter

    left = math.exp(-2.0 * math.pi * pole_Hz / RATE_Hz)
    return np.asarray(lfilter([1.0 - left], [1.0, -left], signal, zi=[left * signal[0]])[0])


def forward_only(text: str) -> str:
    """Return the file without its backward columns."""
    head, _, body = text.partition("[DATA]\n")
    rows = [row.split("\t") for row in body.rstrip().split("\n")]
    kept = [place for place, name in enumerate(rows[0]) if "[bwd]" not in name]
    return f"{head}[DATA]\n" + "\n".join("\t".join(row[k] for k in kept) for row in rows) + "\n"


def fitted(text: str, folder: Path) -> GapLaw:
    """Return what a file says of the barrier."""
    path = folder / "z.dat"
    path.write_text(text)
    law = fit_junction([read_table(path)]).gap_law
    if law is None:
        raise ValueError("sweeps without a law")
    return law


def compare(title: str, seeds: Sequence[int], written: Callable[[int], tuple[str, float]]) -> str:
    """Return one table's summary over the seeds."""
    held, widths, misses, high = 0, [], [], 0
    with TemporaryDirectory() as place:
        for seed in seeds:
            text, truth_eV = written(seed)
            law = fitted(text, Path(place))
            low, top = law.barrier_interval_eV
            inside = low <= truth_eV <= top
            held += inside
            widths.append((top - low) / truth_eV)
            sure = law.confidence.value == "high"
            high += sure
            if not inside:
                off = 100.0 * (law.barrier_eV / truth_eV - 1.0)
                misses.append(f"{seed} ({off:+.1f} %{', high confidence' if sure else ''})")
    count = len(seeds)
    return (
        f"{title}: {held} of {count} hold the truth ({100.0 * held / count:.1f} %); median width "
        f"{100.0 * float(np.median(widths)):.1f} % of the barrier; {high} of high confidence\n"
        f"  missed by seeds: {', '.join(misses) or 'none'}\n"
    )


def written_both(seed: int) -> tuple[str, float]:
    """Return sweeps of either direction and the true barrier."""
    rng = np.random.default_rng([seed, 20261])
    junction = draw(rng)
    return record(junction, rng, 10e-9), junction.barrier_eV


def written_forward(seed: int) -> tuple[str, float]:
    """Return the forward sweeps alone."""
    text, barrier_eV = written_both(seed)
    return forward_only(text), barrier_eV


def written_clipped(seed: int) -> tuple[str, float]:
    """Return sweeps that start at up to five times what the preamplifier can show."""
    rng = np.random.default_rng([seed, 20262])
    junction = draw(rng)
    junction = replace(junction, peak_A=float(rng.uniform(1.5, 5.0)) * CLIPPED_A)
    return record(junction, rng, CLIPPED_A), junction.barrier_eV


if __name__ == "__main__":
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 120
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    every = range(first, first + number)
    sys.stdout.write(f"seeds {first} to {first + number - 1}\n")
    sys.stdout.write(compare("to and fro", every, written_both))
    sys.stdout.write(compare("clipped at 1.2 nA", every, written_clipped))
    sys.stdout.write(compare("forward only", every, written_forward))
