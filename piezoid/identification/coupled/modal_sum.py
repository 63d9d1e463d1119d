"""Modal sum: poles shared by all paths, with residues that depend on the level of the drive."""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array, ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Columns:
    """Terms of a response that real residues multiply.

        h = w / (s - p),   p = w (-zeta + j sqrt(1 - zeta^2))
        columns: (h + h~) / 2, j (h - h~) / 2, w_l / (s + w_l), 1

    value        (lines, columns)   modes, modes again, lags, direct
    by_frequency (2, lines, modes)  dh / d ln w, and that of h~, the mirrored pole
    by_damping   (2, lines, modes)  dh / d ln zeta, likewise
    """

    value: ComplexArray
    by_frequency: ComplexArray
    by_damping: ComplexArray


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

    def columns(self, frequency_Hz: Array, lag_Hz: Array, coordinate: float) -> Columns:
        """Return what the residues multiply at one level.

        frequency_Hz  (lines,)
        lag_Hz        (lags,)   corner frequencies of real poles
        coordinate    l of the level
        """
        log_frequency = self.log_frequency[0] + coordinate * self.log_frequency[1]
        log_damping = self.log_damping[0] + coordinate * self.log_damping[1]
        s = 2j * np.pi * frequency_Hz[:, None]
        w, zeta = 2 * np.pi * np.exp(log_frequency), np.exp(log_damping)
        root = np.sqrt(np.maximum(1 - zeta**2, 1e-6))
        pole = w * (-zeta + 1j * root)
        slope = w * zeta * (-1 - 1j * zeta / root)
        h, mirrored = w / (s - pole), w / (s - pole.conj())
        real = 2 * np.pi * lag_Hz
        direct = np.ones((len(s), 1), dtype=np.complex128)
        value = [(h + mirrored) / 2, 0.5j * (h - mirrored), real / (s + real), direct]
        return Columns(
            value=np.concatenate(value, axis=1),
            by_frequency=np.stack([h + h**2 * pole / w, mirrored + mirrored**2 * pole.conj() / w]),
            by_damping=np.stack([h**2 * slope / w, mirrored**2 * slope.conj() / w]),
        )

    def response(
        self, frequency_Hz: Array, lag_Hz: Array, coordinate: float, residues: Array
    ) -> ComplexArray:
        """Return the response of all paths without the delay, (lines, outputs, inputs).

        residues  (2, columns, outputs, inputs)  at the centre, and the change to the largest level
        """
        columns = self.columns(frequency_Hz, lag_Hz, coordinate).value
        at_level = residues[0] + coordinate * residues[1]
        return np.asarray(np.einsum("fc,coi->foi", columns, at_level))


def level_coordinate(level_V: float, levels_V: Array) -> float:
    """Return ln(a / a_0) / ln(a_max / a_0); zero where the data have one level."""
    low, high = float(levels_V[0]), float(levels_V[-1])
    if len(levels_V) < 2:
        return 0.0
    return 2.0 * float(np.log(level_V / low) / np.log(high / low)) - 1.0
