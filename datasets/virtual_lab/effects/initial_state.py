"""Initial state: the memory depends on a drive before the recording.

Before a recording a laboratory cycles the drive over its range, so that the memory is defined.
Here the drive was not cycled, but turned at a few other voltages before the start of the
recording. The error vanishes gradually as the recorded drive covers the range.

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
from piezoid_datasets.virtual_lab.truths.truth import branches, settled

PASTS = 60  # simulated histories
REACH = 1.0  # of the field: what a past saw beyond the drive range, no record would ever forget
LOOKED_AT = 2000  # samples of each recording, in addition to its reversals


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Simulate random histories of every recording and select the closest to the size."""
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
    """Return a path with the same reversals and fewer samples; the strain is rate independent."""
    reversals = [start for start, _, _ in branches(settled(field))]
    even = range(0, len(field), max(len(field) // LOOKED_AT, 1))
    return np.asarray(field[np.unique([*reversals, *even])])


def _strain(bench: Bench, field: Array, past: Array) -> Array:
    reversible, irreversible = bench.ceramic.respond(field, past)
    return reversible + irreversible


def _random_turns(first: float, rng: np.random.Generator) -> Array:
    """Return turning points that alternate around the start of the recording and approach it."""
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
