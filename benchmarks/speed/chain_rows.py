"""Relative times of fit, diagnosis, design, closed loop and report.

A fit is stated in simulations of all recordings with its model, the other steps in fits. The
closed loop is compared with the same controller called from Python.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

from benchmarks.speed import closed_loop
from benchmarks.speed.campaign import Campaign, make_campaign
from benchmarks.speed.chain import STEPS, ChainResult, Loop, loop_of, run_chain
from benchmarks.speed.stopwatch import Growth, Stopwatch
from benchmarks.speed.table import Row

LOOP = "closed loop"
PYTHON_SAMPLES = 2000  # of the loop in Python
PLAYS = (4, 8, 16, 32)
DIVISORS = (16, 4, 1)  # of the number of ticks


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Results of all steps on a campaign, and its closed loop."""

    result: ChainResult
    loop: Loop


def chain_of(watch: Stopwatch, campaign: Campaign, ticks: int) -> Chain:
    """Run all steps on a campaign, and prepare its closed loop."""
    result = run_chain(watch, campaign)
    return Chain(result=result, loop=loop_of(result, campaign, ticks))


def chain_rows(watch: Stopwatch, chain: Chain) -> list[Row]:
    """Return a row for each step, with the closed loop before the report."""
    time_s = chain.result.time_s
    forward_s, fit_s = time_s["model forward"], time_s[STEPS[0]]
    rows = [Row(stage=STEPS[0], bounds={"forward runs of the campaign": fit_s / forward_s})]
    rows += [Row(stage=step, bounds={"fits": time_s[step] / fit_s}) for step in STEPS[1:]]
    return [*rows[:-1], loop_row(watch, chain.loop), rows[-1]]


def loop_row(watch: Stopwatch, loop: Loop) -> Row:
    """Compare the closed loop with the same in Python, and with its controller alone."""
    loop_s = watch.cpu_s(lambda: closed_loop.run(loop))
    short = replace(loop, reference_m=loop.reference_m[:PYTHON_SAMPLES])
    ratio = len(loop.reference_m) / len(short.reference_m)
    duration_s = len(loop.reference_m) / loop.plant.sampling_rate_Hz
    return Row(
        stage=LOOP,
        loop=watch.cpu_s(lambda: closed_loop.from_python(short)) * ratio / loop_s,
        bounds={
            "controller alone": loop_s / watch.cpu_s(closed_loop.controller_alone(loop)),
            "of the simulated time": loop_s / duration_s,
        },
    )


def loop_growths(watch: Stopwatch, loop: Loop) -> list[Growth]:
    """Return the growth of the closed loop with samples and plays."""
    ticks = len(loop.reference_m)
    shorter = [replace(loop, reference_m=loop.reference_m[: ticks // n]) for n in DIVISORS]
    wider = {plays: closed_loop.with_plays(loop, plays) for plays in PLAYS}
    lengths = {len(part.reference_m): partial(closed_loop.run, part) for part in shorter}
    widths = {plays: partial(closed_loop.run, part) for plays, part in wider.items()}
    return [watch.growth(LOOP, "samples", lengths), watch.growth(LOOP, "plays", widths)]


def step_growths(watch: Stopwatch, lengths: Sequence[int], numbers: Sequence[int]) -> list[Growth]:
    """Return the growth of the steps with the samples of two recordings, and with their number."""
    times = cache(lambda samples, count: run_chain(watch, make_campaign(samples, count)).time_s)
    by_length = {2 * samples: times(samples, 2) for samples in lengths}
    by_number = {count: times(lengths[0], count) for count in numbers}
    return [
        Growth(
            stage=step,
            quantity=quantity,
            size=tuple(runs),
            time_s=tuple(time_s[step] for time_s in runs.values()),
        )
        for quantity, runs in (("samples", by_length), ("recordings", by_number))
        for step in STEPS
    ]
