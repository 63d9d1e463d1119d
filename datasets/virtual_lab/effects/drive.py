"""Effects before the ceramic: the drive before the recording, and the amplifier."""

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Bench,
    Fault,
    Measure,
    Place,
    Trace,
    bisected,
    effect,
)
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.truth import branches, settled

PASTS = 60  # simulated histories
REACH = 1.0  # of the field: what a past saw beyond the drive range, no record would ever forget
LOOKED_AT = 2000  # samples of each recording, in addition to its reversals
FINE_ENOUGH_Hz = 20e3  # sufficient for the scaling
SIDES = (("high",), ("low",), ("high", "low"))


@effect(0.8, shown_by=("sweep",), measure=Measure.PEAK)
def initial_state(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Initial state: the memory depends on a drive before the recording.

    Before a recording a laboratory cycles the drive over its range, so that the memory is defined.
    Here the drive was not cycled, but turned at a few other voltages before the start of the
    recording. The error vanishes gradually as the recorded drive covers the range.

    Simulate random histories of every recording and select the closest to the size.

    Source: Mayergoyz, Mathematical Models of Hysteresis (1991), on the past a Preisach state
    keeps.
    """
    pasts = {trace.scene.order: _past(size_m, bench, trace, rng) for trace in bench.traces}
    numbers: dict[str, float | str] = {
        f"turns_before_recording_{order}": " ".join(f"{field:.4f}" for field in past)
        for order, past in pasts.items()
    }
    return Fault(Place.HISTORY, lambda _known, scene, _: pasts[scene.order], numbers)


def _past(size_m: float, bench: Bench, trace: Trace, rng: np.random.Generator) -> Array:
    """Return the turning points of the random history with a change closest to the size."""
    # A path with the same reversals and fewer samples: the strain is rate independent.
    field = trace.scene.field
    reversals = [start for start, _, _ in branches(settled(field))]
    even = range(0, len(field), max(len(field) // LOOKED_AT, 1))
    field = field[np.unique([*reversals, *even])]
    reference = np.add(*bench.ceramic.respond(field, trace.history))
    first = float(field[0])
    candidates, misses = [], []
    for _ in range(PASTS):
        # Turning points that alternate around the start of the recording and approach it.
        count = int(rng.integers(1, 6))
        reach = np.sort(rng.uniform(0.05, 1.0, count))[::-1]
        side = float(rng.choice([-1.0, 1.0])) * (-1.0) ** np.arange(count)
        edge = np.where(side > 0.0, REACH - first, REACH + first)
        past = first + side * edge * reach
        candidates.append(past)
        strain = np.add(*bench.ceramic.respond(field, past))
        change_m = bench.rig.stroke_m * (strain - reference)
        misses.append(abs(Measure.PEAK.of(change_m) - size_m))
    return candidates[int(np.argmin(misses))]


@effect(0.3, shown_by=("rates",))
def slew_limit(size_m: float, bench: Bench, _: np.random.Generator) -> Fault:
    """Slew limit: the current of the amplifier limits the rate at which it charges the ceramic.

        |dV/dt| <= I / C

    at the output. Below the limit the output is correct; above it the output is a straight line
    that is late and, if the command turns too soon, does not reach the command.

    Search for the limit, with the mean gain of the stage over its range.

    Source: Fleming & Moheimani, control of piezoelectric tube scanners; amplifier data sheets.
    """
    rig = bench.rig
    range_V = rig.amplifier_gain_V_per_V * (rig.drive_max_V - rig.drive_min_V)

    def change(trace: Trace, slowness_s_per_V: float) -> Array:
        stride = max(round(trace.scene.rate_Hz / FINE_ENOUGH_Hz), 1)
        command_V = trace.amplifier_V[::stride]
        step_V = stride / (slowness_s_per_V * trace.scene.rate_Hz)
        return rig.stroke_m / range_V * (limited(command_V, step_V) - command_V)

    fastest = max(
        float(np.max(np.abs(np.diff(trace.amplifier_V)))) * trace.scene.rate_Hz
        for trace in bench.traces
    )
    slowness = bisected(size_m, bench.traces, change, (1.0 / fastest, 1e3 / fastest))
    return Fault(
        Place.OUTPUT,
        lambda command_V, scene, _: limited(command_V, 1.0 / (slowness * scene.rate_Hz)),
        {"slew_V_per_s": 1.0 / slowness},
    )


def limited(command_V: Array, step_V: float) -> Array:
    """Return a voltage that follows the command by at most one step per sample."""
    if np.max(np.abs(np.diff(command_V)), initial=0.0) <= step_V:
        return command_V
    output_V = float(command_V[0])
    output = np.empty_like(command_V)
    for k, target_V in enumerate(command_V.tolist()):
        output_V += min(max(target_V - output_V, -step_V), step_V)
        output[k] = output_V
    return output


@effect(1.2, shown_by=("sweep",), measure=Measure.PEAK)
def amplifier_saturation(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Amplifier saturation: the command exceeds the range of the supply.

        V = min(max(V, V_low), V_high)

    at the output of the amplifier, on one side or on both. The memory of the ceramic then follows
    the clipped voltage and not the command.

    Draw the sides, and set each limit such that the displacement is short by the size.

    Source: data sheets of high-voltage amplifiers.
    """
    sides = SIDES[int(rng.choice(3, p=[0.6, 0.2, 0.2]))]
    output_V = np.concatenate([trace.amplifier_V for trace in bench.traces])
    moved_m = np.concatenate([trace.displacement_m for trace in bench.traces])
    limits = {"low": -np.inf, "high": np.inf}
    if "high" in sides:
        is_below = moved_m <= np.max(moved_m) - size_m
        limits["high"] = float(np.max(output_V[is_below], initial=-np.inf))
    if "low" in sides:
        is_above = moved_m >= np.min(moved_m) + size_m
        limits["low"] = float(np.min(output_V[is_above], initial=np.inf))
    return Fault(
        Place.OUTPUT,
        lambda command_V, _scene, _: np.clip(command_V, limits["low"], limits["high"]),
        {f"{side}_V": limits[side] for side in sides},
    )
