"""The contract of an effect: physics put into the signal chain, at a known size.

The chain knows places, not effects. An effect is told how large it shall be seen, looks at what
the healthy bench does (``Bench``), and answers with the acts that do it and the physical numbers
it chose.

Size is the change an effect makes to the *noise-free displacement reading*, in the recording of
the campaign where that change is largest: its rms over that recording, or, for effects that act
on few samples, its peak.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum, StrEnum

import numpy as np

from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.truth import Ceramic


class Place(IntEnum):
    """Where in the chain an act sits, upstream first; and the signal it is given."""

    HISTORY = 0  # fields of the turns before the record (turns,)
    AMPLIFIER = 1  # volts asked of the amplifier, before its bandwidth
    OUTPUT = 2  # volts it delivers
    IRREVERSIBLE = 3  # irreversible strain, 0 to 1
    CERAMIC = 4  # displacement of the ceramic, m
    MECHANICS = 5  # displacement of the stage, m
    SENSOR = 6  # reading before it is sampled, m
    CONVERTER = 7  # sampled reading, with noise, m
    RECORD = 8  # rows of the file, m; may become fewer


class Measure(StrEnum):
    """How the size of an effect is read from the change it makes."""

    RMS = "rms"
    PEAK = "peak"

    def of(self, change_m: Array) -> float:
        """Return the size of a change."""
        if self is Measure.PEAK:
            return float(np.max(np.abs(change_m), initial=0.0))
        return float(np.sqrt(np.mean(change_m**2)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """What an act may look at: the bench, the clock, and the chain upstream of it.

    rate_Hz, time_s   of the signal the act is given (finer than the record before sampling)
    record_rate_Hz    of the rows
    order             which recording of the campaign this is, from 0
    rest_s            how long the stage stood still before the record
    field             (samples,)  -1 to 1 over the drive range; known from IRREVERSIBLE on
    others_V          amplifier volts of other axes, same length as ``time_s``
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
    """One change of one signal; ``name`` keys the generator it gets in every recording."""

    name: str
    place: Place
    change: Change


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """What one recording looks like on the healthy bench, on the fine clock of the chain.

    history         (turns,)  fields at which the drive turned before the record
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
    """The healthy campaign: what an effect scales itself by."""

    rig: Rig
    ceramic: Ceramic
    traces: tuple[Trace, ...]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """An effect made concrete: its acts, and the numbers it chose, with units in their names."""

    acts: tuple[Act, ...]
    numbers: Mapping[str, float | str]


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One effect.

    name             as in DESIGN's table, truth.json and on the command line
    measure          how its size is read
    visible_percent  of the stroke: the size from which a person can find it in a picture
    shown_by         names of the plans that excite it; a campaign that has it plays one of them
    install          (size_m, bench, rng) -> Fault
    """

    name: str
    measure: Measure
    visible_percent: float
    shown_by: tuple[str, ...]
    install: Callable[[float, Bench, np.random.Generator], Fault]
