"""Whether the hysteresis comes before the dynamics or behind them, told by its harmonics' phase.

    before:  y = G[H[u]]     a harmonic made at f arrives through G(n f)
    behind:  y = H[G[u]]     a harmonic is made of what came through G(f): n times its phase

Above a third of the resonance the two part. What is linear is taken out of the measurement and of
both simulations, and only such frequencies and times count at which the drive itself is silent.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, rfft

from piezoid.identification.dynamics.hammerstein_model import (
    HammersteinRows,
    HammersteinShape,
    simulate_rows,
    straightened,
    terms_at,
)
from piezoid.identification.dynamics.hammerstein_record import Order, StructureVerdict
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns

SILENT = 1e-4  # of the window's strongest line: there the drive does not count as driving
WINDOWS = 32
BLOCKS = 8
SIGNIFICANT = 2.4  # Student's quantile of seven degrees of freedom, 95 %


def judge_structure(
    axis: AxisModel,
    shape: HammersteinShape,
    theta: Array,
    threshold_V: Array,
    rows: HammersteinRows,
) -> StructureVerdict:
    """Compare the harmonics of a recording with both orders of the same two parts.

    rows  of a recording whose drive is silent somewhere, as a chirp's or a sparse multisine's is
    """
    linear = _through(shape, theta, rows, rows.drive_V)
    before = simulate_rows(shape, theta, rows)
    behind = _hysteresis(axis, shape, theta, threshold_V, linear)
    lowest_Hz = float(np.exp(shape.split(theta)[2][0])) / 3.0
    parts = [_nonlinear(signal, linear) for signal in (rows.measured_m, before, behind)]
    blocks = _blocks(rows, parts, lowest_Hz)
    whole = blocks.sum(axis=0)
    left_out = np.array([_agreement(whole - block) for block in blocks])
    a, b = _agreement(whole)
    gap = (left_out[:, 0] - left_out[:, 1]).real
    half = SIGNIFICANT * float(np.sqrt((BLOCKS - 1) * np.var(gap)))
    difference = float((a - b).real)
    order: Order = "undecided"
    if abs(difference) > half and max(a.real, b.real) > 0.0:
        order = "before" if difference > 0.0 else "behind"
    return StructureVerdict(
        order=order,
        agreement_before=float(a.real),
        agreement_behind=float(b.real),
        phase_before_deg=float(np.degrees(np.angle(a))),
        phase_behind_deg=float(np.degrees(np.angle(b))),
        difference_half=half,
        lowest_Hz=lowest_Hz,
    )


def _through(shape: HammersteinShape, theta: Array, rows: HammersteinRows, signal: Array) -> Array:
    _, _, linear, shares = shape.split(theta)
    response = rows.chain * (terms_at(shape, linear, rows.frequency_Hz) @ shares)
    moved = irfft(response * rows.spectrum(signal), rows.padded)[: rows.samples]
    return np.asarray(signal[0] + moved)


def _hysteresis(
    axis: AxisModel, shape: HammersteinShape, theta: Array, threshold_V: Array, drive_V: Array
) -> Array:
    operator = axis.hysteresis
    weight, zones, _, _ = shape.split(theta)
    inside_V = operator.envelope.run(drive_V - operator.voltage_offset_V)
    states_V, _ = play_columns(inside_V, threshold_V, np.zeros(len(threshold_V)))
    return zones.run(states_V @ weight)


def _nonlinear(signal: Array, linear: Array) -> Array:
    level, line = straightened(signal), straightened(linear)
    return np.asarray(level - line * float(level @ line / (line @ line)))


def _blocks(rows: HammersteinRows, parts: list[Array], lowest_Hz: float) -> Array:
    """Cross and own powers of measured and both simulated harmonics, (blocks, 5)."""
    length = 2 ** int(np.log2(rows.samples / WINDOWS))
    signals = np.stack([straightened(rows.drive_V), *parts])
    frequency_Hz, found = _short_time(signals, rows.rate_Hz, length)
    drive, measured, before, behind = found
    power = np.abs(drive) ** 2
    counts = power < SILENT * power.max(axis=0)
    counts &= ((frequency_Hz >= lowest_Hz) & (frequency_Hz <= 0.4 * rows.rate_Hz))[:, None]
    products = [
        np.where(counts, value, 0.0).sum(axis=0)
        for value in (
            measured * before.conj(),
            measured * behind.conj(),
            np.abs(measured) ** 2,
            np.abs(before) ** 2,
            np.abs(behind) ** 2,
        )
    ]
    each = np.array_split(np.array(products), BLOCKS, axis=1)
    return np.array([block.sum(axis=1) for block in each])


def _short_time(signals: Array, rate_Hz: float, length: int) -> tuple[Array, Array]:
    """Return the lines of Hann windows that overlap by half, (signals, lines, windows)."""
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    parts = sliding_window_view(signals, length, axis=1)[:, :: length // 2] * window
    return np.arange(length // 2 + 1) * rate_Hz / length, np.moveaxis(rfft(parts), 1, 2)


def _agreement(sums: Array) -> Array:
    own = np.sqrt(np.maximum(sums[2].real * sums[3:5].real, 1e-300))
    return np.asarray(sums[:2] / own)
