"""Recording: one uninterrupted acquisition, several channels of several axes, in SI units."""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from piezoid.digests import digest_of_bytes
from piezoid.errors import RecordingError
from piezoid.numerics.arrays import Array, frozen, same_length
from piezoid.raw_counts import COUNTS
from piezoid.statement import Statement
from piezoid.summary import Summarised, Summary


class Quantity(Enum):
    """Quantity of a channel; the value is the SI unit of its samples.

    REFERENCE is an external dither: it may be in any unit, and only lab.toml can name it.
    """

    VOLTAGE = "V"
    DISPLACEMENT = "m"
    CURRENT = "A"
    TEMPERATURE = "K"
    HUMIDITY = "1"
    REFERENCE = "any unit"


@dataclass(frozen=True, kw_only=True, eq=False)
class Channel:
    """One column of a recording.

    quantity    measured quantity; decides the unit of the samples
    axis        name of its axis, ``x`` if the file names none
    values      (samples,)  SI units, finite, read-only
    label       heading of the column, for messages and the report
    is_counted  whether the values are counts of a converter instead of metres or volts
    """

    quantity: Quantity
    axis: str
    values: Array
    label: str
    is_counted: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", frozen(self.values, self.label))

    @property
    def unit(self) -> str:
        """Unit of the values: ``counts``, or the SI symbol of the quantity."""
        return COUNTS if self.is_counted else self.quantity.value


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Recording(Summarised):
    """One uninterrupted acquisition on a uniform clock.

    name              the file's name without its folder
    digest            of the file's bytes
    axis              the axis this recording is about
    sampling_rate_Hz  > 0
    channels          at least one; all of the same length; one per quantity and axis
    breaks            (count,)  first sample after each gap in time, increasing; the state of the
                      hysteresis is unknown there
    bridged           (count,)  single lost or invalid samples, interpolated linearly
    statements        problems of the file, in the order of its columns

    A recording holds no NaN. Rows with NaN are cut off at the ends, interpolated if they are
    single, and removed with a break otherwise.
    """

    name: str
    digest: str
    axis: str
    sampling_rate_Hz: float
    channels: tuple[Channel, ...]
    breaks: tuple[int, ...] = ()
    bridged: tuple[int, ...] = ()
    statements: tuple[Statement, ...] = ()

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sampling_rate_Hz) and self.sampling_rate_Hz > 0):
            raise ValueError(f"{self.name}: sampling_rate_Hz is {self.sampling_rate_Hz}")
        if not self.channels:
            raise ValueError(f"{self.name}: no channels")
        same_length([(channel.label, channel.values) for channel in self.channels])
        keys = [(channel.quantity, channel.axis) for channel in self.channels]
        if len(set(keys)) != len(keys):
            raise ValueError(f"{self.name}: two channels of the same quantity and axis")
        if any(not 0 < b < self.samples for b in self.breaks):
            raise ValueError(f"{self.name}: breaks {self.breaks} outside the recording")
        if any(not 0 <= b < self.samples for b in self.bridged):
            raise ValueError(f"{self.name}: bridged {self.bridged} outside the recording")

    def seconds(self, start_s: float = 0.0, stop_s: float | None = None) -> "Recording":
        """Return the part from ``start_s`` to ``stop_s``, excluding the end, under another name.

        Raises ``RecordingError`` for fewer than two samples.

        >>> part = recordings["sweep.csv"].seconds(1.0, 3.0)
        >>> round(part.duration_s, 1)
        2.0
        """
        rate_Hz, end_s = self.sampling_rate_Hz, self.duration_s
        last_s = end_s if stop_s is None else stop_s
        first, stop = (int(np.ceil(t * rate_Hz - 1e-6)) for t in (start_s, last_s))
        stop = self.samples if stop_s is None else stop
        if not 0 <= first < stop <= self.samples or stop - first < 2:
            raise RecordingError(
                f"{self.name}: from {start_s:g} s to {last_s:g} s asked of {end_s:.6g} s",
                needed="at least two samples inside the recording",
                remedy=f"Choose from 0 to {end_s:.6g} s.",
            )
        span = f"{first / rate_Hz:.6g} to {(stop - 1) / rate_Hz:.6g} s"
        return replace(
            self,
            name=f"{self.name} ({span})",
            digest=digest_of_bytes(f"{self.digest} {first} {stop}".encode()),
            channels=tuple(replace(c, values=c.values[first:stop]) for c in self.channels),
            breaks=tuple(b - first for b in self.breaks if first < b < stop),
            bridged=tuple(b - first for b in self.bridged if first <= b < stop),
        )

    @property
    def time_s(self) -> Array:
        """Time since the first sample, without the duration of gaps, (samples,)."""
        return np.asarray(np.arange(self.samples) / self.sampling_rate_Hz)

    @property
    def samples(self) -> int:
        """Number of samples of every channel."""
        return len(self.channels[0].values)

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last."""
        return (self.samples - 1) / self.sampling_rate_Hz

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes of all channels, sorted."""
        return tuple(sorted({channel.axis for channel in self.channels}))

    @property
    def complete_axes(self) -> tuple[str, ...]:
        """Names of the axes that have both a drive and a displacement, sorted."""
        pair = (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
        return tuple(
            axis
            for axis in self.axes
            if all(self.find(quantity, axis) is not None for quantity in pair)
        )

    @property
    def counted(self) -> tuple[str, ...]:
        """Quantities in counts of a converter: ``displacement`` and ``voltage``."""
        counted = {c.quantity.name.lower() for c in self.channels if c.is_counted}
        return tuple(sorted(counted))

    @property
    def pieces(self) -> tuple[slice, ...]:
        """Slices between breaks; the state of the hysteresis is continuous within each."""
        edges = (0, *self.breaks, self.samples)
        return tuple(slice(a, b) for a, b in itertools.pairwise(edges))

    def summary(self) -> Summary:
        """Return a table of the channels, sampling rate, duration and statements.

        >>> print(recordings["sweep.csv"].summary())
        Recording sweep.csv
        ...
        """
        channels = ", ".join(f"{c.quantity.name.lower()} of {c.axis}" for c in self.channels)
        return Summary(
            title=f"Recording {self.name}",
            rows=[
                ("channels", channels),
                ("samples", str(self.samples)),
                ("sampling rate", f"{self.sampling_rate_Hz:.9g} Hz"),
                ("duration", f"{self.duration_s:.6g} s"),
                ("breaks", str(len(self.breaks))),
                ("digest", self.digest),
            ],
            notes=tuple(statement.text for statement in self.statements),
        )

    def find(self, quantity: Quantity, axis: str) -> Channel | None:
        """Return the channel of this quantity and axis, or None.

        >>> recordings["sweep.csv"].find(piezoid.Quantity.DISPLACEMENT, "y") is None
        True
        """
        for channel in self.channels:
            if channel.quantity is quantity and channel.axis == axis:
                return channel
        return None

    def voltage_V(self, axis: str | None = None) -> Array:
        """Return the drive voltage of an axis (default: the axis of the recording).

        >>> recordings["sweep.csv"].voltage_V().shape
        (2500,)
        """
        return self._values(Quantity.VOLTAGE, axis)

    def displacement_m(self, axis: str | None = None) -> Array:
        """Return the measured displacement of an axis (default: the axis of the recording).

        >>> recordings["sweep.csv"].displacement_m("x").shape
        (2500,)
        """
        return self._values(Quantity.DISPLACEMENT, axis)

    def tunnel_current_A(self, axis: str | None = None) -> Array:
        """Return the tunnelling current of an axis (default: the axis of the recording).

        >>> recordings["sweep.csv"].tunnel_current_A()
        Traceback (most recent call last):
        piezoid.errors.RecordingError: sweep.csv: no current of axis 'x', only ...
        """
        return self._values(Quantity.CURRENT, axis)

    def _values(self, quantity: Quantity, axis: str | None) -> Array:
        axis = self.axis if axis is None else axis
        channel = self.find(quantity, axis)
        if channel is None:
            channels = ", ".join(f"{c.quantity.name.lower()} of {c.axis}" for c in self.channels)
            raise RecordingError(
                f"{self.name}: no {quantity.name.lower()} of axis {axis!r}, only {channels}",
                needed=f"a column with the {quantity.name.lower()} of that axis",
                remedy="Name the column in lab.toml, or leave this recording out.",
            )
        return channel.values


def counted_in(recordings: Iterable[Recording]) -> tuple[str, ...]:
    """Return the quantities that any recording has in counts: ``displacement``, ``voltage``."""
    return tuple(sorted({quantity for recording in recordings for quantity in recording.counted}))
