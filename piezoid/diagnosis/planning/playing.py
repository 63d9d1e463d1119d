"""What a bench may play, and recordings and drives as the model of an axis follows them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from piezoid.diagnosis.planning.driven import Driven, rows_of
from piezoid.diagnosis.planning.menu import Bench
from piezoid.errors import LabFileError
from piezoid.identification.model import ActuatorModel, AxisModel
from piezoid.identification.simulation import starts_of
from piezoid.numerics.arrays import Array
from piezoid.records.excitation import Drive, DriveLimits
from piezoid.records.lab import Lab
from piezoid.records.large_drives import equal_cycles
from piezoid.records.recording import Quantity, Recording

ROWS = 700  # of each drive that are compared
SLOW_Hz = 0.5
CYCLE_ROWS = 200.0


def usual_drives(axis: AxisModel, bench: Bench) -> tuple[Drive, ...]:
    """Return what is recorded of a stage as a rule: full cycles, slow and as fast as they were."""
    limits = replace(bench.limits, slew_V_per_s=axis.certificate.slew_V_per_s)
    reach_V = 0.5 * (limits.voltage_max_V - limits.voltage_min_V)
    fast_Hz = max(limits.slew_V_per_s / (2 * np.pi * reach_V), SLOW_Hz)
    drives = []
    for frequency_Hz in (SLOW_Hz, fast_Hz):
        rate_Hz = min(bench.clock_Hz, CYCLE_ROWS * frequency_Hz)
        voltage_V = equal_cycles(limits, rate_Hz, frequency_Hz=frequency_Hz, cycles=5)
        drives.append(
            Drive(
                name="full cycles",
                why="What is recorded as a rule.",
                sampling_rate_Hz=rate_Hz,
                axes=(bench.axis,),
                voltage_V=voltage_V[:, None],
            )
        )
    return tuple(drives)


def bench_of(
    model: ActuatorModel,
    axis: AxisModel,
    lab: Lab,
    recordings: Sequence[Recording],
    clock_Hz: float | None,
) -> tuple[Bench, str]:
    """Return what may be played, and where that is known from."""
    own, words = _limits(axis, lab)
    others = {
        name: _limits(other, lab)[0] for name, other in model.axes.items() if name != axis.axis
    }
    for recording in recordings:
        for channel in recording.channels:
            if channel.quantity is Quantity.VOLTAGE and channel.axis not in (axis.axis, *others):
                moved = channel.values
                if np.ptp(moved) > 0.0:
                    others[channel.axis] = replace(
                        own, voltage_min_V=float(moved.min()), voltage_max_V=float(moved.max())
                    )
    rates = [recording.sampling_rate_Hz for recording in recordings]
    declared = clock_Hz or lab.acquisition.sampling_rate_Hz or model.controller_rate_Hz
    if declared is None and not rates:
        raise LabFileError(
            f"{lab.place}: no sampling rate of the converters",
            needed="the rate at which the drive will be played",
            remedy="Write [acquisition] sampling_rate_Hz = ... into lab.toml, or add --rate.",
        )
    clock = declared or max(rates)
    return Bench(axis=axis.axis, limits=own, clock_Hz=clock, others=others), words


def _limits(axis: AxisModel, lab: Lab) -> tuple[DriveLimits, str]:
    """Return the range that was used, inside what lab.toml allows, and the fastest drive."""
    amplifier, gain = lab.amplifier_of(axis.axis), lab.amplifier_of(axis.axis).gain_V_per_V or 1.0
    low_V, high_V = axis.voltage_V
    declared = [amplifier.output_min_V, amplifier.output_max_V]
    bounds = sorted(
        (-np.inf, np.inf)[k] if v is None else v / gain for k, v in enumerate(declared)
    )
    converter = lab.acquisition.input_range_V or (-np.inf, np.inf)
    low_V, high_V = max(low_V, bounds[0], converter[0]), min(high_V, bounds[1], converter[1])
    words = "the range of the drive in the model's data, inside the limits of lab.toml"
    slew_V_per_s = axis.certificate.slew_V_per_s
    if amplifier.slew_V_per_s is None:
        words += "; as fast as it was driven before, for lab.toml declares no slew limit"
    else:
        slew_V_per_s = amplifier.slew_V_per_s / abs(gain)
        words += "; as fast as lab.toml allows"
    if not (high_V > low_V and slew_V_per_s > 0.0):
        raise LabFileError(
            f"{lab.place}: axis {axis.axis} was driven from {axis.voltage_V[0]:g} to "
            f"{axis.voltage_V[1]:g} V, and of that the limits leave {low_V:g} to {high_V:g} V",
            needed="limits that hold a part of what was driven",
            remedy="Correct output_min_V, output_max_V, gain_V_per_V or input_range_V.",
        )
    return (
        DriveLimits(voltage_min_V=low_V, voltage_max_V=high_V, slew_V_per_s=slew_V_per_s),
        words,
    )


def drives_axis(recording: Recording, axis: AxisModel) -> bool:
    """Tell whether a recording moves this axis."""
    channel = recording.find(Quantity.VOLTAGE, axis.axis)
    return channel is not None and float(np.ptp(channel.values)) > 0.0


def driven_recording(axis: AxisModel, recording: Recording) -> Driven:
    """Return a recording's drive from the memory the fit found for its first piece."""
    starts = starts_of(axis, recording)
    others = {
        channel.axis: channel.values
        for channel in recording.channels
        if channel.quantity is Quantity.VOLTAGE and channel.axis != axis.axis
    }
    return Driven(
        name=recording.name,
        model=axis,
        rate_Hz=recording.sampling_rate_Hz,
        voltage_V=recording.voltage_V(axis.axis),
        rows=rows_of(recording.samples, ROWS),
        others=_moving(others),
        memory_V=starts[0].memory_V if starts else None,
    )


def driven_drive(axis: AxisModel, drive: Drive) -> Driven:
    """Return a planned drive, from a past that cycled over the range."""
    others = {name: drive.voltage_V[:, k] for k, name in enumerate(drive.axes) if k > 0}
    return Driven(
        name=drive.name,
        model=axis,
        rate_Hz=drive.sampling_rate_Hz,
        voltage_V=drive.voltage_V[:, 0],
        rows=rows_of(len(drive.voltage_V), ROWS),
        others=_moving(others),
    )


def _moving(others_V: Mapping[str, Array]) -> dict[str, Array]:
    """Return drives that move, about their middle and over half their range."""
    spans = {axis: (float(u.min()), float(u.max())) for axis, u in others_V.items()}
    return {
        axis: (2.0 * others_V[axis] - low - high) / (high - low)
        for axis, (low, high) in spans.items()
        if high > low
    }
