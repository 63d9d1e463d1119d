"""Open-loop drive of every law of the zoo through the inverse of its model.

    python -m benchmarks.open_loop [LAW...]

Each law is fitted to a decaying sweep and a walk between random levels. The inverse of the plays
alone, and that with loop shape, then lead the law along triangles of three amplitudes and two
tones, which were not recorded. Errors are rms in units of the sensor noise.
"""

import sys
from itertools import pairwise

import numpy as np

from piezoid.identification.fit import fit_axis
from piezoid.numerics.arrays import Array
from piezoid.records.frames import from_arrays
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.truths import ZOO

NOISE_M, RANGE_M, HALF_V, RATE_Hz = 8e-9, 2e-5, 5.0, 400.0
CYCLE = np.array([0.0, 1.0, -1.0, 1.0, -1.0])
SETTLED = 300  # samples of the way to the middle of the range


def through(levels: Array) -> Array:
    """Return a drive at constant speed through turning points."""
    runs = [np.linspace(a, b, int(60 * abs(b - a)) + 3)[1:] for a, b in pairwise(levels)]
    return np.concatenate([levels[:1], *runs])


class Stage:
    """A ceramic of the virtual laboratory with sensor noise."""

    def __init__(self, law: str) -> None:
        truth = next(truth for truth in ZOO if truth.name == law)
        self.ceramic = truth.draw(np.random.default_rng(5))

    def position_m(self, field: Array) -> Array:
        """Return the position along a drive in half ranges, after two full cycles."""
        before = np.tile(through(CYCLE), 2)
        path = np.concatenate([before, field])
        return RANGE_M * np.add(*self.ceramic.respond(path, np.zeros(0)))[len(before) :]

    def recorded(self, field: Array, name: str) -> Recording:
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
    """Return the way to the middle, triangles of three amplitudes, and two tones."""
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
            stage.recorded(through(np.concatenate([[-1.0], sweep])), "sweep"),
            stage.recorded(through(np.concatenate([[-1.0, 1.0, -1.0], levels])), "walk"),
        ]
        model = fit_axis(recordings, "x", Lab())
        ends_m = stage.position_m(through(np.array([-1.0, 1.0])))[[0, -1]]
        reference_m = reference(*ends_m.tolist())
        held_out, open_loop = [], []
        for axis in (model.without_loop_shape(), model):
            voltage_V = axis.inverse(reference_m, axis.memory_after(HALF_V * CYCLE))
            error_m = (stage.position_m(voltage_V / HALF_V) - reference_m)[SETTLED:]
            held_out.append(axis.quality.held_out_rms_m / NOISE_M)
            open_loop.append(float(np.std(error_m)) / NOISE_M)
        cells = " | ".join(f"{value:.2f}" for value in (*held_out, *open_loop))
        print(f"| {law} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
