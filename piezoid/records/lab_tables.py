"""Tables of lab.toml: every key, with its unit, its meaning and its admissible numbers."""

from typing import Literal

import msgspec

from piezoid.errors import LabFileError

# Beyond these nothing on a bench is, and squares and quotients leave the range of numbers.
_SMALLEST, _LARGEST = 1e-30, 1e30
_NOT_ZERO = ("gain_V_per_V", "gain_m_per_V", "gain_V_per_m", "set_point_A", "scale")
_ABOVE_ZERO = (_SMALLEST, _LARGEST, "a number above zero")
_ZERO_OR_MORE = (0.0, _LARGEST, "zero or more")
# Smallest, largest and what is needed, by the name of the number or by its unit.
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
    """``[actuator]``: of the data sheet; a fitted gain replaces the gain.

    bandwidth_Hz  as stated, pole or resonance: the fit tells which, and takes nothing out for it
    """

    gain_m_per_V: float | None = None
    bandwidth_Hz: float | None = None


class Sensor(Table, frozen=True, kw_only=True):
    """``[sensor]``: displacement to volts, where a recording holds the sensor's volts."""

    bandwidth_Hz: float | None = None
    gain_V_per_m: float | None = None


class Acquisition(Table, frozen=True, kw_only=True):
    """``[acquisition]``: the controller's converters and rate; of files without a clock too."""

    sampling_rate_Hz: float | None = None
    dac_bits: int | None = None
    adc_bits: int | None = None
    input_range_V: tuple[float, float] | None = None


class Tunnelling(Table, frozen=True, kw_only=True):
    """``[tunnelling]``: the loop that holds a tunnelling current.

    set_point_A            the current the loop holds, with its sign
    floor_A                > 0: below it the controller takes no logarithm, the tip is lost
    bandwidth_Hz           of the current sensor; the fitted pole stands in where it is missing
    feedback_ohm           resistor of the current sensor, for its Johnson noise
    extension_uncertainty  relative standard uncertainty of the tip's extension per volt
    barrier_range_eV       (low, high) apparent barriers to hold, beside those identified
    ceiling_A              > 0: from here on the tip is retracted at once
    retract_V              where a latched tip waits; the lowest command where it is missing
    retract_m              > 0: how far one retract goes, before the tip approaches again
    retract_s              for how long at first; each retract in a row waits twice as long
    retract_limit          so many retracts, each soon after the last, latch: an operator must look
    lost_s                 an unusable current for so long retracts as well
    search_m               > 0: how far beyond its last contact the tip looks for a lost surface.
                           A step down of the surface and a dead current sensor look the same:
                           what this holds a tip finds again by itself, and is the way it goes on
                           towards the surface when the sensor died. A gap is 0.4 to 1 nm wide
    approach_m_per_s       slower than what the identified loop allows, which is the default
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


# Of ``[tunnelling]``, what export alone takes.
GUARDS = (
    *("ceiling_A", "retract_V", "retract_m", "retract_s", "retract_limit"),
    *("lost_s", "search_m", "approach_m_per_s"),
)


class Certificates(Table, frozen=True, kw_only=True):
    """``[uncertainty]``: numbers of certificates and data sheets, which no recording shows.

    sensor_gain_relative   standard uncertainty (k = 1) of the sensor's gain, as a share of one
    sensor_linearity_m     the sensor's error lies within plus and minus this
    tilt_rad               the sensor's axis lies within this angle of the motion
    temperature_range_K    the room stays within half of this of its middle
    expansion_m_per_K      what the sensor sees of that
    """

    sensor_gain_relative: float | None = None
    sensor_linearity_m: float | None = None
    tilt_rad: float | None = None
    temperature_range_K: float | None = None
    expansion_m_per_K: float | None = None


class Coupled(Table, frozen=True, kw_only=True):
    """``[coupled]``: axes whose drives act on all of their displacements.

    axes              two or more, in the order of the matrix that decouples them
    settling_periods  at the begin of every recording of a repeating drive, which are not steady
    """

    axes: tuple[str, ...] = ()
    settling_periods: int = 1


class RecordingEntry(Table, frozen=True, kw_only=True):
    """``[[recording]]``: how one file is to be read.

    file              its name, from lab.toml's folder
    axis              the axis it is about
    columns           ``time``, ``voltage``, ``displacement``, ``current``, ``temperature``,
                      ``humidity``, ``reference``, each also with ``_x``, ``_y``, ``_z``: a
                      heading, or a number from 1; only what is named here is read. A reference is
                      a dither of the set point or of the drive: it depends on nothing measured.
                      Of a frequency response ``frequency`` with ``magnitude`` and ``phase``,
                      ``real`` and ``imaginary``, or ``response`` (a complex array), ``coherence``
                      and ``excitation``, each also with ``_x``, or ``_xy``: x moves, y is driven
    units             by the same names
    scale             by the same names: what a value is multiplied by after its unit. It turns a
                      polarity (-1) and makes volts of a monitor (15) or, in SI units a count,
                      metres or volts of counts
    offset            by the same names: what is added then, in SI units
    sampling_rate_Hz  of this file, if it has no time column
    start_s, stop_s   the part to use, in seconds from its first sample
    reverse           whether the newest row stands first
    includes          poles of the rig that a frequency response was measured through, of
                      ``amplifier`` and ``sensor``; both, where it is not said
    separator, decimal, heading_row   how a text table is written: the character between fields
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


def check_number(location: str, key: str, value: object) -> None:
    """Refuse a number outside the range of its quantity; other types pass."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return
    # Integers of TOML have any length: do not convert them to a float or a text.
    if not (value == 0 or _SMALLEST <= abs(value) <= _LARGEST):
        number = value if isinstance(value, float) else "a number of very many digits"
        needed = f"a number, zero, or between {_SMALLEST:.0e} and {_LARGEST:.0e}"
        raise lab_error(f"{location} {key} is {number}", needed)
    if key in _NOT_ZERO and value == 0:
        raise lab_error(f"{location} {key} is zero", "a number that is not zero")
    low, high, needed = _RANGES.get(
        key, _RANGES.get(key.rpartition("_")[2], (-_LARGEST, _LARGEST, ""))
    )
    if not low <= value <= high:
        raise lab_error(f"{location} {key} is {value}", needed)


def check_range(location: str, name: str, low: float | None, high: float | None) -> None:
    """Refuse a range whose limits are not increasing."""
    if low is not None and high is not None and not low < high:
        raise lab_error(f"{location} {name} goes from {low} to {high}", "a range that ascends")


def lab_error(problem: str, needed: str) -> LabFileError:
    """Return an error in lab.toml; ``problem`` starts with the name of the file."""
    return LabFileError(
        problem,
        needed=needed,
        remedy="Correct it; every table and name is listed in the documentation of lab.toml.",
    )
