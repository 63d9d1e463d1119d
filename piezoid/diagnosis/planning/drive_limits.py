"""What a bench may play: the range, speed and clock of its drive, and which of them says so."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from piezoid.diagnosis.planning.excitation import DriveLimits
from piezoid.errors import LabFileError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.model import AxisModel
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording


@dataclass(frozen=True, kw_only=True)
class Bench:
    """What can be played.

    axis         the one to be known better
    limits       of its drive
    clock_Hz     of the converters
    others       limits of other axes that may be driven, by name
    range_from   what sets the range, in words
    speed_from   what sets the speed, in words
    """

    axis: str
    limits: DriveLimits
    clock_Hz: float
    others: Mapping[str, DriveLimits] = field(default_factory=dict)
    range_from: str = ""
    speed_from: str = ""

    @property
    def limits_from(self) -> str:
        """Return where the limits come from, in words."""
        return f"{self.range_from}; {self.speed_from}"


def bench_of(
    model: ActuatorModel,
    axis: AxisModel,
    lab: Lab,
    recordings: Sequence[Recording],
    clock_Hz: float | None,
) -> Bench:
    """Return what may be played on one axis, and where that is known from."""
    own = _limits(axis, lab)
    others = {name: _limits(other, lab) for name, other in model.axes.items() if name != axis.axis}
    for recording in recordings:
        for channel in recording.channels:
            if channel.quantity is Quantity.VOLTAGE and channel.axis not in (axis.axis, *others):
                moved = channel.values
                if np.ptp(moved) > 0.0:
                    others[channel.axis] = replace(
                        own, voltage_min_V=float(moved.min()), voltage_max_V=float(moved.max())
                    )
    return Bench(
        axis=axis.axis,
        limits=own,
        clock_Hz=_clock_Hz(model, lab, recordings, clock_Hz),
        others=others,
        range_from=_range_from(axis, lab),
        speed_from=_speed_from(axis, lab),
    )


def _clock_Hz(
    model: ActuatorModel, lab: Lab, recordings: Sequence[Recording], asked_Hz: float | None
) -> float:
    rates = [recording.sampling_rate_Hz for recording in recordings]
    declared = asked_Hz or lab.acquisition.sampling_rate_Hz or model.controller_rate_Hz
    if declared is None and not rates:
        raise LabFileError(
            f"{lab.place}: no sampling rate of the converters",
            needed="the rate at which the drive will be played",
            remedy="Write [acquisition] sampling_rate_Hz = ... into lab.toml, or add --rate.",
        )
    return declared or max(rates)


def _limits(axis: AxisModel, lab: Lab) -> DriveLimits:
    """Return the range that was used, inside what lab.toml allows, and the fastest drive."""
    amplifier, gain = lab.amplifier_of(axis.axis), _gain(axis, lab)
    low_V, high_V = axis.voltage_V
    for floor_V, ceiling_V in _bounds_V(axis, lab).values():
        low_V, high_V = max(low_V, floor_V), min(high_V, ceiling_V)
    slew_V_per_s = axis.certificate.slew_V_per_s
    if amplifier.slew_V_per_s is not None:
        slew_V_per_s = amplifier.slew_V_per_s / abs(gain)
    if not (high_V > low_V and slew_V_per_s > 0.0):
        raise LabFileError(
            f"{lab.place}: axis {axis.axis} was driven from {axis.voltage_V[0]:g} to "
            f"{axis.voltage_V[1]:g} V, and of that the limits leave {low_V:g} to {high_V:g} V",
            needed="limits that hold a part of what was driven",
            remedy="Correct output_min_V, output_max_V, gain_V_per_V or input_range_V.",
        )
    return DriveLimits(voltage_min_V=low_V, voltage_max_V=high_V, slew_V_per_s=slew_V_per_s)


def _gain(axis: AxisModel, lab: Lab) -> float:
    return lab.amplifier_of(axis.axis).gain_V_per_V or 1.0


def _bounds_V(axis: AxisModel, lab: Lab) -> dict[str, tuple[float, float]]:
    """Return what lab.toml allows the drive, by the names of its entries."""
    amplifier, gain = lab.amplifier_of(axis.axis), _gain(axis, lab)
    declared = [amplifier.output_min_V, amplifier.output_max_V]
    low_V, high_V = sorted(
        (-np.inf, np.inf)[k] if v is None else v / gain for k, v in enumerate(declared)
    )
    return {
        "output_min_V and output_max_V": (low_V, high_V),
        "input_range_V": lab.acquisition.input_range_V or (-np.inf, np.inf),
    }


def _range_from(axis: AxisModel, lab: Lab) -> str:
    low_V, high_V = axis.voltage_V
    cut = [
        name
        for name, (floor_V, ceiling_V) in _bounds_V(axis, lab).items()
        if floor_V > low_V or ceiling_V < high_V
    ]
    inside = f" ({' and '.join(cut)})" if cut else ""
    return f"the range of the drive in the model's data, inside the limits of lab.toml{inside}"


def _speed_from(axis: AxisModel, lab: Lab) -> str:
    if lab.amplifier_of(axis.axis).slew_V_per_s is None:
        return "as fast as it was driven before, for lab.toml declares no slew limit"
    return "as fast as lab.toml allows (slew_V_per_s)"
