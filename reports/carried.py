"""Which effects the model itself carries, and what they add to its simulation of a recording."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES
from piezoid.identification.model import AxisModel, Lag, PieceStart
from piezoid.identification.simulation import simulate_recording, starts_of
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording
from piezoid_reports.traces import Trace

MEMORY = "initial_state"
LAGS = ("delay", "lag")
KINDS: Mapping[str, tuple[str, ...]] = {
    "creep": ("creep_ladder",),
    "thermal_drift": ("thermal_drift",),
    "rate_dependence": ("rate_dependence",),
    "resonance": ("linear_mode",),
    "delay": ("delay",),
    "lag": ("first_order_lag",),
    "cross_coupling": ("cross_axis",),
    "mains_interference": ("mains_lines",),
    "sensor_periodic_error": ("periodic_error",),
    "amplifier_saturation": ("amplifier_limits",),
    "slew_limit": ("slew_limit",),
    "gain_change": ("gain_change",),
}


def is_carried(axis: AxisModel, effect: str) -> bool:
    """Say whether the model has the effect in it, so that it can be taken out."""
    if effect == MEMORY:
        return True
    if effect in LAGS and axis.lag.time_s > 0.0:
        return True
    kinds = KINDS.get(effect, ())
    return any(e.kind in kinds for e in axis.extensions)


def carried_part(axis: AxisModel, effect: str, trace: Trace) -> Array:
    """Return what the effect adds in the model, about its mean; nothing where it has none."""
    if not is_carried(axis, effect):
        return np.zeros(len(trace.time_s))
    without_m = simulate_recording(_without(axis, effect, trace.recording), trace.recording)
    part_m = trace.modelled_m - without_m
    return np.asarray(part_m - np.nanmean(part_m))


def _without(axis: AxisModel, effect: str, recording: Recording) -> AxisModel:
    if effect == MEMORY:
        return replace(axis, starts=_cycled(axis, recording))
    others = tuple(e for e in axis.extensions if e.kind not in KINDS[effect])
    lag = Lag(kind="none", time_s=0.0) if effect in LAGS else axis.lag
    return replace(axis, extensions=others, lag=lag)


def _cycled(axis: AxisModel, recording: Recording) -> tuple[PieceStart, ...]:
    """Return the pieces' starts with the memory of a drive that went down, up, and to its start.

    That is what one assumes of a stage about which nothing is known.
    """
    voltage_V, (low_V, high_V) = recording.voltage_V(axis.axis), axis.voltage_V
    fitted = (p.start for p in recording.pieces if p.stop - p.start >= MINIMUM_SAMPLES)
    own = starts_of(axis, recording)
    others = [start for start in axis.starts if start.recording != recording.name]
    cycled = []
    for start, first in zip(own, fitted, strict=True):
        way_V = np.array([low_V, high_V, voltage_V[first]])
        _, memory_V = axis.hysteresis.run(way_V, axis.virgin_memory_V)
        cycled.append(replace(start, memory_V=memory_V))
    return (*others, *cycled)
