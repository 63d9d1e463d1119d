"""Converters of one axis as declared in lab.toml."""

from dataclasses import dataclass

from piezoid.records.checks.command_range import command_range_V, gain_of
from piezoid.records.lab import Lab


@dataclass(frozen=True, kw_only=True)
class Converters:
    """Both converters of one axis, volts at the controller's terminals.

    command_V       (low, high) that a command may take: within what the amplifier puts out over
                    its gain, and within the converter's codes, the highest of which lies one step
                    below the end of its range; None where neither is declared
    command_step_V  of the writing converter; 0 where its bits or range are not declared
    reading_V       (low, high) of the reading converter; None where not declared
    reading_step_V  of the reading converter; 0 likewise
    command_slew_V_per_s  fastest command that the amplifier follows; None where not declared
    """

    command_V: tuple[float, float] | None
    command_step_V: float
    reading_V: tuple[float, float] | None
    reading_step_V: float
    command_slew_V_per_s: float | None = None


def converters_of(lab: Lab, axis: str) -> Converters:
    """Return the declared converters of an axis, without assumptions on undeclared values.

    The laboratory's ``input_range_V`` is that of both converters.
    """
    declared, amplifier = lab.acquisition, lab.amplifier_of(axis)
    reach_V, slew_V_per_s = declared.input_range_V, amplifier.slew_V_per_s
    if slew_V_per_s is not None:  # of the amplifier's output
        slew_V_per_s = float(slew_V_per_s / abs(gain_of(amplifier)))
    command_V, step_V = command_range_V(lab, axis), _step_V(reach_V, declared.dac_bits)
    if command_V is not None and reach_V is not None:
        command_V = command_V[0], min(command_V[1], reach_V[1] - step_V)
    return Converters(
        command_V=command_V,
        command_step_V=step_V,
        reading_V=reach_V,
        reading_step_V=_step_V(reach_V, declared.adc_bits),
        command_slew_V_per_s=slew_V_per_s,
    )


def _step_V(reach_V: tuple[float, float] | None, bits: int | None) -> float:
    if reach_V is None or bits is None:
        return 0.0
    return float((reach_V[1] - reach_V[0]) / 2.0**bits)
