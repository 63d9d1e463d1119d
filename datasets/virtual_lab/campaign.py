"""A campaign: a random stage, three to six recordings of it, and its hidden effects.

The size of a hidden effect is the difference of the recordings with and without the effect.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar
from zlib import crc32

import numpy as np

from piezoid_datasets.virtual_lab.effects import EFFECTS
from piezoid_datasets.virtual_lab.effects.effect import Act, Bench, Effect, Fault, Measure
from piezoid_datasets.virtual_lab.laboratory import Laboratory
from piezoid_datasets.virtual_lab.plans import PLANS, Plan, careless_history_V, run_of
from piezoid_datasets.virtual_lab.rig import Rig, draw_rig
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.stage import Rows, Run, Stage, follow, record
from piezoid_datasets.virtual_lab.truths import TRUTHS, ZOO
from piezoid_datasets.virtual_lab.truths.truth import Truth
from piezoid_datasets.virtual_lab.uncatalogued import UNCATALOGUED

TIMES_VISIBLE = (1.0, 4.0)
ALWAYS = ("sweep", "check")
FEWEST, MOST = 3, 6
Member = TypeVar("Member", Effect, Truth, Plan)


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenEffect:
    """One effect in the recordings; sizes in percent of the stroke.

    measure           definition of the size, in the recording where it is largest
    asked_percent     size to which the effect was scaled on the healthy stage
    measured_percent  actual size: the change if this effect alone is removed
    change_percent    rms of that change in each recording, by name
    moving_percent    largest rms of that change about its mean, which excludes shifts of the zero
    numbers           physical parameters, with units in their names
    """

    name: str
    measure: Measure
    asked_percent: float
    measured_percent: float
    change_percent: Mapping[str, float]
    moving_percent: float
    numbers: Mapping[str, float | str]


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
    sizes_percent = {
        name: _size(member_named(EFFECTS, name), size, seed) for name, size in sizes.items()
    }
    hidden = [effect for effect in EFFECTS if sizes_percent.get(effect.name, 0.0) > 0.0]
    kind = member_named(
        ZOO, truth or str(_generator(seed, "truth").choice([t.name for t in TRUTHS]))
    )
    rig = draw_rig(_generator(seed, "rig"), name=f"virtual stage {seed}")
    past_V = careless_history_V if careless else None
    acts: tuple[Act, ...] = ()
    if laboratory is not None:
        rig, acts = laboratory.furnished(rig), laboratory.acts
        past_V = past_V or laboratory.past_V
    stage = Stage(rig=rig, ceramic=kind.draw(_generator(seed, "ceramic")), acts=acts, seed=seed)
    plan_choices = plans or _plans_for(hidden, _generator(seed, "plans"))
    plan_records = [
        member_named(PLANS, plan) if isinstance(plan, str) else plan for plan in plan_choices
    ]
    runs = [
        run_of(plan, rig, _generator(seed, f"plan {plan.name}"), past_V=past_V)
        for plan in plan_records
    ]
    bench = healthy(stage, runs)
    faults = {
        effect.name: effect.install(
            sizes_percent[effect.name] / 100.0 * rig.stroke_m, bench, _generator(seed, effect.name)
        )
        for effect in hidden
    }
    for name, percent in (uncatalogued or {}).items():
        size_m = percent / 100.0 * rig.stroke_m
        faults[name] = UNCATALOGUED[name](size_m, rig, _generator(seed, name))
    recordings = record_all(stage, runs, faults)
    hidden_effects = tuple(
        measure_effect(effect, sizes_percent[effect.name], stage, runs, faults, recordings)
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


def _size(effect: Effect, size_percent: float | None, seed: int) -> float:
    if size_percent is None:
        factor = np.exp(_generator(seed, f"size of {effect.name}").uniform(*np.log(TIMES_VISIBLE)))
        return float(factor) * effect.visible_percent
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


def healthy(stage: Stage, runs: Sequence[Run]) -> Bench:
    """Simulate every run without effects, as the reference by which effects are scaled."""
    healthy_stage = replace(stage, acts=())
    traces = tuple(follow(healthy_stage, run, order) for order, run in enumerate(runs))
    return Bench(rig=stage.rig, ceramic=stage.ceramic, traces=traces)


def record_all(stage: Stage, runs: Sequence[Run], faults: Mapping[str, Fault]) -> tuple[Rows, ...]:
    """Record every run with the acts of the stage, preceded by these faults."""
    acts = [Act(name=n, place=f.place, change=f.change) for n, f in faults.items()]
    faulty = replace(stage, acts=(*acts, *stage.acts))
    return tuple(record(faulty, run, order) for order, run in enumerate(runs))


def measure_effect(
    effect: Effect,
    asked_percent: float,
    stage: Stage,
    runs: Sequence[Run],
    faults: Mapping[str, Fault],
    recordings: Sequence[Rows],
) -> HiddenEffect:
    """Measure the change of the noise-free readings if one effect is removed."""
    remaining = {name: fault for name, fault in faults.items() if name != effect.name}
    without = record_all(stage, runs, remaining)
    changes = {a.run.name: change_m(a, b) for a, b in zip(recordings, without, strict=True)}
    percent = 100.0 / stage.rig.stroke_m
    return HiddenEffect(
        name=effect.name,
        measure=effect.measure,
        asked_percent=asked_percent,
        measured_percent=percent * max(effect.measure.of(change) for change in changes.values()),
        change_percent={
            name: percent * Measure.RMS.of(change) for name, change in changes.items()
        },
        moving_percent=percent * max(float(np.std(change)) for change in changes.values()),
        numbers=faults[effect.name].numbers,
    )


def change_m(recording: Rows, reference: Rows) -> Array:
    """Return the difference of two recordings of one run, over their common rows."""
    count = min(len(recording.noise_free_m), len(reference.noise_free_m))
    return recording.noise_free_m[:count] - reference.noise_free_m[:count]


def member_named(members: Sequence[Member], name: str) -> Member:
    """Return the member with a name; raise ``ValueError`` with all names if it does not exist."""
    by_name = {member.name: member for member in members}
    if name not in by_name:
        names = ", ".join(sorted(by_name))
        raise ValueError(f"{name!r} is not known here; known are {names}")
    return by_name[name]
