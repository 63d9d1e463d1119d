"""A campaign: one stage drawn from a seed, three to six recordings of it, and what is hidden."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from piezoid_datasets.virtual_lab.ablation import HiddenEffect, healthy, record_all, taken_out
from piezoid_datasets.virtual_lab.effects import EFFECTS
from piezoid_datasets.virtual_lab.effects.effect import Act, Effect, Fault
from piezoid_datasets.virtual_lab.laboratory import Laboratory
from piezoid_datasets.virtual_lab.names import named
from piezoid_datasets.virtual_lab.plans import PLANS, Past, Plan, careless_history_V, run_of
from piezoid_datasets.virtual_lab.rig import Rig, draw_rig
from piezoid_datasets.virtual_lab.stage import Rows, Run, Stage
from piezoid_datasets.virtual_lab.truths import TRUTHS, ZOO
from piezoid_datasets.virtual_lab.uncatalogued import UNCATALOGUED

TIMES_VISIBLE = (1.0, 4.0)
ALWAYS = ("sweep", "check")
FEWEST, MOST = 3, 6


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """What a diagnosis of the campaign should come to.

    truth        the kind of ceramic
    effects      what was put in, upstream first
    noise_rms_m  of the sensor reading
    careless     whether the memory before each record was left to chance
    """

    seed: int
    truth: str
    effects: tuple[HiddenEffect, ...]
    noise_rms_m: float
    careless: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Campaign:
    """What the lab hands over (rig, recordings), and what it does not (answer)."""

    rig: Rig
    recordings: tuple[Rows, ...]
    answer: Answer


def draw_campaign(
    seed: int,
    *,
    effects: Mapping[str, float | None] | Sequence[str] = (),
    truth: str | None = None,
    plans: Sequence[str | Plan] | None = None,
    careless: bool = False,
    uncatalogued: Mapping[str, float] | None = None,
    laboratory: Laboratory | None = None,
) -> Campaign:
    """Draw a stage and record it; the same arguments give the same bytes.

    effects   names of effects to hide; a mapping gives sizes in percent of the stroke, None or a
              bare name draws one between 1 and 4 times what is visible; size 0 leaves it out
    truth     kind of ceramic, any of the zoo; one of ``TRUTHS`` is drawn if None
    plans     recordings or names of known ones; drawn if None, such that every effect can be
              seen in one
    careless  leave the memory before each record to chance instead of cycling the drive
    uncatalogued  names of things in no catalogue to hide besides, with sizes in percent
    laboratory    whose instruments and habits; None: those every rig is drawn with

    Chance is drawn part by part, so the stage of a seed is the same whatever is hidden in it.
    Raises ``ValueError`` that lists the known names for an unknown one.
    """
    sizes = dict(effects) if isinstance(effects, Mapping) else dict.fromkeys(effects)
    asked = {name: _size(named(EFFECTS, name), size, seed) for name, size in sizes.items()}
    hidden = [effect for effect in EFFECTS if asked.get(effect.name, 0.0) > 0.0]
    kind = named(ZOO, truth or str(_chance(seed, "truth").choice([t.name for t in TRUTHS])))
    rig = draw_rig(_chance(seed, "rig"), name=f"virtual stage {seed}")
    past_V = careless_history_V if careless else None
    circumstances: tuple[Act, ...] = ()
    if laboratory is not None:
        rig, circumstances = laboratory.furnished(rig), laboratory.acts
        past_V = past_V or laboratory.past_V
    stage = Stage(rig=rig, ceramic=kind.draw(_chance(seed, "ceramic")), seed=seed)
    asked_for = plans or _plans_for(hidden, _chance(seed, "plans"))
    chosen = [named(PLANS, plan) if isinstance(plan, str) else plan for plan in asked_for]
    runs = _runs(chosen, rig, seed, past_V)
    bench = healthy(stage, runs)
    faults = {
        effect.name: effect.install(
            asked[effect.name] / 100.0 * rig.stroke_m, bench, _chance(seed, effect.name)
        )
        for effect in hidden
    }
    strange = {
        name: Fault(acts=(_unnamed(name, percent, rig, seed),), numbers={})
        for name, percent in (uncatalogued or {}).items()
    }
    always = {**strange, "circumstances": Fault(acts=circumstances, numbers={})}
    recordings = record_all(stage, runs, {**faults, **always})
    found = tuple(
        taken_out(effect, asked[effect.name], stage, runs, {**faults, **always}, recordings)
        for effect in hidden
    )
    answer = Answer(
        seed=seed, truth=kind.name, effects=found, noise_rms_m=rig.noise_rms_m, careless=careless
    )
    return Campaign(rig=rig, recordings=recordings, answer=answer)


def _chance(seed: int, part: str) -> np.random.Generator:
    return np.random.default_rng([seed, crc32(part.encode())])


def _unnamed(name: str, percent: float, rig: Rig, seed: int) -> Act:
    kind = named(UNCATALOGUED, name)
    return kind.act(percent / 100.0 * rig.stroke_m, rig, _chance(seed, name))


def _size(effect: Effect, size_percent: float | None, seed: int) -> float:
    if size_percent is None:
        drawn = np.exp(_chance(seed, f"size of {effect.name}").uniform(*np.log(TIMES_VISIBLE)))
        return float(drawn) * effect.visible_percent
    if not size_percent >= 0.0:
        raise ValueError(f"the size of {effect.name} is {size_percent} %, it must not be negative")
    return size_percent


def _plans_for(hidden: Sequence[Effect], rng: np.random.Generator) -> tuple[str, ...]:
    """Return a sweep, a check, one plan per effect that shows it, and some more."""
    wanted = {*ALWAYS}
    for effect in hidden:
        if not wanted & set(effect.shown_by):
            wanted.add(str(rng.choice(effect.shown_by)))
    rest = [str(name) for name in rng.permutation([p.name for p in PLANS]) if name not in wanted]
    count = max(int(rng.integers(FEWEST, MOST + 1)), len(wanted))
    wanted |= set(rest[: count - len(wanted)])
    return tuple(plan.name for plan in PLANS if plan.name in wanted)


def _runs(plans: Sequence[Plan], rig: Rig, seed: int, past_V: Past | None) -> tuple[Run, ...]:
    return tuple(
        run_of(plan, rig, _chance(seed, f"plan {plan.name}"), past_V=past_V) for plan in plans
    )
