"""Plants from fractions, and observers from their poles."""

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.observer import (
    DisturbanceModel,
    DisturbanceObserver,
    ObserverFrame,
    disturbance_model,
)
from piezoid.design.plant import Plant
from piezoid.numerics.polynomial import trim


def plant_from_fraction(
    label: str, B: ArrayLike, A: ArrayLike, *, sampling_rate_Hz: float, output_unit: str
) -> Plant:
    """Realise B(q^-1)/A(q^-1) in observer form; coefficients of B beyond deg A become taps.

    B  leading zeros are the delay, b_0 = 0        A  monic, degree >= 1
    """
    b, a = trim(B), trim(A)
    order = len(a) - 1
    matrix = np.zeros((order, order))
    matrix[:, 0] = -a[1:]
    matrix[:-1, 1:] = np.eye(order - 1)
    output = np.eye(order)[0]
    taps = np.zeros((order, max(len(b) - 1 - order, 0) + 1))
    first_taps = b[1 : order + 1]
    taps[: len(first_taps), 0] = first_taps
    for delay, value in enumerate(b[order + 1 :], start=1):
        taps[-1, delay] = value
    return Plant(
        label=label,
        sampling_rate_Hz=sampling_rate_Hz,
        output_unit=output_unit,
        state_matrix=matrix,
        input_taps=taps,
        output_vector=output,
        B=b,
        A=a,
    )


def place_observer(
    plant: Plant,
    *,
    feedback_poles: ArrayLike,
    observer_poles: ArrayLike,
    form: str = "affine",
    disturbance: DisturbanceModel | None = None,
) -> DisturbanceObserver:
    """Return the observer with these poles; see ``ObserverFrame.placed``."""
    model = disturbance or disturbance_model(plant.sampling_rate_Hz)
    frame = ObserverFrame(plant=plant, disturbance=model, form=form)
    return frame.placed(feedback_poles=feedback_poles, observer_poles=observer_poles)
