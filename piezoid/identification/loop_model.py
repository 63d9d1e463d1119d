"""Linear model of an axis for control loops, common to design and verification.

    u -> clip, slew -> front -> hysteresis -> behind -> slow -> position, + motion -> sensor

Whatever fit and diagnosis put into a model is in here, or in the hysteresis itself.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.extensions.linear_mode import LinearMode, mode_spread
from piezoid.identification.extensions.loop_effect import LoopEffect
from piezoid.identification.model import AxisModel, Lag
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.linear import ContinuousSystem, cascade, first_order

DECLARED_SPREAD = 0.1  # a data sheet's bandwidth is a round number for a typical specimen
INSTANTANEOUS = 5.7  # sampling rates: of such a pole exp(-2 pi f / fs) is below float64's last bit
CARRIES = 0.5  # of the gain at rest: a mode with less is not in series with the motion
FAR_BELOW = 0.1  # of the lowest mode's frequency
SAME_MODE = 0.1  # modes nearer than this part of their frequency are one
_LEAST_SHARE = 0.1  # of a lag whose interval reaches zero: a pole needs some time constant


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopModel:
    """Linear dynamics between a drive and its reading, in series with the hysteresis.

    front        in front of the hysteresis; gain 1 at rest
    behind       linear and quick, behind it; gain 1 at rest
    slow         creep, behind that; gain 1 at once: its output is the stage's position
    sensor       from the position to the reading; gain 1 at rest
    delay_s      s, of everything
    effects      of every extension, as a loop feels it
    quick_gain   by how much less a small quick drive may move it than the hysteresis says
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
        """Factor of the displacement, now."""
        return float(np.prod([effect.gain for effect in self.effects]))

    @property
    def slow_gain(self) -> float:
        """Displacement after all creep over that at once."""
        return rest_gain(self.slow)

    @property
    def drive_range_V(self) -> tuple[float, float]:
        """Ends of the drive that reach the ceramic."""
        lows = [effect.low_V for effect in self.effects]
        highs = [effect.high_V for effect in self.effects]
        return max(lows, default=-np.inf), min(highs, default=np.inf)

    @property
    def slew_V_per_s(self) -> float:
        """Fastest drive that reaches the ceramic."""
        return min((effect.slew_V_per_s for effect in self.effects), default=np.inf)

    @property
    def activation(self) -> tuple[float, float]:
        """Time constant and strain with which the irreversible part follows, s and m."""
        delayed = [e for e in self.effects if e.activation_s > 0.0]
        return (delayed[0].activation_s, delayed[0].activation_m) if delayed else (0.0, 0.0)


def loop_model(axis: AxisModel, rate_Hz: float) -> LoopModel:
    """Return an axis as a loop of this sampling rate feels it.

    Identified dynamics stand for everything linear that they were fitted to; of the extensions
    then only modes outside of what the dynamics know are added.
    """
    quick_gain = 1.0
    effects = tuple(extension.loop_effect(rate_Hz) for extension in axis.extensions)
    slow = [e.system for e in effects if e.system is not None and e.is_slow]
    if axis.dynamics is None:
        quick = [e.system for e in effects if e.system is not None and not e.is_slow]
        front = _pole(axis.rig.amplifier_bandwidth_Hz, rate_Hz)
        behind, lag = cascade(through(), *quick), axis.lag
        if lag.kind == "first_order" and lag.time_s > 0.0:
            behind = cascade(behind, first_order(1.0 / (2.0 * np.pi * lag.time_s)))
        delay_s = lag.time_s if lag.kind == "delay" else 0.0
        delay_s += sum(effect.dead_time_s for effect in effects)
    else:
        front = through()
        behind, delay_s, quick_gain = _of_dynamics(axis, axis.dynamics, rate_Hz)
    return LoopModel(
        front=front,
        behind=behind,
        slow=cascade(through(), *slow),
        sensor=_pole(axis.rig.sensor_bandwidth_Hz, rate_Hz),
        delay_s=delay_s,
        effects=effects,
        quick_gain=quick_gain,
    )


def at_corner(axis: AxisModel, slower: float, sharper: float) -> AxisModel:
    """Return the axis at an end of its intervals, for a family of plants.

    slower   +1: everything linear as late as its 95 % interval allows; -1: as early
    sharper  +1: modes as little damped as theirs allows; -1: as much

    Declared poles are known to a tenth. A lag that was fitted moves to the end of its interval;
    of one that was not the upper end becomes delay.
    """
    spread = 1.0 + slower * DECLARED_SPREAD
    poles = (axis.rig.amplifier_bandwidth_Hz, axis.rig.sensor_bandwidth_Hz)
    amplifier_Hz, sensor_Hz = (None if f is None else f / spread for f in poles)
    moved_s = axis.lag.time_s + slower * lag_half_s(axis)
    kind, least_s = axis.lag.kind, 0.0
    if kind == "none":
        kind = "delay"
    elif kind == "first_order":
        least_s = _LEAST_SHARE * axis.lag.time_s
    return replace(
        axis,
        rig=replace(axis.rig, amplifier_bandwidth_Hz=amplifier_Hz, sensor_bandwidth_Hz=sensor_Hz),
        lag=Lag(kind=kind, time_s=max(moved_s, least_s)),
        extensions=tuple(e.at_corner(slower, sharper) for e in axis.extensions),
        dynamics=None if axis.dynamics is None else _moved(axis, axis.dynamics, slower, sharper),
    )


