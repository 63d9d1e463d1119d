"""Open-loop drive of every law of the zoo through the inverse of its model.

    python -m benchmarks.open_loop [LAW...]

Each law is fitted to a decaying sweep and a walk between random levels. The inverses of the plays,
with and without loop shape, then drive it along triangles of three amplitudes and two tones, which
were not recorded. Errors are rms over the sensor noise.
"""

import sys

import numpy as np

from benchmarks.recordings import polyline
from piezoid.identification.fit import fit_axis
from piezoid.numerics.arrays import Array
from piezoid.records.frames import from_arrays
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.truths import ZOO

NOISE_M, RANGE_M, HALF_V, RATE_Hz = 8e-9, 2e-5, 5.0, 400.0
CYCLE = np.array([0.0, 1.0, -1.0, 1.0, -1.0])
APPROACH = 300  # samples before the error is evaluated
DENSITY = 60  # samples per half range


class Stage:
    """A ceramic of the virtual laboratory with sensor noise."""

    def __init__(self, law: str) -> None:
        truth = next(truth for truth in ZOO if truth.name == law)
        self.ceramic = truth.draw(np.random.default_rng(5))

    def position_m(self, field: Array) -> Array:
        """Return the position along a drive in half ranges, after two full cycles."""
        cycles = np.tile(polyline(CYCLE, DENSITY), 2)
        path = np.concatenate([cycles, field])
        return RANGE_M * np.add(*self.ceramic.respond(path, np.zeros(0)))[len(cycles) :]

    def record(self, field: Array, name: str) -> Recording:
        """Record a drive."""
        noise_m = NOISE_M * np.random.default_rng(len(field)).standard_normal(len(field))
        return from_arrays(
            voltage_V=HALF_V * field,
            displacement_m=self.position_m(field) + noise_m,
            sampling_rate_Hz=RATE_Hz,
            axis="x",
            name=name,
        )


def reference(low_m: float, high_m: float) -> Array:
    """Return a ramp to the middle, triangles of three amplitudes, and two tones."""
    middle_m, half_m = 0.5 * (low_m + high_m), 0.5 * (high_m - low_m)
    turn = np.linspace(0.0, 1.0, 4000)
    amplitude = np.select([turn < 1 / 3, turn < 2 / 3], [0.8, 0.5], 0.25)
    triangles = amplitude * 2.0 / np.pi * np.arcsin(np.sin(12.0 * np.pi * turn))
    tones = 0.35 * np.sin(10.0 * np.pi * turn) + 0.3 * np.sin(26.0 * np.pi * turn)
    begin_m = np.linspace(low_m, middle_m, 200)
    return np.concatenate([begin_m, middle_m + half_m * np.concatenate([triangles, tones])])


def main() -> None:
    print("| law | held-out error: plays | with loop shape | open loop: plays | with loop shape |")
    print("| --- | --- | --- | --- | --- |")
    for law in sys.argv[1:] or [truth.name for truth in ZOO]:
        stage = Stage(law)
        levels = np.random.default_rng(1).uniform(-1.0, 1.0, 30)
        sweep = np.linspace(1.0, 0.05, 31) * (-1.0) ** np.arange(31)
        recordings = [
            stage.record(polyline(np.concatenate([[-1.0], sweep]), DENSITY), "sweep"),
            stage.record(polyline(np.concatenate([[-1.0, 1.0, -1.0], levels]), DENSITY), "walk"),
        ]
        model = fit_axis(recordings, "x", Lab())
        ends_m = stage.position_m(polyline(np.array([-1.0, 1.0]), DENSITY))[[0, -1]]
        reference_m = reference(*ends_m.tolist())
        held_out, open_loop = [], []
        for axis in (model.without_loop_shape(), model):
            voltage_V = axis.inverse(reference_m, axis.memory_after(HALF_V * CYCLE))
            error_m = (stage.position_m(voltage_V / HALF_V) - reference_m)[APPROACH:]
            held_out.append(axis.quality.held_out_rms_m / NOISE_M)
            open_loop.append(float(np.std(error_m)) / NOISE_M)
        cells = " | ".join(f"{value:.2f}" for value in (*held_out, *open_loop))
        print(f"| {law} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
