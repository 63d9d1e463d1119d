"""Which limit stands in the way of an answer: each is loosened alone, the menu played again."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from piezoid.diagnosis.planning.bench import Bench

LOOSER = 4.0  # times the limit
FELT = 0.9  # of what is left open: a limit that changes less does not stand in the way

Best = Callable[[Bench], float]


def what_forbids(bench: Bench, best: Best, left: float) -> str:
    """Return which limit forbids more, or that none does, as one sentence.

    best  (bench) -> how much of the question the best drive of the menu leaves there
    left  what it leaves inside the limits there are
    """
    found = {words: best(looser) for words, looser in _looser(bench).items()}
    words, least = min(found.items(), key=lambda one: one[1])
    if least > FELT * left:
        return (
            f"No limit stands in the way: {LOOSER:g} times the range, the speed or the clock "
            "would not change that"
            + ("." if bench.others else "; no other axis is known that could be driven.")
        )
    return (
        f"What forbids more is {words}: {LOOSER:g} times as much would leave {100 * least:.0f} % "
        f"of what is open, not {100 * left:.0f} %."
    )


def _looser(bench: Bench) -> Mapping[str, Bench]:
    """Return benches of which one limit each is looser, by that limit in words."""
    limits = bench.limits
    span_V = limits.voltage_max_V - limits.voltage_min_V
    more_V = 0.5 * (LOOSER - 1.0) * span_V
    wider = replace(
        limits,
        voltage_min_V=limits.voltage_min_V - more_V,
        voltage_max_V=limits.voltage_max_V + more_V,
    )
    faster = replace(limits, slew_V_per_s=LOOSER * limits.slew_V_per_s)
    return {
        f"the speed, {limits.slew_V_per_s:.3g} V/s ({bench.speed_from})": replace(
            bench, limits=faster
        ),
        f"the converters' clock, {bench.clock_Hz:g} Hz (sampling_rate_Hz of lab.toml, or "
        "--rate)": replace(bench, clock_Hz=LOOSER * bench.clock_Hz),
        f"the range, {limits.voltage_min_V:.4g} to {limits.voltage_max_V:.4g} V "
        f"({bench.range_from})": replace(bench, limits=wider),
    }
