"""Fit, diagnosis, design, closed loop and report, in units of the same run.

Nothing else does what these do: a fit is counted in forward runs of its model over all recordings
of the campaign, the others in fits. Only the closed loop has a rival: the same controller stepped
from Python.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

from benchmarks.speed import closed_loop
from benchmarks.speed.campaign import Campaign, made
from benchmarks.speed.chain import STEPS, Loop, Made, loop_of, walked
from benchmarks.speed.stopwatch import Growth, Stopwatch
from benchmarks.speed.table import Row

LOOP = "closed loop"
STEPPED = 2000  # samples of the loop in Python
PLAYS = (4, 8, 16, 32)
PARTS = (16, 4, 1)  # one in so many ticks


@dataclass(frozen=True, kw_only=True, eq=False)
class Walk:
    """A campaign, what became of it, and its closed loop."""

    campaign: Campaign
    made: Made
    loop: Loop


def walk_of(watch: Stopwatch, campaign: Campaign, ticks: int) -> Walk:
    """Walk from recordings to report, and make a closed loop of so many samples."""
    found = walked(watch, campaign)
    return Walk(campaign=campaign, made=found, loop=loop_of(found, campaign, ticks))


def chain_rows(watch: Stopwatch, walk: Walk) -> list[Row]:
    """Return a row for each step of a walk, the closed loop before the report."""
    time_s = walk.made.time_s
    forward_s, fit_s = time_s["model forward"], time_s[STEPS[0]]
    rows = [Row(stage=STEPS[0], bounds={"forward runs of the campaign": fit_s / forward_s})]
    rows += [Row(stage=step, bounds={"fits": time_s[step] / fit_s}) for step in STEPS[1:]]
    return [*rows[:-1], loop_row(watch, walk.loop), rows[-1]]


def loop_row(watch: Stopwatch, loop: Loop) -> Row:
    """Return the closed loop beside the same in Python, and beside its controller alone."""
    own_s = watch.cpu_s(lambda: closed_loop.run(loop))
    part = replace(loop, reference_m=loop.reference_m[:STEPPED])
    share = len(loop.reference_m) / len(part.reference_m)
    lasts_s = len(loop.reference_m) / loop.plant.sampling_rate_Hz
    return Row(
        stage=LOOP,
        loop=watch.cpu_s(lambda: closed_loop.from_python(part)) * share / own_s,
        bounds={
            "controller alone": own_s / watch.cpu_s(closed_loop.controller_alone(loop)),
            "of the time it stands for": own_s / lasts_s,
        },
    )


def loop_growths(watch: Stopwatch, loop: Loop) -> list[Growth]:
    """Return how the closed loop grows with samples and plays."""
    ticks = len(loop.reference_m)
    parts = [replace(loop, reference_m=loop.reference_m[: ticks // n]) for n in PARTS]
    lengths = {len(part.reference_m): lambda part=part: closed_loop.run(part) for part in parts}
    wider = {plays: closed_loop.with_plays(loop, plays) for plays in PLAYS}
    widths = {plays: lambda one=one: closed_loop.run(one) for plays, one in wider.items()}
    return [
        watch.grown(LOOP, "samples", lengths),
        watch.grown(LOOP, "plays", widths),
    ]


def step_growths(watch: Stopwatch, lengths: Sequence[int], numbers: Sequence[int]) -> list[Growth]:
    """Return how the steps grow with the samples of two recordings, and with their number."""
    walk = cache(lambda samples, count: walked(watch, made(samples, count)).time_s)
    by_length = {2 * samples: walk(samples, 2) for samples in lengths}
    by_number = {count: walk(lengths[0], count) for count in numbers}
    found = []
    for what, walks in (("samples", by_length), ("recordings", by_number)):
        for step in STEPS:
            times = tuple(time_s[step] for time_s in walks.values())
            found.append(Growth(stage=step, what=what, size=tuple(walks), time_s=times))
    return found
