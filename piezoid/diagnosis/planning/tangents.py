"""What each effect would add along a drive that has not been played yet: one effect, one entry.

The columns are those of the score test, made from the fitted model alone, in metres for a
strength of one. Effects that are faults of the data, and what the model always follows, have
none: no drive exposes them better.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.planning.driven import Driven
from piezoid.diagnosis.signals import mode, rate_of
from piezoid.identification.extensions.slew_limit import SlewLimit
from piezoid.identification.hysteresis.filters import first_order, later, relaxed
from piezoid.numerics.arrays import Array
from piezoid.operators.ladder import ladder

PER_DECADE = 2
CREEP_s = (0.03, 3000.0)
DRIFT_s = 100.0
CLIPS_AT = 0.94  # of the range, about its middle
SLOWS_AT = 0.7  # of the fastest speed along the drive
MAINS_Hz = (50.0, 60.0, 100.0, 120.0, 150.0, 180.0)
PERIODS = 60.0  # of a periodic sensor error in the stroke, where none was found
QUALITY = 20.0

Columns = Callable[[Driven, float], Array]


@dataclass(frozen=True, kw_only=True)
class Tangent:
    """What one effect adds.

    name     as in diagnosis.json
    columns  (drive, scale) -> (rows, columns); ``scale`` in its own unit where it has one
    own      whether every drive has coefficients of its own
    lags     whether it is a lag itself, so that a fitted lag must not take it away
    scale    in s or Hz: for effects whose shape depends on their size; 0: it does not
    found    name of a finding's parameter that is this scale, or empty
    """

    name: str
    columns: Columns
    own: bool = False
    lags: bool = False
    scale: float = 0.0
    found: str = ""


def _creep(drive: Driven, _: float) -> Array:
    first, last = np.log10(CREEP_s)
    times_s = np.logspace(first, last, round((last - first) * PER_DECADE))
    rungs = [first_order(time_s, drive.rate_Hz) for time_s in times_s]
    return ladder(drive.static_m, rungs, 1.0 / PER_DECADE)[:, None]


def _drift(drive: Driven, _: float) -> Array:
    unit = drive.time_s / DRIFT_s
    return 1e-6 * np.column_stack([unit, unit**2])


def _delay(drive: Driven, time_s: float) -> Array:
    late_m = later(drive.static_m, time_s * drive.rate_Hz)
    return np.asarray((late_m - drive.static_m)[:, None] / time_s)


def _lag(drive: Driven, time_s: float) -> Array:
    behind_m = relaxed(drive.static_m, time_s, drive.rate_Hz)
    return np.asarray((behind_m - drive.static_m)[:, None] / time_s)


def _rate(drive: Driven, _: float) -> Array:
    return -rate_of(drive.walls_m, drive.rate_Hz)[:, None]


def _resonance(drive: Driven, frequency_Hz: float) -> Array:
    ringing_m = mode(drive.static_m, frequency_Hz, QUALITY, drive.rate_Hz) - drive.static_m
    return ringing_m[:, None]


def _coupling(drive: Driven, _: float) -> Array:
    if not drive.others:
        return np.zeros((len(drive.voltage_V), 1))
    return 1e-6 * np.column_stack(list(drive.others.values()))


def _saturation(drive: Driven, _: float) -> Array:
    low_V, high_V = drive.model.voltage_V
    unit = (2.0 * drive.voltage_V - low_V - high_V) / (high_V - low_V)
    over, under = np.maximum(unit - CLIPS_AT, 0.0), np.minimum(unit + CLIPS_AT, 0.0)
    gain_m = float(np.sum(drive.model.hysteresis.plays.weight)) * drive.half_range_V
    return -gain_m * np.column_stack([over, under])


def _slew(drive: Driven, _: float) -> Array:
    """Return what a drive misses that gets no faster than a share of the fastest so far."""
    limit = SlewLimit(limit_V_per_s=SLOWS_AT * drive.model.certificate.slew_V_per_s)
    missed_V = limit.drive(drive.voltage_V, drive.rate_Hz) - drive.voltage_V
    gain = float(np.sum(drive.model.hysteresis.plays.weight))
    return np.asarray(gain * missed_V[:, None])


def _gain(drive: Driven, _: float) -> Array:
    after = drive.time_s > 0.5 * drive.time_s[-1]
    return np.asarray((drive.static_m * after)[:, None])


def _hum(drive: Driven, _: float) -> Array:
    heard = [f for f in MAINS_Hz if f < 0.4 * drive.rate_Hz]
    reversals = [2 * np.pi * f * drive.time_s for f in heard]
    waves = [wave(turn) for turn in reversals for wave in (np.cos, np.sin)]
    return 1e-6 * np.column_stack(waves or [np.zeros(len(drive.voltage_V))])


def _periodic(drive: Driven, _: float) -> Array:
    stroke_m = float(np.sum(drive.model.hysteresis.plays.weight)) * 2 * drive.half_range_V
    turn = 2 * np.pi * PERIODS * drive.static_m / stroke_m
    return 1e-6 * np.column_stack([np.cos(turn), np.sin(turn)])


def _bias(drive: Driven, _: float) -> Array:
    unit = drive.drive_V / drive.half_range_V
    return np.column_stack([drive.walls_m * unit, drive.walls_m * unit**2])


TANGENTS: tuple[Tangent, ...] = (
    Tangent(name="amplifier_saturation", columns=_saturation),
    Tangent(name="slew_limit", columns=_slew),
    Tangent(name="delay", columns=_delay, lags=True, scale=1e-4),
    Tangent(name="lag", columns=_lag, lags=True, scale=1e-4),
    Tangent(name="resonance", columns=_resonance, lags=True, scale=500.0, found="frequency_Hz"),
    Tangent(name="rate_dependence", columns=_rate),
    Tangent(name="creep", columns=_creep),
    Tangent(name="thermal_drift", columns=_drift, own=True),
    Tangent(name="cross_coupling", columns=_coupling),
    Tangent(name="mains_interference", columns=_hum, own=True),
    Tangent(name="sensor_periodic_error", columns=_periodic),
    Tangent(name="gain_change", columns=_gain, own=True),
    Tangent(name="non_congruence", columns=_bias),
)

WITHOUT: Mapping[str, str] = {
    "quantisation": "its remedy is a finer converter range, not another drive",
    "timestamp_fault": "its remedy is the acquisition's own counter in a column",
    "outliers": "its remedy is the wiring, not another drive",
    "asymmetry": "the model has dead zones and follows it, so that nothing of it can be missing",
    "initial_state": "its remedy is to cycle the drive first, as every planned drive does",
}


def tangent_of(name: str) -> Tangent | None:
    """Return the entry of an effect, or None for a fault of the data."""
    return next((one for one in TANGENTS if one.name == name), None)
