"""How much healthy stages show: the null of what is left, and of every cause that is named.

Hysteresis of another law than the class follows leaves a remainder that lives somewhere, and no
shuffling of it tells that from an effect nobody has named. So its score,

    s = g (rms / noise)^2,

g the part of its power that the best coordinate explains on blocks left out, is held against the
scores of healthy stages of all laws of the zoo. Its rank among n of them is a probability,

    p = (1 + #{s_i >= s}) / (n + 1),

exactly uniform for a healthy stage that is exchangeable with these, whatever the score is: no
threshold is typed in. A cause is held in the same way against the strongest that the diagnosis of
a healthy stage came upon, named or dismissed: its rms over that of the structure left beside it.
That probability is of any finding in the whole diagnosis, hence no factor for many effects. What
goes wrong: these stages have pasts, so evidence of an initial state is left out of the table, and
a named initial state is only ranked beside the evidence of other effects.
``python -m benchmarks.zoo.healthy`` makes the table.

Source: Vovk, Gammerman & Shafer, Algorithmic Learning in a Random World (2005), conformal p.
"""

import json
from collections.abc import Iterable
from functools import cache
from importlib.resources import files


def score_of(gain: float, rms: float, noise: float) -> float:
    """Return the power that one coordinate explains, in units of the noise's.

        gain rms^2 / min(noise^2, (1 - gain) rms^2)

    gain  part of the remainder's power that the coordinate explains on blocks left out

    What repeats within a few samples passes for white noise; what a coordinate explains is none.
    """
    gain = min(max(gain, 0.0), 1.0)
    left = min(noise**2, (1.0 - gain) * rms**2)
    return gain * rms**2 / max(left, 1e-300)


def chance_of(score: float, healthy: Iterable[float] | None = None) -> float:
    """Return the probability that a healthy stage scores as much.

    healthy  scores of healthy stages; None: those of the table

    >>> chance_of(3.0, [0.1, 0.5, 4.0])
    0.5
    """
    scores = list(_table("scores") if healthy is None else healthy)
    return (1.0 + sum(one >= score for one in scores)) / (len(scores) + 1.0)


def strengths_of_healthy() -> tuple[float, ...]:
    """Return the strength of the strongest evidence in each healthy stage; 0 where none was."""
    return _table("strengths")


def least_chance() -> float:
    """Return the smallest probability that the table can say: no healthy stage leaves as much."""
    return chance_of(float("inf"))


@cache
def _table(kind: str) -> tuple[float, ...]:
    table = json.loads(files(__package__).joinpath("healthy_scores.json").read_text("utf-8"))
    return tuple(one for of_law in table[kind].values() for one in of_law)
