"""Table of all parameters of a fitted axis with unit and 95 % interval."""

from dataclasses import fields
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


def parameters_of(axis: AxisModel) -> "DataFrame":
    """Return a table of all parameters by name: ``value``, ``unit``, ``low``, ``high``.

    Intervals of the hysteresis come from leaving out blocks of cycles; a weight of 0 has a
    one-sided limit. Intervals of dynamics and extensions are normal, from their standard errors.
    """
    from pandas import DataFrame

    uncertainty, dynamics = axis.uncertainty, axis.dynamics
    half = NORMAL_95 * np.sqrt(np.diag(uncertainty.covariance))
    rows: list[tuple[str, float, float, float]] = []  # name, value, low, high
    for name, value, spread in zip(uncertainty.names, uncertainty.values, half, strict=True):
        limit = uncertainty.upper_limit.get(name)
        low, high = (value - spread, value + spread) if limit is None else (value, limit)
        rows.append((name, float(value), float(low), float(high)))
    if dynamics is not None:
        of_modes = (dynamics.mode_frequency_Hz, dynamics.mode_frequency_interval_Hz())
        for name, (values, intervals) in {
            "mode_frequency_Hz": of_modes,
            "mode_damping": (dynamics.mode_damping, dynamics.mode_damping_interval()),
            "lag_frequency_Hz": (dynamics.lag_frequency_Hz, dynamics.lag_frequency_interval_Hz()),
        }.items():
            for k, (value, (low, high)) in enumerate(zip(values, intervals, strict=True)):
                rows.append((f"{name}[{k}]", float(value), float(low), float(high)))
        low_s, high_s = dynamics.delay_interval_s().tolist()
        rows.append(("delay_s", dynamics.delay_s, low_s, high_s))
    for extension in axis.extensions:
        # The ends of an interval are the fields of the extension at the ends of its free numbers.
        free, half = extension.free(), NORMAL_95 * np.array(extension.std)
        stated = _numbers(extension)
        limits = [dict.fromkeys(stated, np.nan)] * 2
        if len(half) == len(free.value) > 0:
            bounds = [np.clip(free.value + step, free.lower, free.upper) for step in (-half, half)]
            limits = [_numbers(extension.moved_to(value)) for value in bounds]
        for name, value in stated.items():
            low, high = sorted((limits[0][name], limits[1][name]))
            if not low < high:  # not a free number
                low = high = np.nan
            rows.append((f"{extension.kind}.{name}", value, low, high))
    names, numbers, lows, highs = zip(*rows, strict=True)
    units = []
    for name in names:  # the unit is at the end of the name
        stem = name.partition("[")[0]
        unit = next((unit for ending, unit in _ENDINGS if stem.endswith(ending)), "1")
        units.append(in_counts(unit, axis.counted))
    table = {"value": numbers, "unit": units, "low": lows, "high": highs}
    return DataFrame(table, index=list(names))


def _numbers(extension: Extension) -> dict[str, float]:
    """Return the numbers of an extension by name, without those of single recordings."""
    numbers: dict[str, float] = {}
    for entry in fields(extension):
        value = getattr(extension, entry.name)
        if entry.name == "std":
            continue
        if isinstance(value, float):
            numbers[entry.name] = value
        elif isinstance(value, tuple) and all(isinstance(number, float) for number in value):
            numbers |= {f"{entry.name}[{k}]": number for k, number in enumerate(value)}
    return numbers
