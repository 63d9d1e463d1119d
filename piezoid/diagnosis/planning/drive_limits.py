"""Limits of a drive and of all axes of a bench, with their origin."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from piezoid.errors import LabFileError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array, frozen
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording


@dataclass(frozen=True, kw_only=True)
class DriveLimits:
    """Limits of the voltage and of its rate of change; every waveform stays within them.

    voltage_min_V    lowest voltage
    voltage_max_V    highest voltage
    slew_V_per_s     largest rate of change, > 0
    """

    voltage_min_V: float
    voltage_max_V: float
    slew_V_per_s: float

    def __post_init__(self) -> None:
        if not (self.voltage_max_V > self.voltage_min_V and self.slew_V_per_s > 0):
            raise ValueError(f"limits must be ordered and the slew positive, found {self}")

    @property
    def range_V(self) -> tuple[float, float]:
        """Return the lowest and the highest voltage."""
        return self.voltage_min_V, self.voltage_max_V

    @property
    def middle_V(self) -> float:
        """Return the middle of the range."""
        return 0.5 * (self.voltage_min_V + self.voltage_max_V)

    @property
    def reach_V(self) -> float:
        """Return half the range."""
        return 0.5 * (self.voltage_max_V - self.voltage_min_V)

    @property
    def rest_V(self) -> float:
        """Return the voltage within the limits that is nearest to 0 V."""
        return min(max(0.0, self.voltage_min_V), self.voltage_max_V)


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """Voltages for the converters, one column for each axis.

    name              of the experiment
    why               purpose, in one sentence
    sampling_rate_Hz  > 0
    axes              names of the driven axes
    voltage_V         (samples, axes)
    """

    name: str
    why: str
    sampling_rate_Hz: float
    axes: tuple[str, ...]
    voltage_V: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "voltage_V", frozen(self.voltage_V, "voltage_V", ndim=2))
        if self.voltage_V.shape[1] != len(self.axes):
            raise ValueError(f"{self.voltage_V.shape[1]} columns for axes {self.axes}")

    @property
    def duration_s(self) -> float:
        """Return the duration of the drive."""
        return len(self.voltage_V) / self.sampling_rate_Hz

    def to_csv(self) -> str:
        """Return the drive as text: a header with units, then one row for each sample.

        Reading the text gives exactly the same numbers; ingest understands the header.
        """
        header = ",".join(["time [s]", *(f"voltage_{axis} [V]" for axis in self.axes)])
        time_s = np.arange(len(self.voltage_V)) / self.sampling_rate_Hz
        rows = np.column_stack([time_s, self.voltage_V]).tolist()
        return "\n".join([header, *(",".join(map(repr, row)) for row in rows)]) + "\n"


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Limits of all drives of one stage.

    axis          axis of the next experiment
    limits        of the drive of this axis
    clock_Hz      of the converters
    other_limits  limits of other axes that may be driven, by name
    range_from    origin of the range, in words
    speed_from    origin of the largest speed, in words
    """

    axis: str
    limits: DriveLimits
    clock_Hz: float
    other_limits: Mapping[str, DriveLimits] = field(default_factory=dict)
    range_from: str = ""
    speed_from: str = ""


def bench_of(
    model: ActuatorModel,
    axis: AxisModel,
    lab: Lab,
    recordings: Sequence[Recording],
    clock_Hz: float | None,
) -> Bench:
    """Return the drive limits of an axis and of other axes, from the model and lab.toml."""
    limits, range_from, speed_from = _limits(axis, lab)
    other_limits = {
        name: _limits(model_axis, lab)[0]
        for name, model_axis in model.axes.items()
        if name != axis.axis
    }
    for channel in (channel for recording in recordings for channel in recording.channels):
        is_drive = channel.quantity is Quantity.VOLTAGE
        if is_drive and channel.axis not in (axis.axis, *other_limits):
            low_V, high_V = float(channel.values.min()), float(channel.values.max())
            if high_V > low_V:
                other_limits[channel.axis] = replace(
                    limits, voltage_min_V=low_V, voltage_max_V=high_V
                )
    rates_Hz = [recording.sampling_rate_Hz for recording in recordings]
    declared_Hz = clock_Hz or lab.acquisition.sampling_rate_Hz or model.controller_rate_Hz
    if declared_Hz is None and not rates_Hz:
        raise LabFileError(
            f"{lab.place}: no sampling rate of the converters",
            needed="the rate at which the drive will be played",
            remedy="Write [acquisition] sampling_rate_Hz = ... into lab.toml, or add --rate.",
        )
    return Bench(
        axis=axis.axis,
        limits=limits,
        clock_Hz=declared_Hz or max(rates_Hz),
        other_limits=other_limits,
        range_from=range_from,
        speed_from=speed_from,
    )


def _limits(axis: AxisModel, lab: Lab) -> tuple[DriveLimits, str, str]:
    """Return the recorded range within lab.toml and the largest speed, and the origin of each."""
    amplifier = lab.amplifier_of(axis.axis)
    gain = amplifier.gain_V_per_V or 1.0
    output_V = sorted(
        default if declared_V is None else declared_V / gain
        for declared_V, default in (
            (amplifier.output_min_V, -np.inf),
            (amplifier.output_max_V, np.inf),
        )
    )
    declared = {
        "output_min_V and output_max_V": output_V,
        "input_range_V": lab.acquisition.input_range_V or (-np.inf, np.inf),
    }
    low_V = max(axis.voltage_V[0], *(floor_V for floor_V, _ in declared.values()))
    high_V = min(axis.voltage_V[1], *(ceiling_V for _, ceiling_V in declared.values()))
    slew_V_per_s = axis.certificate.slew_V_per_s
    speed_from = "the fastest drive of the recordings, because lab.toml declares no slew limit"
    if amplifier.slew_V_per_s is not None:
        slew_V_per_s = amplifier.slew_V_per_s / abs(gain)
        speed_from = "as fast as lab.toml allows (slew_V_per_s)"
    if not (high_V > low_V and slew_V_per_s > 0.0):
        raise LabFileError(
            f"{lab.place}: axis {axis.axis} was driven from {axis.voltage_V[0]:g} to "
            f"{axis.voltage_V[1]:g} V, and the limits restrict this range to {low_V:g} to "
            f"{high_V:g} V",
            needed="limits that contain a part of the recorded range",
            remedy="Correct output_min_V, output_max_V, gain_V_per_V or input_range_V.",
        )
    binding = [
        name
        for name, (floor_V, ceiling_V) in declared.items()
        if floor_V > axis.voltage_V[0] or ceiling_V < axis.voltage_V[1]
    ]
    range_from = "the range of the drive in the model's data, inside the limits of lab.toml" + (
        f" ({' and '.join(binding)})" if binding else ""
    )
    limits = DriveLimits(voltage_min_V=low_V, voltage_max_V=high_V, slew_V_per_s=slew_V_per_s)
    return limits, range_from, speed_from
