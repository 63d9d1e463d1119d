"""What the numbers of a lab.toml may be."""

from pathlib import Path

from piezoid.errors import LabFileError

_POSITIVE = (
    "bandwidth_Hz",
    "slew_V_per_s",
    "sampling_rate_Hz",
    "dac_bits",
    "adc_bits",
    "floor_A",
    "ceiling_A",
    "barrier_eV",
    "retract_s",
    "lost_s",
    "retract_m",
    "retract_limit",
    "search_m",
    "approach_m_per_s",
    "feedback_ohm",
    "heading_row",
)
_NOT_NEGATIVE = (
    "sensor_gain_relative",
    "sensor_linearity_m",
    "tilt_rad",
    "temperature_range_K",
    "expansion_m_per_K",
    "settling_periods",
)
_NOT_ZERO = ("gain_V_per_V", "gain_m_per_V", "gain_V_per_m", "set_point_A", "scale")
_SHARES = ("extension_uncertainty",)
_LARGEST_BITS = 64
_RATES_Hz = 1e-6, 1e12  # of any bandwidth or clock on a bench
# Beyond this nothing on a bench is, and squares and quotients leave the range of numbers.
_SMALLEST, _LARGEST = 1e-30, 1e30


def check_number(path: Path, place: str, key: str, value: object) -> None:
    """Refuse a number that cannot be what its name says; anything else passes."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return
    # Whole numbers of TOML have any length: neither a float nor a text is made of them here.
    if not (value == 0 or _SMALLEST <= abs(value) <= _LARGEST):
        found = value if isinstance(value, float) else "a number of very many digits"
        needed = f"zero, or between {_SMALLEST:.0e} and {_LARGEST:.0e}"
        raise refusal(path, f"{place} {key} is {found}", f"a number, {needed}")
    if key in _POSITIVE and not value > 0:
        raise refusal(path, f"{place} {key} is {value}", "a number above zero")
    if key.endswith("_Hz") and not _RATES_Hz[0] <= value <= _RATES_Hz[1]:
        low_Hz, high_Hz = _RATES_Hz
        raise refusal(path, f"{place} {key} is {value}", f"{low_Hz:g} to {high_Hz:g} Hz")
    if key in _NOT_NEGATIVE and not value >= 0:
        raise refusal(path, f"{place} {key} is {value}", "zero or more")
    if key in _NOT_ZERO and value == 0:
        raise refusal(path, f"{place} {key} is zero", "a number that is not zero")
    if key in _SHARES and not 0 <= value < 1:
        raise refusal(path, f"{place} {key} is {value}", "a share from 0 to below 1")
    if key.endswith("_bits") and value > _LARGEST_BITS:
        raise refusal(path, f"{place} {key} is {value}", f"at most {_LARGEST_BITS} bits")


def check_file_name(path: Path, place: str, name: str) -> None:
    """Refuse what no file can be called."""
    if "\0" in name:
        raise refusal(path, f"{place} holds a zero character", "the name of a file")


def check_separator(path: Path, place: str, separator: str | None) -> None:
    """Refuse what cannot stand between two numbers."""
    if separator is None or (len(separator) == 1 and not separator.isalnum() and separator != "."):
        return
    found = f"{place} separator is {separator[:20]!r}"
    raise refusal(path, found, 'one character, as ";", "\\t" or " " for any white space')


def check_range(path: Path, place: str, name: str, low: float | None, high: float | None) -> None:
    """Refuse a range that does not ascend."""
    if low is not None and high is not None and not low < high:
        raise refusal(path, f"{place} {name} goes from {low} to {high}", "a range that ascends")


def refusal(path: Path, found: str, needed: str) -> LabFileError:
    """Return the error of a lab.toml, naming the file."""
    return LabFileError(
        f"{path.name}: {found}",
        needed=needed,
        remedy="Correct it; every table and name is listed in the documentation of lab.toml.",
    )
