"""Initial state: the stage remembers what nobody recorded.

Before a recording a lab cycles the drive over its range, so that the memory is known. Here that
was forgotten: the drive turned at a few other voltages before it came to where the record starts.
The error ends, by and by, as the record itself visits the range.

Source: Mayergoyz, Mathematical Models of Hysteresis (1991), on the past a Preisach state keeps.
"""

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Act,
    Bench,
    Effect,
    Fault,
    Measure,
    Place,
    Trace,
)
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.branches import branches, settled

PASTS = 60  # tried; the one that comes nearest to the size is taken
REACH = 1.0  # of the field: what a past saw beyond the drive range, no record would ever forget
LOOKED_AT = 2000  # instants of each recording, besides its reversals


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Try random pasts for every recording and keep the one nearest to the size."""
    pasts = {trace.scene.order: _past(size_m, bench, trace, rng) for trace in bench.traces}
    act = Act(
        name=EFFECT.name,
        place=Place.HISTORY,
        change=lambda _known, scene, _: pasts[scene.order],
    )
    numbers: dict[str, float | str] = {
        f"turns_before_recording_{order}": " ".join(f"{field:.4f}" for field in past)
        for order, past in pasts.items()
    }
    return Fault(acts=(act,), numbers=numbers)


def _past(size_m: float, bench: Bench, trace: Trace, rng: np.random.Generator) -> Array:
    field = _thinned(trace.scene.field)
    known = _strain(bench, field, trace.history)
    tried = [_random_turns(float(field[0]), rng) for _ in range(PASTS)]
    misses = [
        abs(EFFECT.measure.of(bench.rig.stroke_m * (_strain(bench, field, past) - known)) - size_m)
        for past in tried
    ]
    return tried[int(np.argmin(misses))]


def _thinned(field: Array) -> Array:
    """Return a path with the same reversals and fewer instants; strain does not know its speed."""
    reversals = [start for start, _, _ in branches(settled(field))]
    even = range(0, len(field), max(len(field) // LOOKED_AT, 1))
    return np.asarray(field[np.unique([*reversals, *even])])


def _strain(bench: Bench, field: Array, past: Array) -> Array:
    reversible, irreversible = bench.ceramic.respond(field, past)
    return reversible + irreversible


def _random_turns(first: float, rng: np.random.Generator) -> Array:
    """Return turns that alternate about where the record starts, shrinking towards it."""
    count = int(rng.integers(1, 6))
    reach = np.sort(rng.uniform(0.05, 1.0, count))[::-1]
    side = float(rng.choice([-1.0, 1.0])) * (-1.0) ** np.arange(count)
    edge = np.where(side > 0.0, REACH - first, REACH + first)
    return np.asarray(first + side * edge * reach)


EFFECT = Effect(
    name="initial_state",
    measure=Measure.PEAK,
    visible_percent=0.8,
    shown_by=("sweep",),
    install=install,
)
