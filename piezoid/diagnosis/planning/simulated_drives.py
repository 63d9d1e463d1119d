"""Recordings and planned drives as the model of an axis follows them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from piezoid.diagnosis.planning.drive_limits import Bench
from piezoid.diagnosis.planning.drive_response import Driven, rows_of
from piezoid.diagnosis.planning.excitation import Drive
from piezoid.diagnosis.planning.full_range_drives import equal_cycles
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import starts_of
from piezoid.numerics.arrays import Array
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
    """Return a planned drive, from an initial state that cycled over the range."""
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
