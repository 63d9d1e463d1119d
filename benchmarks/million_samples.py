"""Time and memory of a fit of a million samples, including the thresholds.

    python -m benchmarks.million_samples [SAMPLES]

The stage has 16 plays and 12 dead zones and a drive at 2 Hz. The fit consists of a search on
thinned rows and of iterations on all rows. Times are processor times, in units of a simulation.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.recordings import recording_of
from benchmarks.speed.loops import numpy_sum
from benchmarks.speed.stopwatch import Stopwatch, peak_megabytes, used_s
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.gauss_newton import HysteresisFit, Task, minimise, rms_of
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings, search
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.records.recording import Recording

RATE_Hz = 20_000.0
NOISE_m = 10e-9
LOOP_SAMPLES = 20_000  # of the NumPy loop
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
class TimedFit:
    """Fits to thinned and to all rows, and the time until each."""

    thinned: HysteresisFit
    final: HysteresisFit
    thinned_s: float
    total_s: float


def drive_V(samples: int) -> Array:
    """Return a sine at 2 Hz with modulated amplitude, which covers all levels."""
    t = np.arange(samples) / RATE_Hz
    swell = 0.05 + 0.95 * np.abs(np.cos(np.pi * t / t[-1] * 3))
    return np.asarray(5.0 * swell * np.sin(2 * np.pi * 2.0 * t))


def recording(samples: int) -> Recording:
    """Return drive and displacement of the stage with noise."""
    u_V = drive_V(samples)
    h_m, _ = PLAYS.run(u_V, PLAYS.virgin_memory())
    y_m = ZONES.run(h_m) + NOISE_m * np.random.default_rng(1).standard_normal(samples)
    return recording_of(u_V, y_m, RATE_Hz)


def fit(data: Recording) -> TimedFit:
    """Fit a recording without prior knowledge."""
    start_s = used_s()
    pieces = pieces_of([data], "x", scales_of([data], "x"), Rig())
    thinned = search(pieces, SHAPE, SETTINGS)
    thinned_s = used_s() - start_s
    final = minimise(thinned.theta, every_sample(thinned.task), iterations=4)
    return TimedFit(thinned=thinned, final=final, thinned_s=thinned_s, total_s=used_s() - start_s)


def every_sample(task: Task) -> Task:
    """Return the task with every sample fitted."""
    return replace(task, samples=[piece.fitted_samples() for piece in task.pieces])


def loop_s(watch: Stopwatch, data: Recording) -> float:
    """Return the time of one simulation of the plays by a NumPy loop over the samples."""
    voltage_V = data.voltage_V()[:LOOP_SAMPLES]
    time_s = watch.cpu_s(lambda: numpy_sum(voltage_V, PLAYS, PLAYS.virgin_memory()))
    return time_s * data.samples / len(voltage_V)


def main(arguments: Sequence[str] | None = None, *, watch: Stopwatch = PATIENT) -> None:
    """Print the figures."""
    arguments = sys.argv[1:] if arguments is None else arguments
    data = recording(int(arguments[0]) if arguments else 1_000_000)
    initial_megabytes = peak_megabytes()
    timed = fit(data)
    final_megabytes, task = peak_megabytes(), every_sample(timed.thinned.task)
    forward_s = watch.cpu_s(lambda: rms_of(timed.final.theta, task))
    residual_nm = 1e9 * timed.final.rms * abs(scales_of([data], "x").displacement_m)
    print(f"{data.samples} samples, 16 plays and 12 dead zones, thresholds included:")
    print(f"  the fit takes as long as {timed.total_s / forward_s:.0f} simulations of its model,")
    print(f"  or {timed.total_s / loop_s(watch, data):.2g} runs of its plays in a NumPy loop,")
    print(f"  {timed.thinned_s / timed.total_s:.0%} of it on thinned rows;")
    print(f"  {timed.total_s:.1f} s of processor time")
    print(f"  residual {residual_nm:.2f} nm, noise {1e9 * NOISE_m:.0f} nm")
    print(f"  peak memory {final_megabytes:.0f} MB, {initial_megabytes:.0f} MB before the fit")


if __name__ == "__main__":
    main()
