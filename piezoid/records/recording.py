"""Recording: one uninterrupted acquisition, several channels of several axes, in SI units."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from piezoid.errors import RecordingError
from piezoid.numerics.arrays import Array, frozen, same_length
from piezoid.showing import shown
from piezoid.upstairs import upstairs

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

ByAxis = ArrayLike | Mapping[str, ArrayLike]  # one axis' samples, or those of several by name


class Quantity(Enum):
    """What a channel measures; the value is the SI unit its samples are in.

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

    quantity  what it measures; decides the unit of the samples
    axis      the axis it belongs to, ``x`` where the file names none
    values    (samples,)  SI units, finite, read-only
    label     the column's own name, for messages and the report
    is_counted  whether the values are counts of a converter, in place of metres or volts
    """

    quantity: Quantity
    axis: str
    values: Array
    label: str
    is_counted: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", frozen(self.values, self.label))


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Something wrong with a file that does not stop it from being read.

    kind     a short name: ``gap``, ``duplicate_time``, ``jitter``, ``dead``, ``saturated``, ...
    place    where: a column, a line, a time
    text     one sentence with the number and its unit
    samples  of a clock's fault: how many are missing, have a stamp again, or were stepped back; of
             lost readings: how many
    farthest how far the farthest of these stands off, SI units
    """

    kind: str
    place: str
    text: str
    samples: int = 0
    farthest: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """One uninterrupted acquisition on a uniform clock.

    name              the file's name without its folder
    digest            of the file's bytes
    axis              the axis this recording is about
    sampling_rate_Hz  > 0
    channels          at least one; all of the same length; one per quantity and axis
    breaks            (count,)  first sample after each gap in time, increasing; memory of what
                      happened inside a gap is lost there
    bridged           (count,)  samples that are no measurement, lost one at a time or written
                      without one: on straight lines between their neighbours
    problems          what was odd about the file, in the order of its columns

    A recording holds no NaN: rows that had one were cut at the ends or are behind a break.
    """

    name: str
    digest: str
    axis: str
    sampling_rate_Hz: float
    channels: tuple[Channel, ...]
    breaks: tuple[int, ...] = ()
    bridged: tuple[int, ...] = ()
    problems: tuple[Problem, ...] = ()

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

    @staticmethod
    def from_arrays(
        *,
        voltage_V: ByAxis,
        displacement_m: ByAxis | None = None,
        current_A: ByAxis | None = None,
        time_s: ArrayLike | None = None,
        sampling_rate_Hz: float | None = None,
        axis: str = "x",
        name: str = "recording",
    ) -> "Recording":
        """Return a recording of arrays in SI units, with what is odd about them in ``problems``.

        voltage_V, displacement_m, current_A  (samples,), or by axis: ``{"x": ..., "y": ...}``
        time_s, sampling_rate_Hz  one of the two: (samples,) s, or Hz
        axis  that it is about, and that bare arrays belong to
        name  of its own: a fit keeps results by it

        Raises ``RecordingError`` for arrays of other shapes or lengths, or without a clock.

        >>> import numpy as np
        >>> time_s = np.arange(2000) / 1000.0
        >>> voltage_V = 5.0 - 5.0 * np.cos(2.0 * np.pi * time_s)
        >>> recording = Recording.from_arrays(
        ...     time_s=time_s, voltage_V=voltage_V, displacement_m=1e-7 * voltage_V
        ... )
        >>> recording.samples, round(recording.sampling_rate_Hz), recording.axes
        (2000, 1000, ('x',))
        """
        from piezoid.records.frames import from_arrays

        given = {"voltage": voltage_V, "displacement": displacement_m, "current": current_A}
        return from_arrays(
            given, time_s=time_s, sampling_rate_Hz=sampling_rate_Hz, axis=axis, name=name
        )

    @staticmethod
    def from_frame(
        frame: "DataFrame",
        *,
        units: Mapping[str, str] | None = None,
        columns: Mapping[str, str] | None = None,
        axis: str | None = None,
        name: str = "frame",
        sampling_rate_Hz: float | None = None,
    ) -> "Recording":
        """Return a recording of a pandas DataFrame, its headings read as those of a file.

        frame    a column for each channel, a row for each sample; NaN where there is no number.
                 An index of times is the clock
        units    by heading, for columns whose heading names none: ``{"piezo": "V"}``
        columns  which is which where headings do not say it, as in lab.toml:
                 ``{"voltage": "piezo", "displacement": "gauge"}``; then nothing else is read
        axis     that it is about; default: what the headings say, else ``x``
        sampling_rate_Hz  where no column is a time

        Raises ``UnitError`` for a column without unit or meaning, and for two that claim the same
        part; ``RecordingError`` for what is no frame, or holds no numbers.

        >>> import pandas as pd
        >>> frame = pd.DataFrame(
        ...     {"t [ms]": [0.0, 1.0, 2.0], "U [V]": [0.0, 1.0, 2.0], "weg": [0.0, 0.1, 0.2]}
        ... )
        >>> Recording.from_frame(frame, units={"weg": "um"}).displacement_m().tolist()
        [0.0, 1e-07, 2e-07]
        """
        from piezoid.records.frames import from_frame

        return from_frame(
            frame,
            units=units,
            columns=columns,
            axis=axis,
            name=name,
            sampling_rate_Hz=sampling_rate_Hz,
        )

    def to_frame(self) -> "DataFrame":
        """Return a pandas DataFrame that ``from_frame`` reads back.

        Columns ``time_s``, ``voltage_x_V``, ``displacement_x_m`` and so on, in SI units, humidity
        in percent. A row of NaN stands at each break; samples that were bridged stand there as
        they are held.

        >>> list(recordings["sweep.csv"].to_frame())
        ['time_s', 'voltage_x_V', 'displacement_x_m']
        """
        from piezoid.records.frames import to_frame

        return to_frame(self)

    def seconds(self, start_s: float = 0.0, stop_s: float | None = None) -> "Recording":
        """Return the part from ``start_s`` up to, not with, ``stop_s``, under a name of its own.

        Raises ``RecordingError`` where less than two samples lie between.

        >>> part = recordings["sweep.csv"].seconds(1.0, 3.0)
        >>> round(part.duration_s, 1)
        2.0
        """
        from piezoid.records.frames import part_of

        return part_of(self, start_s, stop_s)

    def plot(
        self, kind: str = "loop", *, axis: str | None = None, ax: "Axes | None" = None
    ) -> "Axes":
        """Draw displacement over drive (``loop``), or both over time (``time``), in matplotlib.

        >>> recordings["sweep.csv"].plot("time").get_xlabel()
        'time (s)'
        """
        axes: Axes = upstairs("figures").recording(self, kind, axis=axis, ax=ax)
        return axes

    @property
    def time_s(self) -> Array:
        """Time of every sample from the first, (samples,), gaps at breaks left out."""
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
        """Names of all axes any channel belongs to, sorted."""
        return tuple(sorted({channel.axis for channel in self.channels}))

    @property
    def counted(self) -> tuple[str, ...]:
        """What is in counts of its converter, of ``displacement`` and ``voltage``."""
        counted = {c.quantity.name.lower() for c in self.channels if c.is_counted}
        return tuple(sorted(counted))

    @property
    def pieces(self) -> tuple[slice, ...]:
        """The parts between breaks: inside each, memory carries from sample to sample."""
        edges = (0, *self.breaks, self.samples)
        return tuple(slice(a, b) for a, b in itertools.pairwise(edges))

    def _repr_html_(self) -> str:
        channels = ", ".join(f"{c.quantity.name.lower()} of {c.axis}" for c in self.channels)
        return shown(
            f"Recording {self.name}",
            (
                ("channels", channels),
                ("samples", str(self.samples)),
                ("rate", f"{self.sampling_rate_Hz:.9g} Hz"),
                ("duration", f"{self.duration_s:.6g} s"),
                ("breaks", str(len(self.breaks))),
                ("problems", "; ".join(problem.text for problem in self.problems) or "none"),
                ("digest", self.digest),
            ),
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
        """Return the drive voltage of an axis (default: the recording's own), or refuse.

        >>> recordings["sweep.csv"].voltage_V().shape
        (2500,)
        """
        return self._values(Quantity.VOLTAGE, axis)

    def displacement_m(self, axis: str | None = None) -> Array:
        """Return the measured displacement of an axis (default: the recording's own).

        >>> recordings["sweep.csv"].displacement_m("x").shape
        (2500,)
        """
        return self._values(Quantity.DISPLACEMENT, axis)

    def tunnel_current_A(self, axis: str | None = None) -> Array:
        """Return the tunnelling current of an axis (default: the recording's own).

        >>> recordings["sweep.csv"].tunnel_current_A()
        Traceback (most recent call last):
        piezoid.errors.RecordingError: sweep.csv: no current of axis 'x', only ...
        """
        return self._values(Quantity.CURRENT, axis)

    def _values(self, quantity: Quantity, axis: str | None) -> Array:
        wanted = self.axis if axis is None else axis
        channel = self.find(quantity, wanted)
        if channel is None:
            held = ", ".join(f"{c.quantity.name.lower()} of {c.axis}" for c in self.channels)
            raise RecordingError(
                f"{self.name}: no {quantity.name.lower()} of axis {wanted!r}, only {held}",
                needed=f"a column with the {quantity.name.lower()} of that axis",
                remedy="Name the column in lab.toml, or leave this recording out.",
            )
        return channel.values
