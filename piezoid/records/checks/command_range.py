"""Report a drive outside the range of the controller: it was recorded behind the amplifier.

The controller commands the input of the amplifier between converter and ceramic. A recording of
the amplifier's output differs from the command by its gain.
"""

import re
from math import inf, isfinite
from pathlib import Path

from piezoid.formatting import with_unit
from piezoid.records.lab import Amplifier, Lab
from piezoid.records.recording import Quantity, Recording
from piezoid.statement import Statement, finding

DRIVE_VOLTAGE_NOTE = (
    "Every drive voltage is the controller's output, the command at the amplifier's input, "
    "not the high voltage at the ceramic."
)
HIGH_VOLTAGE = re.compile(r"(?<![A-Za-z])HV(?![A-Za-z])|high.?voltage", re.IGNORECASE)
MAY_BE_HIGH_VOLTAGE = "may_be_high_voltage"  # quantity of the statement about a heading
ROUNDING = 1e-6  # of the range
MONITOR_ERROR = 0.02  # of the range: noise and calibration of a monitor of the command

Range_V = tuple[float, float]


def check_command_range(recording: Recording, lab: Lab) -> list[Statement]:
    """Report a drive outside the output range of the controller."""
    statements = []
    for axis in recording.axes:
        drive = recording.find(Quantity.VOLTAGE, axis)
        command_V = command_range_V(lab, axis)
        if drive is None or drive.is_counted:
            continue
        if command_V is None:
            # Ask about a drive that its heading calls a high voltage, unless lab.toml scales it.
            entries = [e for e in lab.recordings if Path(e.file).name == recording.name]
            is_scaled = any({f"voltage_{axis}", "voltage"} & set(e.scale) for e in entries)
            if not is_scaled and HIGH_VOLTAGE.search(drive.label):
                text = (
                    f"{drive.label!r} may be the high voltage behind the amplifier. "
                    f"{DRIVE_VOLTAGE_NOTE} If so, its [[recording]] needs "
                    f"{amplifier_scale(lab, axis)}. If not, state output_min_V and output_max_V "
                    "of [amplifier]."
                )
                statements.append(finding(MAY_BE_HIGH_VOLTAGE, text, axis=axis, place=drive.label))
            continue
        drive_V = float(drive.values.min()), float(drive.values.max())
        if exceeds_range(drive_V, command_V, tolerance=MONITOR_ERROR):
            text = (
                f"The drive goes from {with_unit(drive_V[0], 'V')} to "
                f"{with_unit(drive_V[1], 'V')}, the controller's output "
                f"only from {with_unit(command_V[0], 'V')} to {with_unit(command_V[1], 'V')} "
                "by lab.toml. "
                f"{DRIVE_VOLTAGE_NOTE} If it was recorded behind the amplifier, write "
                f"{amplifier_scale(lab, axis)} into its [[recording]]; else correct input_range_V "
                "or [amplifier]."
            )
            statements.append(finding("beyond_the_controller", text, axis=axis))
    return statements


def command_range_V(lab: Lab, axis: str) -> Range_V | None:
    """Return the range of admissible commands of an axis; None if lab.toml declares neither end.

    Commands lie within the range of the converter and within the amplifier's output over its gain,
    which is 1 by default. An undeclared end is infinite.
    """
    amplifier = lab.amplifier_of(axis)
    low_V, high_V, gain = amplifier.output_min_V, amplifier.output_max_V, gain_of(amplifier)
    ranges = [] if lab.acquisition.input_range_V is None else [lab.acquisition.input_range_V]
    if low_V is not None or high_V is not None:
        output_V = -inf if low_V is None else low_V, inf if high_V is None else high_V
        first_V, second_V = (end_V / gain for end_V in output_V)
        ranges.append((min(first_V, second_V), max(first_V, second_V)))
    if not ranges:
        return None
    return max(low for low, _ in ranges), min(high for _, high in ranges)


def gain_of(amplifier: Amplifier) -> float:
    """Return the gain of an amplifier, or 1 if none is declared."""
    return 1.0 if amplifier.gain_V_per_V is None else amplifier.gain_V_per_V


def exceeds_range(drive_V: Range_V, command_V: Range_V, *, tolerance: float = ROUNDING) -> bool:
    """Return whether a drive exceeds a range of commands by more than ``tolerance`` of it."""
    span_V = command_V[1] - command_V[0]
    tolerance_V = tolerance * (span_V if isfinite(span_V) else drive_V[1] - drive_V[0])
    return drive_V[0] < command_V[0] - tolerance_V or drive_V[1] > command_V[1] + tolerance_V


def amplifier_scale(lab: Lab, axis: str) -> str:
    """Return the line of lab.toml that converts the amplifier's output to its input."""
    gain = lab.amplifier_of(axis).gain_V_per_V
    if gain is None:
        return "scale = { voltage = ... }, one over the amplifier's gain"
    return f"scale = {{ voltage = {1.0 / gain:.9g} }}"
