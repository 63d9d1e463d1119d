"""Admissible numbers of lab.toml."""

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
