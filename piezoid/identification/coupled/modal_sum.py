"""The linear part: poles shared by all paths, residues that follow the level of the drive."""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array, ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Columns:
    """What the entries of a response are sums of, with real coefficients.

        h = w / (s - p),   p = w (-zeta + j sqrt(1 - zeta^2))
        columns: (h + h~) / 2, j (h - h~) / 2, w_l / (s + w_l), 1

    value        (lines, columns)   modes, modes again, lags, direct
    by_frequency (2, lines, modes)  dh / d ln w, and that of h~, the mirrored pole
    by_damping   (2, lines, modes)  dh / d ln zeta, likewise
    """

    value: ComplexArray
    by_frequency: ComplexArray
    by_damping: ComplexArray


def modal_columns(
    frequency_Hz: Array, log_frequency: Array, log_damping: Array, lag_Hz: Array
) -> Columns:
    """Return the columns at lines of frequency.

    frequency_Hz   (lines,)
    log_frequency  (modes,)  ln of the undamped frequency in Hz
    log_damping    (modes,)  ln zeta, zeta below one
    lag_Hz         (lags,)   corner frequencies of real poles
    """
    s = 2j * np.pi * frequency_Hz[:, None]
    w, zeta = 2 * np.pi * np.exp(log_frequency), np.exp(log_damping)
    swing = np.sqrt(np.maximum(1 - zeta**2, 1e-6))
    pole = w * (-zeta + 1j * swing)
    turned = w * zeta * (-1 - 1j * zeta / swing)
    h, mirrored = w / (s - pole), w / (s - pole.conj())
    real = 2 * np.pi * lag_Hz
    direct = np.ones((len(s), 1), dtype=np.complex128)
    value = [(h + mirrored) / 2, 0.5j * (h - mirrored), real / (s + real), direct]
    return Columns(
        value=np.concatenate(value, axis=1),
        by_frequency=np.stack([h + h**2 * pole / w, mirrored + mirrored**2 * pole.conj() / w]),
        by_damping=np.stack([h**2 * turned / w, mirrored**2 * turned.conj() / w]),
    )


def complex_residues(residue: Array, modes: int) -> ComplexArray:
    """Return the residues of the modes, (modes, outputs, inputs), from coefficients of columns."""
    return np.asarray(residue[:modes] + 1j * residue[modes : 2 * modes])


def gram_of_residues(columns: ComplexArray, drive: ComplexArray) -> Array:
    """Return A'A of one output, A the rows that its coefficients meet: never formed.

        (A'A)_(ci, dk) = sum_f Re( conj(b_c) b_d sum_r conj(V_i) V_k )

    columns   (lines, columns)              b
    drive     (lines, inputs, realisations) V, weighted
    returned  (columns * inputs,) twice
    """
    count, inputs = columns.shape[1], drive.shape[1]
    power = drive.conj() @ drive.transpose(0, 2, 1)
    gram = np.empty((count, inputs, count, inputs))
    for i in range(inputs):
        for k in range(inputs):
            gram[:, i, :, k] = ((columns.conj() * power[:, i, k, None]).T @ columns).real
    return gram.reshape(count * inputs, count * inputs)


def products_with_residues(
    columns: ComplexArray, drive: ComplexArray, rows: ComplexArray
) -> Array:
    """Return A' t for every output and vector t.

    rows      (vectors, lines, outputs, realisations)  t
    returned  (columns * inputs, outputs, vectors)
    """
    vectors, lines, outputs, _ = rows.shape
    count, inputs = columns.shape[1], drive.shape[1]
    met = np.matmul(rows, drive.conj().transpose(0, 2, 1))  # (vectors, lines, outputs, inputs)
    flat = met.transpose(1, 0, 2, 3).reshape(lines, -1)
    products = (columns.conj().T @ flat).real.reshape(count, vectors, outputs, inputs)
    return np.asarray(products.transpose(0, 3, 2, 1).reshape(count * inputs, outputs, vectors))
