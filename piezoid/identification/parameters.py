"""Every number of a fitted axis in one table, with its unit and its 95 % interval."""

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from piezoid.identification.extensions.extension import Extension
from piezoid.identification.model import AxisModel
from piezoid.numerics.robust import NORMAL_95
from piezoid.raw_counts import in_counts

if TYPE_CHECKING:
    from pandas import DataFrame

# Longest first: ``m_per_V`` is not ``V``.
_ENDINGS = (
    ("_m_per_V", "m/V"), ("_V_per_s", "V/s"), ("_m_per_s", "m/s"), ("_per_V", "1/V"),
    ("_Hz", "Hz"), ("_V", "V"), ("_m", "m"), ("_s", "s"), ("_K", "K"),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class _Row:
    name: str
    value: float
    unit: str
    low: float = np.nan
    high: float = np.nan


def parameters_of(axis: AxisModel) -> "DataFrame":
    """Return the table, names down its side: ``value``, ``unit``, ``low``, ``high``.

    Intervals of the hysteresis are from leaving out blocks of cycles, a weight on zero has its
    one-sided limit; those of dynamics and extensions are from the fit's curvature.
    """
    from pandas import DataFrame

    rows = [*_hysteresis(axis), *_dynamics(axis)]
    rows += [row for extension in axis.extensions for row in _extension(extension)]
    rows = [replace(row, unit=in_counts(row.unit, axis.counted)) for row in rows]
    return DataFrame(
        {name: [getattr(row, name) for row in rows] for name in ("value", "unit", "low", "high")},
        index=[row.name for row in rows],
    )


def unit_of_name(name: str) -> str:
    """Return the unit at the end of a name, ``1`` if it has none."""
    stem = name.partition("[")[0]
    return next((unit for ending, unit in _ENDINGS if stem.endswith(ending)), "1")


def _hysteresis(axis: AxisModel) -> list[_Row]:
    uncertainty = axis.uncertainty
    half = NORMAL_95 * np.sqrt(np.diag(uncertainty.covariance))
    rows = []
    for name, value, spread in zip(uncertainty.names, uncertainty.values, half, strict=True):
        high = uncertainty.upper_limit.get(name, value + spread)
        low = value if name in uncertainty.upper_limit else value - spread
        rows.append(
            _Row(
                name=name,
                value=float(value),
                unit=unit_of_name(name),
                low=float(low),
                high=float(high),
            )
        )
    return rows


def _dynamics(axis: AxisModel) -> list[_Row]:
    if axis.dynamics is None:
        return []
    dynamics = axis.dynamics
    tables = (
        ("mode_frequency_Hz", dynamics.mode_frequency_Hz, dynamics.mode_frequency_interval_Hz()),
        ("mode_damping", dynamics.mode_damping, dynamics.mode_damping_interval()),
        ("lag_frequency_Hz", dynamics.lag_frequency_Hz, dynamics.lag_frequency_interval_Hz()),
    )
    rows = [
        _Row(
            name=f"{name}[{k}]",
            value=float(value),
            unit=unit_of_name(name),
            low=float(low),
            high=float(high),
        )
        for name, values, intervals in tables
        for k, (value, (low, high)) in enumerate(zip(values, intervals, strict=True))
    ]
    low_s, high_s = dynamics.delay_interval_s().tolist()
    rows.append(_Row(name="delay_s", value=dynamics.delay_s, unit="s", low=low_s, high=high_s))
    return rows


def _extension(extension: Extension) -> list[_Row]:
    """Return the numbers of one extension but those that belong to single recordings.

    The ends of an interval are the extension's own numbers with what was fitted moved there.
    """
    free, std = extension.free(), np.array(extension.std)
    values = _numbers(extension)
    lows = highs = {name: np.nan for name in values}
    if len(std) == len(free.value) > 0:
        half = NORMAL_95 * std
        lows, highs = (
            _numbers(extension.moved_to(np.clip(free.value + step, free.lower, free.upper)))
            for step in (-half, half)
        )
    rows = []
    for name, value in values.items():
        low, high = sorted((lows[name], highs[name]))
        fitted = low < high
        rows.append(
            _Row(
                name=f"{extension.kind}.{name}",
                value=value,
                unit=unit_of_name(name),
                low=low if fitted else np.nan,
                high=high if fitted else np.nan,
            )
        )
    return rows


def _numbers(extension: Extension) -> dict[str, float]:
    numbers: dict[str, float] = {}
    for entry in fields(extension):
        value = getattr(extension, entry.name)
        if entry.name == "std":
            continue
        if isinstance(value, float):
            numbers[entry.name] = value
        elif isinstance(value, tuple) and all(isinstance(part, float) for part in value):
            numbers |= {f"{entry.name}[{k}]": part for k, part in enumerate(value)}
    return numbers
