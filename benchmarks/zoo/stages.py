"""Stages of the zoo: every hysteresis law, healthy or with one, two or three hidden effects.

The full size of an effect is four times, a quarter of it once the size that is visible by eye.
Each stage has its own laboratory with instruments, drive histories and offsets. It has three to
six recordings, of which some do not show the hidden effect.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.zoo.score import StageRequest
from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign
from piezoid_datasets.virtual_lab.effects import EFFECTS
from piezoid_datasets.virtual_lab.laboratory import draw_laboratory
from piezoid_datasets.virtual_lab.truths import ZOO

FULL_SIZE = 4.0  # times the visible size
HIDDEN = tuple(e.name for e in EFFECTS if e.name != "asymmetry")  # the simulation has dead zones
VISIBLE = {effect.name: effect.visible_percent for effect in EFFECTS}
# kind -> number of effects, share of full size
KINDS: dict[str, tuple[int, float]] = {
    "healthy": (0, 1.0),
    "single": (1, 1.0),
    "half": (1, 0.5),
    "quarter": (1, 0.25),
    "pair": (2, 1.0),
    "triple": (3, 1.0),
}
# The seed of a stage does not depend on the other requested ones, so that runs can be joined.
PER_KIND = 1000
PER_LAW = PER_KIND * len(KINDS)
NAMES = tuple(truth.name for truth in ZOO)


def stage_requests(
    laws: Sequence[str], kinds: Sequence[str], cases: int, first: int
) -> Iterator[StageRequest]:
    """Return the stages in rounds of one per law and kind, so that a partial run is balanced."""
    for number in range(cases):
        for kind in kinds:
            for law in laws:
                yield stage(law, kind, number, first)


def stage(law: str, kind: str, number: int, first: int) -> StageRequest:
    """Return one stage; single effects rotate with the number and start differently per law."""
    index, (count, size) = NAMES.index(law), KINDS[kind]
    seed = first + index * PER_LAW + list(KINDS).index(kind) * PER_KIND + number
    if count == 1:
        names = [HIDDEN[(number + 5 * index) % len(HIDDEN)]]
    else:
        rng = np.random.default_rng([seed, 7])
        names = [HIDDEN[int(k)] for k in rng.choice(len(HIDDEN), count, replace=False)]
    hidden = {name: FULL_SIZE * size * VISIBLE[name] for name in names}
    return StageRequest(law=law, kind=kind, seed=seed, size=size, hidden=hidden)


def draw_stage(
    request: StageRequest, *, settled: bool = False, plans: Sequence[str] | None = None
) -> Campaign:
    """Simulate the recordings of a stage in its own laboratory.

    settled  all drives start in a steady cycle
    plans    names of the recordings; None draws three to six, of which one shows the effects
    """
    laboratory = draw_laboratory(np.random.default_rng([request.seed, 9]))
    return draw_campaign(
        request.seed,
        effects=request.hidden,
        truth=request.law,
        plans=plans,
        laboratory=laboratory.settled if settled else laboratory,
    )


def noise_floor_m(campaign: Campaign) -> float:
    """Return the rms error that no model removes: sensor noise and rounding of a coarse converter.

    Rounding to steps q has the rms error q / sqrt(12).
    """
    steps_m = [
        float(e.numbers["step_m"]) for e in campaign.answer.effects if e.name == "quantisation"
    ]
    return float(np.linalg.norm([campaign.answer.noise_rms_m, *np.array(steps_m) / np.sqrt(12.0)]))
