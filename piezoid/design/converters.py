"""Converters of one axis as declared in lab.toml."""

from dataclasses import dataclass

from piezoid.records.checks.command_range import command_range_V, gain_of
from piezoid.records.lab import Lab


@dataclass(frozen=True, kw_only=True)
class Converters:
    """DAC and ADC of one axis, in volts at the controller's terminals.

    command_V       (low, high) of a command: the amplifier's output range over its gain,
                    intersected with the codes of the DAC, the highest of which lies one step below
                    the end of its range; None if neither is declared
    command_step_V  of the DAC; 0 if its bits or range are not declared
    reading_V       (low, high) of the ADC; None if not declared
    reading_step_V  of the ADC; 0 if its bits or range are not declared
    command_slew_V_per_s  fastest command that the amplifier follows; None if not declared
    """

    command_V: tuple[float, float] | None
    command_step_V: float
    reading_V: tuple[float, float] | None
    reading_step_V: float
    command_slew_V_per_s: float | None = None


def converters_of(lab: Lab, axis: str) -> Converters:
    """Return the declared converters of an axis, without assumptions on undeclared values.

    ``input_range_V`` of lab.toml is the range of both converters.
    """
    acquisition, amplifier = lab.acquisition, lab.amplifier_of(axis)
    range_V, slew_V_per_s = acquisition.input_range_V, amplifier.slew_V_per_s
    if slew_V_per_s is not None:  # of the amplifier's output
        slew_V_per_s = float(slew_V_per_s / abs(gain_of(amplifier)))
    command_V, step_V = command_range_V(lab, axis), _step_V(range_V, acquisition.dac_bits)
    if command_V is not None and range_V is not None:
        command_V = command_V[0], min(command_V[1], range_V[1] - step_V)
    return Converters(
        command_V=command_V,
        command_step_V=step_V,
        reading_V=range_V,
        reading_step_V=_step_V(range_V, acquisition.adc_bits),
        command_slew_V_per_s=slew_V_per_s,
    )


def _step_V(range_V: tuple[float, float] | None, bits: int | None) -> float:
    if range_V is None or bits is None:
        return 0.0
    return float((range_V[1] - range_V[0]) / 2.0**bits)
