"""Interface of a hysteresis law: a rate-independent ceramic, drawn from a seed.

The memory of a law is computed branch by branch, without a Python loop over samples.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array

# Maps a path of fields to the irreversible part of the strain at each of its points. The path
# starts at FLOOR, where no ceramic has any memory.
Memory = Callable[[Array], Array]
Curve = Callable[[Array], Array]

FLOOR = -3.0
ROUNDING = 13  # decimals of the field; the last bit of a filter's output is not a reversal


@dataclass(frozen=True, kw_only=True)
class Ceramic:
    """A quasi-static piezo ceramic: strain as a rate-independent functional of the field.

        strain[field] = (1 - p) reversible(field) + p irreversible[field]

    Both parts run from 0 to 1 over the major loop between field -1 and 1; ``p`` determines the
    opening of that loop.
    """

    share: float
    reversible_curve: Curve
    memory: Memory

    def respond(self, field: Array, history: Array) -> tuple[Array, Array]:
        """Return (reversible, irreversible) strain; they add up to the strain.

        field    (samples,)  -1 to 1 is the nominal range
        history  (turns,)    fields at which the drive turned before the first sample
        """
        path = np.concatenate(([FLOOR], history, field))
        irreversible = self.memory(path)[len(history) + 1 :]
        return (1.0 - self.share) * self.reversible_curve(field), self.share * irreversible


@dataclass(frozen=True, kw_only=True)
class Truth:
    """A type of ceramic.

    name  in truth.json and on the command line
    draw  returns a random ceramic
    """

    name: str
    draw: Callable[[np.random.Generator], Ceramic]


def draw_ceramic(
    rng: np.random.Generator, memory: Memory, opening: tuple[float, float] = (0.08, 0.14)
) -> Ceramic:
    """Draw a reversible part with a curvature of a few percent, and an opening from a range."""
    bend, flex = rng.uniform(-0.06, 0.06), rng.uniform(-0.05, 0.02)
    return ceramic_with_opening(
        float(rng.uniform(*opening)),
        lambda field: field + bend * field**2 + flex * field**3,
        memory,
    )


def ceramic_with_opening(opening: float, reversible: Curve, memory: Memory) -> Ceramic:
    """Normalise both parts over the major loop and combine them for a given opening.

    opening  largest vertical distance between the branches of the major loop, as a fraction of
             the stroke
    """
    up = np.linspace(-1.0, 1.0, 401)
    path = np.concatenate(([FLOOR, 1.0], up[::-1], up))
    loop = memory(path)[2:]
    falling, rising = loop[: len(up)][::-1], loop[len(up) :]
    low, span = float(rising[0]), float(rising[-1] - rising[0])
    widest = float(np.max(falling - rising)) / span
    share = opening / widest
    if not 0.0 < share < 1.0:
        raise ValueError(f"an opening of {opening:.3f} needs {share:.2f} of the strain")
    strain = reversible(np.array([-1.0, 1.0]))
    start, rise = float(strain[0]), float(strain[1] - strain[0])
    return Ceramic(
        share=share,
        reversible_curve=lambda field: (reversible(field) - start) / rise,
        memory=lambda path: (memory(path) - low) / span,
    )


def settled(field: Array) -> Array:
    """Return the field without rounding noise, which would create reversals."""
    return np.round(field, ROUNDING)


def branches(path: Array) -> Iterator[tuple[int, int, bool]]:
    """Yield ``(start, end, rising)`` of each monotone branch; neighbours share a sample.

    Pauses belong to the preceding branch; a constant path has no branch.
    """
    steps = np.sign(np.diff(path))
    moving = np.flatnonzero(steps)
    if len(moving) == 0:
        return
    turns = moving[1:][steps[moving[1:]] != steps[moving[:-1]]]
    edges = [0, *turns.tolist(), len(path) - 1]
    rising = bool(steps[moving[0]] > 0)
    for start, end in itertools.pairwise(edges):
        yield start, end, rising
        rising = not rising
