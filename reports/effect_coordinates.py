"""In which coordinate each effect shows: drawn as classes, over time, or as a spectrum."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.recording import Quantity
from piezoid_reports.chart import Axis, axis_over, decades_over
from piezoid_reports.traces import Trace

STILL = 1e-4  # of the drive's range: a change below it is a hold
SHORTEST_s = 0.2  # hold that counts

Along = Callable[[Trace], tuple[Array, Array]]


@dataclass(frozen=True, kw_only=True)
class Coordinate:
    """What a residual is drawn against.

    effects  that show in it
    label    of the axis
    unit     SI
    kind     ``classes`` of all recordings, ``time`` of one, or ``spectrum`` of one
    along    (trace) -> place of every sample, NaN where it does not count, and a sign that the
             residual is multiplied by
    reading  how to read the picture
    decades  whether places are log10 of numbers in ``unit``
    """

    effects: tuple[str, ...]
    label: str
    unit: str
    kind: str
    along: Along
    reading: str
    decades: bool = False

    def axis(self, place: Array) -> Axis:
        """Return the axis over some places."""
        over = decades_over if self.decades else axis_over
        return over(self.label, [place], self.unit)


def _same(place: Array) -> tuple[Array, Array]:
    return place, np.ones(len(place))


def _time(trace: Trace) -> tuple[Array, Array]:
    return _same(trace.time_s)


def _drive(trace: Trace) -> tuple[Array, Array]:
    return _same(trace.voltage_V)


def _speed(trace: Trace) -> tuple[Array, Array]:
    speed = np.gradient(trace.voltage_V) * trace.recording.sampling_rate_Hz
    return _same(np.asarray(speed))


def _hold(trace: Trace) -> tuple[Array, Array]:
    """Decades of time since the drive stopped, and the direction it had come from."""
    step = np.diff(trace.voltage_V, prepend=trace.voltage_V[0])
    moving = np.abs(step) > STILL * max(float(np.ptp(trace.voltage_V)), 1e-30)
    last = np.maximum.accumulate(np.where(moving, np.arange(len(step)), 0))
    since_s = (np.arange(len(step)) - last) / trace.recording.sampling_rate_Hz
    with np.errstate(divide="ignore"):
        decades = np.where(moving | (since_s <= 0.0), np.nan, np.log10(since_s))
    ends = np.flatnonzero(np.diff(np.append(moving, True).astype(int)) > 0)
    for end in ends:
        if since_s[end] < SHORTEST_s:
            decades[last[end] : end + 1] = np.nan
    return np.asarray(decades), np.asarray(np.sign(step[last]))


def _about_middle(trace: Trace) -> tuple[Array, Array]:
    middle = trace.voltage_V - 0.5 * (trace.voltage_V.max() + trace.voltage_V.min())
    return trace.time_s, np.asarray(np.sign(middle))


def _other(trace: Trace) -> tuple[Array, Array]:
    for channel in trace.recording.channels:
        if channel.quantity is Quantity.VOLTAGE and channel.axis != trace.recording.axis:
            return _same(channel.values)
    return _same(np.full(len(trace.time_s), np.nan))


def _window(trace: Trace) -> tuple[Array, Array]:
    """A twentieth of the stroke around the middle, so that periods can be seen."""
    middle, span = float(np.nanmedian(trace.measured_m)), trace.range_m
    near = np.abs(trace.measured_m - middle) < span / 40.0
    return _same(np.where(near, trace.measured_m, np.nan))


COORDINATES: tuple[Coordinate, ...] = (
    Coordinate(
        effects=("creep",),
        label="time in a hold",
        unit="s",
        decades=True,
        kind="classes",
        along=_hold,
        reading="Times the direction of the last step. Creep: as much in every decade.",
    ),
    Coordinate(
        effects=("thermal_drift", "initial_state", "quantisation", "timestamp_fault", "outliers"),
        label="time",
        unit="s",
        kind="time",
        along=_time,
        reading="Drift: one slow motion whatever the drive does. A slip: small before, large "
        "after. Outliers: single spikes. A wrong beginning: gone after the first large cycle.",
    ),
    Coordinate(
        effects=("gain_change",),
        label="time",
        unit="s",
        kind="time",
        along=_about_middle,
        reading="Times the side of the range. A change of gain: a step to one side for good, or a "
        "slope from end to end.",
    ),
    Coordinate(
        effects=("delay", "lag", "rate_dependence", "slew_limit"),
        label="speed of the drive",
        unit="V/s",
        kind="classes",
        along=_speed,
        reading="Delay and lag: a straight line through zero. Rate dependence: bent. A slew "
        "limit: flat, then steep beyond the limit.",
    ),
    Coordinate(
        effects=("resonance", "mains_interference"),
        label="frequency",
        unit="Hz",
        decades=True,
        kind="spectrum",
        along=_time,
        reading="A mode: a hill where the stage rings. Hum: needles at 50 or 60 Hz and multiples.",
    ),
    Coordinate(
        effects=("cross_coupling",),
        label="drive of the other axis",
        unit="V",
        kind="classes",
        along=_other,
        reading="Coupling: a line, or a loop, with the other axis' drive.",
    ),
    Coordinate(
        effects=("amplifier_saturation", "asymmetry", "non_congruence"),
        label="drive",
        unit="V",
        kind="classes",
        along=_drive,
        reading="Saturation: nothing, then steep at an end. Asymmetry: one side bends.",
    ),
    Coordinate(
        effects=("sensor_periodic_error",),
        label="displacement",
        unit="m",
        kind="classes",
        along=_window,
        reading="A wave that repeats with displacement, whatever the speed.",
    ),
)


def over_time(where: Coordinate) -> Coordinate:
    """Return the course over time, for recordings in which a coordinate hardly occurs."""
    return Coordinate(
        effects=where.effects,
        label="time",
        unit="s",
        kind="time",
        along=_time,
        reading="Over time, because too few rows of these recordings have a place on the axis "
        f"where it shows best, the {where.label}.",
    )


def coordinate_of(effect: str) -> Coordinate:
    """Return the coordinate in which an effect shows."""
    return next(one for one in COORDINATES if effect in one.effects)
