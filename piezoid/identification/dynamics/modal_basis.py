"""Modal form: structure, order of the parameters, and columns at measured lines."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.operators.linear import ContinuousSystem, butterworth, sampled_fractions

Hold = Literal["band_limited", "zero_order"]


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Numbers of terms of the modal form.

        G(s) = e^(-s tau) F(s) [ sum_m g_m w_m^2 / (s^2 + 2 zeta_m w_m s + w_m^2)
                                 + sum_l g_l w_l / (s + w_l) + D ]

    modes   resonances (f, zeta); zeta > 1 is allowed
    lags    first-order poles
    direct  whether there is a term D for dynamics above the band
    """

    modes: int
    lags: int = 0
    direct: bool = False

    def __post_init__(self) -> None:
        if self.modes < 0 or self.lags < 0 or self.modes + self.lags == 0:
            raise ValueError(f"a structure needs at least one mode or lag, found {self}")

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
class ModalBasis:
    """Columns of the modal form at measured lines, which the gains multiply.

    structure         of the model
    frequency_Hz      (lines,)
    sampling_rate_Hz  of converter and sensor
    declaration       hold and declared filters between drive and sensor
    creep_from_Hz     frequency at which the slow part (f / from)^power e^(j phase), a factor of
                      all columns, has gain one; None: no slow part

    A shape is log frequencies of modes, log dampings, log frequencies of lags, delay; then power
    and phase of the slow part.
    """

    structure: Structure
    frequency_Hz: Array
    sampling_rate_Hz: float
    declaration: Declaration
    creep_from_Hz: float | None = None

    @property
    def shapes(self) -> int:
        """Number of shape parameters, including the slow part."""
        return self.structure.shapes + (0 if self.creep_from_Hz is None else 2)

    def columns(self, shape: Array) -> ComplexArray:
        """Return all columns, (lines, columns)."""
        values = np.empty((len(self.frequency_Hz), self.structure.columns), dtype=np.complex128)
        for column, parameters in enumerate(self._terms()):
            values[:, column] = self._term(shape[None], parameters)[0]
        return values * self._creep(shape)[:, None]

    def derivatives(self, shape: Array, step: float) -> ComplexArray:
        """Return derivatives by each shape parameter, (shapes, lines, columns).

        Central differences of width ``step``; of power and phase exact.
        """
        n, delay = len(shape), self.structure.shapes - 1
        derivatives = np.zeros(
            (n, len(self.frequency_Hz), self.structure.columns), dtype=np.complex128
        )
        for column, parameters in enumerate(self._terms()):
            indices = [*parameters, delay]
            steps = np.zeros((len(indices), n))
            steps[range(len(indices)), indices] = step
            steps[-1, delay] /= self.sampling_rate_Hz
            shapes = np.concatenate([shape + steps, shape - steps])
            shapes[:, delay] = np.maximum(shapes[:, delay], 0.0)  # one-sided at delay zero
            width = (shapes[: len(steps)] - shapes[len(steps) :]).sum(axis=1)
            up, down = np.split(self._term(shapes, parameters), 2)
            derivatives[indices, :, column] = (up - down) / width[:, None]
        derivatives *= self._creep(shape)[:, None]
        if self.creep_from_Hz is not None:
            columns = self.columns(shape)
            derivatives[-2] = np.log(self.frequency_Hz / self.creep_from_Hz)[:, None] * columns
            derivatives[-1] = 1j * columns
        return derivatives

    def _creep(self, shape: Array) -> ComplexArray:
        if self.creep_from_Hz is None:
            return np.ones(len(self.frequency_Hz), dtype=np.complex128)
        power, phase = shape[-2:]
        gain = (self.frequency_Hz / self.creep_from_Hz) ** power
        return np.asarray(gain * np.exp(1j * phase))

    def _terms(self) -> list[list[int]]:
        """Return the indices of the shape parameters of each column, without the delay."""
        n, lags = self.structure.modes, self.structure.lags
        modes = [[m, n + m] for m in range(n)]
        return [*modes, *([2 * n + k] for k in range(lags)), *([[]] * self.structure.direct)]

    def _term(self, shapes: Array, parameters: list[int]) -> ComplexArray:
        """Return the column of one term for several shapes, (shapes, lines)."""
        values, delay_s = np.exp(shapes[:, parameters]), shapes[:, self.structure.shapes - 1]
        w = 2.0 * np.pi * values[:, 0] if parameters else np.ones(len(shapes))
        numerator, pole = np.ones(len(shapes)), np.zeros((len(shapes), 0), dtype=complex)
        if len(parameters) == 2:
            damping = values[:, 1]
            root = np.sqrt(damping**2 - 1.0 + 0j)
            numerator, pole = w**2, (w * np.array([-damping + root, -damping - root])).T
        elif parameters:
            numerator, pole = w, -w[:, None].astype(complex)
        if self.declaration.hold == "zero_order":
            poles = self._declared_poles
            numerator = numerator * np.prod(-poles).real
            pole = np.hstack([pole, np.broadcast_to(poles, (len(shapes), len(poles)))])
            return sampled_fractions(
                numerator, pole, delay_s, self.sampling_rate_Hz, self.frequency_Hz
            )
        s = 2j * np.pi * self.frequency_Hz
        factor = self._declared_response * np.exp(-s * delay_s[:, None])
        for pole_of_shape in pole.T:
            factor /= s - pole_of_shape[:, None]
        return np.asarray(numerator[:, None] * factor)

    @cached_property
    def _declared_poles(self) -> ComplexArray:
        poles = [np.linalg.eigvals(f.system().A).astype(complex) for f in self.declaration.filters]
        return np.concatenate([np.zeros(0, dtype=complex), *poles])

    @cached_property
    def _declared_response(self) -> ComplexArray:
        return self.declaration.response(self.frequency_Hz, self.sampling_rate_Hz)
