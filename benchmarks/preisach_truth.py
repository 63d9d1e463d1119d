"""Prediction error of the model on ceramics that are no sum of plays.

    python -m benchmarks.preisach_truth [DRAWS]

For each ceramic of the virtual laboratory, the model is fitted to a decaying sweep. It then
predicts a decaying sweep of other levels and a walk between random levels, where only zero and
initial memory are fitted. The errors include white noise of 0.05 % of the stroke.
"""

import sys

import numpy as np

from benchmarks.recordings import polyline, recording_of
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings, refit_initial_state, search
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.truths import TRUTHS

STROKE_m = 30e-6
NOISE = 5e-4
HISTORY = np.array([1.0, -1.0, 0.8, -0.7, 0.5, -0.4, 0.2, 0.0])
SHAPES = (
    Shape(plays=16, below=6, above=6),
    Shape(plays=16, below=6, above=6, bends=6),
)


def fields(rng: np.random.Generator) -> list[Array]:
    """Return a sweep for the fit, a sweep of other levels, and a random walk."""
    sweeps = [
        np.concatenate([[0.0, -1.0], np.linspace(top, 0.05, n) * (-1.0) ** np.arange(n)])
        for n, top in ((41, 1.0), (22, 0.93))
    ]
    walk = np.r_[0.0, rng.uniform(-1, 1, 40)]
    return [polyline(levels, 75) for levels in (*sweeps, walk)]


def recordings(rng: np.random.Generator, truth: str) -> list[Recording]:
    """Return three recordings of one ceramic."""
    ceramic = next(t for t in TRUTHS if t.name == truth).draw(rng)
    drives = fields(rng)
    strains = [np.add(*ceramic.respond(field, HISTORY)) for field in drives]
    stroke = max(float(np.ptp(strain)) for strain in strains)
    return [
        recording_of(
            5 + 5 * field,
            (strain / stroke + NOISE * rng.standard_normal(len(field))) * STROKE_m,
            500.0,
            name,
        )
        for name, field, strain in zip("abc", drives, strains, strict=True)
    ]


def main() -> None:
    """Print rms in percent of the stroke for every ceramic."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 6
    settings = Settings(longest_lag_s=0.02, follow_zero=False, iterations=40)
    print("rms in % of the stroke: fitted sweep, other sweep, random walk")
    for truth in (t.name for t in TRUTHS):
        rows: list[list[float]] = []
        for seed in range(draws):
            measured = recordings(np.random.default_rng(seed), truth)
            scales = scales_of(measured, "x")
            pieces = pieces_of(measured, "x", scales, Rig())
            percent = 100 * abs(scales.displacement_m) / STROKE_m
            row: list[float] = []
            for shape in SHAPES:
                fit = search(pieces[:1], shape, settings)
                predictions = [refit_initial_state(fit, [piece]).rms for piece in pieces[1:]]
                row += [percent * rms for rms in (fit.rms, *predictions)]
            rows.append(row)
            figures = "  ".join(f"{value:.3f}" for value in row)
            print(f"{truth:12s} {seed}: Kuhnen's model, then with envelope: {figures}")
        figures = "  ".join(f"{value:.3f}" for value in np.median(rows, axis=0))
        print(f"{truth:12s} median:                                   {figures}")


if __name__ == "__main__":
    main()
