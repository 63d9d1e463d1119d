"""Modal form of the linear dynamics of an axis: structure, fitted values, records of fits."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from piezoid.numerics.arrays import Array, ComplexArray, expect_shapes, freeze
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.linear import (
    ContinuousSystem,
    DiscreteSystem,
    butterworth,
    cascade,
    first_order,
    resonance,
    sample,
)

Hold = Literal["band_limited", "zero_order"]


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Numbers of terms of the modal form.

        G(s) = e^(-s tau) F(s) [ sum_m g_m w_m^2 / (s^2 + 2 zeta_m w_m s + w_m^2)
                                 + sum_l g_l w_l / (s + w_l) + D ]

    modes   resonances (f, zeta); zeta > 1 is allowed
    lags    first-order poles, at most one
    direct  whether there is a term D for dynamics above the band
    """

    modes: int
    lags: int = 0
    direct: bool = False

    def __post_init__(self) -> None:
        if self.modes < 0 or self.lags not in {0, 1} or self.modes + self.lags == 0:
            raise ValueError(
                f"a structure needs a mode or a lag, and at most one lag, found {self}"
            )

    @property
    def columns(self) -> int:
        """Number of gains: modes, lags, direct term."""
        return self.modes + self.lags + self.direct

    @property
    def shapes(self) -> int:
        """Number of other parameters: frequencies, dampings, lags, delay."""
        return 2 * self.modes + self.lags + 1


@dataclass(frozen=True, kw_only=True)
class Filter:
    """Declared filter of the signal chain: a Butterworth low-pass of unit gain at rest.

    name          ``amplifier``, ``sensor``, ...
    frequency_Hz  > 0, at which the gain has fallen by 3 dB
    order         1 for a single pole
    """

    name: str
    frequency_Hz: float
    order: int = 1

    def system(self) -> ContinuousSystem:
        """Return the filter as a linear system."""
        return butterworth(self.order, self.frequency_Hz)


