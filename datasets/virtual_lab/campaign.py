"""A campaign: a random stage, three to six recordings of it, and its hidden effects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from piezoid_datasets.virtual_lab.ablation import HiddenEffect, healthy, measure_effect, record_all
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
    """Correct result of a diagnosis of the campaign.

    truth        type of ceramic
    effects      hidden effects, in the order of the signal chain
    noise_rms_m  of the sensor reading
    careless     whether the initial state of each recording is random
    """

    seed: int
    truth: str
    effects: tuple[HiddenEffect, ...]
    noise_rms_m: float
    careless: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Campaign:
    """Rig and recordings, which the diagnosis receives, and the answer, which it does not."""

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

    effects   names of effects to hide; a mapping gives sizes in percent of the stroke. None or a
              name without size selects 1 to 4 times the visible size; size 0 omits the effect
    truth     type of ceramic in ``ZOO``; None selects one of ``TRUTHS`` at random
    plans     plans or their names; None selects plans at random such that each effect is visible
              in one of them
    careless  random initial state of each recording instead of a cycled drive
    uncatalogued  further effects, outside the catalogue, with sizes in percent
    laboratory    instruments and habits; None: those of a random rig

    Each part has its own random generator, so the stage of a seed does not depend on its effects.
    Raises ``ValueError`` with the available names for an unknown name.
    """
    sizes = dict(effects) if isinstance(effects, Mapping) else dict.fromkeys(effects)
    sizes_percent = {name: _size(named(EFFECTS, name), size, seed) for name, size in sizes.items()}
    hidden = [effect for effect in EFFECTS if sizes_percent.get(effect.name, 0.0) > 0.0]
    kind = named(ZOO, truth or str(_generator(seed, "truth").choice([t.name for t in TRUTHS])))
    rig = draw_rig(_generator(seed, "rig"), name=f"virtual stage {seed}")
    past_V = careless_history_V if careless else None
    circumstances: tuple[Act, ...] = ()
    if laboratory is not None:
        rig, circumstances = laboratory.furnished(rig), laboratory.acts
        past_V = past_V or laboratory.past_V
    stage = Stage(rig=rig, ceramic=kind.draw(_generator(seed, "ceramic")), seed=seed)
    plan_choices = plans or _plans_for(hidden, _generator(seed, "plans"))
    plan_records = [named(PLANS, plan) if isinstance(plan, str) else plan for plan in plan_choices]
    runs = _runs(plan_records, rig, seed, past_V)
    bench = healthy(stage, runs)
    faults = {
        effect.name: effect.install(
            sizes_percent[effect.name] / 100.0 * rig.stroke_m, bench, _generator(seed, effect.name)
        )
        for effect in hidden
    }
    further_faults = {
        name: Fault(acts=(_unnamed(name, percent, rig, seed),), numbers={})
        for name, percent in (uncatalogued or {}).items()
    }
    always = {**further_faults, "circumstances": Fault(acts=circumstances, numbers={})}
    recordings = record_all(stage, runs, {**faults, **always})
    all_faults = {**faults, **always}
    hidden_effects = tuple(
        measure_effect(effect, sizes_percent[effect.name], stage, runs, all_faults, recordings)
        for effect in hidden
    )
    answer = Answer(
        seed=seed,
        truth=kind.name,
        effects=hidden_effects,
        noise_rms_m=rig.noise_rms_m,
        careless=careless,
    )
    return Campaign(rig=rig, recordings=recordings, answer=answer)


def _generator(seed: int, part: str) -> np.random.Generator:
    return np.random.default_rng([seed, crc32(part.encode())])


def _unnamed(name: str, percent: float, rig: Rig, seed: int) -> Act:
    kind = named(UNCATALOGUED, name)
    return kind.act(percent / 100.0 * rig.stroke_m, rig, _generator(seed, name))


def _size(effect: Effect, size_percent: float | None, seed: int) -> float:
    if size_percent is None:
        drawn = np.exp(_generator(seed, f"size of {effect.name}").uniform(*np.log(TIMES_VISIBLE)))
        return float(drawn) * effect.visible_percent
    if not size_percent >= 0.0:
        raise ValueError(f"the size of {effect.name} is {size_percent} %, it must not be negative")
    return size_percent


def _plans_for(hidden: Sequence[Effect], rng: np.random.Generator) -> tuple[str, ...]:
    """Return a sweep, a check, one plan per effect that shows it, and some more."""
    selected_names = {*ALWAYS}
    for effect in hidden:
        if not selected_names & set(effect.shown_by):
            selected_names.add(str(rng.choice(effect.shown_by)))
    shuffled = [str(name) for name in rng.permutation([p.name for p in PLANS])]
    other_names = [name for name in shuffled if name not in selected_names]
    count = max(int(rng.integers(FEWEST, MOST + 1)), len(selected_names))
    selected_names |= set(other_names[: count - len(selected_names)])
    return tuple(plan.name for plan in PLANS if plan.name in selected_names)


def _runs(plans: Sequence[Plan], rig: Rig, seed: int, past_V: Past | None) -> tuple[Run, ...]:
    return tuple(
        run_of(plan, rig, _generator(seed, f"plan {plan.name}"), past_V=past_V) for plan in plans
    )
