"""What a search found of one effect, and what its numbers mean on the recordings.

A search speaks in half ranges of the drive and half strokes; the model's extensions are in SI.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from piezoid.identification.extensions.extension import Where
from piezoid.identification.joint.vector import parts_of
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """One effect as a search left it.

    effect       its name
    parameters   nonlinear ones, by name with unit; drives in half ranges
    coefficient  (columns,)  linear ones
    from_jumps   whether jumps of the drive have shown it
    """

    effect: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    coefficient: Array = field(default_factory=lambda: np.ones(1))
    from_jumps: bool = False

    @property
    def share(self) -> float:
        """Return the first coefficient, 1 where there is none."""
        return float(self.coefficient[0]) if len(self.coefficient) else 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Setting:
    """What the numbers of a search mean, and the pieces they were found on.

    voltage_V         half the range of the drive: what 1 means
    voltage_offset_V  its middle: what 0 means
    stroke_m          half the stroke
    pieces            in the order of the search's tracks
    recordings        names, in the order in which they were made
    """

    voltage_V: float
    voltage_offset_V: float
    stroke_m: float
    pieces: tuple[Where, ...]
    recordings: tuple[str, ...]

    @property
    def longest_s(self) -> float:
        """Return the duration of the longest piece."""
        return max(piece.samples / piece.rate_Hz for piece in self.pieces)


def setting_of(
    model: AxisModel, recordings: Sequence[Recording], scales: Mapping[str, float]
) -> Setting:
    """Return the setting of a search on these recordings.

    scales  ``voltage_V``, ``voltage_offset_V`` and ``stroke_m`` of the search's view
    """
    return Setting(
        voltage_V=scales["voltage_V"],
        voltage_offset_V=scales["voltage_offset_V"],
        stroke_m=scales["stroke_m"],
        pieces=tuple(part.where for part in parts_of(model, recordings)),
        recordings=tuple(recording.name for recording in recordings),
    )
