"""The modal form: which columns a structure has, and their values at measured lines."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from piezoid.identification.dynamics.frequency_response import ComplexArray
from piezoid.numerics.arrays import Array
from piezoid.operators.linear import ContinuousSystem, butterworth, sampled_fractions

Hold = Literal["band_limited", "zero_order"]


@dataclass(frozen=True, kw_only=True)
class Structure:
    """How many terms of each kind the model has.

        G(s) = e^(-s tau) F(s) [ sum_m (g_m + h_m s) w_m^2 / (s^2 + 2 zeta_m w_m s + w_m^2)
                                 + sum_l g_l w_l / (s + w_l) + D ]

    modes       resonances, with (f, zeta) of their own; zeta > 1 is allowed
    lags        first-order poles
    rate_gains  whether modes have an h: needed where damping is not proportional
    direct      whether D stands for everything above the band
    """

    modes: int
    lags: int = 0
    rate_gains: bool = False
    direct: bool = False

    def __post_init__(self) -> None:
        if self.modes < 0 or self.lags < 0 or self.modes + self.lags == 0:
            raise ValueError(f"a structure needs at least one mode or lag, found {self}")

    @property
    def columns(self) -> int:
        """Gains of one path: modes, their rate gains, lags, direct term."""
        return self.modes * (1 + self.rate_gains) + self.lags + self.direct

    @property
    def shapes(self) -> int:
        """Parameters all paths share: frequencies, dampings, lags, delay."""
        return 2 * self.modes + self.lags + 1

    def static_columns(self) -> Array:
        """Return 1 where a column counts at frequency zero, else 0, (columns,)."""
        counts = [self.modes, self.modes * self.rate_gains, self.lags + self.direct]
        return np.repeat([1.0, 0.0, 1.0], counts)


@dataclass(frozen=True, kw_only=True)
class Filter:
    """A declared part of the signal chain: a Butterworth low-pass of unit gain at rest.

    name          ``amplifier``, ``sensor``, ...
    frequency_Hz  > 0, where it has fallen by 3 dB
    order         1 for a plain pole
    """

    name: str
    frequency_Hz: float
    order: int = 1

    def system(self) -> ContinuousSystem:
        """Return it as a linear system."""
        return butterworth(self.order, self.frequency_Hz)


@dataclass(frozen=True, kw_only=True, eq=False)
class Lines:
    """Where and how the response is looked at.

    frequency_Hz      (lines,)
    sampling_rate_Hz  of converter and sensor
    hold              ``zero_order``: the drive is the number sent to the converter;
                      ``band_limited``: it was measured, and has no power above half the rate
    declared          filters between drive and sensor
    """

    frequency_Hz: Array
    sampling_rate_Hz: float
    hold: Hold
    declared: tuple[Filter, ...] = ()

    def look_at(self, numerator: Array, pole: ComplexArray, delay_s: Array) -> ComplexArray:
        """Return responses behind the declared chain, (systems, lines, outputs).

        numerator, pole, delay_s  as for ``sampled_fractions``
        """
        f = self.frequency_Hz
        if self.hold == "zero_order":
            before = np.broadcast_to(self._before, (len(pole), len(self._before)))
            numerator, pole = numerator * np.prod(-self._before).real, np.hstack([pole, before])
            return sampled_fractions(numerator, pole, delay_s, self.sampling_rate_Hz, f)
        s = 2j * np.pi * f
        powers = s[:, None] ** np.arange(numerator.shape[2])
        factor = self._chain * np.exp(-s * delay_s[:, None])
        factor /= np.prod(s[:, None] - pole[:, None], axis=2)
        return np.asarray(powers @ np.swapaxes(numerator, 1, 2) * factor[:, :, None])

    @cached_property
    def _before(self) -> ComplexArray:
        """The poles of the declared filters, the same for every shape."""
        poles = [np.linalg.eigvals(f.system().A).astype(complex) for f in self.declared]
        return np.concatenate([np.zeros(0, dtype=complex), *poles])

    @cached_property
    def _chain(self) -> ComplexArray:
        """Response of the declared filters, the same for every shape."""
        chain = np.ones(len(self.frequency_Hz), dtype=np.complex128)
        for known in self.declared:
            chain = chain * known.system().response(self.frequency_Hz)[:, 0, 0]
        return np.asarray(chain)


@dataclass(frozen=True, kw_only=True)
class Term:
    """One mode, lag or direct term: which shape parameters it has, which columns it fills."""

    kind: Literal["mode", "lag", "direct"]
    parameters: tuple[int, ...]
    columns: tuple[int, ...]


def terms_of(structure: Structure) -> tuple[Term, ...]:
    """Return the terms of a structure; the delay, last of the shape, belongs to all of them."""
    n, lags = structure.modes, structure.lags
    lag_column = n * (1 + structure.rate_gains)
    found = [
        Term(
            kind="mode",
            parameters=(m, n + m),
            columns=(m, n + m) if structure.rate_gains else (m,),
        )
        for m in range(n)
    ]
    found += [
        Term(kind="lag", parameters=(2 * n + k,), columns=(lag_column + k,)) for k in range(lags)
    ]
    if structure.direct:
        found.append(Term(kind="direct", parameters=(), columns=(structure.columns - 1,)))
    return tuple(found)


def term_columns(lines: Lines, term: Term, shapes: Array) -> ComplexArray:
    """Return the values of one term's columns, (shapes, lines, columns of the term).

    shapes  (shapes, numbers)  log frequency of modes, log damping, log frequency of lags, delay

    A mode's columns are those of its gain g and of h w.
    """
    numerator, pole = _FRACTIONS[term.kind](np.exp(shapes[:, list(term.parameters)]))
    return lines.look_at(numerator[:, : len(term.columns)], pole, shapes[:, -1])


def basis(lines: Lines, structure: Structure, shape: Array) -> ComplexArray:
    """Return all columns in the order of ``Structure.columns``, (lines, columns)."""
    found = np.empty((len(lines.frequency_Hz), structure.columns), dtype=np.complex128)
    for term in terms_of(structure):
        found[:, list(term.columns)] = term_columns(lines, term, shape[None])[0]
    return found


def _mode(parameters: Array) -> tuple[Array, ComplexArray]:
    """Return w^2 and s w over s^2 + 2 zeta w s + w^2."""
    w, damping = 2.0 * np.pi * parameters[:, 0], parameters[:, 1]
    half = np.sqrt(damping**2 - 1.0 + 0j)
    pole = (w * np.array([-damping + half, -damping - half])).T
    none = np.zeros(len(w))
    return np.moveaxis(np.array([[w**2, none], [none, w]]), 2, 0), pole


def _lag(parameters: Array) -> tuple[Array, ComplexArray]:
    w = 2.0 * np.pi * parameters
    return w[:, :, None], -w.astype(complex)


def _direct(parameters: Array) -> tuple[Array, ComplexArray]:
    return np.ones((len(parameters), 1, 1)), np.zeros((len(parameters), 0), dtype=complex)


_FRACTIONS = {"mode": _mode, "lag": _lag, "direct": _direct}