def filters_of(**poles_Hz: float | None) -> tuple[Filter, ...]:
    """Return a first-order filter for every declared pole, by name; None: not declared."""
    return tuple(
        Filter(name=name, frequency_Hz=f) for name, f in poles_Hz.items() if f is not None
    )


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """Declared hold and filters of the chain, which are not fitted.

    hold              ``zero_order`` if the drive column contains the values sent to the converter,
                      ``band_limited`` if it was measured through a filter
    filters           amplifier, sensor, anti-alias filter
    longest_delay_s   longest delay tried as a start; None: four samples
    """

    hold: Hold = "zero_order"
    filters: tuple[Filter, ...] = ()
    longest_delay_s: float | None = None

    def response(self, frequency_Hz: Array, sampling_rate_Hz: float) -> ComplexArray:
        """Return the response of the declared chain, (lines,); a hold averages over its sample."""
        chain = np.ones(len(frequency_Hz), dtype=np.complex128)
        if self.hold == "zero_order":
            turn = frequency_Hz / sampling_rate_Hz
            chain *= np.sinc(turn) * np.exp(-1j * np.pi * turn)
        for low_pass in self.filters:
            chain *= low_pass.system().response(frequency_Hz)[:, 0, 0]
        return chain


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearDynamics:
    """Linear dynamics of one axis in continuous time.

        G(s) = e^(-s delay) F(s) [ sum_m g_m w_m^2 / (s^2 + 2 zeta_m w_m s + w_m^2)
                                   + sum_l g_l w_l / (s + w_l) + D ],   w = 2 pi f

    axis
    mode_frequency_Hz   (modes,)  undamped frequency of each mode, increasing
    mode_damping        (modes,)  zeta; above one a mode is two real poles
    mode_gain_m_per_V   (modes,)  g: share of the static gain
    lag_frequency_Hz    (lags,)
    lag_gain_m_per_V    (lags,)
    direct_gain_m_per_V  D: dynamics above the measured band
    delay_s             >= 0
    declared            F: declared filters of the chain, not fitted
    shape_covariance    (shapes, shapes)  of log frequencies, log dampings, log lags, delay
    static_gain_std_m_per_V  one standard deviation of the gain at rest
    hold                ``zero_order`` or ``band_limited``: drive between its samples
    sampling_rate_Hz    of the data
    band_Hz             lowest and highest fitted frequency
    drive_rms_V         level of the data
    cost                weighted sum of squared residuals
    expected_cost       expected cost of a true model with correct variances
    """

    axis: str
    mode_frequency_Hz: Array
    mode_damping: Array
    mode_gain_m_per_V: Array
    lag_frequency_Hz: Array
    lag_gain_m_per_V: Array
    direct_gain_m_per_V: float
    delay_s: float
    declared: tuple[Filter, ...]
    shape_covariance: Array
    static_gain_std_m_per_V: float
    hold: Hold
    sampling_rate_Hz: float
    band_Hz: tuple[float, float]
    drive_rms_V: float
    cost: float
    expected_cost: float

    def __post_init__(self) -> None:
        freeze(self, "mode_frequency_Hz", "mode_damping", "mode_gain_m_per_V")
        freeze(self, "lag_frequency_Hz", "lag_gain_m_per_V")
        freeze(self, "shape_covariance", ndim=2)
        modes, lags = len(self.mode_frequency_Hz), len(self.lag_frequency_Hz)
        expected = {
            "mode_damping": (modes,),
            "mode_gain_m_per_V": (modes,),
            "lag_gain_m_per_V": (lags,),
            "shape_covariance": (2 * modes + lags + 1,) * 2,
        }
        expect_shapes(self, expected)
        positive = (*self.mode_frequency_Hz, *self.mode_damping, *self.lag_frequency_Hz)
        if min(positive) <= 0 or not self.delay_s >= 0:
            raise ValueError("frequencies and dampings must be > 0, delay_s >= 0")

    @property
    def structure(self) -> Structure:
        """Numbers of terms."""
        return Structure(
            modes=len(self.mode_frequency_Hz),
            lags=len(self.lag_frequency_Hz),
            direct=self.direct_gain_m_per_V != 0.0,
        )

    @property
    def shape(self) -> Array:
        """Log frequencies, log dampings, log lags and delay, as in the covariance, (shapes,)."""
        positive = (self.mode_frequency_Hz, self.mode_damping, self.lag_frequency_Hz)
        return np.append(np.log(np.concatenate(positive)), self.delay_s)

    @property
    def static_gain_m_per_V(self) -> float:
        """Gain at rest, m/V."""
        parts = self.mode_gain_m_per_V.sum() + self.lag_gain_m_per_V.sum()
        return float(parts + self.direct_gain_m_per_V)

    @property
    def cost_ratio(self) -> float:
        """Cost over its expected value: near one if no dynamics are missing."""
        return self.cost / self.expected_cost

    def mode_frequency_interval_Hz(self) -> Array:
        """Return the 95 % intervals of the mode frequencies, (modes, 2), Hz."""
        return self._interval(self.mode_frequency_Hz, 0)

    def mode_damping_interval(self) -> Array:
        """Return the 95 % intervals of the dampings, (modes, 2)."""
        return self._interval(self.mode_damping, len(self.mode_frequency_Hz))

    def lag_frequency_interval_Hz(self) -> Array:
        """Return the 95 % intervals of the lags' frequencies, (lags, 2), Hz."""
        return self._interval(self.lag_frequency_Hz, 2 * len(self.mode_frequency_Hz))

    def delay_interval_s(self) -> Array:
        """Return the 95 % interval of the delay, (2,), s, for this structure.

        Terms outside the band can replace a part of the delay.
        """
        half = NORMAL_95 * np.sqrt(self.shape_covariance[-1, -1])
        return np.maximum([self.delay_s - half, self.delay_s + half], 0.0)

    def _interval(self, values: Array, first: int) -> Array:
        """Return 95 % intervals that are symmetric in the logarithm."""
        variance = np.diag(self.shape_covariance)[first : first + len(values)]
        factor = np.exp(np.minimum(NORMAL_95 * np.sqrt(variance), 300.0))  # avoids overflow
        return np.stack([values / factor, values * factor], axis=1)

    def response(self, frequency_Hz: ArrayLike) -> ComplexArray:
        """Return the continuous frequency response, (lines,), m/V."""
        return self.realised().response(frequency_Hz)[:, 0, 0]

    def response_as_measured(self, frequency_Hz: ArrayLike) -> ComplexArray:
        """Return the response including the hold of the data, (lines,), m/V."""
        if self.hold == "band_limited":
            return self.response(frequency_Hz)
        return self.sampled(self.sampling_rate_Hz).response(frequency_Hz)[:, 0, 0]

    def realised(self) -> ContinuousSystem:
        """Return A, B, C, D in continuous time, and the delay."""
        modes = zip(self.mode_frequency_Hz, self.mode_damping, strict=True)
        terms = [resonance(float(f), float(zeta)) for f, zeta in modes]
        terms += [first_order(float(f)) for f in self.lag_frequency_Hz]
        gains = [*self.mode_gain_m_per_V, *self.lag_gain_m_per_V]
        inner = ContinuousSystem(
            A=block_diag(*[term.A for term in terms]),
            B=np.concatenate([term.B for term in terms]),
            C=np.hstack([gain * term.C for gain, term in zip(gains, terms, strict=True)]),
            D=np.full((1, 1), self.direct_gain_m_per_V),
            delay_s=self.delay_s,
        )
        return cascade(*(low_pass.system() for low_pass in self.declared), inner)

    def sampled(self, sampling_rate_Hz: float) -> DiscreteSystem:
        """Return A, B, C, D and the interval, exact behind a zero-order hold."""
        return sample(self.realised(), sampling_rate_Hz)

    def to_json(self) -> dict[str, Any]:
        """Return lists and numbers from which ``from_json`` restores the record exactly.

        The format allows several inputs and outputs, and modes out of phase.
        """
        entries: dict[str, Any] = dict(vars(self))
        for name in ("mode_frequency_Hz", "mode_damping", "lag_frequency_Hz", "shape_covariance"):
            entries[name] = entries[name].tolist()
        for name in ("mode_gain_m_per_V", "lag_gain_m_per_V"):
            entries[name] = entries[name].reshape(-1, 1, 1).tolist()
        for name in ("direct_gain_m_per_V", "static_gain_std_m_per_V"):
            entries[name] = [[entries[name]]]
        axis = entries.pop("axis")
        return entries | {
            "inputs": [axis],
            "outputs": [axis],
            "mode_rate_gain_m_s_per_V": [[[0.0]]] * len(self.mode_gain_m_per_V),
            "band_Hz": list(self.band_Hz),
            "drive_rms_V": [self.drive_rms_V],
            "declared": [dict(vars(low_pass)) for low_pass in self.declared],
        }

    @staticmethod
    def from_json(record: dict[str, Any]) -> "LinearDynamics":
        """Return the record written by ``to_json``."""
        entries = {**record, "axis": record["outputs"][0]}
        for name in ("inputs", "outputs", "mode_rate_gain_m_s_per_V"):
            del entries[name]
        for name in ("mode_gain_m_per_V", "lag_gain_m_per_V"):
            entries[name] = np.ravel(entries[name])
        for name in ("direct_gain_m_per_V", "static_gain_std_m_per_V", "drive_rms_V"):
            entries[name] = float(np.ravel(entries[name])[0])
        low_Hz, high_Hz = entries["band_Hz"]
        entries["band_Hz"] = (float(low_Hz), float(high_Hz))
        entries["declared"] = tuple(Filter(**low_pass) for low_pass in entries["declared"])
        return LinearDynamics(**entries)


