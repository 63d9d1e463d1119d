"""The modal form: which columns a structure has, and their values at measured lines."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from piezoid.identification.dynamics.frequency_response import ComplexArray
from piezoid.numerics.arrays import Array
from piezoid.operators.linear import (
    ContinuousSystem,
    butterworth,
    cascade,
    first_order,
    resonance,
    sampled_response,
)

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

    def look_at(self, system: ContinuousSystem) -> ComplexArray:
        """Return the response of a system of one input behind the declared chain."""
        if self.hold == "zero_order":
            whole = system if self._before is None else cascade(self._before, system)
            return sampled_response(whole, self.sampling_rate_Hz, self.frequency_Hz)[:, :, 0]
        return system.response(self.frequency_Hz)[:, :, 0] * self._chain[:, None]

    @cached_property
    def _before(self) -> ContinuousSystem | None:
        """The declared filters one after the other, the same for every shape."""
        return cascade(*[f.system() for f in self.declared]) if self.declared else None

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


def term_columns(lines: Lines, term: Term, shape: Array) -> ComplexArray:
    """Return the values of one term's columns, (lines, columns of the term).

    shape  (shapes,)  log frequency of modes, log damping, log frequency of lags, delay

    A mode's columns are those of its gain g and of h w.
    """
    inner = _SYSTEMS[term.kind](np.exp(shape[list(term.parameters)]))
    late = ContinuousSystem(A=inner.A, B=inner.B, C=inner.C, D=inner.D, delay_s=float(shape[-1]))
    return lines.look_at(late)[:, : len(term.columns)]


def basis(lines: Lines, structure: Structure, shape: Array) -> ComplexArray:
    """Return all columns in the order of ``Structure.columns``, (lines, columns)."""
    found = np.empty((len(lines.frequency_Hz), structure.columns), dtype=np.complex128)
    for term in terms_of(structure):
        found[:, list(term.columns)] = term_columns(lines, term, shape)
    return found


def _mode(parameters: Array) -> ContinuousSystem:
    frequency_Hz, damping = parameters
    both = resonance(float(frequency_Hz), float(damping))
    return ContinuousSystem(A=both.A, B=both.B, C=np.eye(2), D=np.zeros((2, 1)))


def _lag(parameters: Array) -> ContinuousSystem:
    return first_order(float(parameters[0]))


def _direct(_: Array) -> ContinuousSystem:
    none = np.zeros((0, 0))
    return ContinuousSystem(A=none, B=np.zeros((0, 1)), C=np.zeros((1, 0)), D=np.ones((1, 1)))


_SYSTEMS = {"mode": _mode, "lag": _lag, "direct": _direct}
