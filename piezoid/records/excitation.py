"""Drives that make dynamics visible: multisines, chirps, stepped sines, small steps, as CSV."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError
from piezoid.numerics.arrays import Array, frozen

CREST_TRIALS = 20  # draws of phases; the one with the lowest peak is taken


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


def odd_lines(
    lowest_Hz: float,
    highest_Hz: float,
    resolution_Hz: float,
    *,
    left_out_of: int,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Return odd multiples of the resolution in a band, one of every group left out at random.

    left_out_of  size of a group; the line left out detects odd distortion, as all even lines
                 detect even distortion. 0 leaves none out
    """
    first = int(np.ceil(lowest_Hz / resolution_Hz))
    lines = np.arange(first + 1 - first % 2, int(highest_Hz / resolution_Hz) + 1, 2)
    if left_out_of > 1:
        groups = len(lines) // left_out_of
        silent = np.arange(groups) * left_out_of + rng.integers(0, left_out_of, groups)
        lines = np.delete(lines, silent)
    return np.asarray(lines, dtype=np.int64)


def multisines(
    lines: NDArray[np.int64],
    *,
    period_samples: int,
    periods: int,
    realisations: int,
    rms_V: float,
    offset_V: float,
    axes: Sequence[str],
    sampling_rate_Hz: float,
    limits: DriveLimits,
    rng: np.random.Generator,
) -> tuple[Drive, ...]:
    """Return random-phase multisines, one drive per realisation.

        u(t) = offset + a sum_k cos(2 pi k f_0 t + phi_k)         [Pintelon & Schoukens 2012]

    lines          which multiples of the inverse period to excite, with equal amplitude
    periods        to record; the first is for settling
    realisations   with several axes a multiple of their number: within such a block the axes
                   turn by exp(2 pi j r c / axes), so that their spectra are orthogonal
    rms_V          of each axis about the offset

    Of several draws of phases the one with the lowest peak is kept. Refuses a drive that would
    leave the limits: a clipped multisine excites lines nobody asked for.
    """
    count = len(axes)
    if realisations % count:
        raise ExcitationError(
            f"{realisations} realisations for {count} axes",
            needed="a multiple of the number of axes, for orthogonal blocks",
            remedy=f"Ask for {(realisations // count + 1) * count} realisations.",
        )
    drives = []
    for block in range(realisations // count):
        phases = [_calm_phases(lines, period_samples, rng) for _ in axes]
        for r in range(count):
            turns = np.exp(2j * np.pi * r * np.arange(count) / count)
            columns = [
                _sum_of_lines(lines, np.exp(1j * phase) * turn, period_samples)
                for phase, turn in zip(phases, turns, strict=True)
            ]
            period_V = offset_V + rms_V * np.column_stack(columns)
            _check_periodic(period_V, sampling_rate_Hz, limits)
            drives.append(
                Drive(
                    name=f"multisine_{block * count + r + 1}",
                    why="Linear response, noise and distortion apart, at one level.",
                    sampling_rate_Hz=sampling_rate_Hz,
                    axes=tuple(axes),
                    voltage_V=np.tile(period_V, (periods, 1)),
                    period_samples=period_samples,
                    periods=periods,
                )
            )
    return tuple(drives)


def _sum_of_lines(
    lines: NDArray[np.int64], coefficient: NDArray[np.complex128], samples: int
) -> Array:
    """One period of unit rms."""
    spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
    spectrum[lines] = coefficient
    wave = np.fft.irfft(spectrum, samples)
    return np.asarray(wave / np.sqrt(np.mean(wave**2)))


def _calm_phases(lines: NDArray[np.int64], samples: int, rng: np.random.Generator) -> Array:
    draws = rng.uniform(0, 2 * np.pi, (CREST_TRIALS, len(lines)))
    peaks = [np.abs(_sum_of_lines(lines, np.exp(1j * draw), samples)).max() for draw in draws]
    return np.asarray(draws[int(np.argmin(peaks))])


def _check_periodic(period_V: Array, rate_Hz: float, limits: DriveLimits) -> None:
    low_V, high_V = float(period_V.min()), float(period_V.max())
    jumps_V = np.diff(period_V, axis=0, append=period_V[:1])
    slew_V_per_s = float(np.abs(jumps_V).max()) * rate_Hz
    inside = limits.voltage_min_V <= low_V and high_V <= limits.voltage_max_V
    if not inside or slew_V_per_s > limits.slew_V_per_s:
        raise ExcitationError(
            f"the multisine spans {low_V:.4g} to {high_V:.4g} V at up to {slew_V_per_s:.4g} V/s",
            needed=f"{limits.voltage_min_V:g} to {limits.voltage_max_V:g} V and at most "
            f"{limits.slew_V_per_s:g} V/s",
            remedy="Lower rms_V, move the offset, or end the band lower.",
        )


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


EXCITATIONS: tuple[Callable[..., Drive | tuple[Drive, ...]], ...] = (
    multisines,
    log_chirp,
    stepped_sine,
    small_steps,
)
"""All of them, in the order in which a laboratory would use them."""
