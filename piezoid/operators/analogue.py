"""The sections of an analogue signal chain: lags, resonances, filters, one after the other."""

import numpy as np

from piezoid.operators.linear import ContinuousSystem


def first_order(frequency_Hz: float) -> ContinuousSystem:
    """Return w / (s + w) with w = 2 pi ``frequency_Hz``: an amplifier, a sensor."""
    w = 2 * np.pi * frequency_Hz
    one = np.ones((1, 1))
    return ContinuousSystem(A=-w * one, B=w * one, C=one, D=np.zeros((1, 1)))


def resonance(frequency_Hz: float, damping: float, rate_gain_s: float = 0.0) -> ContinuousSystem:
    """Return (1 + h s) w^2 / (s^2 + 2 zeta w s + w^2), one mode of unit gain at rest.

    w     2 pi frequency_Hz  > 0
    zeta  damping            > 0
    h     rate_gain_s        s; not zero where a mode is not in phase with its drive

    The states are the displacement over w^2 and its rate over w, so both are of like size.
    """
    w = 2 * np.pi * frequency_Hz
    return ContinuousSystem(
        A=np.array([[0.0, w], [-w, -2 * damping * w]]),
        B=np.array([[0.0], [w]]),
        C=np.array([[1.0, rate_gain_s * w]]),
        D=np.zeros((1, 1)),
    )


def butterworth(order: int, frequency_Hz: float) -> ContinuousSystem:
    """Return the low-pass filter of maximal flatness and unit gain at rest.

    order         >= 1; the poles stand at equal angles on the circle of radius 2 pi frequency_Hz
    frequency_Hz  > 0, where the gain has fallen by 3 dB
    """
    angles = np.pi * (2 * np.arange(1, order // 2 + 1) - 1) / (2 * order)
    pairs = [resonance(frequency_Hz, float(np.sin(angle))) for angle in angles]
    return cascade(*pairs, *([first_order(frequency_Hz)] if order % 2 else []))


def cascade(*systems: ContinuousSystem) -> ContinuousSystem:
    """Return the systems one after the other, the first one at the drive; delays add up."""
    whole = systems[0]
    for after in systems[1:]:
        upper = np.zeros((len(whole.A), len(after.A)))
        whole = ContinuousSystem(
            A=np.block([[whole.A, upper], [after.B @ whole.C, after.A]]),
            B=np.concatenate([whole.B, after.B @ whole.D]),
            C=np.concatenate([after.D @ whole.C, after.C], axis=1),
            D=after.D @ whole.D,
            delay_s=whole.delay_s + after.delay_s,
        )
    return whole