# Creep of 1 to 5 % per decade is 0.1 to 0.4 dB, loops of 15 % lag by 9 degrees: far below.
MAX_SLOPE_dB = 3.0
MAX_LAG_deg = 30.0


@dataclass(frozen=True, kw_only=True)
class SlowPart:
    """Creep and hysteresis in a frequency response, at all frequencies.

        G_slow(f) = (f / from_Hz)^(slope / 20 dB) e^(j phase)

    Creep makes the gain fall with frequency; creep and hysteresis make the phase lag by the same
    angle at every frequency. A pole or a filter does neither.

    slope_dB, slope_ci95   of the gain, dB per decade
    phase_deg, phase_ci95  without delay and modes
    low_Hz, high_Hz        range of the fitted lines, far below the first mode
    from_Hz                frequency of the first mode, at which the gain of the slow part is 1
    is_taken               whether it may be creep and hysteresis, and was fitted with the modes
    """

    slope_dB: float
    slope_ci95: tuple[float, float]
    phase_deg: float
    phase_ci95: tuple[float, float]
    low_Hz: float
    high_Hz: float
    from_Hz: float
    is_taken: bool

    @staticmethod
    def of(
        slope_dB: Array, phase_deg: Array, band_Hz: tuple[float, float], from_Hz: float
    ) -> "SlowPart":
        """Return the slow part of a slope and a phase, not yet taken.

        slope_dB, phase_deg  (2,)  value and standard deviation
        """
        intervals = [
            (float(value - NORMAL_95 * std), float(value + NORMAL_95 * std))
            for value, std in (slope_dB, phase_deg)
        ]
        return SlowPart(
            slope_dB=float(slope_dB[0]),
            slope_ci95=intervals[0],
            phase_deg=float(phase_deg[0]),
            phase_ci95=intervals[1],
            low_Hz=band_Hz[0],
            high_Hz=band_Hz[1],
            from_Hz=from_Hz,
            is_taken=False,
        )

    @property
    def falls(self) -> bool:
        """Whether the gain falls significantly, as with creep."""
        return self.is_taken and self.slope_ci95[1] < 0.0

    def response(self, frequency_Hz: Array) -> ComplexArray:
        """Return the response of the slow part, (lines,); 1 if it is not taken."""
        if not self.is_taken:
            return np.ones(len(frequency_Hz), dtype=np.complex128)
        gain = (frequency_Hz / self.from_Hz) ** (self.slope_dB / 20.0)
        return np.asarray(gain * np.exp(1j * np.radians(self.phase_deg)))


