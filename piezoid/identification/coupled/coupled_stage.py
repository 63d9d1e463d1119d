"""CoupledStage: several drives, several displacements, one model for all levels of the drive."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from piezoid.errors import IdentificationError
from piezoid.identification.coupled.distortion import distortion_terms
from piezoid.identification.coupled.hysteresis_terms import (
    TERMS,
    at_lines,
    hysteresis_terms,
    oversampled,
)
from piezoid.identification.coupled.modal_sum import complex_residues, modal_columns
from piezoid.numerics.arrays import Array, ComplexArray, expect_shapes, freeze, frozen
from piezoid.numerics.robust import student_quantile

# Between levels the model interpolates; a drive within so much of the outer ones counts as theirs,
# because realisations of one level differ in their rms (by 0.3 % on the steering mirror).
BEYOND = 1.05
FAR_BELOW = 0.05  # of the first mode: it adds 0.25 % of its share there
SETTLING = 3.0  # time constants of the slowest pole: 5 % of its share is left


@dataclass(frozen=True, kw_only=True, eq=False)
class CoupledStage:
    """A linear stage whose modes move with the level of the drive, behind hysteresis.

        Y = e^(-s delay) G(s, l) (U + phi),   phi_i = sum_k c_ik F_ik(u_i, s_i),   s = B G(l) u
        ln w_m, ln zeta_m and all residues: x(l) = x_0 + l x_1,   l = ln(a / a_0) / ln(a_max / a_0)

    a is the rms of the drive over all inputs, a_0 the geometric centre of the levels of the data.
    G is the sum of ``modal_columns``. F are plays and powers of drive and elongation
    (``hysteresis_terms``); plays of the elongation are what hysteresis inside the stage does to
    first order, the elongations being those of the linear stage. The shift of modes with the level
    is the rest of it; logarithmic, because distortion relative to displacement hardly changes with
    the level: hysteresis without a scale of its own.

    inputs, outputs      names
    sampling_rate_Hz     of the data
    band_Hz              lowest and highest line of the data
    levels_V             (levels,) rms of the drive in the data, increasing
    log_frequency        (2, modes)  ln Hz: at the centre, and the change to the largest level
    log_damping          (2, modes)
    lag_Hz               (lags,) corners of real poles: creep
    residue_m_per_V      (2, 2 modes + lags + 1, outputs, inputs) of ``modal_columns``
    delay_s              of the drives
    elongation_V_per_m   (inputs, outputs)  B
    scale_V              (2, inputs)  rms of drive and elongation that the terms are relative to
    term_V               (inputs, TERMS)  c
    linear_V             (2, inputs)  what c leaves of drive and elongation: F is without them
    replicate_frequency  (replicates, 2, modes)  log_frequency, each without one realisation
    equivalent_gain      (levels, inputs, 2)  what the terms add to drive and elongation where the
                         level is one of the data's, V/V: their describing function
    moved_rms_m          (levels, outputs)  of the data
    noise_rms_m          (levels, outputs)  of one period about the mean of its realisation
    error_rms_m          (levels, outputs)  of the means of the periods
    error_is_left_out    each realisation's error is of a fit without it; otherwise in sample
    distortion_m         (columns, terms, outputs)  W of ``distortion``, added to Y; None: too few
                         data tell it
    recordings           names of those it was fitted to; none where it was fitted to arrays
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
    elongation_V_per_m: Array
    scale_V: Array
    term_V: Array
    linear_V: Array
    replicate_frequency: Array
    equivalent_gain: Array
    moved_rms_m: Array
    noise_rms_m: Array
    error_rms_m: Array
    error_is_left_out: bool
    distortion_m: Array | None = None
    recordings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "levels_V", "lag_Hz")
        freeze(self, "log_frequency", "log_damping", ndim=2)
        freeze(self, "elongation_V_per_m", "scale_V", "term_V", "linear_V", ndim=2)
        freeze(self, "moved_rms_m", "noise_rms_m", "error_rms_m", ndim=2)
        freeze(self, "replicate_frequency", "equivalent_gain", ndim=3)
        freeze(self, "residue_m_per_V", ndim=4)
        if self.distortion_m is not None:
            freeze(self, "distortion_m", ndim=3)
        modes, inputs = self.log_frequency.shape[1], len(self.inputs)
        columns = 2 * modes + len(self.lag_Hz) + 1
        levels = len(self.levels_V)
        expected = {
            "equivalent_gain": (levels, inputs, 2),
            **dict.fromkeys(
                ("moved_rms_m", "noise_rms_m", "error_rms_m"), (levels, len(self.outputs))
            ),
            "residue_m_per_V": (2, columns, len(self.outputs), inputs),
            "elongation_V_per_m": (inputs, len(self.outputs)),
            "term_V": (inputs, TERMS),
        }
        expect_shapes(self, expected)

    def coordinate(self, level_V: float) -> float:
        """Return l of a level: -1 at the smallest of the data, 1 at the largest.

        Raises ``IdentificationError`` outside the levels of the data.

        >>> round(coupled.coordinate(float(coupled.levels_V[-1])), 6)
        1.0
        """
        low, high = float(self.levels_V[0]), float(self.levels_V[-1])
        if not low / BEYOND <= level_V <= high * BEYOND:
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
        delayed = np.exp(-2j * np.pi * f * self.delay_s)[:, None, None]
        return np.asarray(delayed * self._undelayed(f, self.coordinate(level_V)))

    def simulate(self, drive_V: ArrayLike, *, periodic: bool = False) -> Array:
        """Return the displacements that a drive causes, from the drive alone.

        drive_V   (samples, inputs)  V at ``sampling_rate_Hz``
        periodic  the drive is one period of many, and the answer that of the steady state;
                  otherwise drive and displacement are zero before the first sample
        returned  (samples, outputs)  m, without the mean, which a band without zero does not hold

        Raises ``IdentificationError`` for a drive of the wrong shape or outside the levels of the
        data. The level is the rms of all samples: a drive whose level changes on the way is not
        what this model is for; cut it.

        >>> one = levels[0].voltage_V[:, :, 0, 0]
        >>> coupled.simulate(one, periodic=True).shape == one.shape
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
            slowest = 2 * np.pi * min(self.lag_Hz.min(), float(self._damped_Hz().min()))
            tail = int(np.ceil(SETTLING / slowest * self.sampling_rate_Hz))
            drive = np.concatenate([drive, np.zeros((tail + (count + tail) % 2, drive.shape[1]))])
        spectrum = np.fft.rfft(drive, axis=0)
        f = np.arange(len(spectrum)) * self.sampling_rate_Hz / len(drive)
        spectrum[(f < 0.5 * self.band_Hz[0]) | (f > self.band_Hz[1])] = 0.0
        linear = self._undelayed(f, coordinate)
        drives, elongations = self._signals(spectrum, linear, len(drive))
        added = self._hysteresis(drives, elongations, f, periodic)
        moved = np.einsum("foi,fi->fo", linear, spectrum + added)
        if self.distortion_m is not None:
            terms = distortion_terms(drives, elongations, periodic=periodic)
            lines = at_lines(terms, np.arange(len(f)))
            lines[(f < 0.5 * self.band_Hz[0]) | (f > self.band_Hz[1])] = 0.0
            columns = self._columns(f, coordinate)
            moved += np.einsum("fc,ft,cto->fo", columns, lines, self.distortion_m, optimize=True)
        moved *= np.exp(-2j * np.pi * f * self.delay_s)[:, None]
        return np.asarray(np.fft.irfft(moved, len(drive), axis=0)[:count])

    @property
    def coupling_m_per_V(self) -> Array:
        """What each displacement does per volt of each drive, (outputs, inputs), m/V.

        Far below the first mode, at the centre of the levels.

        >>> coupled.coupling_m_per_V.shape
        (1, 1)
        """
        far_Hz = max(FAR_BELOW * float(np.exp(self.log_frequency[0].min())), self.band_Hz[0])
        return np.asarray(self._undelayed(np.array([far_Hz]), 0.0)[0].real)

    @property
    def decoupling(self) -> Array:
        """D: D y answers, far below the first mode, to each drive alone, (outputs, outputs).

            D = diag(G_0) G_0^-1

        Raises ``IdentificationError`` where drives and displacements are not the same axes.

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
        """Return how the gain changes from the smallest level to the largest, (lines, 2).

        The relative change of the Frobenius norm of the response: of the whole model, its terms by
        their equivalent gain, and without the terms.

        >>> coupled.gain_change([10.0]).shape
        (1, 2)
        """
        f = np.asarray(frequency_Hz, dtype=np.float64)
        gains = []
        for place in (0, -1):
            bare = self._undelayed(f, self.coordinate(float(self.levels_V[place])))
            on_drive, on_elongation = self.equivalent_gain[place].T
            driven = np.eye(len(self.inputs)) * (1.0 + on_drive)
            driven = driven + on_elongation[:, None] * (self.elongation_V_per_m @ bare)
            gains.append([np.linalg.norm(one, axis=(1, 2)) for one in (bare @ driven, bare)])
        low, high = np.array(gains)
        return np.asarray((high / low - 1.0).T)

    def hysteretic_frequency_change(self) -> Array:
        """Return what the terms move each mode by between the levels, to first order, (modes,).

            dw / w = Im tr(A B R),   A = diag(equivalent gain of the elongations)

        Relative, and beside ``frequency_change``, which is that of the response behind the terms.

        >>> coupled.hysteretic_frequency_change().shape
        (1,)
        """
        shifts = []
        for place in (0, -1):
            l = self.coordinate(float(self.levels_V[place]))  # noqa: E741
            residue = complex_residues(
                self.residue_m_per_V[0] + l * self.residue_m_per_V[1], self.log_frequency.shape[1]
            )
            weight = self.equivalent_gain[place][:, 1, None] * self.elongation_V_per_m
            shifts.append(0.5 * np.einsum("io,moi->m", weight, residue).imag)
        return np.asarray(shifts[1] - shifts[0])

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
        """Return how the modes move from the smallest level to the largest, (modes, 3).

        A column for the relative change, two for its 95 % interval, by the jackknife over
        realisations: without replicates the interval is infinite.

        >>> coupled.frequency_change().shape
        (1, 3)
        """
        change = 2.0 * self.log_frequency[1]
        half = 2.0 * _jackknife_half(self.replicate_frequency[:, 1])
        return np.asarray(np.expm1(np.stack([change, change - half, change + half], axis=1)))

    def mode_frequency_interval_Hz(self, level_V: float) -> Array:
        """Return 95 % intervals of the frequencies at a level, (modes, 2), by the jackknife.

        >>> coupled.mode_frequency_interval_Hz(float(coupled.levels_V[0])).shape
        (1, 2)
        """
        l = self.coordinate(level_V)  # noqa: E741
        half = _jackknife_half(self.replicate_frequency[:, 0] + l * self.replicate_frequency[:, 1])
        middle = self.log_frequency[0] + l * self.log_frequency[1]
        return np.asarray(np.exp(np.stack([middle - half, middle + half], axis=1)))

    def _damped_Hz(self) -> Array:
        """Return what the modes' envelopes decay with, in Hz, at the centre of the levels."""
        return np.asarray(np.exp(self.log_frequency[0] + self.log_damping[0]))

    def _columns(self, frequency_Hz: Array, coordinate: float) -> ComplexArray:
        log_frequency = self.log_frequency[0] + coordinate * self.log_frequency[1]
        log_damping = self.log_damping[0] + coordinate * self.log_damping[1]
        return modal_columns(frequency_Hz, log_frequency, log_damping, self.lag_Hz).value

    def _undelayed(self, frequency_Hz: Array, coordinate: float) -> ComplexArray:
        residue = self.residue_m_per_V[0] + coordinate * self.residue_m_per_V[1]
        columns = self._columns(frequency_Hz, coordinate)
        return np.asarray(np.einsum("fc,coi->foi", columns, residue))

    def _signals(
        self, spectrum: ComplexArray, linear: ComplexArray, samples: int
    ) -> tuple[Array, Array]:
        """Return drives and elongations over their scales, (fine samples, inputs)."""
        moved = np.einsum("foi,fi->fo", linear, spectrum)
        both = spectrum, moved @ self.elongation_V_per_m.T
        drives, elongations = (oversampled(one, samples) for one in both)
        return drives / self.scale_V[0], elongations / self.scale_V[1]

    def _hysteresis(
        self, drives: Array, elongations: Array, frequency_Hz: Array, periodic: bool
    ) -> ComplexArray:
        """Return the lines of phi."""
        lines = np.arange(len(frequency_Hz))
        added = np.zeros((len(lines), len(self.inputs)), dtype=np.complex128)
        for i, weight in enumerate(self.term_V):
            u, s = drives[:, i], elongations[:, i]
            terms = hysteresis_terms(u, s, periodic=periodic) @ weight
            linear_u, linear_s = self.linear_V[:, i]
            added[:, i] = at_lines(terms - linear_u * u - linear_s * s, lines)
        added[(frequency_Hz < 0.5 * self.band_Hz[0]) | (frequency_Hz > self.band_Hz[1])] = 0.0
        return added


def level_coordinate(level_V: float, levels_V: Array) -> float:
    """Return ln(a / a_0) / ln(a_max / a_0); zero where the data have one level."""
    low, high = float(levels_V[0]), float(levels_V[-1])
    if len(levels_V) < 2:
        return 0.0
    return 2.0 * float(np.log(level_V / low) / np.log(high / low)) - 1.0


def _jackknife_half(replicates: Array) -> Array:
    """Return half a 95 % interval of estimates that each leave one realisation out [Tukey 1958].

    replicates  (replicates, modes)
    """
    count = len(replicates)
    if count < 2:
        return np.full(replicates.shape[1], np.inf)
    spread = ((replicates - replicates.mean(axis=0)) ** 2).sum(axis=0)
    quantile = float(student_quantile(0.975, count - 1))
    return np.asarray(quantile * np.sqrt((count - 1) / count * spread))
