"""Static tunnelling junction: current over gap, its logarithm, barrier and decay.

Sign: the gap ``d`` grows when the tip retracts; a drive that extends the tip lowers ``d`` and
raises ``ln i``. The decay ``k`` is that of the *current* (``k = 2 kappa`` where kappa is the decay
of the wave function). Barriers are in electronvolts, the one unit besides SI that every source on
tunnelling uses; all else is SI.

    i = i_0 exp(-k d),    k = 2 sqrt(2 m phi) / hbar        [Binnig & Rohrer 1987]
    k = 10.246 sqrt(phi / eV) per nanometre                 constants of CODATA 2022
"""

import math

import numpy as np

from piezoid.numerics.arrays import Array

ELEMENTARY_CHARGE_C = 1.602176634e-19  # exact since 2019
BOLTZMANN_J_PER_K = 1.380649e-23  # exact since 2019
PLANCK_J_S = 6.62607015e-34  # exact since 2019
ELECTRON_MASS_KG = 9.1093837139e-31  # CODATA 2022, relative uncertainty 3.1e-10

# 1.0246e10: the decay per metre of a barrier of one electronvolt.
DECAY_AT_ONE_EV_PER_M = (
    4.0 * math.pi * math.sqrt(2.0 * ELECTRON_MASS_KG * ELEMENTARY_CHARGE_C) / PLANCK_J_S
)


def decay_of_barrier(barrier_eV: float) -> float:
    """Return the decay of the current per metre for an apparent barrier height.

        k = 2 sqrt(2 m phi) / hbar

    phi  barrier_eV  scalar  eV, >= 0
    k    returned    scalar  1/m
    """
    return DECAY_AT_ONE_EV_PER_M * math.sqrt(barrier_eV)


def barrier_of_decay(decay_per_m: float) -> float:
    """Return the apparent barrier height in electronvolts for a decay of the current.

        phi = (k / 10.246 nm^-1)^2 eV

    The apparent barrier is not a work function; in air it is far lower. The relative error of the
    height calibration enters doubled.
    """
    return (decay_per_m / DECAY_AT_ONE_EV_PER_M) ** 2


def log_current(current_A: Array, *, set_point_A: float, floor_A: float) -> Array:
    """Return the log current relative to a set point, with a floor below which the tip is lost.

        y = ln( max(s i, i_min) / |i_set| ),   s = sign(i_set)

    i      current_A    (samples,)  A, of either polarity
    i_set  set_point_A  scalar      A, of the current's polarity
    i_min  floor_A      scalar      A, > 0: bounds the approach speed of a lost tip
    y      returned     (samples,)  nepers

    For a noisy current the mean of ``y`` lies below the log of the mean current by
    ``var / (2 i^2)``.
    """
    magnitude_A = math.copysign(1.0, set_point_A) * current_A
    nepers: Array = np.log(np.maximum(magnitude_A, floor_A) / abs(set_point_A))
    return nepers
