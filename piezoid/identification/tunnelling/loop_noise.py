"""What moves the gap while the loop is closed: spectrum, mains lines, drift, limit of resolution.

The disturbance is what the drive does not explain, turned into metres,

    d = -(y - G u) / k        > 0 where the gap was opened

so that the loop, which hides it below its bandwidth, is undone.
"""

import math
from dataclasses import dataclass

import numpy as np

from piezoid.errors import ExcitationError
from piezoid.identification.tunnelling.current_noise import CurrentChain
from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.identification.tunnelling.loop_files import LoopRecord
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.robust import student_quantile

_MAINS_Hz = (50.0, 60.0)
_HARMONICS = 6
_SEEN = 10.0  # power over its expectation in noise; exceeded once in 20000
_DRIFT_BLOCKS = 10
_LEAST_DURATION_s = 0.5


@dataclass(frozen=True, kw_only=True)
class MainsLine:
    """One harmonic of the mains in the gap.

    frequency_Hz  as found, near a multiple of 50 or 60 Hz
    amplitude_m   of the sine
    """

    frequency_Hz: float
    amplitude_m: float


@dataclass(frozen=True, kw_only=True)
class NoiseSource:
    """One source of noise and what it amounts to in the gap.

    name   shot, johnson, adc_step, drive_step or gap
    rms_m  in the bandwidth asked for; a drive step counts whole, it does not average out
    """

    name: str
    rms_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopNoise:
    """The disturbance of the gap and what limits the resolution.

    frequency_Hz          (lines,)
    density_m2_per_Hz     (lines,)  one-sided
    mains                 lines found, none where none stands out
    drift_m_per_s         > 0 where the gap opens
    drift_interval_m_per_s  95 %
    bandwidth_Hz          of the figures below
    gap_rms_m             of the disturbance, drift taken out
    sources               electronics first, then what is left: the gap itself
    """

    frequency_Hz: Array
    density_m2_per_Hz: Array
    mains: tuple[MainsLine, ...]
    drift_m_per_s: float
    drift_interval_m_per_s: tuple[float, float]
    bandwidth_Hz: float
    gap_rms_m: float
    sources: tuple[NoiseSource, ...]

    def __post_init__(self) -> None:
        freeze(self, "frequency_Hz", "density_m2_per_Hz")

    @property
    def limiting_source(self) -> str:
        """The source that moves or blurs the gap most, the gap's own unrest included."""
        return max(self.sources, key=lambda source: source.rms_m).name

    @property
    def limiting_electronics(self) -> str:
        """The largest of shot, Johnson, converter step and drive step."""
        electronics = [source for source in self.sources if source.name != "gap"]
        return max(electronics, key=lambda source: source.rms_m).name


def measure_loop_noise(
    record: LoopRecord,
    plant: JunctionPlant,
    *,
    decay_per_m: float,
    drive_step_V: float,
    chain: CurrentChain,
) -> LoopNoise:
    """Take the disturbance of the gap from a closed-loop record and budget it.

    record        of at least half a second
    plant         identified from it, or from one like it
    decay_per_m   k
    drive_step_V  of the converter
    chain         bandwidth, resistor, converter step of the current; its bandwidth is the budget's

    Shot 2 e i B, Johnson 4 k T B / R and the share 2 B / f_s of the converter's step^2 / 12 are
    divided by k i; a drive step counts as step / sqrt(12) times the extension per volt.
    """
    _refuse_short(record, chain)
    disturbance_m = _disturbance(record, plant, decay_per_m)
    drift, half = _drift(disturbance_m, record.sampling_rate_Hz)
    time_s = np.arange(len(disturbance_m)) / record.sampling_rate_Hz
    level_m = disturbance_m - np.polyval(np.polyfit(time_s, disturbance_m, 1), time_s)
    frequency_Hz, density = power_density(level_m, record.sampling_rate_Hz)
    bandwidth_Hz = float(chain.bandwidth_Hz or 0.0)
    inside = frequency_Hz <= bandwidth_Hz
    gap_rms_m = math.sqrt(float(np.sum(density[inside])) * float(frequency_Hz[1]))
    return LoopNoise(
        frequency_Hz=frequency_Hz,
        density_m2_per_Hz=density,
        mains=_mains_lines(level_m, record.sampling_rate_Hz),
        drift_m_per_s=drift,
        drift_interval_m_per_s=(drift - half, drift + half),
        bandwidth_Hz=bandwidth_Hz,
        gap_rms_m=gap_rms_m,
        sources=budget_resolution(
            set_point_A=record.set_point_A,
            decay_per_m=decay_per_m,
            drive_step_m=drive_step_V * plant.gain_nepers_per_V / decay_per_m,
            sampling_rate_Hz=record.sampling_rate_Hz,
            chain=chain,
            gap_rms_m=gap_rms_m,
        ),
    )


