"""FrequencyResponseRecord: measured response at each frequency, path by path."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import (
    Array,
    ComplexArray,
    frozen,
    frozen_complex,
    strictly_increasing,
)
from piezoid.statement import Statement

CHAIN = ("amplifier", "sensor")
MIN_LINES = 3
MIN_COHERENCE = 0.8


@dataclass(frozen=True, kw_only=True, eq=False)
class ResponsePath:
    """The response of one axis to the drive of one axis.

    output, drive      names of the axes
    response_m_per_V   (lines,)  complex, never zero
    coherence          (lines,)  magnitude squared, 0 to 1; None if it was not measured
    """

    output: str
    drive: str
    response_m_per_V: ComplexArray
    coherence: Array | None = None

    def __post_init__(self) -> None:
        response = frozen_complex(self.response_m_per_V, "response_m_per_V", ndim=1)
        object.__setattr__(self, "response_m_per_V", response)
        if not response.all():
            raise ValueError(f"response_m_per_V[{int(np.argmin(np.abs(response)))}] is zero")
        if self.coherence is None:
            return
        coherence = frozen(self.coherence, "coherence")
        object.__setattr__(self, "coherence", coherence)
        if len(coherence) != len(response) or coherence.min() < 0.0 or coherence.max() > 1.0:
            raise ValueError(
                f"coherence has {len(coherence)} values from {coherence.min():g} to "
                f"{coherence.max():g}, expected {len(response)} from 0 to 1"
            )

    @property
    def is_self_response(self) -> bool:
        """Whether output and drive belong to the same axis."""
        return self.output == self.drive

    @property
    def is_coherent(self) -> NDArray[np.bool_]:
        """Whether the coherence of each line is sufficient, (lines,)."""
        if self.coherence is None:
            return np.ones(len(self.response_m_per_V), dtype=np.bool_)
        return np.asarray(self.coherence >= MIN_COHERENCE)


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyResponseRecord:
    """One file of a network analyser, a lock-in or a controller's frequency sweep.

    name, digest    of the file
    frequency_Hz    (lines,)  > 0, increasing
    paths           no two of the same output and drive
    axis_is_named   whether the file or lab.toml names the axis; otherwise it is x
    includes        poles of the rig within the measured response, of ``CHAIN``
    statements      problems of the file
    """

    name: str
    digest: str
    frequency_Hz: Array
    paths: tuple[ResponsePath, ...]
    axis_is_named: bool = True
    includes: tuple[str, ...] = CHAIN
    statements: tuple[Statement, ...] = ()

    def __post_init__(self) -> None:
        frequency_Hz = frozen(self.frequency_Hz, "frequency_Hz")
        object.__setattr__(self, "frequency_Hz", frequency_Hz)
        strictly_increasing(frequency_Hz, "frequency_Hz")
        lines = len(frequency_Hz)
        if lines < MIN_LINES or not frequency_Hz[0] > 0.0:
            raise ValueError(
                f"frequency_Hz has {lines} values from {frequency_Hz[:1]} on, expected "
                f"{MIN_LINES} or more above zero"
            )
        pairs = [(path.output, path.drive) for path in self.paths]
        if not pairs or len(set(pairs)) < len(pairs):
            raise ValueError(f"paths are {pairs}, expected at least one, each once")
        for path in self.paths:
            if (path_lines := len(path.response_m_per_V)) != lines:
                raise ValueError(
                    f"{path.output}{path.drive} has {path_lines} lines, expected {lines}"
                )
        if unknown := set(self.includes) - set(CHAIN):
            raise ValueError(f"includes names {sorted(unknown)}, expected some of {CHAIN}")

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes with a measured response to their own drive."""
        return tuple(path.output for path in self.paths if path.is_self_response)

    def renamed(self, axis: str) -> "FrequencyResponseRecord":
        """Return the record of a single axis under another name of the axis."""
        paths = tuple(replace(path, output=axis, drive=axis) for path in self.paths)
        return replace(self, paths=paths, axis_is_named=True)

    def path(self, output: str, drive: str) -> ResponsePath | None:
        """Return one path, or None if it was not measured."""
        matches = [p for p in self.paths if (p.output, p.drive) == (output, drive)]
        return matches[0] if matches else None
