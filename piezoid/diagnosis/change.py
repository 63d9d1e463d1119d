"""What changed since a model was fitted: the model as it was against new recordings.

Three simulations of the new recordings, judged on rows left out in the same way: the model as it
was, with only memory and zero of each recording fitted; the same with another sensitivity; and
everything refitted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.gain_change import GainChange
from piezoid.identification.extensions.mains_lines import MainsLines
from piezoid.identification.extensions.thermal_drift import ThermalDrift
from piezoid.identification.joint.fit_extended import Extended, fit_extended
from piezoid.identification.joint.vector import Structure
from piezoid.identification.model import AxisModel
from piezoid.readable import told
from piezoid.records.recording import Recording

AS_IT_WAS = Structure(operator=False)
QUANTILE = 2.8  # of Student's distribution for five folds
PASSING = (GainChange, MainsLines, ThermalDrift)  # what belongs to the recordings of then
WORTH = 0.05  # of the error: a change that takes off less is none


@dataclass(frozen=True, kw_only=True)
class Change:
    """How far a model still holds, rms on rows left out.

    axis            which one
    digest          of the model's file
    held_out_then_m when it was fitted, on the recordings of then
    as_it_was_m     on the new recordings, only memory and zero fitted
    other_gain_m    with another sensitivity as well
    refitted_m      with everything refitted
    gain_ratio      sensitivity now over then, with its 95 % interval
    """

    axis: str
    digest: str
    held_out_then_m: float
    as_it_was_m: float
    other_gain_m: float
    refitted_m: float
    gain_ratio: tuple[float, float, float]

    @property
    def sentence(self) -> str:
        """Return what changed in words."""
        ratio, low, high = self.gain_ratio
        percent = 100.0 * (ratio - 1.0)
        error = f"{told(self.as_it_was_m, 'm')}, {told(self.refitted_m, 'm')} refitted"
        if self.refitted_m > (1.0 - WORTH) * self.as_it_was_m:
            return f"axis {self.axis}: the model still holds; it leaves {error}"
        if self.other_gain_m < (1.0 - WORTH) * self.as_it_was_m and not low <= 1.0 <= high:
            reach = 50.0 * (high - low)
            return (
                f"axis {self.axis}: the stage moves {percent:+.2f} % (+- {reach:.2f} %) more than "
                f"when the model was fitted; the model leaves {error}"
            )
        return f"axis {self.axis}: more than the sensitivity changed; the model leaves {error}"

    def to_json(self) -> dict[str, Any]:
        """Return the content of ``since_model`` in diagnosis.json."""
        ratio, low, high = self.gain_ratio
        return {
            "axis": self.axis,
            "model_digest": self.digest,
            "held_out_rms_then_m": self.held_out_then_m,
            "as_it_was_rms_m": self.as_it_was_m,
            "other_gain_rms_m": self.other_gain_m,
            "refitted_rms_m": self.refitted_m,
            "gain_ratio": {"value": ratio, "unit": "1", "ci95": [low, high]},
            "explanation": self.sentence,
        }


def change_since(
    model: AxisModel,
    recordings: Sequence[Recording],
    *,
    digest: str = "",
    progress: Callable[[str], None] = lambda _: None,
) -> Change:
    """Compare a fitted axis with recordings made later.

    model       as it was fitted
    recordings  new ones in which the axis moves
    digest      of the model's file, to say which model was meant
    progress    told what is being done

    What goes wrong: recordings that begin with a memory nobody can tell leave room for it.
    """
    progress("simulating the model as it was")
    kept = tuple(e for e in model.extensions if not isinstance(e, PASSING))
    then = replace(model, extensions=kept, starts=())
    was = fit_extended(then, recordings, kept, structure=AS_IT_WAS)
    other = fit_extended(then, recordings, (*kept, _sensitivity(recordings)), structure=AS_IT_WAS)
    progress("refitting the model")
    refitted = fit_extended(other.model, recordings, kept)
    return Change(
        axis=model.axis,
        digest=digest,
        held_out_then_m=model.quality.held_out_rms_m,
        as_it_was_m=was.held_out_rms_m,
        other_gain_m=other.held_out_rms_m,
        refitted_m=min(refitted.held_out_rms_m, was.held_out_rms_m),
        gain_ratio=_ratio(other),
    )


def _sensitivity(recordings: Sequence[Recording]) -> Extension:
    first, *rest = (recording.name for recording in recordings)
    return GainChange(recording=first, instant_s=0.0, ratio=1.0, later=tuple(rest))


def _ratio(fit: Extended) -> tuple[float, float, float]:
    place = next(
        k for k, extension in enumerate(fit.model.extensions) if isinstance(extension, GainChange)
    )
    value = float(fit.model.extensions[place].free().value[0])
    reach = QUANTILE * float(np.asarray(fit.spread[place])[0])
    return value, value - reach, value + reach
