"""To and from python-control, for those who design with it; it need not be installed otherwise."""

from importlib import import_module
from typing import Any

import numpy as np

from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.operators.linear import DiscreteSystem


def to_control(dynamics: LinearDynamics, sampling_rate_Hz: float) -> Any:
    """Return a discrete ``control.StateSpace``, exact behind a zero-order hold, delay included.

    Discrete only: a continuous state space has no pure delay.
    """
    plain = dynamics.sampled(sampling_rate_Hz)
    return import_module("control").ss(plain.A, plain.B, plain.C, plain.D, plain.interval_s)


def from_control(system: Any) -> DiscreteSystem:
    """Return plain A, B, C, D and the interval of a discrete system of python-control.

    system  a state space, or a transfer function, which ``control.ss`` then realises

    A system without a sampling interval is refused: 0, None and True mean continuous time or an
    interval nobody knows.
    """
    interval_s = system.dt
    if interval_s is None or interval_s is True or not interval_s > 0:
        raise ValueError(f"dt is {interval_s!r}: give a discrete system with its interval in s")
    state_space = system if hasattr(system, "A") else import_module("control").ss(system)
    A, B, C, D = (np.atleast_2d(getattr(state_space, name)) for name in "ABCD")
    return DiscreteSystem(A=A, B=B, C=C, D=D, interval_s=float(interval_s))
