"""Tables of lab.toml: every key, with its unit, its meaning and its admissible numbers."""

from typing import Literal

import msgspec

from piezoid.errors import LabFileError
from piezoid.toml_files import toml_string

# Limits of all quantities; squares and quotients of larger or smaller numbers would overflow.
_SMALLEST, _LARGEST = 1e-30, 1e30
_NOT_ZERO = ("gain_V_per_V", "gain_m_per_V", "gain_V_per_m", "set_point_A", "scale")
_ABOVE_ZERO = (_SMALLEST, _LARGEST, "a number above zero")
_ZERO_OR_MORE = (0.0, _LARGEST, "zero or more")
# Smallest and largest number, and their description, by the key or by the unit at its end.
_RANGES = {
    **dict.fromkeys(
        (
            *("slew_V_per_s", "floor_A", "ceiling_A", "barrier_range_eV", "retract_s", "lost_s"),
            *("retract_m", "retract_limit", "search_m", "approach_m_per_s", "feedback_ohm"),
            "heading_row",
        ),
        _ABOVE_ZERO,
    ),
    **dict.fromkeys(
        (
            *("sensor_gain_relative", "sensor_linearity_m", "tilt_rad", "temperature_range_K"),
            *("expansion_m_per_K", "settling_periods"),
        ),
        _ZERO_OR_MORE,
    ),
    "extension_uncertainty": (0.0, 1.0 - 1e-16, "a share from 0 to below 1"),
    "bits": (1, 64, "1 to 64 bits"),
    "Hz": (1e-6, 1e12, "1e-06 to 1e+12 Hz"),  # any bandwidth or clock on a bench
}


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of lab.toml."""


class RigName(Table, frozen=True, kw_only=True):
    """``[rig]``: name of the rig in its laboratory."""

    name: str = ""


class Amplifier(Table, frozen=True, kw_only=True):
    """``[amplifier]``: between the converter and the piezo."""

    gain_V_per_V: float | None = None
    bandwidth_Hz: float | None = None
    output_min_V: float | None = None
    output_max_V: float | None = None
    slew_V_per_s: float | None = None


class Actuator(Table, frozen=True, kw_only=True):
    """``[actuator]``: numbers of the data sheet; the fitted gain replaces the gain.

    bandwidth_Hz  a pole or a resonance; the fit finds out which, and does not compensate for it
    """

    gain_m_per_V: float | None = None
    bandwidth_Hz: float | None = None


class Sensor(Table, frozen=True, kw_only=True):
    """``[sensor]``: bandwidth, and gain of recordings in volts of the sensor."""

    bandwidth_Hz: float | None = None
    gain_V_per_m: float | None = None


class Acquisition(Table, frozen=True, kw_only=True):
    """``[acquisition]``: converters and rate of the controller, also of files without a clock."""

    sampling_rate_Hz: float | None = None
    dac_bits: int | None = None
    adc_bits: int | None = None
    input_range_V: tuple[float, float] | None = None


class Tunnelling(Table, frozen=True, kw_only=True):
    """``[tunnelling]``: the loop that controls a tunnelling current.

    set_point_A            set point of the current, with its sign
    floor_A                > 0: smallest current of the logarithm; below it the tip is lost
    bandwidth_Hz           of the current sensor; default: the fitted pole
    feedback_ohm           resistor of the current sensor, for its Johnson noise
    extension_uncertainty  relative standard uncertainty of the tip's extension per volt
    barrier_range_eV       (low, high) apparent barriers for which the loop must be stable, besides
                           the identified ones
    ceiling_A              > 0: current at which the tip is retracted immediately
    retract_V              voltage at which a latched tip waits; default: the lowest command
    retract_m              > 0: length of one retraction, before the tip approaches again
    retract_s              duration of the first retraction; it doubles with each successive one
    retract_limit          number of successive retractions after which the tip stays retracted
                           (latched) until an operator intervenes
    lost_s                 duration of an unusable current after which the tip is retracted
    search_m               > 0: distance beyond its last contact that the tip searches for a lost
                           surface. A step down of the surface and a dead current sensor look the
                           same: the tip finds lower steps by itself, and moves so far towards the
                           surface when the sensor has failed. A gap is 0.4 to 1 nm wide
    approach_m_per_s       speed of the approach; default: the largest that the loop allows
    """

    set_point_A: float | None = None
    floor_A: float | None = None
    bandwidth_Hz: float | None = None
    feedback_ohm: float | None = None
    extension_uncertainty: float = 0.0
    barrier_range_eV: tuple[float, float] | None = None
    ceiling_A: float | None = None
    retract_V: float | None = None
    retract_m: float = 5e-9
    retract_s: float = 0.01
    retract_limit: int = 5
    lost_s: float = 1e-3
    search_m: float = 3.5e-10
    approach_m_per_s: float | None = None


# Keys of ``[tunnelling]`` that only the export uses.
GUARDS = (
    *("ceiling_A", "retract_V", "retract_m", "retract_s", "retract_limit"),
    *("lost_s", "search_m", "approach_m_per_s"),
)


class Certificates(Table, frozen=True, kw_only=True):
    """``[uncertainty]``: numbers from certificates and data sheets that recordings do not contain.

    sensor_gain_relative   relative standard uncertainty (k = 1) of the sensor's gain
    sensor_linearity_m     limits of the sensor's linearity error, plus and minus
    tilt_rad               largest angle between the sensor's axis and the motion
    temperature_range_K    full range of the room's temperature
    expansion_m_per_K      apparent displacement per kelvin
    """

    sensor_gain_relative: float | None = None
    sensor_linearity_m: float | None = None
    tilt_rad: float | None = None
    temperature_range_K: float | None = None
    expansion_m_per_K: float | None = None


class Coupled(Table, frozen=True, kw_only=True):
    """``[coupled]``: axes whose drives act on all of their displacements.

    axes              two or more, in the order of the matrix that decouples them
    settling_periods  periods at the start of a periodic drive that are not yet steady
    """

    axes: tuple[str, ...] = ()
    settling_periods: int = 1


class RecordingEntry(Table, frozen=True, kw_only=True):
    """``[[recording]]``: declarations about one file.

    file              name, relative to the folder of lab.toml
    axis              axis of the recording
    columns           ``time``, ``voltage``, ``displacement``, ``current``, ``temperature``,
                      ``humidity``, ``reference``, each also with ``_x``, ``_y``, ``_z``: a
                      heading, or a number from 1; other columns are not read. A reference is
                      a dither of the set point or of the drive, independent of all measurements.
                      Of a frequency response ``frequency`` with ``magnitude`` and ``phase``,
                      ``real`` and ``imaginary``, or ``response`` (a complex array), ``coherence``
                      and ``excitation``, each also with ``_x``, or ``_xy``: x moves, y is driven
    units             by the same names
    scale             by the same names: factor that is applied after the unit. It reverses a
                      polarity (-1), converts volts of a monitor (15), or converts counts (in SI
                      units per count)
    offset            by the same names: constant that is added after the scale, in SI units
    sampling_rate_Hz  of this file, if it has no time column
    start_s, stop_s   the part to use, in seconds from the first sample
    reverse           whether the newest row is the first
    includes          poles of the rig that a frequency response was measured through, of
                      ``amplifier`` and ``sensor``; default: both
    separator, decimal, heading_row   layout of a text table: the character between fields
                      (a blank for any white space), ``.`` or ``,``, and the line of the headings,
                      from 1
    """

    file: str
    axis: str | None = None
    columns: dict[str, str | int] = {}
    units: dict[str, str] = {}
    scale: dict[str, float] = {}
    offset: dict[str, float] = {}
    sampling_rate_Hz: float | None = None
    start_s: float | None = None
    stop_s: float | None = None
    reverse: bool = False
    includes: tuple[Literal["amplifier", "sensor"], ...] | None = None
    separator: str | None = None
    decimal: Literal[".", ","] | None = None
    heading_row: int | None = None


class AxisRig(Table, frozen=True, kw_only=True):
    """``[axis.<name>.*]``: tables that replace the common ones for one axis."""

    amplifier: Amplifier | None = None
    actuator: Actuator | None = None
    sensor: Sensor | None = None


def check_numbers(location: str, table: Table) -> None:
    """Refuse numbers and ranges of a table that its quantities do not have."""
    for key in table.__struct_fields__:
        value = getattr(table, key)
        values = value.values() if isinstance(value, dict) else value
        low, high, needed = _RANGES.get(
            key, _RANGES.get(key.rpartition("_")[2], (-_LARGEST, _LARGEST, ""))
        )
        for number in values if isinstance(value, dict | tuple) else (value,):
            if isinstance(number, bool) or not isinstance(number, int | float):
                continue
            # Integers of TOML have any length: they are not converted to a float or a text.
            if not (number == 0 or _SMALLEST <= abs(number) <= _LARGEST):
                raise lab_error(
                    f"{location} {key} is "
                    f"{number if isinstance(number, float) else 'a number of very many digits'}",
                    f"a number, zero, or between {_SMALLEST:.0e} and {_LARGEST:.0e}",
                )
            if key in _NOT_ZERO and number == 0:
                raise lab_error(f"{location} {key} is zero", "a number that is not zero")
            if not low <= number <= high:
                raise lab_error(f"{location} {key} is {number}", needed)
        if isinstance(value, tuple) and key in ("input_range_V", "barrier_range_eV"):
            check_range(location, key, *value)
    if isinstance(table, Amplifier):
        check_range(location, "output", table.output_min_V, table.output_max_V)


def check_range(location: str, name: str, low: float | None, high: float | None) -> None:
    """Refuse a range whose limits are not increasing."""
    if low is not None and high is not None and not low < high:
        raise lab_error(f"{location} {name} goes from {low} to {high}", "a range that ascends")


def entry_text(file: str, *lines: str) -> str:
    """Return a ``[[recording]]`` entry about a file, as TOML."""
    return "\n".join(["[[recording]]", f"file = {toml_string(file)}", *lines])


def lab_error(problem: str, needed: str) -> LabFileError:
    """Return an error in lab.toml; ``problem`` starts with the name of the file."""
    return LabFileError(
        problem,
        needed=needed,
        remedy="Correct it; docs/guide/lab_toml.md lists all tables and keys.",
    )
