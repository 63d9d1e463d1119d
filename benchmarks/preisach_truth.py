"""How well the model predicts a Preisach ceramic, which is no sum of plays.

    python benchmarks/preisach_truth.py [DRAWS]

For each drawn ceramic of the virtual laboratory: fit on a decaying sweep, then simulate a decaying
sweep of other levels and a walk between random levels, zero and initial memory being all that is
fitted there. White noise of 0.05 % of the stroke is added everywhere and is part of the figures.
"""

import itertools
import sys

import numpy as np

from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings, refit_initial_state, search
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid_datasets.virtual_lab.truths import TRUTHS

STROKE_m = 30e-6
NOISE = 5e-4
PAST = np.array([1.0, -1.0, 0.8, -0.7, 0.5, -0.4, 0.2, 0.0])
SHAPES = (
    Shape(plays=16, below=6, above=6),
    Shape(plays=16, below=6, above=6, bends=6),
)


def through(levels: Array) -> Array:
    """Straight runs between levels, 75 samples a unit of field."""
    runs = [np.linspace(a, b, int(75 * abs(b - a)) + 3)[1:] for a, b in itertools.pairwise(levels)]
    return np.concatenate([levels[:1], *runs])


def fields(rng: np.random.Generator) -> list[Array]:
    """A sweep to fit, a sweep of other levels, a random walk."""
    sweeps = [
        np.concatenate([[0.0, -1.0], np.linspace(top, 0.05, n) * (-1.0) ** np.arange(n)])
        for n, top in ((41, 1.0), (22, 0.93))
    ]
    return [through(levels) for levels in (*sweeps, np.r_[0.0, rng.uniform(-1, 1, 40)])]


def recordings(rng: np.random.Generator, truth: str) -> list[Recording]:
    """Record one drawn ceramic three times."""
    ceramic = next(t for t in TRUTHS if t.name == truth).draw(rng)
    drives = fields(rng)
    strains = [np.add(*ceramic.respond(field, PAST)) for field in drives]
    stroke = max(float(np.ptp(strain)) for strain in strains)
    made = []
    for name, field, strain in zip("abc", drives, strains, strict=True):
        noise = NOISE * rng.standard_normal(len(field))
        columns = (
            (Quantity.VOLTAGE, 5 + 5 * field),
            (Quantity.DISPLACEMENT, strain / stroke + noise),
        )
        channels = tuple(
            Channel(
                quantity=quantity,
                axis="x",
                values=values * (STROKE_m if quantity is Quantity.DISPLACEMENT else 1.0),
                label=quantity.name,
            )
            for quantity, values in columns
        )
        made.append(
            Recording(name=name, digest="", axis="x", sampling_rate_Hz=500.0, channels=channels)
        )
    return made


def main() -> None:
    """Print rms in percent of the stroke for every ceramic."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 6
    settings = Settings(longest_lag_s=0.02, follow_zero=False, iterations=40)
    print("rms in % of the stroke: fitted sweep, other sweep, random walk")
    for truth in (t.name for t in TRUTHS):
        kept: list[list[float]] = []
        for seed in range(draws):
            made = recordings(np.random.default_rng(seed), truth)
            scales = scales_of(made, "x")
            pieces = pieces_of(made, "x", scales, Rig())
            percent = 100 * abs(scales.displacement_m) / STROKE_m
            row: list[float] = []
            for shape in SHAPES:
                fitted = search(pieces[:1], shape, settings)
                others = [refit_initial_state(fitted, [piece]).rms for piece in pieces[1:]]
                row += [percent * rms for rms in (fitted.rms, *others)]
            kept.append(row)
            figures = "  ".join(f"{value:.3f}" for value in row)
            print(f"{truth:12s} {seed}: Kuhnen's model, then with envelope: {figures}")
        figures = "  ".join(f"{value:.3f}" for value in np.median(kept, axis=0))
        print(f"{truth:12s} median:                                   {figures}")


if __name__ == "__main__":
    main()
