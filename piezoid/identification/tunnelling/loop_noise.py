"""Motion of the gap in closed loop: drift, mains lines, spectrum, limit of resolution.

The motion is the part of the log current that the drive does not explain, in metres,

    d = -(y - G u) / k        > 0 for a wider gap

which removes the suppression of the motion by the loop below its bandwidth.
"""

import math
from dataclasses import dataclass

import numpy as np

from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.identification.tunnelling.loop_files import LoopRecord, LoopRig
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import student_quantile
from piezoid.operators.tunnelling import BOLTZMANN_J_PER_K, ELEMENTARY_CHARGE_C
from piezoid.record_json import Interval
from piezoid.records.sample_statistics import step_size

_MAINS_Hz = (50.0, 60.0)
_HARMONICS = 6
_PEAK_RATIO = 10.0  # power over its expectation in noise, exceeded once in 20000 lines
_DRIFT_BLOCKS = 10
_MIN_DURATION_s = 0.5
_TEMPERATURE_K = 293.0  # of the feedback resistor


@dataclass(frozen=True, kw_only=True)
class CurrentChain:
    """Properties of the current amplifier and converter.

    bandwidth_Hz   of one reading: 1 / (2 integration time) for an averaged one
    feedback_ohm   resistor of the transimpedance stage; None: unknown
    adc_step_A     one step of the converter, in current; 0: unknown
    """

    bandwidth_Hz: float
    feedback_ohm: float | None = None
    adc_step_A: float = 0.0

    @property
    def johnson_A(self) -> float:
        """Rms Johnson noise of one reading, sqrt(4 k T B / R); 0 without a declared resistor."""
        if self.feedback_ohm is None:
            return 0.0
        power = 4.0 * BOLTZMANN_J_PER_K * _TEMPERATURE_K * self.bandwidth_Hz
        return math.sqrt(power / self.feedback_ohm)

    @property
    def quantisation_A(self) -> float:
        """Rms of one converter step, step / sqrt(12)."""
        return self.adc_step_A / math.sqrt(12.0)

    def shot_A(self, current_A: float) -> float:
        """Return the rms shot noise of one reading, sqrt(2 e |i| B)."""
        return math.sqrt(2.0 * ELEMENTARY_CHARGE_C * abs(current_A) * self.bandwidth_Hz)


@dataclass(frozen=True, kw_only=True)
class MainsLine:
    """One harmonic of the mains in the gap.

    frequency_Hz  of the peak, near a multiple of 50 or 60 Hz
    amplitude_m   of the sine
    """

    frequency_Hz: float
    amplitude_m: float


@dataclass(frozen=True, kw_only=True)
class NoiseSource:
    """One source of noise and its size in the gap.

    name   shot, johnson, adc_step, drive_step or gap
    rms_m  within the bandwidth; a drive step counts at full size, because it does not average
    """

    name: str
    rms_m: float


@dataclass(frozen=True, kw_only=True)
class LoopNoise:
    """Motion of the gap during one record, and the limits of its resolution.

    drift_m_per_s        > 0 if the gap opens, and its 95 % interval
    mains                significant harmonics of the mains
    bandwidth_Hz         of the values below
    gap_rms_m            of the motion, drift removed
    sources              shot, johnson, adc_step, drive_step, gap; 0 if unknown
    limiting_source      largest source
    limiting_electronics largest source except the motion of the gap
    """

    drift_m_per_s: float
    drift_interval_m_per_s: Interval
    mains: tuple[MainsLine, ...]
    bandwidth_Hz: float
    gap_rms_m: float
    sources: tuple[NoiseSource, ...]
    limiting_source: str
    limiting_electronics: str


def measure_loop_noise(record: LoopRecord, plant: JunctionPlant, rig: LoopRig) -> LoopNoise | None:
    """Measure the motion of the gap during a closed-loop record, and list its sources.

    plant  identified from the record, or from a similar one

    Returns None for a record of less than half a second, which cannot resolve mains lines.
    Converter steps are estimated from the columns; a column without visible steps has none.
    Without a declared bandwidth of the current sensor its fitted pole is used, half the rate at
    most.
    """
    from scipy.signal import detrend

    rate_Hz = record.sampling_rate_Hz
    if record.samples < _MIN_DURATION_s * rate_Hz:
        return None
    decay_per_m = plant.gain_nepers_per_V / rig.drive_gain_m_per_V
    chain = CurrentChain(
        bandwidth_Hz=rig.bandwidth_Hz or min(plant.sensor_pole_Hz, 0.5 * rate_Hz),
        feedback_ohm=rig.feedback_ohm,
        adc_step_A=step_size(record.current_A),
    )
    motion_m = gap_motion(record, plant, decay_per_m)
    # The drift follows from differences of block means: a random walk has no trend line.
    length = len(motion_m) // _DRIFT_BLOCKS
    means = motion_m[: length * _DRIFT_BLOCKS].reshape(_DRIFT_BLOCKS, length).mean(axis=1)
    rates = np.diff(means) * rate_Hz / length
    drift, standard = float(np.mean(rates)), np.std(rates, ddof=1) / np.sqrt(len(rates))
    half = float(student_quantile(0.975, len(rates) - 1) * standard)
    level_m = np.asarray(detrend(motion_m))  # drift would leak to all frequencies
    frequency_Hz, density = power_density(level_m, rate_Hz)
    in_band = density[frequency_Hz <= chain.bandwidth_Hz]
    gap_rms_m = math.sqrt(float(np.sum(in_band)) * float(frequency_Hz[1]))
    sources = budget_resolution(
        set_point_A=record.set_point_A,
        decay_per_m=decay_per_m,
        drive_step_m=step_size(record.drive_V) * plant.gain_nepers_per_V / decay_per_m,
        sampling_rate_Hz=rate_Hz,
        chain=chain,
        gap_rms_m=gap_rms_m,
    )
    electronics = [source for source in sources if source.name != "gap"]
    return LoopNoise(
        drift_m_per_s=drift,
        drift_interval_m_per_s=(drift - half, drift + half),
        mains=_mains_lines(level_m, rate_Hz),
        bandwidth_Hz=chain.bandwidth_Hz,
        gap_rms_m=gap_rms_m,
        sources=sources,
        limiting_source=max(sources, key=lambda source: source.rms_m).name,
        limiting_electronics=max(electronics, key=lambda source: source.rms_m).name,
    )


