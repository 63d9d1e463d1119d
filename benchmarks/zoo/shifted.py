"""Placebos made of the data at hand, shifted and reversed columns, as the null of an effect.

    python -m benchmarks.zoo.shifted [--cases 1] [--seeds 3200000]

On healthy stages of every law each effect of the catalogue gets its score test, with initial
states of every recording's own. Its gain on blocks left out,

    g = -n log(rms with / rms without),   n blocks,

is held against those of its own columns rolled by chance along each recording, every other one
run backwards; an exponential tail above their median gives small probabilities, times the number
of effects tried (Bonferroni). Printed are the effects below 5 %: a null that holds accuses one
stage in twenty. What hysteresis leaves is locked to the drive, and so are the columns of an
effect, but not where they are rolled.
"""

import argparse
from dataclasses import dataclass
from itertools import pairwise
from math import log

import numpy as np

from benchmarks.zoo.score import recorded
from benchmarks.zoo.stages import NAMES, Asked, drawn, stage
from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.initial_state_search import (
    with_individual_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.score_test import ScoreTest, null_of, score_test
from piezoid.diagnosis.segments import BLOCKS
from piezoid.diagnosis.selection import repair_faults
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import SERIAL

PLACEBOS = 40
LEVEL = 0.05
NEAREST = 0.05  # of a recording: the least that columns are rolled by


@dataclass(frozen=True, kw_only=True)
class Accused:
    """An effect that its shifted placebos make evident.

    gain     1 - rms with / rms without
    p_value  times the number of effects tried
    """

    name: str
    gain: float
    p_value: float


def accused(asked: Asked) -> list[Accused]:
    """Return what a stage is accused of by this null."""
    recordings, lab = recorded(drawn(asked))
    clean, _, _ = repair_faults(view_on(recordings, axis="x", lab=lab), SERIAL)
    view = with_individual_initial_states(clean, with_shared_initial_state(clean, SERIAL))
    view = min(clean, view, key=lambda one: one.rms)
    tests = [one for one in map(lambda effect: _tested(effect, view), EFFECTS) if one is not None]
    tried = [(one, len(tests) * _p_value(one, view)) for one in tests]
    return [
        Accused(name=one.effect.name, gain=one.cv.gain, p_value=p) for one, p in tried if p < LEVEL
    ]


def _tested(effect: Effect, view: View) -> ScoreTest | None:
    if effect.structural is not None or effect.untestable(view):
        return None
    found = score_test(effect, view)
    return found if found is not None and found.physical else None


def _p_value(found: ScoreTest, view: View) -> float:
    null, chance = null_of(found.effect, view), np.random.default_rng(5)
    placebos = [
        _nats(null, _moved(found.trial.columns, null, chance, backwards=j % 2 == 1))
        for j in range(PLACEBOS)
    ]
    own, middle = -len(null.edges) * log(1.0 - found.cv.gain), float(np.median(placebos))
    beyond = [one - middle for one in placebos if one >= middle]
    if own <= middle:
        return 1.0
    return 0.5 * float(np.exp(-(own - middle) / max(float(np.mean(beyond)), 1e-9)))


def _nats(null: Null, columns: Array) -> float:
    return -len(null.edges) * log(1.0 - null.cross_validated(columns).gain)


def _moved(columns: Array, null: Null, chance: np.random.Generator, *, backwards: bool) -> Array:
    recording = null.block // BLOCKS
    edges = [0, *(np.flatnonzero(np.diff(recording)) + 1).tolist(), len(recording)]
    moved = np.empty_like(columns)
    for first, last in pairwise(edges):
        own = columns[first:last][::-1] if backwards else columns[first:last]
        near = max(1, int(NEAREST * (last - first)))
        moved[first:last] = np.roll(own, chance.integers(near, last - first - near), axis=0)
    return moved


def main() -> None:
    """Print a line for each stage, then how many were accused."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--cases", type=int, default=1, help="of each law")
    parser.add_argument("--seeds", type=int, default=3_200_000, help="the first of them")
    asked = parser.parse_args()
    wrong = 0
    stages = [
        stage(law, "healthy", number, asked.seeds)
        for number in range(asked.cases)
        for law in NAMES
    ]
    for one in stages:
        found = accused(one)
        wrong += bool(found)
        words = ", ".join(f"{f.name} (gain {f.gain:.1%}, p {f.p_value:.1g})" for f in found)
        print(f"{one.law} {one.seed}: {words or 'nothing'}", flush=True)
    print(f"{wrong} of {len(stages)} healthy stages accused at {LEVEL:.0%}")


if __name__ == "__main__":
    main()
