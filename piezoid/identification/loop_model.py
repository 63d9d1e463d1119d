"""Linear model of an axis for control loops, scipy.signal and python-control.

    u -> clip, slew -> front -> hysteresis -> behind -> slow -> position, + motion -> sensor

Design and verification share it. It contains the lag, the dynamics and all extensions of the axis
model.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import IdentificationError
from piezoid.formatting import with_unit
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.extensions.extension import LoopEffect
from piezoid.identification.extensions.linear_mode import LinearMode, mode_spread
from piezoid.identification.model import AxisModel, Lag
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.linear import (
    ContinuousSystem,
    DiscreteSystem,
    cascade,
    first_order,
    sample,
)

if TYPE_CHECKING:
    from scipy.signal import StateSpace

DECLARED_SPREAD = 0.1  # a data sheet states a round bandwidth of a typical specimen
INSTANTANEOUS = 5.7  # sampling rates: exp(-2 pi f / fs) of such a pole is below float64's last bit
MIN_MODE_SHARE = 0.5  # of the static gain: modes with less are not in series with the motion
MAX_SLOW_LAG = 0.1  # of the lowest mode's frequency
SAME_MODE = 0.1  # relative difference of frequencies below which two modes are the same
_CONTINUOUS_RATE_Hz = 1e9  # for continuous time: much faster than any pole
_MIN_LAG = 0.1  # of a lag whose interval contains zero: a pole needs a time constant


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopModel:
    """Linear dynamics between a drive and its reading, in series with the hysteresis.

    front       in front of the hysteresis; static gain 1
    behind      fast dynamics behind the hysteresis; static gain 1
    slow        creep, behind the fast dynamics; instantaneous gain 1, output is the position
    sensor      from the position to the reading; static gain 1
    delay_s     s, total
    effects     loop effects of all extensions
    quick_gain  gain of a small fast drive over the middle slope of the hysteresis
    """

    front: ContinuousSystem
    behind: ContinuousSystem
    slow: ContinuousSystem
    sensor: ContinuousSystem
    delay_s: float
    effects: tuple[LoopEffect, ...]
    quick_gain: float = 1.0

    @property
    def gain(self) -> float:
        """Factor of the displacement after the recordings."""
        return float(np.prod([effect.gain for effect in self.effects]))

    @property
    def slow_gain(self) -> float:
        """Displacement after all creep over the instantaneous displacement."""
        return rest_gain(self.slow)

    @property
    def drive_range_V(self) -> tuple[float, float]:
        """Range of the drive that reaches the ceramic."""
        lows = [effect.low_V for effect in self.effects]
        highs = [effect.high_V for effect in self.effects]
        return max(lows, default=-np.inf), min(highs, default=np.inf)

    @property
    def slew_V_per_s(self) -> float:
        """Largest slew rate of the drive that reaches the ceramic."""
        return min((effect.slew_V_per_s for effect in self.effects), default=np.inf)

    @property
    def activation(self) -> tuple[float, float]:
        """Time constant and strain of the irreversible part, s and m; 0 without a delay."""
        delayed = [e for e in self.effects if e.activation_s > 0.0]
        return (delayed[0].activation_s, delayed[0].activation_m) if delayed else (0.0, 0.0)


def loop_model(axis: AxisModel, rate_Hz: float) -> LoopModel:
    """Return the linear model of an axis for a loop of this sampling rate.

    Identified dynamics replace lag, amplifier and fast extensions, which acted in the data of
    their fit. They were measured with a small fast drive: their gain relative to the middle of the
    slope sector is ``quick_gain``. Only modes at other frequencies than theirs are added.
    """
    front, quick_gain, dynamics = through(), 1.0, axis.dynamics
    effects = tuple(extension.loop_effect(rate_Hz) for extension in axis.extensions)
    slow_systems = [e.system for e in effects if e.system is not None and e.is_slow]
    if dynamics is None:
        fast_systems = [e.system for e in effects if e.system is not None and not e.is_slow]
        front = _pole(axis.rig.amplifier_bandwidth_Hz, rate_Hz)
        behind, lag = cascade(through(), *fast_systems), axis.lag
        if lag.kind == "first_order" and lag.time_s > 0.0:
            behind = cascade(behind, first_order(1.0 / (2.0 * np.pi * lag.time_s)))
        delay_s = lag.time_s if lag.kind == "delay" else 0.0
        delay_s += sum(effect.dead_time_s for effect in effects)
    else:
        # In a linear fit a lag far below the modes represents hysteresis, and often lies below the
        # measured band: it is omitted.
        middle_m_per_V = axis.operator.middle_slope_m_per_V
        is_slow = _is_slow_lag(dynamics, middle_m_per_V)
        is_kept = np.ones(len(dynamics.shape_covariance), dtype=np.bool_)
        is_kept[-1 - len(is_slow) : -1] = ~is_slow
        fast = replace(
            dynamics,
            lag_frequency_Hz=dynamics.lag_frequency_Hz[~is_slow],
            lag_gain_m_per_V=dynamics.lag_gain_m_per_V[~is_slow],
            shape_covariance=dynamics.shape_covariance[np.ix_(is_kept, is_kept)],
            declared=tuple(
                filter_
                for filter_ in dynamics.declared
                if filter_.name != "sensor" and filter_.frequency_Hz <= INSTANTANEOUS * rate_Hz
            ),
        )
        other_modes = [
            mode
            for extension in axis.extensions
            if isinstance(extension, LinearMode)
            and not (
                np.abs(np.log(dynamics.mode_frequency_Hz / extension.frequency_Hz)) < SAME_MODE
            ).any()
            and (mode := extension.loop_effect(rate_Hz).system) is not None
        ]
        system, gain, delay_s = fast.realised(), fast.static_gain_m_per_V, fast.delay_s
        scaled = replace(system, C=system.C / gain, D=system.D / gain, delay_s=0.0)
        behind, quick_gain = cascade(scaled, *other_modes), abs(gain) / middle_m_per_V
    return LoopModel(
        front=front,
        behind=behind,
        slow=cascade(through(), *slow_systems),
        sensor=_pole(axis.rig.sensor_bandwidth_Hz, rate_Hz),
        delay_s=delay_s,
        effects=effects,
        quick_gain=quick_gain,
    )


def at_corner(axis: AxisModel, slower: float, sharper: float) -> AxisModel:
    """Return the axis at an end of its intervals, for a family of plants.

    slower   +1: longest delays and lags within the 95 % intervals; -1: shortest
    sharper  +1: least damping of modes within the 95 % intervals; -1: most

    Declared poles are known to a tenth. Without a fitted lag, the upper end of its interval
    becomes a delay.
    """
    spread = 1.0 + slower * DECLARED_SPREAD
    poles = (axis.rig.amplifier_bandwidth_Hz, axis.rig.sensor_bandwidth_Hz)
    amplifier_Hz, sensor_Hz = (None if f is None else f / spread for f in poles)
    lag_s = axis.lag.time_s + slower * lag_half_s(axis)
    kind, min_lag_s = axis.lag.kind, 0.0
    if kind == "none":
        kind = "delay"
    elif kind == "first_order":
        min_lag_s = _MIN_LAG * axis.lag.time_s
    dynamics = axis.dynamics
    if dynamics is not None:
        spreads = np.array(_mode_spreads(dynamics)).reshape(-1, 2)
        lag_Hz = dynamics.lag_frequency_Hz
        if len(lag_Hz):
            high = dynamics.lag_frequency_interval_Hz()[:, 1] / lag_Hz
            corner_Hz = lag_Hz / np.maximum(high, 1.0 + DECLARED_SPREAD) ** slower
            # Of a slow lag, which ``loop_model`` omits, the interval may contain the modes.
            is_slow = _is_slow_lag(dynamics, axis.operator.middle_slope_m_per_V)
            lag_Hz = np.where(is_slow, lag_Hz, corner_Hz)
        low_s, high_s = dynamics.delay_interval_s()
        half_s = max(float(high_s - low_s) / 2.0, DECLARED_SPREAD * dynamics.delay_s)
        dynamics = replace(
            dynamics,
            mode_frequency_Hz=dynamics.mode_frequency_Hz * (1.0 - slower * spreads[:, 0]),
            mode_damping=dynamics.mode_damping / spreads[:, 1] ** sharper,
            lag_frequency_Hz=lag_Hz,
            delay_s=max(dynamics.delay_s + slower * half_s, 0.0),
            declared=tuple(
                replace(declared, frequency_Hz=declared.frequency_Hz / spread)
                for declared in dynamics.declared
            ),
        )
    return replace(
        axis,
        rig=replace(axis.rig, amplifier_bandwidth_Hz=amplifier_Hz, sensor_bandwidth_Hz=sensor_Hz),
        lag=Lag(kind=kind, time_s=max(lag_s, min_lag_s)),
        extensions=tuple(e.at_corner(slower, sharper) for e in axis.extensions),
        dynamics=dynamics,
    )


def lag_half_s(axis: AxisModel) -> float:
    """Return half the 95 % interval of the lag."""
    return float(NORMAL_95 * axis.uncertainty.standard_error("lag_s"))


def mode_half(axis: AxisModel) -> float:
    """Return the widest 95 % half interval of a mode frequency, in half widths of the mode.

    Above 1 the responses at the ends of the interval do not bound those within it.
    """
    half_widths = [0.0]
    for extension in axis.extensions:
        if isinstance(extension, LinearMode):
            f, quality = extension.frequency_Hz, extension.quality
            half_widths.append(mode_spread(f, quality, extension.std)[0] * 2.0 * quality)
    if axis.dynamics is not None:
        spreads = _mode_spreads(axis.dynamics)
        for (half, _), damping in zip(spreads, axis.dynamics.mode_damping, strict=True):
            half_widths.append(half / float(damping))
    return max(half_widths)


def rest_gain(system: ContinuousSystem) -> float:
    """Return the static gain of a system."""
    if not len(system.A):
        return float(system.D[0, 0])
    return float((system.D - system.C @ np.linalg.solve(system.A, system.B))[0, 0])


def through() -> ContinuousSystem:
    """Return the identity system."""
    none = np.zeros((0, 0))
    return ContinuousSystem(A=none, B=np.zeros((0, 1)), C=np.zeros((1, 0)), D=np.ones((1, 1)))


def _pole(frequency_Hz: float | None, rate_Hz: float) -> ContinuousSystem:
    """Return a declared pole, or the identity if it is undeclared or instantaneous."""
    if frequency_Hz is None or frequency_Hz > INSTANTANEOUS * rate_Hz:
        return through()
    return first_order(frequency_Hz)


def _is_slow_lag(path: LinearDynamics, middle_m_per_V: float) -> NDArray[np.bool_]:
    """Return for each lag whether it is far below the modes, if these have most of the motion.

    The motion is computed from the hysteresis: the static gain of the linear dynamics is
    extrapolated below their band, where a lag can change it arbitrarily.
    """
    mode_share = abs(float(path.mode_gain_m_per_V.sum())) / middle_m_per_V
    if not len(path.mode_frequency_Hz) or mode_share < MIN_MODE_SHARE:
        return np.zeros(len(path.lag_frequency_Hz), dtype=np.bool_)
    return np.asarray(path.lag_frequency_Hz < MAX_SLOW_LAG * path.mode_frequency_Hz.min())


def _mode_spreads(dynamics: LinearDynamics) -> list[tuple[float, float]]:
    """Return ``mode_spread`` of every mode."""
    modes = len(dynamics.mode_frequency_Hz)
    std = np.sqrt(np.diag(dynamics.shape_covariance))
    return [
        mode_spread(1.0, 1.0, (float(std[k]), float(std[modes + k])))  # of the logarithms
        for k in range(modes)
    ]


def linear_part(axis: AxisModel, sampling_rate_Hz: float | None) -> ContinuousSystem:
    """Return the linear system between drive and reading, V to m, with its delay.

        G(s) = polarity (m + M) / 2 front(s) behind(s) slow(s) sensor(s) e^(-s delay)

    m and M are the bounds of the slope of the hysteresis; their mean replaces the hysteresis.
    """
    loop = loop_model(axis, sampling_rate_Hz or _CONTINUOUS_RATE_Hz)
    gain = axis.polarity * axis.operator.middle_slope_m_per_V * loop.gain
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
