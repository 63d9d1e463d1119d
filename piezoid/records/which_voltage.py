"""Which voltage is meant, and a recording whose voltage cannot be that one.

Between converter and ceramic stands an amplifier; what a loop is designed for, ships and is
clipped to are the volts in front of it. A recording of the other side is off by the gain.
"""

from piezoid.formatting import with_unit
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording
from piezoid.statement import Statement, finding

WHICH_VOLTAGE = (
    "Every drive voltage is the controller's output, the command in front of the amplifier, "
    "not the high voltage at the ceramic."
)
_ROUNDED = 1e-6  # of a range: a recorded voltage may pass a converter's end by its own rounding
_MONITORED = 0.02  # of a range: a monitor of the command adds its noise and its calibration

Range_V = tuple[float, float]


def command_range_V(lab: Lab, axis: str) -> Range_V | None:
    """Return the commands an axis may take, None where lab.toml declares neither end.

    They lie within the converter's range, and within what the amplifier puts out over its gain.
    """
    known = [pair for pair in (lab.acquisition.input_range_V, _amplified(lab, axis)) if pair]
    if not known:
        return None
    return max(pair[0] for pair in known), min(pair[1] for pair in known)


def passes(drive_V: Range_V, command_V: Range_V, *, slack: float = _ROUNDED) -> bool:
    """Return whether a drive leaves a range of commands by more than ``slack`` of it."""
    slack_V = slack * (command_V[1] - command_V[0])
    return drive_V[0] < command_V[0] - slack_V or drive_V[1] > command_V[1] + slack_V


def scale_of_output(lab: Lab, axis: str) -> str:
    """Return the line of lab.toml that turns the amplifier's output into its input."""
    gain = lab.amplifier_of(axis).gain_V_per_V
    if gain is None:
        return "scale = { voltage = ... }, one over the amplifier's gain"
    return f"scale = {{ voltage = {1.0 / gain:.9g} }}"


def beyond_the_controller(recording: Recording, lab: Lab) -> tuple[Statement, ...]:
    """Tell a drive that the controller cannot have put out: it was taken behind the amplifier."""
    found = []
    for axis in recording.axes:
        drive = recording.find(Quantity.VOLTAGE, axis)
        command_V = command_range_V(lab, axis)
        if drive is None or command_V is None or drive.is_counted:
            continue
        drive_V = float(drive.values.min()), float(drive.values.max())
        if passes(drive_V, command_V, slack=_MONITORED):
            text = (
                f"its drive goes from {with_unit(drive_V[0], 'V')} to "
                f"{with_unit(drive_V[1], 'V')}, and lab.toml lets the controller put out "
                f"{with_unit(command_V[0], 'V')} to {with_unit(command_V[1], 'V')}. "
                f"{WHICH_VOLTAGE} If it was recorded behind the amplifier, write "
                f"{scale_of_output(lab, axis)} into its [[recording]]; else correct input_range_V "
                "or [amplifier]"
            )
            found.append(finding(quantity="beyond_the_controller", axis=axis, text=text))
    return tuple(found)


def _amplified(lab: Lab, axis: str) -> Range_V | None:
    """Return the commands at which the amplifier reaches its ends."""
    amplifier = lab.amplifier_of(axis)
    low_V, high_V, gain = amplifier.output_min_V, amplifier.output_max_V, amplifier.gain_V_per_V
    if low_V is None or high_V is None or gain is None:
        return None
    ends_V = sorted((low_V / gain, high_V / gain))
    return ends_V[0], ends_V[1]
