"""Drives that make dynamics visible: limits, chirps, stepped sines, small steps, as CSV."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.errors import ExcitationError
from piezoid.numerics.arrays import Array, frozen


@dataclass(frozen=True, kw_only=True)
class DriveLimits:
    """What amplifier and actuator bear; every waveform is made to stay inside.

    voltage_min_V    lowest voltage
    voltage_max_V    highest voltage
    slew_V_per_s     largest rate of change, > 0
    """

    voltage_min_V: float
    voltage_max_V: float
    slew_V_per_s: float

    def __post_init__(self) -> None:
        if not (self.voltage_max_V > self.voltage_min_V and self.slew_V_per_s > 0):
            raise ValueError(f"limits must be ordered and the slew positive, found {self}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """What to send to the converters, one column per axis.

    name              of the experiment
    why               one sentence: what it will show
    sampling_rate_Hz  > 0
    axes              names of the driven axes
    voltage_V         (samples, axes)
    period_samples    length of one period; 0 where nothing repeats
    periods           how many, the first of which is for settling
    """

    name: str
    why: str
    sampling_rate_Hz: float
    axes: tuple[str, ...]
    voltage_V: Array
    period_samples: int = 0
    periods: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "voltage_V", frozen(self.voltage_V, "voltage_V", ndim=2))
        if self.voltage_V.shape[1] != len(self.axes):
            raise ValueError(f"{self.voltage_V.shape[1]} columns for axes {self.axes}")

    def to_csv(self) -> str:
        """Return the drive as text: a header with units, then one row per sample.

        Numbers come back exactly; ingest reads the header as it is.
        """
        header = ",".join(["time [s]", *(f"voltage_{axis} [V]" for axis in self.axes)])
        time_s = np.arange(len(self.voltage_V)) / self.sampling_rate_Hz
        rows = np.column_stack([time_s, self.voltage_V]).tolist()
        return "\n".join([header, *(",".join(map(repr, row)) for row in rows)]) + "\n"


def log_chirp(
    *,
    lowest_Hz: float,
    highest_Hz: float,
    duration_s: float,
    amplitude_V: float,
    offset_V: float,
    axis: str,
    sampling_rate_Hz: float,
    limits: DriveLimits,
) -> Drive:
    """Return a sine whose frequency rises by equal factors in equal times.

        phase(t) = 2 pi f_1 T / ln(f_2/f_1) ((f_2/f_1)^(t/T) - 1)

    Where 2 pi f amplitude would exceed the slew limit, or the offset leaves less room than the
    amplitude, the amplitude falls to what is allowed.
    """
    time_s = np.arange(round(duration_s * sampling_rate_Hz)) / sampling_rate_Hz
    growth = np.log(highest_Hz / lowest_Hz) / duration_s
    frequency_Hz = lowest_Hz * np.exp(growth * time_s)
    phase = 2 * np.pi * (frequency_Hz - lowest_Hz) / growth
    wave_V = _allowed_V(amplitude_V, frequency_Hz, offset_V, limits) * np.sin(phase)
    return Drive(
        name="log_chirp",
        why="Resonances and coherence over decades in one sweep.",
        sampling_rate_Hz=sampling_rate_Hz,
        axes=(axis,),
        voltage_V=(offset_V + wave_V)[:, None],
    )


def stepped_sine(
    frequencies_Hz: Sequence[float],
    *,
    cycles: int,
    amplitude_V: float,
    offset_V: float,
    axis: str,
    sampling_rate_Hz: float,
    limits: DriveLimits,
) -> Drive:
    """Return whole cycles of one sine after the other, each starting and ending at the offset.

    frequencies_Hz  each rounded so that its cycles fill whole samples
    cycles          of each; use the last ones, after the ring has decayed
    """
    pieces = []
    for wanted_Hz in frequencies_Hz:
        samples = round(cycles * sampling_rate_Hz / wanted_Hz)
        frequency_Hz = np.array([cycles * sampling_rate_Hz / samples])
        allowed_V = _allowed_V(amplitude_V, frequency_Hz, offset_V, limits)
        pieces.append(allowed_V * np.sin(2 * np.pi * cycles * np.arange(samples) / samples))
    return Drive(
        name="stepped_sine",
        why="Gain, phase and harmonics at single frequencies, with the best ratio to noise.",
        sampling_rate_Hz=sampling_rate_Hz,
        axes=(axis,),
        voltage_V=(offset_V + np.concatenate(pieces))[:, None],
    )


def small_steps(
    levels_V: Sequence[float],
    *,
    hold_s: float,
    axis: str,
    sampling_rate_Hz: float,
    limits: DriveLimits,
) -> Drive:
    """Return levels held in turn, joined by ramps no steeper than the slew limit.

    levels_V  inside the voltage limits; the steps between them should stay below the smallest
              play threshold where the linear response is wanted
    """
    outside = [v for v in levels_V if not limits.voltage_min_V <= v <= limits.voltage_max_V]
    if outside:
        raise ExcitationError(
            f"level {outside[0]:g} V",
            needed=f"levels from {limits.voltage_min_V:g} to {limits.voltage_max_V:g} V",
            remedy="Choose levels inside the limits.",
        )
    most_V = limits.slew_V_per_s / sampling_rate_Hz
    pieces, now_V = [], float(levels_V[0])
    for level_V in levels_V:
        ramp = int(np.ceil(abs(level_V - now_V) / most_V - 1e-12))
        pieces.append(np.linspace(now_V, level_V, ramp + 1)[1:])
        pieces.append(np.full(round(hold_s * sampling_rate_Hz), float(level_V)))
        now_V = float(level_V)
    return Drive(
        name="small_steps",
        why="Ringing, its damping, and creep after it.",
        sampling_rate_Hz=sampling_rate_Hz,
        axes=(axis,),
        voltage_V=np.concatenate(pieces)[:, None],
    )


def _allowed_V(
    amplitude_V: float, frequency_Hz: Array, offset_V: float, limits: DriveLimits
) -> Array:
    """The amplitude at each frequency after both limits."""
    room_V = min(limits.voltage_max_V - offset_V, offset_V - limits.voltage_min_V)
    if room_V <= 0:
        raise ExcitationError(
            f"an offset of {offset_V:g} V",
            needed=f"one between {limits.voltage_min_V:g} and {limits.voltage_max_V:g} V",
            remedy="Move the offset inside the limits.",
        )
    by_slew_V = limits.slew_V_per_s / (2 * np.pi * frequency_Hz)
    return np.asarray(np.minimum(min(amplitude_V, room_V), by_slew_V))
