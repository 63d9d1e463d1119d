"""Correction gains of the disturbance observer from noise variances."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_are

from piezoid.design.observer import DisturbanceModel, extended
from piezoid.design.plant import Plant
from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array, freeze


@dataclass(frozen=True, kw_only=True, eq=False)
class KalmanGain:
    """A stationary Kalman gain in current form.

    gain                 (n + w,)  of plant and disturbance states
    innovation_variance  output unit squared; a recording whose innovations vary otherwise, or
                         are not white, says that a variance or the model is wrong
    """

    gain: Array
    innovation_variance: float

    def __post_init__(self) -> None:
        freeze(self, "gain")


def kalman_gain(
    plant: Plant,
    disturbance: DisturbanceModel,
    *,
    input_variance: float,
    drift_variance: float,
    sensor_variance: float,
) -> KalmanGain:
    """Solve the Riccati equation of the extended state.

        Pm = A_e Pm A_e' - A_e Pm C_e' (C_e Pm C_e' + r)^-1 C_e Pm A_e' + blkdiag(q_x b b', q_d I)
        L = Pm C_e' (C_e Pm C_e' + r)^-1                                 [Kalman 1960]

    q_x  input_variance   V^2 of one sample, white, at the plant's input
    q_d  drift_variance   V^2 of one sample's change of each disturbance state, > 0
    r    sensor_variance  output unit squared, > 0

    q_d is E[(D d)^2], for example of the hysteresis model's remainder along the planned scan.
    """
    if not (drift_variance > 0.0 and sensor_variance > 0.0 and input_variance >= 0.0):
        raise ValueError(
            f"variances are {input_variance}, {drift_variance}, {sensor_variance}; the drift and "
            "the sensor need > 0: an exact constant needs no observer, an exact sensor no filter"
        )
    A_e, C_e = extended(plant, disturbance)
    order, states = len(plant.state_matrix), len(disturbance.output)
    drive = np.concatenate([plant.input_taps.sum(axis=1), np.zeros(states)])
    Q = input_variance * np.outer(drive, drive)
    Q[order:, order:] += drift_variance * np.eye(states)
    scale = 1.0 / sensor_variance
    try:
        ahead = solve_discrete_are(A_e.T, C_e[:, None] * np.sqrt(scale), Q, np.eye(1))
    except (np.linalg.LinAlgError, ValueError) as fault:
        raise DesignError(
            f"the Riccati equation of '{plant.label}' has no stabilising solution: {fault}",
            needed="a drift variance > 0, and a plant that passes a constant",
            remedy="Raise the drift variance, or place the observer's poles.",
        ) from fault
    innovation = float(C_e @ ahead @ C_e + sensor_variance)
    return KalmanGain(gain=ahead @ C_e / innovation, innovation_variance=innovation)
