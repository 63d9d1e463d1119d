"""Interface of an effect: physics added to the signal chain, scaled to a known size.

The chain has places at which acts change the signal. An effect receives its size and the signals
of the healthy stage (``Bench``), and returns its change and physical parameters.

Size is the change an effect makes to the *noise-free displacement reading*, in the recording of
the campaign where that change is largest: its rms over that recording, or, for effects that act
on few samples, its peak.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import NamedTuple

import numpy as np

from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.truth import Ceramic

HALVINGS = 14  # of the logarithm of the range; a range of 1e4 is then known to 0.1 %


class Place(IntEnum):
    """Places of acts in the signal chain, in its order, with their signals."""

    HISTORY = 0  # fields at the turning points before the recording (turns,)
    AMPLIFIER = 1  # input of the amplifier times its gain, before its bandwidth, V
    OUTPUT = 2  # output of the amplifier, V
    IRREVERSIBLE = 3  # irreversible strain, 0 to 1
    CERAMIC = 4  # displacement of the ceramic, m
    MECHANICS = 5  # displacement of the stage, m
    SENSOR = 6  # reading before it is sampled, m
    CONVERTER = 7  # sampled reading, with noise, m
    RECORD = 8  # rows of the file, m; an act may remove rows


class Measure(StrEnum):
    """Definition of the size of an effect by the change that it causes."""

    RMS = "rms"
    PEAK = "peak"

    def of(self, change_m: Array) -> float:
        """Return the size of a change."""
        if self is Measure.PEAK:
            return float(np.max(np.abs(change_m), initial=0.0))
        return float(np.sqrt(np.mean(change_m**2)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Information for an act: the rig, the clock, and earlier signals of the chain.

    rate_Hz, time_s   of the signal of the act (finer than the recording before sampling)
    record_rate_Hz    of the rows
    order             index of the recording in the campaign, from 0
    rest_s            duration of the rest before the recording
    field             (samples,)  -1 to 1 over the drive range; available from IRREVERSIBLE on
    others_V          amplifier volts of other axes, with the length of ``time_s``
    """

    rig: Rig
    ceramic: Ceramic
    rate_Hz: float
    time_s: Array
    record_rate_Hz: float
    order: int
    rest_s: float
    field: Array
    others_V: Mapping[str, Array]


Change = Callable[[Array, Scene, np.random.Generator], Array]


@dataclass(frozen=True, kw_only=True)
class Act:
    """One change of one signal; ``name`` seeds its random generator in every recording."""

    name: str
    place: Place
    change: Change


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """Signals of one recording on the healthy stage, on the fine time grid of the chain.

    history         (turns,)  fields at the turning points before the recording
    amplifier_V     (fine,)  delivered to the ceramic
    irreversible    (fine,)  part of the strain
    displacement_m  (fine,)  of the stage
    """

    scene: Scene
    history: Array
    amplifier_V: Array
    irreversible: Array
    displacement_m: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Bench:
    """The campaign without effects, by which an effect is scaled."""

    rig: Rig
    ceramic: Ceramic
    traces: tuple[Trace, ...]


class Fault(NamedTuple):
    """Change of one signal by an effect, and its physical parameters with units in their names."""

    place: Place
    change: Change
    numbers: Mapping[str, float | str]


Install = Callable[[float, Bench, np.random.Generator], Fault]


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One effect.

    name             in truth.json and on the command line
    measure          definition of its size
    visible_percent  size from which a person can see it in a figure, in percent of the stroke
    shown_by         names of the plans that excite it; a campaign with it contains one of them
    install          (size_m, bench, rng) -> Fault
    """

    name: str
    measure: Measure
    visible_percent: float
    shown_by: tuple[str, ...]
    install: Install


def effect(
    visible_percent: float, *, shown_by: tuple[str, ...], measure: Measure = Measure.RMS
) -> Callable[[Install], Effect]:
    """Return a decorator that makes an effect of the function that installs it."""

    def decorate(install: Install) -> Effect:
        return Effect(
            name=install.__name__,
            measure=measure,
            visible_percent=visible_percent,
            shown_by=shown_by,
            install=install,
        )

    return decorate


def largest_rms(changes: Iterable[Array]) -> float:
    """Return the largest rms of the changes in the recordings of a campaign."""
    return max((Measure.RMS.of(change) for change in changes), default=0.0)


def proportional(size_m: float, unit: Iterable[Array], *, why: str) -> float:
    """Return the factor that scales changes of unit strength to an rms.

    why  reason in the error message if no recording changes
    """
    reached_m = largest_rms(unit)
    if not reached_m > 0.0:
        raise ValueError(f"the campaign cannot show this effect: {why}")
    return size_m / reached_m


def bisected(
    size_m: float,
    traces: Sequence[Trace],
    change: Callable[[Trace, float], Array],
    strengths: tuple[float, float],
) -> float:
    """Return the strength for which the largest rms change of a recording equals a size.

    change     (trace, strength) -> change of the displacement, increasing with the strength
    strengths  physical range of the strength; its nearer end is returned if no strength fits
    """
    weak, strong = strengths
    for _ in range(HALVINGS):
        middle = math.sqrt(weak * strong)
        if largest_rms(change(trace, middle) for trace in traces) < size_m:
            weak = middle
        else:
            strong = middle
    return math.sqrt(weak * strong)