@dataclass(frozen=True, kw_only=True)
class ResponseFit:
    """Record of a fit of dynamics to a measured frequency response.

    name            of the file
    lines, used     number of lines in the file, and of coherent lines without interference
    left_out_Hz     coherent lines that were left out as interference
    gain_m_per_V    of the modes of the model at rest
    gain_ratio      that gain over the middle of the slopes of the hysteresis
    factor          from the response in the file to that of the model: negative if the sign is
                    opposite to the polarity of the axis, not +-1 if a recording determines the
                    gain
    noise_relative  standard deviation of one line far below the first mode, over the gain
    left_relative   largest residual of the model, over the larger of the gain at that line and the
                    gain at rest
    left_Hz         frequency of that residual
    slow            None: too few lines far below the first mode
    """

    name: str
    lines: int
    used: int
    left_out_Hz: tuple[float, ...]
    gain_m_per_V: float
    gain_ratio: float
    factor: float
    noise_relative: float
    left_relative: float
    left_Hz: float
    slow: SlowPart | None


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """Record of a joint fit of operator and dynamics; the axis contains the dynamics.

    recordings            names, one for every segment
    play_threshold_V      (plays,)  of the operator, and smaller ones for the exciting drive
    play_weight_m_per_V   (plays,)
    dead_zone_weight      (zones,)  at the operator's thresholds
    separate_rms_m        residual of separate fits of operator and dynamics, for each segment
    joint_rms_m           residual of the joint fit, for each segment
    """

    recordings: tuple[str, ...]
    play_threshold_V: tuple[float, ...]
    play_weight_m_per_V: tuple[float, ...]
    dead_zone_weight: tuple[float, ...]
    separate_rms_m: tuple[float, ...]
    joint_rms_m: tuple[float, ...]
