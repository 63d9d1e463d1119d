"""Model of a stage with several drives and displacements, linear at each level of the drive.

All paths share the poles of a modal sum; poles and residues depend on the level of the drive.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from piezoid.errors import IdentificationError
from piezoid.numerics.arrays import Array, ComplexArray, expect_shapes, freeze, frozen
from piezoid.numerics.robust import jackknife_half

# Levels that differ by less than this factor count as equal: the rms of realisations of one level
# differs by 0.3 % on the steering mirror.
LEVEL_TOLERANCE = 1.05
FAR_BELOW = 0.05  # of the first mode, which raises its share by 0.25 % there
SETTLING = 3.0  # time constants of the slowest pole: 5 % of its share remain


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalShape:
    """Poles that move with the level of the drive, and the delay.

        ln f = log_frequency[0] + l log_frequency[1],   ln zeta likewise,   -1 <= l <= 1

    log_frequency, log_damping  (2, modes)  at the centre of the levels, and the change to the
                                largest
    delay_s                     of the drives
    """

    log_frequency: Array
    log_damping: Array
    delay_s: float

    def columns(
        self, frequency_Hz: Array, lag_Hz: Array, coordinate: float
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return the columns of the response at one level, which real residues multiply.

            h = w / (s - p),   p = w (-zeta + j sqrt(1 - zeta^2))
            columns: (h + h~) / 2, j (h - h~) / 2, w_l / (s + w_l), 1

        frequency_Hz  (lines,)
        lag_Hz        (lags,)   corner frequencies of real poles
        coordinate    l of the level
        returned      (lines, columns): modes, modes again, lags, direct; dh / d ln w and
                      dh~ / d ln w of the conjugate pole, (2, lines, modes); likewise by ln zeta
        """
        log_frequency = self.log_frequency[0] + coordinate * self.log_frequency[1]
        log_damping = self.log_damping[0] + coordinate * self.log_damping[1]
        s = 2j * np.pi * frequency_Hz[:, None]
        w, zeta = 2 * np.pi * np.exp(log_frequency), np.exp(log_damping)
        root = np.sqrt(np.maximum(1 - zeta**2, 1e-6))
        pole = w * (-zeta + 1j * root)
        slope = w * zeta * (-1 - 1j * zeta / root)
        h, conjugate = w / (s - pole), w / (s - pole.conj())
        real = 2 * np.pi * lag_Hz
        direct = np.ones((len(s), 1), dtype=np.complex128)
        value = [(h + conjugate) / 2, 0.5j * (h - conjugate), real / (s + real), direct]
        return (
            np.concatenate(value, axis=1),
            np.stack([h + h**2 * pole / w, conjugate + conjugate**2 * pole.conj() / w]),
            np.stack([h**2 * slope / w, conjugate**2 * slope.conj() / w]),
        )

    def response(
        self, frequency_Hz: Array, lag_Hz: Array, coordinate: float, residues: Array
    ) -> ComplexArray:
        """Return the response of all paths without the delay, (lines, outputs, inputs).

        residues  (2, columns, outputs, inputs)  at the centre, and the change to the largest level
        """
        columns, _, _ = self.columns(frequency_Hz, lag_Hz, coordinate)
        at_level = residues[0] + coordinate * residues[1]
        return np.asarray(np.einsum("fc,coi->foi", columns, at_level))


