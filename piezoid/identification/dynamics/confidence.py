"""What of a fitted model may be read by itself, and what only as part of the whole."""

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.numerics.arrays import Array


def resolved_modes(dynamics: LinearDynamics) -> NDArray[np.bool_]:
    """Tell which modes the data determine, (modes,).

    The others are overdamped, or known to no better than a factor: they stand for what lies
    outside the band, and their numbers mean nothing by themselves.
    """
    frequency = dynamics.mode_frequency_interval_Hz()
    damping = dynamics.mode_damping_interval()
    known = (frequency[:, 1] < 1.1 * frequency[:, 0]) & (damping[:, 1] < 3 * damping[:, 0])
    return np.asarray(known & (dynamics.mode_damping < 1.0), dtype=np.bool_)


def phase_delay_s(dynamics: LinearDynamics, frequency_Hz: float) -> Array:
    """Return how late each output follows a slow sine, all lags together, (outputs, inputs), s.

        - arg(G(j w) / G(0)) / w

    frequency_Hz  well below the first resonance

    At low frequency only the sum of all time constants can be known; how a fit shares it between
    the pure delay and terms outside the band depends on its structure, and the interval of
    ``delay_s`` holds for that structure alone. This sum does not depend on it.
    """
    relative = dynamics.response([frequency_Hz])[0] / dynamics.static_gain_m_per_V
    return np.asarray(-np.angle(relative) / (2 * np.pi * frequency_Hz))
