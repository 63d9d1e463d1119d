"""Frequency responses of a stage with known modes, in the formats of instruments."""

from pathlib import Path

import numpy as np
import scipy.io

from piezoid.numerics.arrays import Array, ComplexArray

FREQUENCY_Hz = np.geomspace(1.0, 3000.0, 300)
MODES = ((812.0, 30.0, 1.0),)
GAIN_m_per_V = 2e-7
DELAY_s = 1e-4


def response(
    frequency_Hz: Array = FREQUENCY_Hz,
    modes: tuple[tuple[float, float, float], ...] = MODES,
    *,
    gain_m_per_V: float = GAIN_m_per_V,
    delay_s: float = DELAY_s,
    slope_dB: float = 0.0,
) -> ComplexArray:
    """Return modes of (frequency, quality, share), a delay, and creep of a slope per decade."""
    s = 2j * np.pi * frequency_Hz
    total = np.zeros(len(s), dtype=np.complex128)
    for f, quality, share in modes:
        w = 2.0 * np.pi * f
        total += share * w**2 / (s**2 + w / quality * s + w**2)
    creep = (1j * frequency_Hz / modes[0][0]) ** (slope_dB / 20.0)
    return np.asarray(gain_m_per_V * total * np.exp(-s * delay_s) * creep)


def noisy(rng: np.random.Generator, exact: ComplexArray, relative: float) -> ComplexArray:
    """Return a response with complex noise in proportion to it and to the gain at rest."""
    size = relative * np.hypot(np.abs(exact), np.abs(exact[0])) / np.sqrt(2.0)
    noise = rng.standard_normal(len(exact)) + 1j * rng.standard_normal(len(exact))
    return np.asarray(exact + size * noise / np.sqrt(2.0))


def write_csv(path: Path, heading: str, *columns: Array) -> Path:
    """Write columns under a line of headings."""
    np.savetxt(
        path, np.column_stack(columns), delimiter=",", header=heading, comments="", fmt="%.10g"
    )
    return path


def cells_of(values: ComplexArray, cell: str) -> list[str]:
    """Return complex numbers as text: ``re`` and ``im``, and the ``sign`` and ``size`` of im."""
    return [
        cell.format(re=z.real, im=z.imag, sign="-" if z.imag < 0 else "+", size=abs(z.imag))
        for z in values
    ]


def write_cells(path: Path, separator: str, cell: str) -> Path:
    """Write the response with a complex number in each cell; semicolons with decimal commas."""
    cells = cells_of(response() * 1e6, cell)
    rows = [f"{f:.12g}{separator}{z}" for f, z in zip(FREQUENCY_Hz, cells, strict=True)]
    text = "\n".join([separator.join(("f[Hz]", "H[um/V]")), *rows])
    path.write_text(text.replace(".", ",") if separator == ";" else text)
    return path


def write_matlab(path: Path, **arrays: object) -> Path:
    """Write arrays by name."""
    scipy.io.savemat(path, arrays)
    return path


def matrix(coupling: float = 0.02) -> ComplexArray:
    """Return a response of three axes, (outputs, drives, lines), each with another mode."""
    diagonal = [response(modes=((f, 30.0, 1.0),)) for f in (812.0, 640.0, 1310.0)]
    coupled = response(modes=((400.0, 20.0, 1.0),))
    return np.array(
        [[diagonal[i] if i == j else coupling * coupled for j in range(3)] for i in range(3)]
    )
