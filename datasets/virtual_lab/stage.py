"""The signal chain of one axis, from the command to the rows of the file.

    command -> DAC -> amplifier -> ceramic (history) -> mechanics -> sensor -> ADC -> rows

At each place of the chain, the acts of effects change the signal. A recording at the clock rate is
simulated on a grid four times finer than its rows, on which the DAC holds each value. A slower
recording contains every n-th row of the clock, so its drive is linear between rows, with a delay
of half a clock period.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from zlib import crc32

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import Act, Place, Scene, Trace
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.signals import (
    Array,
    coloured_noise,
    first_order,
    held_first_order,
    shifted,
)
from piezoid_datasets.virtual_lab.truths.truth import Ceramic

FINER = 4  # simulated samples per row at the clock rate
NOWHERE = np.zeros(0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """One planned recording.

    name              of its file, without suffix
    sampling_rate_Hz  of its rows: the clock rate divided by an integer
    command_V         (samples,)  at the DAC
    history_V         (turns,)  commands at the turning points before the recording
    rest_s            duration of the rest before the recording
    others_V          commands of other axes, by axis name
    """

    name: str
    sampling_rate_Hz: float
    command_V: Array
    history_V: Array
    rest_s: float = 60.0
    others_V: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """One recording, and its displacement without noise."""

    run: Run
    time_s: Array
    voltage_V: Array
    displacement_m: Array
    noise_free_m: Array
    others_V: Mapping[str, Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage:
    """A rig with its ceramic and the acts of its effects; ``seed`` is for all random numbers."""

    rig: Rig
    ceramic: Ceramic
    acts: tuple[Act, ...] = ()
    seed: int = 0


def record(stage: Stage, run: Run, order: int = 0) -> Rows:
    """Simulate one run and return its rows.

    Noise and every act have separate random generators. If one act is removed, the difference of
    the two recordings is therefore the contribution of that act.
    """
    trace = follow(stage, run, order)
    lag_s = 1.0 / (2.0 * np.pi * stage.rig.sensor_bandwidth_Hz)
    moved_m = trace.displacement_m
    reading_m = first_order(moved_m, lag_s, trace.scene.rate_Hz, float(moved_m[0]))
    reading_m = _act(stage, Place.SENSOR, reading_m, trace.scene)
    sampled = slice(None, None, _finer(stage.rig, run))
    rows = replace(trace.scene, rate_Hz=run.sampling_rate_Hz, time_s=trace.scene.time_s[sampled])
    noise = stage.rig.noise_rms_m * coloured_noise(
        len(run.command_V),
        run.sampling_rate_Hz,
        stage.rig.sensor_bandwidth_Hz,
        stage.rig.flicker_share,
        np.random.default_rng([stage.seed, order]),
    )
    clean, noisy = (
        _act(stage, Place.RECORD, _act(stage, Place.CONVERTER, signal_m, rows), rows)
        for signal_m in (reading_m[sampled], reading_m[sampled] + noise)
    )
    count, step_m = len(clean), stage.rig.adc_step_m
    return Rows(
        run=run,
        time_s=rows.time_s[:count],
        voltage_V=_converted(stage.rig, run.command_V)[:count],
        displacement_m=step_m * np.round(noisy / step_m),
        noise_free_m=clean,
        others_V={axis: _converted(stage.rig, u)[:count] for axis, u in run.others_V.items()},
    )


def follow(stage: Stage, run: Run, order: int = 0) -> Trace:
    """Return the signals of the chain during a run, on its fine time grid."""
    rig = stage.rig
    finer = _finer(rig, run)
    rate_Hz = run.sampling_rate_Hz * finer
    samples = len(run.command_V) * finer
    scene = Scene(
        rig=rig,
        ceramic=stage.ceramic,
        rate_Hz=rate_Hz,
        time_s=np.arange(samples) / rate_Hz,
        record_rate_Hz=run.sampling_rate_Hz,
        order=order,
        rest_s=run.rest_s,
        field=NOWHERE,
        others_V={
            axis: _bandwidth(rig, run, _amplified(rig, run, u), rate_Hz)
            for axis, u in run.others_V.items()
        },
    )
    command_V = _act(stage, Place.AMPLIFIER, _amplified(rig, run, run.command_V), scene)
    amplifier_V = _act(stage, Place.OUTPUT, _bandwidth(rig, run, command_V, rate_Hz), scene)
    scene = replace(scene, field=rig.field_of(amplifier_V))
    history = rig.field_of(rig.amplifier_gain_V_per_V * run.history_V)
    history = _act(stage, Place.HISTORY, history, scene)
    reversible, quasi_static = stage.ceramic.respond(scene.field, history)
    irreversible = _act(stage, Place.IRREVERSIBLE, quasi_static, scene)
    ceramic_m = _act(stage, Place.CERAMIC, rig.stroke_m * (reversible + irreversible), scene)
    return Trace(
        scene=scene,
        history=history,
        amplifier_V=amplifier_V,
        irreversible=irreversible,
        displacement_m=_act(stage, Place.MECHANICS, ceramic_m, scene),
    )


def _act(stage: Stage, place: Place, signal: Array, scene: Scene) -> Array:
    for act in stage.acts:
        if act.place is place:
            rng = np.random.default_rng([stage.seed, scene.order, crc32(act.name.encode())])
            signal = act.change(signal, scene, rng)
    return signal


def _finer(rig: Rig, run: Run) -> int:
    return FINER if run.sampling_rate_Hz >= rig.clock_Hz else 1


def _amplified(rig: Rig, run: Run, command_V: Array) -> Array:
    """Return a command on the fine time grid, times the gain of the amplifier."""
    converted_V = _converted(rig, command_V)
    if _finer(rig, run) > 1:
        fine_V = np.repeat(converted_V, FINER)
    else:
        fine_V = shifted(converted_V, 0.5 / rig.clock_Hz, run.sampling_rate_Hz)
    return rig.amplifier_gain_V_per_V * fine_V


def _converted(rig: Rig, command_V: Array) -> Array:
    return rig.dac_step_V * np.round(command_V / rig.dac_step_V)


def _bandwidth(rig: Rig, run: Run, command_V: Array, rate_Hz: float) -> Array:
    lag_s = 1.0 / (2.0 * np.pi * rig.amplifier_bandwidth_Hz)
    if _finer(rig, run) > 1:
        return held_first_order(command_V, lag_s, rate_Hz)
    return first_order(command_V, lag_s, rate_Hz, float(command_V[0]))