def level_coordinate(level_V: float, levels_V: Array) -> float:
    """Return ln(a / a_0) / ln(a_max / a_0); zero if the data have one level."""
    low, high = float(levels_V[0]), float(levels_V[-1])
    if len(levels_V) < 2:
        return 0.0
    return 2.0 * float(np.log(level_V / low) / np.log(high / low)) - 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class CoupledStage:
    """A linear stage whose modes move with the level of the drive.

        Y = e^(-s delay) G(s, l) U
        ln w_m, ln zeta_m and all residues: x(l) = x_0 + l x_1,   l = ln(a / a_0) / ln(a_max / a_0)

    a is the rms of the drive over all inputs, a_0 the geometric centre of the levels of the data.
    G is the sum of the columns of ``ModalShape``. The change with the level is the average effect
    of hysteresis inside the stage on its stiffness; it is logarithmic because distortion relative
    to the displacement hardly depends on the level. Hysteresis itself is fitted per axis.

    inputs, outputs      names
    sampling_rate_Hz     of the data
    band_Hz              lowest and highest line of the data
    levels_V             (levels,) rms of the drive in the data, increasing
    log_frequency        (2, modes)  ln Hz: at the centre, and the change to the largest level
    log_damping          (2, modes)
    lag_Hz               (lags,) corner frequencies of real poles: creep
    residue_m_per_V      (2, 2 modes + lags + 1, outputs, inputs) of those columns
    delay_s              of the drives
    replicate_frequency  (replicates, 2, modes)  log_frequency, each without one realisation
    moved_rms_m          (levels, outputs)  of the data
    noise_rms_m          (levels, outputs)  of one period about the mean of its realisation
    error_rms_m          (levels, outputs)  of the means of the periods
    error_is_left_out    whether the error of a realisation is of a fit without it, or in sample
    recordings           names of the fitted recordings; empty for data from arrays
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sampling_rate_Hz: float
    band_Hz: tuple[float, float]
    levels_V: Array
    log_frequency: Array
    log_damping: Array
    lag_Hz: Array
    residue_m_per_V: Array
    delay_s: float
    replicate_frequency: Array
    moved_rms_m: Array
    noise_rms_m: Array
    error_rms_m: Array
    error_is_left_out: bool
    recordings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "levels_V", "lag_Hz")
        freeze(self, "log_frequency", "log_damping", ndim=2)
        freeze(self, "moved_rms_m", "noise_rms_m", "error_rms_m", ndim=2)
        freeze(self, "replicate_frequency", ndim=3)
        freeze(self, "residue_m_per_V", ndim=4)
        columns = 2 * self.log_frequency.shape[1] + len(self.lag_Hz) + 1
        by_level = (len(self.levels_V), len(self.outputs))
        expected = {
            **dict.fromkeys(("moved_rms_m", "noise_rms_m", "error_rms_m"), by_level),
            "residue_m_per_V": (2, columns, len(self.outputs), len(self.inputs)),
        }
        expect_shapes(self, expected)

    @property
    def shape(self) -> ModalShape:
        """Poles and delay as one record.

        >>> coupled.shape.delay_s == coupled.delay_s
        True
        """
        return ModalShape(
            log_frequency=self.log_frequency, log_damping=self.log_damping, delay_s=self.delay_s
        )

    def coordinate(self, level_V: float) -> float:
        """Return l of a level: -1 at the smallest level of the data, 1 at the largest.

        Raises ``IdentificationError`` outside the levels of the data.

        >>> round(coupled.coordinate(float(coupled.levels_V[-1])), 6)
        1.0
        """
        low, high = float(self.levels_V[0]), float(self.levels_V[-1])
        if not low / LEVEL_TOLERANCE <= level_V <= high * LEVEL_TOLERANCE:
            raise IdentificationError(
                f"a drive of {level_V:.4g} V rms",
                needed=f"one from {low:.4g} to {high:.4g} V rms, the levels of the data",
                remedy="Record the stage at that level too and fit again.",
            )
        return level_coordinate(level_V, self.levels_V)

    def response(self, frequency_Hz: ArrayLike, level_V: float) -> ComplexArray:
        """Return the linear response at a level, (lines, outputs, inputs), m/V.

        >>> coupled.response([10.0, 20.0], float(coupled.levels_V[0])).shape
        (2, 1, 1)
        """
        f = np.asarray(frequency_Hz, dtype=np.float64)
        delay = np.exp(-2j * np.pi * f * self.delay_s)[:, None, None]
        return np.asarray(delay * self._without_delay(f, self.coordinate(level_V)))

    def simulate(self, drive_V: ArrayLike, *, periodic: bool = False) -> Array:
        """Simulate the displacements due to a drive.

        drive_V   (samples, inputs)  V at ``sampling_rate_Hz``
        periodic  whether the drive is one period of the steady state; otherwise drive and
                  displacement are zero before the first sample
        returned  (samples, outputs)  m, without the mean, which lies outside the band of the data

        Raises ``IdentificationError`` for a drive of the wrong shape or outside the levels of the
        data. The level is the rms of all samples: cut a drive whose level changes.

        >>> drive_V = levels[0].voltage_V[:, :, 0, 0]
        >>> coupled.simulate(drive_V, periodic=True).shape == drive_V.shape
        True
        """
        drive = frozen(drive_V, "drive_V", ndim=2)
        if drive.shape[1] != len(self.inputs):
            raise IdentificationError(
                f"a drive of {drive.shape[1]} columns",
                needed=f"{len(self.inputs)}, one for each of {', '.join(self.inputs)}",
                remedy="Give the drives side by side, one column each.",
            )
        coordinate = self.coordinate(float(drive.std()))
        count = len(drive)
        if not periodic:
            slowest_Hz = min(
                self.lag_Hz.min(), float(np.exp(self.log_frequency[0] + self.log_damping[0]).min())
            )
            tail = int(np.ceil(SETTLING / (2 * np.pi * slowest_Hz) * self.sampling_rate_Hz))
            drive = np.concatenate([drive, np.zeros((tail + (count + tail) % 2, drive.shape[1]))])
        spectrum = np.fft.rfft(drive, axis=0)
        f = np.arange(len(spectrum)) * self.sampling_rate_Hz / len(drive)
        spectrum[(f < 0.5 * self.band_Hz[0]) | (f > self.band_Hz[1])] = 0.0
        response = np.einsum("foi,fi->fo", self._without_delay(f, coordinate), spectrum)
        response *= np.exp(-2j * np.pi * f * self.delay_s)[:, None]
        return np.asarray(np.fft.irfft(response, len(drive), axis=0)[:count])

    @property
    def coupling_m_per_V(self) -> Array:
        """Static displacement per volt of each drive, (outputs, inputs), m/V.

        Far below the first mode, at the centre of the levels.

        >>> coupled.coupling_m_per_V.shape
        (1, 1)
        """
        low_Hz = max(FAR_BELOW * float(np.exp(self.log_frequency[0].min())), self.band_Hz[0])
        return np.asarray(self._without_delay(np.array([low_Hz]), 0.0)[0].real)

    @property
    def decoupling(self) -> Array:
        """Decoupling matrix D: below the modes, D y responds to single drives, (outputs, outputs).

            D = diag(G_0) G_0^-1

        Raises ``IdentificationError`` if drives and displacements are not the same axes.

        >>> coupled.decoupling.shape
        (1, 1)
        """
        if self.inputs != self.outputs:
            raise IdentificationError(
                f"drives of {', '.join(self.inputs)}, displacements of {', '.join(self.outputs)}",
                needed="a displacement of each driven axis",
                remedy="Name drives and displacements by the axes they belong to.",
            )
        gain = self.coupling_m_per_V
        return np.asarray(np.diag(gain)[:, None] * np.linalg.inv(gain))

    def gain_change(self, frequency_Hz: ArrayLike) -> Array:
        """Return the relative change of the gain from the smallest level to the largest, (lines,).

        The gain is the Frobenius norm of the response.

        >>> coupled.gain_change([10.0]).shape
        (1,)
        """
        low, high = (
            np.linalg.norm(self.response(frequency_Hz, float(self.levels_V[k])), axis=(1, 2))
            for k in (0, -1)
        )
        return np.asarray(high / low - 1.0)

    def mode_frequency_Hz(self, level_V: float) -> Array:
        """Return the undamped frequencies of the modes at a level, (modes,), Hz.

        >>> coupled.mode_frequency_Hz(float(coupled.levels_V[0])).round().tolist()
        [60.0]
        """
        log = self.log_frequency[0] + self.coordinate(level_V) * self.log_frequency[1]
        return np.asarray(np.exp(log))

    def mode_damping(self, level_V: float) -> Array:
        """Return the dampings of the modes at a level, (modes,).

        >>> coupled.mode_damping(float(coupled.levels_V[0])).round(2).tolist()
        [0.05]
        """
        log = self.log_damping[0] + self.coordinate(level_V) * self.log_damping[1]
        return np.asarray(np.exp(log))

    def frequency_change(self) -> Array:
        """Return the relative change of the modes from smallest to largest level, (modes, 3).

        The columns are the change and the limits of its 95 % interval, by the jackknife over
        realisations; without replicates the interval is infinite.

        >>> coupled.frequency_change().shape
        (1, 3)
        """
        change = 2.0 * self.log_frequency[1]
        half = 2.0 * jackknife_half(self.replicate_frequency[:, 1])
        return np.asarray(np.expm1(np.stack([change, change - half, change + half], axis=1)))

    def mode_frequency_interval_Hz(self, level_V: float) -> Array:
        """Return 95 % intervals of the frequencies at a level, (modes, 2), by the jackknife.

        >>> coupled.mode_frequency_interval_Hz(float(coupled.levels_V[0])).shape
        (1, 2)
        """
        coordinate = self.coordinate(level_V)
        first, change = self.replicate_frequency[:, 0], self.replicate_frequency[:, 1]
        half = jackknife_half(first + coordinate * change)
        middle = self.log_frequency[0] + coordinate * self.log_frequency[1]
        return np.asarray(np.exp(np.stack([middle - half, middle + half], axis=1)))

    def _without_delay(self, frequency_Hz: Array, coordinate: float) -> ComplexArray:
        return self.shape.response(frequency_Hz, self.lag_Hz, coordinate, self.residue_m_per_V)
