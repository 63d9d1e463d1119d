"""Report a drive outside the range of the controller: it was recorded behind the amplifier.

Between converter and ceramic stands an amplifier. A loop is designed for, ships and is clipped to
the voltage in front of it; a recording of the other side is off by the gain.
"""

from piezoid.formatting import with_unit
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording
from piezoid.statement import Statement, finding

DRIVE_VOLTAGE_NOTE = (
    "Every drive voltage is the controller's output, the command in front of the amplifier, "
    "not the high voltage at the ceramic."
)
ROUNDING = 1e-6  # of the range
MONITOR_ERROR = 0.02  # of the range: noise and calibration of a monitor of the command

Range_V = tuple[float, float]


def check_command_range(recording: Recording, lab: Lab) -> list[Statement]:
    """Report a drive that the controller cannot have put out."""
    statements = []
    for axis in recording.axes:
        drive = recording.find(Quantity.VOLTAGE, axis)
        command_V = command_range_V(lab, axis)
        if drive is None or command_V is None or drive.is_counted:
            continue
        drive_V = float(drive.values.min()), float(drive.values.max())
        if exceeds_range(drive_V, command_V, tolerance=MONITOR_ERROR):
            text = (
                f"{axis}: the drive goes from {with_unit(drive_V[0], 'V')} to "
                f"{with_unit(drive_V[1], 'V')}, the controller only from "
                f"{with_unit(command_V[0], 'V')} to {with_unit(command_V[1], 'V')} (lab.toml). "
                f"{DRIVE_VOLTAGE_NOTE} If it was recorded behind the amplifier, write "
                f"{amplifier_scale(lab, axis)} into its [[recording]]; else correct input_range_V "
                "or [amplifier]."
            )
            statements.append(finding(quantity="beyond_the_controller", axis=axis, text=text))
    return statements


def command_range_V(lab: Lab, axis: str) -> Range_V | None:
    """Return the commands an axis may take, None where lab.toml declares neither end.

    They lie within the range of the converter and within the amplifier's output over its gain.
    """
    amplifier = lab.amplifier_of(axis)
    low_V, high_V, gain = amplifier.output_min_V, amplifier.output_max_V, amplifier.gain_V_per_V
    ranges = [] if lab.acquisition.input_range_V is None else [lab.acquisition.input_range_V]
    if low_V is not None and high_V is not None and gain is not None:
        ranges.append((min(low_V / gain, high_V / gain), max(low_V / gain, high_V / gain)))
    if not ranges:
        return None
    return max(low for low, _ in ranges), min(high for _, high in ranges)


def exceeds_range(drive_V: Range_V, command_V: Range_V, *, tolerance: float = ROUNDING) -> bool:
    """Return whether a drive leaves a range of commands by more than ``tolerance`` of it."""
    tolerance_V = tolerance * (command_V[1] - command_V[0])
    return drive_V[0] < command_V[0] - tolerance_V or drive_V[1] > command_V[1] + tolerance_V


def amplifier_scale(lab: Lab, axis: str) -> str:
    """Return the line of lab.toml that converts the amplifier's output to its input."""
    gain = lab.amplifier_of(axis).gain_V_per_V
    if gain is None:
        return "scale = { voltage = ... }, one over the amplifier's gain"
    return f"scale = {{ voltage = {1.0 / gain:.9g} }}"
