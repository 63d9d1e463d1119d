"""LinearDynamics: modes, lags and delay of a stage, with what is known about each of them."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from piezoid.identification.dynamics.frequency_response import ComplexArray
from piezoid.identification.dynamics.modal_basis import Filter, Hold
from piezoid.numerics.arrays import Array, expect_shapes, freeze
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.linear import ContinuousSystem, DiscreteSystem, cascade, fraction, sample


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearDynamics:
    """A parametric model in continuous time, common to all its paths but for the gains.

        G(s) = e^(-s delay) F(s) [ sum_m (g_m + h_m s) w_m^2 / (s^2 + 2 zeta_m w_m s + w_m^2)
                                   + sum_l g_l w_l / (s + w_l) + D ],   w = 2 pi f

    inputs, outputs   names of the axes
    mode_frequency_Hz (modes,)                  undamped frequency of each mode, increasing
    mode_damping      (modes,)                  zeta; above one a mode is two real poles
    mode_gain_m_per_V (modes, outputs, inputs)  g: its share of the static gain
    mode_rate_gain_m_s_per_V (modes, outputs, inputs)  h; zero where modes are in phase
    lag_frequency_Hz  (lags,)
    lag_gain_m_per_V  (lags, outputs, inputs)
    direct_gain_m_per_V (outputs, inputs)       D: what lies above the measured band
    delay_s           >= 0
    declared          F: known filters of the chain, not fitted
    shape_covariance  (shapes, shapes)          of log frequencies, log dampings, log lags, delay
    static_gain_std_m_per_V (outputs, inputs)   one standard deviation of the gain at rest
    hold              how the drive of the data was to be understood
    sampling_rate_Hz  of the data
    band_Hz           lowest and highest frequency that was fitted
    drive_rms_V       (inputs,)                 level of the data
    cost              weighted sum of squared residuals
    expected_cost     what it would be if the model were true and the variances right
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    mode_frequency_Hz: Array
    mode_damping: Array
    mode_gain_m_per_V: Array
    mode_rate_gain_m_s_per_V: Array
    lag_frequency_Hz: Array
    lag_gain_m_per_V: Array
    direct_gain_m_per_V: Array
    delay_s: float
    declared: tuple[Filter, ...]
    shape_covariance: Array
    static_gain_std_m_per_V: Array
    hold: Hold
    sampling_rate_Hz: float
    band_Hz: tuple[float, float]
    drive_rms_V: Array
    cost: float
    expected_cost: float

    def __post_init__(self) -> None:
        for name, ndim in _ARRAYS:
            freeze(self, name, ndim=ndim)
        paths = (len(self.outputs), len(self.inputs))
        modes, lags = len(self.mode_frequency_Hz), len(self.lag_frequency_Hz)
        expected = {
            "mode_damping": (modes,),
            "mode_gain_m_per_V": (modes, *paths),
            "mode_rate_gain_m_s_per_V": (modes, *paths),
            "lag_gain_m_per_V": (lags, *paths),
            "direct_gain_m_per_V": paths,
            "static_gain_std_m_per_V": paths,
            "shape_covariance": (2 * modes + lags + 1,) * 2,
        }
        expect_shapes(self, expected)
        positive = (*self.mode_frequency_Hz, *self.mode_damping, *self.lag_frequency_Hz)
        if min(positive) <= 0 or not self.delay_s >= 0:
            raise ValueError("frequencies and dampings must be > 0, delay_s >= 0")

    @property
    def static_gain_m_per_V(self) -> Array:
        """Gain at rest, (outputs, inputs), m/V."""
        modes, lags = self.mode_gain_m_per_V.sum(axis=0), self.lag_gain_m_per_V.sum(axis=0)
        return np.asarray(modes + lags + self.direct_gain_m_per_V)

    @property
    def cost_ratio(self) -> float:
        """Cost over its expected value: near one, nothing linear is left to be modelled."""
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

        Terms outside the band take what the delay does not.
        """
        half = NORMAL_95 * np.sqrt(self.shape_covariance[-1, -1])
        return np.maximum([self.delay_s - half, self.delay_s + half], 0.0)

    def _interval(self, values: Array, first: int) -> Array:
        """Intervals that are symmetric in the logarithm, as the fit is."""
        variance = np.diag(self.shape_covariance)[first : first + len(values)]
        factor = np.exp(np.minimum(NORMAL_95 * np.sqrt(variance), 300.0))  # that is: not known
        return np.stack([values / factor, values * factor], axis=1)

    def response(self, frequency_Hz: ArrayLike) -> ComplexArray:
        """Return the continuous frequency response, (lines, outputs, inputs), m/V."""
        s = 2j * np.pi * np.asarray(frequency_Hz, dtype=np.float64)[:, None]
        w = 2 * np.pi * self.mode_frequency_Hz
        poles = w**2 / (s**2 + 2 * self.mode_damping * w * s + w**2)
        lags = 2 * np.pi * self.lag_frequency_Hz
        inner = (
            np.tensordot(poles, self.mode_gain_m_per_V, 1)
            + np.tensordot(s * poles, self.mode_rate_gain_m_s_per_V, 1)
            + np.tensordot(lags / (s + lags), self.lag_gain_m_per_V, 1)
            + self.direct_gain_m_per_V
        )
        chain = np.exp(-s * self.delay_s)
        for known in self.declared:
            chain = chain * known.system().response(s.imag[:, 0] / (2 * np.pi))[:, 0]
        return np.asarray(chain[:, :, None] * inner)

    def response_as_measured(self, frequency_Hz: ArrayLike) -> ComplexArray:
        """Return the response as the data saw it: behind its hold."""
        if self.hold == "band_limited":
            return self.response(frequency_Hz)
        return self.sampled(self.sampling_rate_Hz).response(frequency_Hz)

    def realised(self) -> ContinuousSystem:
        """Return A, B, C, D in continuous time with the delay beside them.

        A mode whose gains have rank r takes 2 r states.
        """
        parts = [
            mode_states(w, zeta, g, h)
            for w, zeta, g, h in zip(
                2 * np.pi * self.mode_frequency_Hz,
                self.mode_damping,
                self.mode_gain_m_per_V,
                self.mode_rate_gain_m_s_per_V,
                strict=True,
            )
        ]
        parts += [
            lag_states(w, g)
            for w, g in zip(2 * np.pi * self.lag_frequency_Hz, self.lag_gain_m_per_V, strict=True)
        ]
        inner = ContinuousSystem(
            A=block_diag(*[A for A, _, _ in parts]),
            B=np.concatenate([B for _, B, _ in parts]),
            C=np.concatenate([C for _, _, C in parts], axis=1),
            D=self.direct_gain_m_per_V,
            delay_s=self.delay_s,
        )
        chain = [for_each(known.system(), len(self.inputs)) for known in self.declared]
        return cascade(*chain, inner)

    def sampled(self, sampling_rate_Hz: float) -> DiscreteSystem:
        """Return plain A, B, C, D and the interval: exact behind a zero-order hold."""
        return sample(self.realised(), sampling_rate_Hz)

    def path(self, output: str, drive: str) -> "LinearDynamics":
        """Return the dynamics from one input to one output."""
        i, j = self.outputs.index(output), self.inputs.index(drive)
        return replace(
            self,
            inputs=(drive,),
            outputs=(output,),
            mode_gain_m_per_V=self.mode_gain_m_per_V[:, i : i + 1, j : j + 1],
            mode_rate_gain_m_s_per_V=self.mode_rate_gain_m_s_per_V[:, i : i + 1, j : j + 1],
            lag_gain_m_per_V=self.lag_gain_m_per_V[:, i : i + 1, j : j + 1],
            direct_gain_m_per_V=self.direct_gain_m_per_V[i : i + 1, j : j + 1],
            static_gain_std_m_per_V=self.static_gain_std_m_per_V[i : i + 1, j : j + 1],
            drive_rms_V=self.drive_rms_V[j : j + 1],
        )

    def polynomials(self, sampling_rate_Hz: float) -> tuple[Array, Array]:
        """Return B and A in q^-1 of a single path behind a zero-order hold, for the RST design.

        A[0] = 1; the delay stands in B as leading zeros.
        """
        if (len(self.outputs), len(self.inputs)) != (1, 1):
            raise ValueError(f"{len(self.outputs)} x {len(self.inputs)} paths; needed one")
        return fraction(self.realised(), sampling_rate_Hz)

    def to_json(self) -> dict[str, Any]:
        """Return plain lists and numbers that come back exactly."""
        record: dict[str, Any] = dict(vars(self))
        for name, _ in _ARRAYS:
            record[name] = record[name].tolist()
        for name in ("inputs", "outputs", "band_Hz"):
            record[name] = list(record[name])
        record["declared"] = [dict(vars(known)) for known in self.declared]
        return record

    @staticmethod
    def from_json(record: dict[str, Any]) -> "LinearDynamics":
        """Return the record that ``to_json`` wrote."""
        paths = (len(record["outputs"]), len(record["inputs"]))
        changed: dict[str, Any] = {
            name: np.reshape(record[name], (-1, *paths))
            for name in ("mode_gain_m_per_V", "mode_rate_gain_m_s_per_V", "lag_gain_m_per_V")
        }
        changed["inputs"], changed["outputs"] = tuple(record["inputs"]), tuple(record["outputs"])
        lowest_Hz, highest_Hz = record["band_Hz"]
        changed["band_Hz"] = (float(lowest_Hz), float(highest_Hz))
        changed["declared"] = tuple(Filter(**known) for known in record["declared"])
        return LinearDynamics(**{**record, **changed})


_ARRAYS = (
    ("mode_frequency_Hz", 1),
    ("mode_damping", 1),
    ("mode_gain_m_per_V", 3),
    ("mode_rate_gain_m_s_per_V", 3),
    ("lag_frequency_Hz", 1),
    ("lag_gain_m_per_V", 3),
    ("direct_gain_m_per_V", 2),
    ("shape_covariance", 2),
    ("static_gain_std_m_per_V", 2),
    ("drive_rms_V", 1),
)


def mode_states(w: float, zeta: float, g: Array, h: Array) -> tuple[Array, Array, Array]:
    """Return A, B, C of one mode: two states for each independent combination of its inputs.

    w     scalar             rad/s
    zeta  scalar
    g, h  (outputs, inputs)  its gain, and its gain for the rate
    """
    both = np.concatenate([g, h * w])
    left, strength, right = np.linalg.svd(both, full_matrices=False)
    rank = max(int((strength > 1e-13 * strength[0]).sum()), 1)
    shape = left[:, :rank] * strength[:rank]
    single = np.array([[0.0, w], [-w, -2 * zeta * w]])
    drive = np.array([[0.0], [w]])
    outputs = len(g)
    return (
        np.kron(np.eye(rank), single),
        np.kron(np.eye(rank), drive) @ right[:rank],
        np.stack([shape[:outputs], shape[outputs:]], axis=2).reshape(outputs, 2 * rank),
    )


def lag_states(w: float, g: Array) -> tuple[Array, Array, Array]:
    """Return A, B, C of one first-order pole: a state for each input."""
    inputs = g.shape[1]
    return -w * np.eye(inputs), w * np.eye(inputs), g


def for_each(system: ContinuousSystem, inputs: int) -> ContinuousSystem:
    """Return the same filter in every input."""
    each = np.eye(inputs)
    A, B, C, D = (np.kron(each, getattr(system, name)) for name in "ABCD")
    return ContinuousSystem(A=A, B=B, C=C, D=D)