def gap_motion(record: LoopRecord, plant: JunctionPlant, decay_per_m: float) -> Array:
    """Return the motion of the gap from log current and drive, (samples,) m."""
    unexplained = record.log_current - plant.respond(record.drive_V - record.drive_V[0])
    return np.asarray(-unexplained / decay_per_m)


def budget_resolution(
    *,
    set_point_A: float,
    decay_per_m: float,
    drive_step_m: float,
    sampling_rate_Hz: float,
    chain: CurrentChain,
    gap_rms_m: float,
) -> tuple[NoiseSource, ...]:
    """Return all sources of noise in metres of gap.

    Shot noise 2 e i B, Johnson noise 4 k T B / R and the share 2 B / f_s of the converter's
    step^2 / 12 are divided by k i; a drive step counts as step / sqrt(12) times the extension per
    volt. The last source, the gap, is the measured motion minus the noise of the current sensor.
    """
    per_ampere = 1.0 / (decay_per_m * abs(set_point_A))
    in_band = min(2.0 * chain.bandwidth_Hz / sampling_rate_Hz, 1.0)
    electronics = (
        NoiseSource(name="shot", rms_m=chain.shot_A(set_point_A) * per_ampere),
        NoiseSource(name="johnson", rms_m=chain.johnson_A * per_ampere),
        NoiseSource(name="adc_step", rms_m=chain.quantisation_A * math.sqrt(in_band) * per_ampere),
        NoiseSource(name="drive_step", rms_m=drive_step_m / math.sqrt(12.0)),
    )
    reading_m2 = sum(source.rms_m**2 for source in electronics[:3])
    gap_m = math.sqrt(max(gap_rms_m**2 - reading_m2, 0.0))
    return (*electronics, NoiseSource(name="gap", rms_m=gap_m))


def power_density(signal: Array, sampling_rate_Hz: float) -> tuple[Array, Array]:
    """Return the one-sided power density from half-overlapping Hann windows [Welch 1967].

    signal    (samples,)
    returned  frequencies and densities, unit^2/Hz; their sum times the spacing is the variance
    """
    from scipy.signal import welch

    length = min(int(2 ** np.floor(np.log2(len(signal) / 4))), int(sampling_rate_Hz))
    frequency_Hz, density = welch(signal, sampling_rate_Hz, nperseg=length, detrend=False)
    return np.asarray(frequency_Hz), np.asarray(density)


def _mains_lines(level_m: Array, sampling_rate_Hz: float) -> tuple[MainsLine, ...]:
    """Return harmonics of 50 and 60 Hz that exceed the power at neighbouring frequencies."""
    window = np.hanning(len(level_m))
    power = np.abs(np.fft.rfft(level_m * window)) ** 2
    spacing_Hz = sampling_rate_Hz / len(level_m)
    lines = []
    for nominal_Hz in sorted({mains * n for mains in _MAINS_Hz for n in range(1, _HARMONICS + 1)}):
        around = np.arange(
            int((nominal_Hz - 8.0) / spacing_Hz),
            min(int((nominal_Hz + 8.0) / spacing_Hz), len(power)),
        )
        off_Hz = np.abs(around * spacing_Hz - nominal_Hz)
        reach_Hz = max(0.004 * nominal_Hz, spacing_Hz)  # tolerance of the mains: 0.4 %
        inside = around[off_Hz <= reach_Hz]
        outside = around[off_Hz > reach_Hz + 2.0 * spacing_Hz]
        if len(inside) == 0 or len(outside) < 8:
            continue
        peak = int(inside[np.argmax(power[inside])])
        if power[peak] > _PEAK_RATIO * float(np.median(power[outside])) / math.log(2.0):
            amplitude_m = float(np.sqrt(power[peak])) * 2.0 / float(np.sum(window))
            lines.append(MainsLine(frequency_Hz=peak * spacing_Hz, amplitude_m=amplitude_m))
    return tuple(lines)