def budget_resolution(
    *,
    set_point_A: float,
    decay_per_m: float,
    drive_step_m: float,
    sampling_rate_Hz: float,
    chain: CurrentChain,
    gap_rms_m: float,
) -> tuple[NoiseSource, ...]:
    """Return every source of noise in metres of gap, and what the electronics leave over.

    The last source, the gap, is the measured unrest less what the current's electronics put
    into it.
    """
    per_ampere = 1.0 / (decay_per_m * abs(set_point_A))
    seen = min(2.0 * (chain.bandwidth_Hz or 0.0) / sampling_rate_Hz, 1.0)
    electronics = (
        NoiseSource(name="shot", rms_m=chain.shot_A(set_point_A) * per_ampere),
        NoiseSource(name="johnson", rms_m=chain.johnson_A * per_ampere),
        NoiseSource(name="adc_step", rms_m=chain.quantisation_A * math.sqrt(seen) * per_ampere),
        NoiseSource(name="drive_step", rms_m=drive_step_m / math.sqrt(12.0)),
    )
    reading_m2 = sum(source.rms_m**2 for source in electronics[:3])
    left_m = math.sqrt(max(gap_rms_m**2 - reading_m2, 0.0))
    return (*electronics, NoiseSource(name="gap", rms_m=left_m))


def power_density(signal: Array, sampling_rate_Hz: float) -> tuple[Array, Array]:
    """Return the one-sided power density by half overlapping Hann windows [Welch 1967].

    signal    (samples,)
    returned  frequencies and densities, unit^2/Hz; their sum times the spacing is the variance
    """
    from scipy.signal import welch

    length = min(int(2 ** np.floor(np.log2(len(signal) / 4))), int(sampling_rate_Hz))
    frequency_Hz, density = welch(signal, sampling_rate_Hz, nperseg=length, detrend=False)
    return np.asarray(frequency_Hz), np.asarray(density)


def is_long_enough(record: LoopRecord) -> bool:
    """Whether a record lasts half a second, to tell mains lines apart."""
    return record.samples >= _LEAST_DURATION_s * record.sampling_rate_Hz


def _refuse_short(record: LoopRecord, chain: CurrentChain) -> None:
    if not is_long_enough(record):
        raise ExcitationError(
            f"{record.label}: {record.samples / record.sampling_rate_Hz:.3g} s",
            needed=f"at least {_LEAST_DURATION_s} s, to tell mains lines apart",
            remedy="Record longer.",
        )
    if chain.bandwidth_Hz is None:
        raise ExcitationError(
            f"{record.label}: the bandwidth of the current is not declared",
            needed="the bandwidth the noise budget is to be drawn up for",
            remedy="Declare the current sensor's bandwidth.",
        )


def _disturbance(record: LoopRecord, plant: JunctionPlant, decay_per_m: float) -> Array:
    drive_V = record.drive_V - record.drive_V[0]
    unexplained = record.log_current - plant.respond(drive_V)
    disturbance: Array = -unexplained / decay_per_m
    return disturbance


def _drift(disturbance_m: Array, sampling_rate_Hz: float) -> tuple[float, float]:
    """Rate and half its interval, from the steps between block means: a walk has no trend line."""
    length = len(disturbance_m) // _DRIFT_BLOCKS
    means = disturbance_m[: length * _DRIFT_BLOCKS].reshape(_DRIFT_BLOCKS, length).mean(axis=1)
    rates = np.diff(means) * sampling_rate_Hz / length
    standard = np.std(rates, ddof=1) / np.sqrt(len(rates))
    half = student_quantile(0.975, len(rates) - 1) * standard
    return float(np.mean(rates)), float(half)


def _mains_lines(level_m: Array, sampling_rate_Hz: float) -> tuple[MainsLine, ...]:
    """Harmonics of 50 and 60 Hz that stand out of the power around them."""
    windowed = level_m * np.hanning(len(level_m))
    spectrum = np.abs(np.fft.rfft(windowed)) ** 2
    spacing_Hz = sampling_rate_Hz / len(level_m)
    amplitude_scale = 2.0 / float(np.sum(np.hanning(len(level_m))))
    lines = []
    wanted_Hz = {mains * n for mains in _MAINS_Hz for n in range(1, _HARMONICS + 1)}
    for near_Hz in sorted(wanted_Hz):
        around = np.arange(
            int((near_Hz - 8.0) / spacing_Hz),
            min(int((near_Hz + 8.0) / spacing_Hz), len(spectrum)),
        )
        off_Hz = np.abs(around * spacing_Hz - near_Hz)
        reach_Hz = max(0.004 * near_Hz, spacing_Hz)  # networks keep their frequency to 0.4 %
        inside = around[off_Hz <= reach_Hz]
        outside = around[off_Hz > reach_Hz + 2.0 * spacing_Hz]
        if len(inside) == 0 or len(outside) < 8:
            continue
        peak = int(inside[np.argmax(spectrum[inside])])
        background = float(np.median(spectrum[outside])) / math.log(2.0)
        if spectrum[peak] > _SEEN * background:
            amplitude_m = float(np.sqrt(spectrum[peak])) * amplitude_scale
            lines.append(MainsLine(frequency_Hz=peak * spacing_Hz, amplitude_m=amplitude_m))
    return tuple(lines)
