"""Convert the linear part of an axis to scipy.signal and python-control."""

from typing import TYPE_CHECKING, Any

import numpy as np

from piezoid.errors import IdentificationError
from piezoid.formatting import with_unit
from piezoid.identification.loop_model import loop_model
from piezoid.identification.model import AxisModel
from piezoid.operators.linear import ContinuousSystem, DiscreteSystem, cascade, sample

if TYPE_CHECKING:
    from scipy.signal import StateSpace

_CONTINUOUS_RATE_Hz = 1e9  # for continuous time: much faster than any pole


def linear_part(axis: AxisModel, sampling_rate_Hz: float | None) -> ContinuousSystem:
    """Return the linear system between drive and reading, V to m, with its delay.

        G(s) = polarity (m + M) / 2 front(s) behind(s) slow(s) sensor(s) e^(-s delay)

    m and M are the bounds of the slope of the hysteresis; their mean replaces the hysteresis.
    """
    loop = loop_model(axis, sampling_rate_Hz or _CONTINUOUS_RATE_Hz)
    gain = axis.polarity * 0.5 * sum(axis.operator.slope_sector_m_per_V) * loop.gain
    chain = cascade(loop.front, loop.behind, loop.slow, loop.sensor)
    return ContinuousSystem(
        A=chain.A, B=chain.B, C=gain * chain.C, D=gain * chain.D, delay_s=loop.delay_s
    )


def to_scipy(axis: AxisModel, sampling_rate_Hz: float | None) -> "StateSpace":
    """Return the linear part as ``scipy.signal.StateSpace``, discrete if a rate is passed."""
    from scipy.signal import StateSpace

    system = _system(axis, sampling_rate_Hz)
    matrices = (system.A, system.B, system.C, system.D)
    if isinstance(system, DiscreteSystem):
        return StateSpace(*map(np.array, matrices), dt=system.interval_s)
    return StateSpace(*map(np.array, matrices))


def to_control(axis: AxisModel, sampling_rate_Hz: float | None) -> Any:
    """Return the linear part as ``control.StateSpace``."""
    system = _system(axis, sampling_rate_Hz)
    interval_s = system.interval_s if isinstance(system, DiscreteSystem) else 0
    return control().ss(system.A, system.B, system.C, system.D, interval_s)


def control() -> Any:
    """Import python-control, or explain how to install it."""
    try:
        import control as package
    except ImportError as error:
        raise IdentificationError(
            "python-control is not installed",
            needed="the package control, which is optional",
            remedy="Install it with: pip install control. Or use to_scipy().",
        ) from error
    return package


def _system(axis: AxisModel, sampling_rate_Hz: float | None) -> ContinuousSystem | DiscreteSystem:
    system = linear_part(axis, sampling_rate_Hz)
    if sampling_rate_Hz is not None:
        if not 0.0 < sampling_rate_Hz < np.inf:
            raise IdentificationError(
                f"axis {axis.axis}: a sampling rate of {sampling_rate_Hz} Hz",
                needed="a rate above 0 Hz",
                remedy="Pass the rate of the controller.",
            )
        return sample(system, sampling_rate_Hz)
    if system.delay_s > 0.0:
        raise IdentificationError(
            f"axis {axis.axis}: its linear part has a delay of "
            f"{with_unit(system.delay_s, 's', 4)}",
            needed="a sampling rate: in continuous time a delay has no system of finite order",
            remedy="Pass sampling_rate_Hz; states then represent the delay.",
        )
    return system
