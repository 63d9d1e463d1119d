"""Which stages are asked for: every law, and on each healthy ones, singles, pairs and triples.

Full size is four times what a person sees by eye; a quarter is what a person just sees. Every
stage stands in a laboratory of its own: other instruments, pasts, zeros; three to six recordings,
of which some show nothing that is hidden (an axis that moves unfelt, holds without creep).
"""

from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.zoo.score import Asked
from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign
from piezoid_datasets.virtual_lab.effects import EFFECTS
from piezoid_datasets.virtual_lab.laboratory import draw_laboratory
from piezoid_datasets.virtual_lab.truths import ZOO

FULL = 4.0  # times what is visible
HIDDEN = tuple(e.name for e in EFFECTS if e.name != "asymmetry")  # the simulation has dead zones
VISIBLE = {effect.name: effect.visible_percent for effect in EFFECTS}
# kind -> effects at once, part of full size
KINDS: dict[str, tuple[int, float]] = {
    "healthy": (0, 1.0),
    "single": (1, 1.0),
    "half": (1, 0.5),
    "quarter": (1, 0.25),
    "pair": (2, 1.0),
    "triple": (3, 1.0),
}
# a stage has the same seed whatever else is asked for, so that runs can be resumed and joined
PER_KIND = 1000
PER_LAW = PER_KIND * len(KINDS)
NAMES = tuple(truth.name for truth in ZOO)


def asked_for(
    laws: Sequence[str], kinds: Sequence[str], cases: int, first: int
) -> Iterator[Asked]:
    """Yield stages, one of each law and kind in turn, so that a run cut short is a small one."""
    for number in range(cases):
        for kind in kinds:
            for law in laws:
                yield stage(law, kind, number, first)


def stage(law: str, kind: str, number: int, first: int) -> Asked:
    """Return the stage of a number; singles take the effects in turn, from law to law others."""
    place, (count, size) = NAMES.index(law), KINDS[kind]
    seed = first + place * PER_LAW + list(KINDS).index(kind) * PER_KIND + number
    if count == 1:
        names = [HIDDEN[(number + 5 * place) % len(HIDDEN)]]
    else:
        rng = np.random.default_rng([seed, 7])
        names = [HIDDEN[int(k)] for k in rng.choice(len(HIDDEN), count, replace=False)]
    hidden = {name: FULL * size * VISIBLE[name] for name in names}
    return Asked(law=law, kind=kind, seed=seed, size=size, hidden=hidden)


def drawn(asked: Asked, *, settled: bool = False, plans: Sequence[str] | None = None) -> Campaign:
    """Record the stage in a laboratory of its own.

    settled  its drives always cycled until nothing moved
    plans    its recordings; None: three to six, one of which shows what is hidden
    """
    laboratory = draw_laboratory(np.random.default_rng([asked.seed, 9]))
    return draw_campaign(
        asked.seed,
        effects=asked.hidden,
        truth=asked.law,
        plans=plans,
        laboratory=laboratory.settled if settled else laboratory,
    )
