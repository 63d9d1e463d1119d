"""Requirements on one axis: specification with defaults and design.toml, and its converters."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from reprlib import repr as short
from typing import Any

import numpy as np

from piezoid.design.plant import Plant, PlantFamily
from piezoid.design.sensitivity import FUNCTIONS, Template, attenuation, constant_limit
from piezoid.errors import LabFileError
from piezoid.numerics.polynomial import decibel
from piezoid.records.checks.command_range import command_range_V, gain_of
from piezoid.records.lab import Lab
from piezoid.toml_files import read_toml

_AT_BANDWIDTH_dB = -3.0
MODE_SHARE = 0.15
_DELAY_SHARE = 0.03
_CONTROL_LIMIT_dB = 20.0
# Names of the limits that follow from the model, which no key of design.toml relaxes.
CONTROL_EFFORT = "control effort"
BEYOND = "control effort beyond what is known"  # guards against unseen modes

_SMALLEST, _LARGEST = 1e-30, 1e30  # magnitudes of a number in design.toml
# The attenuation's template begins at a thousandth of the bandwidth. If that lies above the
# Nyquist frequency, it limits nothing, and any bandwidth is "met" (1e30 Hz was). Controllers run
# at more than 2 kHz.
_FASTEST_Hz = 1e6
_LARGEST_dB = 1000.0
_LARGEST_rms = 1000.0  # m or nepers
_LAST_HARMONIC, _MAX_HARMONICS = 999, 8


@dataclass(frozen=True, kw_only=True)
class Specification:
    """Requirements on every member of the plant family.

    bandwidth_Hz        output disturbances are attenuated by 3 dB here, and by 20 dB more for each
                        decade below (template ``attenuation``)
    modulus_margin      1 / max |Syp|; Landau & Zito recommend 0.5 or more
    delay_margin_s      additional loop delay that must not destabilise; one sample or more
    templates           additional upper limits of Syp, Sup, Syb, Syv
    voltage_min_V, voltage_max_V   limits of the command
    voltage_step_V      of the converter; 0: no rounding
    voltage_slew_V_per_s  fastest command that the amplifier follows; None: any
    sensor_noise_rms    of one sample, white; output unit
    noise_limit_rms     of the output error by sensor noise and converter steps; None: no limit
    scan_frequency_Hz   of the planned trajectory
    disturbance_rms     residual of the linear model at the scan frequency, output unit; its odd
                        harmonics are assumed to fall as 1/h, as in hysteresis
    resonant_harmonics  harmonics of the scan at which the observer has an oscillator
    """

    bandwidth_Hz: float
    modulus_margin: float = 0.5
    delay_margin_s: float
    templates: tuple[Template, ...] = field(default=(), compare=False)
    voltage_min_V: float
    voltage_max_V: float
    voltage_step_V: float = 0.0
    voltage_slew_V_per_s: float | None = None
    sensor_noise_rms: float
    noise_limit_rms: float | None = None
    scan_frequency_Hz: float
    disturbance_rms: float
    resonant_harmonics: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not 0 < self.modulus_margin < 1:
            raise ValueError(f"modulus_margin is {self.modulus_margin}, expected between 0 and 1")
        if not self.voltage_min_V < self.voltage_max_V:
            raise ValueError(
                f"voltage limits {self.voltage_min_V} and {self.voltage_max_V} V cross"
            )
        positive = ("bandwidth_Hz", "delay_margin_s", "scan_frequency_Hz")
        for name in (*positive, "noise_limit_rms", "voltage_slew_V_per_s"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ValueError(f"{name} is {value}, expected > 0")
        for name in ("sensor_noise_rms", "disturbance_rms", "voltage_step_V"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} is {getattr(self, name)}, expected >= 0")

    @property
    def oscillation_Hz(self) -> tuple[float, ...]:
        """Frequencies of the observer's oscillators."""
        return tuple(h * self.scan_frequency_Hz for h in self.resonant_harmonics)

    @property
    def all_templates(self) -> tuple[Template, ...]:
        """The attenuation template of the bandwidth, then the additional templates."""
        return (attenuation(self.bandwidth_Hz, _AT_BANDWIDTH_dB), *self.templates)


def default_specification(
    family: PlantFamily,
    *,
    voltage_min_V: float,
    voltage_max_V: float,
    sensor_noise_rms: float,
    disturbance_rms: float,
    voltage_slew_V_per_s: float | None = None,
) -> Specification:
    """Return the default specification for a plant family.

    bandwidth          0.15 of the slowest pole or mode, or 0.03 / delay, whichever is less; the
                       delay is the plant's phase delay at rest, if that is positive
    margins            modulus 0.5, delay one sample
    control            |Sup| <= 20 dB relative to 1/gain of the least sensitive member: the drive
                       that rejects any disturbance is at most ten times the static drive. An
                       integrator makes |Sup| = 1/gain at rest, so that no lower limit can be met
    scan               a tenth of the bandwidth
    """
    plant = family.nominal
    delay_s = plant.rest_delay_s
    bandwidth_Hz = MODE_SHARE * slowest_Hz(plant)
    if delay_s > 0.0:  # a zero slower than every pole leads at rest
        bandwidth_Hz = min(bandwidth_Hz, _DELAY_SHARE / delay_s)
    min_gain = min(abs(member.gain) for member in family.members)
    limit_dB = _CONTROL_LIMIT_dB - float(decibel(min_gain))
    nyquist_Hz = 0.5 * plant.sampling_rate_Hz
    control = constant_limit(CONTROL_EFFORT, "Sup", (1e-3, nyquist_Hz), limit_dB)
    return Specification(
        bandwidth_Hz=bandwidth_Hz,
        delay_margin_s=1.0 / plant.sampling_rate_Hz,
        templates=(control,),
        voltage_min_V=voltage_min_V,
        voltage_max_V=voltage_max_V,
        voltage_slew_V_per_s=voltage_slew_V_per_s,
        sensor_noise_rms=sensor_noise_rms,
        scan_frequency_Hz=bandwidth_Hz / 10.0,
        disturbance_rms=disturbance_rms,
    )