def lag_half_s(axis: AxisModel) -> float:
    """Return half the 95 % interval of the lag."""
    index = axis.uncertainty.names.index("lag_s")
    return float(NORMAL_95 * np.sqrt(axis.uncertainty.covariance[index, index]))


def mode_half(axis: AxisModel) -> float:
    """Return the widest 95 % half interval of a mode frequency, in half widths of the mode.

    Above 1 the ends of the interval do not bound the responses between them.
    """
    half_widths = [0.0]
    for extension in axis.extensions:
        if isinstance(extension, LinearMode):
            f, quality = extension.frequency_Hz, extension.quality
            half_widths.append(mode_spread(f, quality, extension.std)[0] * 2.0 * quality)
    if axis.dynamics is not None:
        for (half, _), damping in zip(
            _mode_spreads(axis.dynamics), axis.dynamics.mode_damping, strict=True
        ):
            half_widths.append(half / float(damping))
    return max(half_widths)


def rest_gain(system: ContinuousSystem) -> float:
    """Return the gain at rest."""
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


def _of_dynamics(
    axis: AxisModel, dynamics: LinearDynamics, rate_Hz: float
) -> tuple[ContinuousSystem, float, float]:
    """Return identified dynamics in front of the sensor with unit static gain, delay and gain.

    A lag far below the mode that carries the motion is omitted: it is the image of hysteresis in a
    linear fit, and often lies below the measured band. The gain is that of the remaining dynamics,
    measured with a small fast drive, over the middle of the slope sector.
    """
    declared = tuple(
        filter_
        for filter_ in dynamics.declared
        if filter_.name != "sensor" and filter_.frequency_Hz <= INSTANTANEOUS * rate_Hz
    )
    path = replace(dynamics, declared=declared)
    middle = _middle_m_per_V(axis)
    is_slow = _is_slow_lag(path, middle)
    is_kept = np.ones(len(path.shape_covariance), dtype=np.bool_)
    is_kept[-1 - len(is_slow) : -1] = ~is_slow
    quick = replace(
        path,
        lag_frequency_Hz=path.lag_frequency_Hz[~is_slow],
        lag_gain_m_per_V=path.lag_gain_m_per_V[~is_slow],
        shape_covariance=path.shape_covariance[np.ix_(is_kept, is_kept)],
    )
    system_m_per_V = quick.realised()
    at_once = quick.static_gain_m_per_V
    scaled = replace(
        system_m_per_V, C=system_m_per_V.C / at_once, D=system_m_per_V.D / at_once, delay_s=0.0
    )
    further = [
        system
        for extension in axis.extensions
        if isinstance(extension, LinearMode)
        and not (
            np.abs(np.log(dynamics.mode_frequency_Hz / extension.frequency_Hz)) < SAME_MODE
        ).any()
        and (system := extension.loop_effect(rate_Hz).system) is not None
    ]
    return cascade(scaled, *further), system_m_per_V.delay_s, abs(at_once) / middle


def _middle_m_per_V(axis: AxisModel) -> float:
    """Return the middle of the slopes of the hysteresis."""
    return 0.5 * sum(axis.operator.slope_sector_m_per_V)


def _is_slow_lag(path: LinearDynamics, middle_m_per_V: float) -> NDArray[np.bool_]:
    """Tell which lags lie far below the modes, where these carry most of the motion.

    The motion is that of the hysteresis: the static gain of the linear dynamics is extrapolated
    below their band, where a lag can change it arbitrarily.
    """
    carried = abs(float(path.mode_gain_m_per_V.sum())) / middle_m_per_V
    if not len(path.mode_frequency_Hz) or carried < CARRIES:
        return np.zeros(len(path.lag_frequency_Hz), dtype=np.bool_)
    return np.asarray(path.lag_frequency_Hz < FAR_BELOW * path.mode_frequency_Hz.min())


def _mode_spreads(dynamics: LinearDynamics) -> list[tuple[float, float]]:
    """Return for every mode half its relative interval, and the factor of its quality."""
    modes = len(dynamics.mode_frequency_Hz)
    std = np.sqrt(np.diag(dynamics.shape_covariance))
    return [
        mode_spread(1.0, 1.0, (float(std[k]), float(std[modes + k])))  # of the logarithms
        for k in range(modes)
    ]


def _moved(
    axis: AxisModel, dynamics: LinearDynamics, slower: float, sharper: float
) -> LinearDynamics:
    """Return dynamics at an end of their intervals.

    An omitted slow lag does not change: the end of its wide interval may lie among the modes.
    """
    spreads = np.array(_mode_spreads(dynamics)).reshape(-1, 2)
    lag_Hz = dynamics.lag_frequency_Hz
    if len(lag_Hz):
        high = dynamics.lag_frequency_interval_Hz()[:, 1] / lag_Hz
        moved_Hz = lag_Hz / np.maximum(high, 1.0 + DECLARED_SPREAD) ** slower
        lag_Hz = np.where(_is_slow_lag(dynamics, _middle_m_per_V(axis)), lag_Hz, moved_Hz)
    early_s, late_s = dynamics.delay_interval_s()
    half_s = max(float(late_s - early_s) / 2.0, DECLARED_SPREAD * dynamics.delay_s)
    spread = 1.0 + slower * DECLARED_SPREAD
    return replace(
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