def slowest_Hz(plant: Plant) -> float:
    """Return the smallest natural frequency of the plant's poles, |ln z| fs / 2 pi."""
    return float(np.abs(np.log(plant.poles)).min() * plant.sampling_rate_Hz / (2.0 * np.pi))


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
    step_V, reading_step_V = (
        0.0 if range_V is None or bits is None else float((range_V[1] - range_V[0]) / 2.0**bits)
        for bits in (acquisition.dac_bits, acquisition.adc_bits)
    )
    command_V = command_range_V(lab, axis)
    if command_V is not None and range_V is not None:
        command_V = command_V[0], min(command_V[1], range_V[1] - step_V)
    return Converters(
        command_V=command_V,
        command_step_V=step_V,
        reading_V=range_V,
        reading_step_V=reading_step_V,
        command_slew_V_per_s=slew_V_per_s,
    )


def specifications_from_toml(
    text: str, defaults: Mapping[str, Specification], *, source: str = "design.toml"
) -> dict[str, Specification]:
    """Read ``design.toml``, one table per axis, which overrides the defaults of the model.

        [x]
        bandwidth_Hz = 120
        [[x.template]]
        name = "mode"
        function = "Syp"
        frequency_Hz = [500, 800]
        upper_dB = [3, 3]

    Raises ``LabFileError`` for an axis, key or value that cannot be used.
    """
    try:
        tables = read_toml(text)
    except ValueError as fault:
        raise _unusable(source, f"not TOML: {fault}", "correct TOML") from fault
    result = dict(defaults)
    for axis, table in tables.items():
        if axis not in defaults or not isinstance(table, dict):
            names = ", ".join(sorted(defaults))
            raise _unusable(source, f"[{axis}] is not an axis of this model", f"one of {names}")
        try:
            result[axis] = _from_table(defaults[axis], table, f"{source} [{axis}]")
        except (TypeError, OverflowError) as fault:
            raise _unusable(source, f"[{axis}]: {fault}", "values of the right kind") from fault
    return result


def _from_table(default: Specification, table: dict[str, Any], source: str) -> Specification:
    values = dict(table)
    templates = tuple(_template(t, source) for t in values.pop("template", ()))
    allowed_keys = {f.name for f in fields(Specification)} - {"templates"}
    for key, value in values.items():
        if key not in allowed_keys:
            names = ", ".join(sorted(allowed_keys))
            raise _unusable(source, f"unknown key {short(key)}", f"one of {names}")
        # TOML integers may have thousands of digits.
        is_number = (
            isinstance(value, int | float)
            and not isinstance(value, bool)
            and (value == 0 or _SMALLEST <= abs(value) <= _LARGEST)
        )
        if key == "resonant_harmonics":
            harmonics = value if isinstance(value, list) else [value]
            if not all(type(h) is int and 0 < h <= _LAST_HARMONIC for h in harmonics):
                needed = f"a list of whole numbers from 1 to {_LAST_HARMONIC}"
                raise _unusable(source, f"{key} is {short(value)}", needed)
            if len(harmonics) > _MAX_HARMONICS:
                needed = f"at most {_MAX_HARMONICS}: an observer has no more states"
                raise _unusable(source, f"{key} holds {len(harmonics)} numbers", needed)
            values[key] = tuple(harmonics)
        elif not is_number:
            raise _unusable(source, f"{key} is {short(value)}", "a number in SI units")
        elif key in ("bandwidth_Hz", "scan_frequency_Hz") and value > _FASTEST_Hz:
            raise _unusable(source, f"{key} is {short(value)}", f"at most {_FASTEST_Hz:.0e} Hz")
        elif key.endswith("_rms") and value > _LARGEST_rms:
            raise _unusable(source, f"{key} is {short(value)}", f"at most {_LARGEST_rms:.0f}")
    try:
        return replace(default, **values, templates=default.templates + templates)
    except ValueError as fault:
        raise _unusable(source, str(fault), "a value in its range") from fault


def _template(table: Any, source: str) -> Template:
    try:
        template = Template(**table)
    except (TypeError, ValueError) as fault:
        needed = f"name, function (one of {', '.join(FUNCTIONS)}), frequency_Hz, upper_dB"
        raise _unusable(source, f"template: {fault}", needed) from fault
    if not isinstance(template.name, str):
        raise _unusable(source, f"template: name is {short(template.name)}", "a text")
    if np.abs(template.upper_dB).max() > _LARGEST_dB or template.frequency_Hz[-1] > _LARGEST:
        needed = f"within {_LARGEST_dB:.0f} dB and below {_LARGEST:.0e} Hz"
        raise _unusable(source, f"template {short(template.name)} is out of range", needed)
    return template


def _unusable(source: str, fault: str, needed: str) -> LabFileError:
    return LabFileError(
        f"{source}: {fault}", needed=needed, remedy=f"Correct {source} and design again."
    )
