"""What changed since a model was fitted: the model as it was against new recordings.

Three simulations of the new recordings, judged on rows left out in the same way: the model as it
was, with only memory and zero of each recording fitted; the same with another sensitivity; and
everything refitted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np

from piezoid.counts import in_counts
from piezoid.errors import RecordingError
from piezoid.formatting import significant, with_unit
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.gain_change import GainChange
from piezoid.identification.extensions.mains_lines import MainsLines
from piezoid.identification.extensions.thermal_drift import ThermalDrift
from piezoid.identification.hysteresis.outlying import outlying
from piezoid.identification.joint.fit_extended import Extended, fit_extended
from piezoid.identification.joint.vector import Structure
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import simulate_recording
from piezoid.numerics.noise import white_noise_rms
from piezoid.records.comparison import counted_in
from piezoid.records.recording import Quantity, Recording

AS_IT_WAS = Structure(operator=False)
QUANTILE = 2.8  # of Student's distribution for five folds
PASSING = (GainChange, MainsLines, ThermalDrift)  # what belongs to the recordings of then
WORTH = 0.05  # of the error: a change that takes off less is none
# times the error of then: another excitation of the same stage doubles it (Preisach ceramics leave
# 0.08 % on a like sweep and 0.15 % on a staircase), a lag or a load multiplies it
GROWN = 3.0
MOST = 0.2  # of the motion, rms: 8 % of the range of a triangle, where no fit applies either
NOISIER = 2.0  # times the noise of then: sensors of one stage differ by less from day to day
SEARCHED = (0.11, 9.0)  # ratios inside the search's own ends, at which nothing was found


@dataclass(frozen=True, kw_only=True)
class Change:
    """How far a model still holds, rms on rows left out.

    axis            which one
    digest          of the model's file
    against_then    why the model did not apply when it was fitted; empty where it did
    held_out_then_m when it was fitted, on the recordings of then
    motion_m        of the new recordings about their mean, each: what no model would leave
    as_it_was_m     on the new recordings, only memory and zero fitted
    other_gain_m    with another sensitivity as well
    refitted_m      with everything refitted
    gain_ratio      sensitivity now over then, with its 95 % interval
    noise_then_m    of the sensor, when the model was fitted
    noise_m         of the sensor in the new recordings
    counted         as ``AxisModel.counted``
    """

    axis: str
    digest: str
    against_then: str = ""
    held_out_then_m: float
    motion_m: float
    as_it_was_m: float
    other_gain_m: float
    refitted_m: float
    gain_ratio: tuple[float, float, float]
    noise_then_m: float
    noise_m: float
    counted: tuple[str, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether the model applied then and leaves now hardly more, and little of the motion."""
        return not self.against_then and self._is_small(self.as_it_was_m)

    @property
    def sentence(self) -> str:
        """Return what changed in words."""
        return in_counts(f"axis {self.axis}: {self._verdict()}", self.counted)

    def _verdict(self) -> str:
        if self.against_then:
            return (
                f"the model never applied ({self.against_then}), and does not hold: it leaves "
                f"{self._left(self.as_it_was_m)}{self._noisier()}"
            )
        moves = self._moves()
        if moves and self._is_alone():
            return (
                f"the sensitivity alone changed: {moves}; the model leaves "
                f"{self._left(self.as_it_was_m)}, with the new sensitivity "
                f"{self._left(self.other_gain_m)}{self._noisier()}"
            )
        as_good = self.refitted_m > (1.0 - WORTH) * self.as_it_was_m
        if self.holds and (as_good or self.as_it_was_m <= self.held_out_then_m):
            return (
                f"the model still holds; it leaves {self._left(self.as_it_was_m)}, "
                f"{with_unit(self.held_out_then_m, 'm')} when it was fitted{self._noisier()}"
            )
        verdict = "holds less well" if self.holds else "does not hold"
        return (
            f"more than the sensitivity changed, and the model {verdict}: it leaves "
            f"{self._left(self.as_it_was_m)}, {with_unit(self.held_out_then_m, 'm')} when it was "
            f"fitted; {with_unit(self.other_gain_m, 'm')} with another sensitivity"
            f"{f' ({moves})' if moves else ''}, {with_unit(self.refitted_m, 'm')} refitted"
            f"{self._noisier()}"
        )

    def _moves(self) -> str:
        """Say how the sensitivity changed, where that is sure and takes error off."""
        ratio, low, high = self.gain_ratio
        if self.other_gain_m > (1.0 - WORTH) * self.as_it_was_m or low <= 1.0 <= high:
            return ""
        # less than the model missed when it was fitted is no change: a model that fits badly is
        # mended a little by any factor, on its own recording as well
        is_seen = abs(ratio - 1.0) * self.motion_m > self.held_out_then_m
        if not (is_seen and SEARCHED[0] < ratio < SEARCHED[1]):
            return ""
        return (
            f"the stage moves {100.0 * abs(ratio - 1.0):.2f} % (+- {50.0 * (high - low):.2f} %) "
            f"{'more' if ratio > 1.0 else 'less'} than when the model was fitted"
        )

    def _noisier(self) -> str:
        """Say that the sensor is noisier than it was, where it is."""
        if self.noise_m <= NOISIER * self.noise_then_m:
            return ""
        return (
            f"; the sensor's noise is {with_unit(self.noise_m, 'm')} rms now, "
            f"{with_unit(self.noise_then_m, 'm')} when it was fitted"
        )

    def _is_alone(self) -> bool:
        """Tell whether little is left besides, or nothing that a refit would take off."""
        if self.other_gain_m > MOST * self.motion_m:
            return False
        as_good = self.refitted_m > (1.0 - WORTH) * self.other_gain_m
        return as_good or self._is_small(self.other_gain_m)

    def _is_small(self, error_m: float) -> bool:
        more_m2 = max(
            self.noise_m**2 - self.noise_then_m**2, 0.0
        )  # is the sensor's, not the model's
        at_then_m = sqrt(max(error_m**2 - more_m2, 0.0))
        return at_then_m <= GROWN * self.held_out_then_m and error_m <= MOST * self.motion_m

    def _left(self, error_m: float) -> str:
        share = 100.0 * error_m / self.motion_m
        return f"{with_unit(error_m, 'm')} ({significant(share, 2)} % of the motion)"

    def to_json(self) -> dict[str, Any]:
        """Return the content of ``since_model`` in diagnosis.json."""
        ratio, low, high = self.gain_ratio
        return {
            "axis": self.axis,
            "model_digest": self.digest,
            "holds": self.holds,
            "held_out_rms_then_m": self.held_out_then_m,
            "motion_rms_m": self.motion_m,
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
    if counted_in(recordings) != model.counted:
        told = [" and ".join(c) or "nothing" for c in (model.counted, counted_in(recordings))]
        raise RecordingError(
            f"the model has {told[0]} in counts of the converter, the recordings {told[1]}",
            needed="recordings in the units of the model",
            remedy="Write scale = { ... } into lab.toml as at the fit.",
        )
    progress("simulating the model as it was")
    model = model.without_minor_loops()  # what is refitted is plays with dead zones
    asked = recordings
    kept = tuple(e for e in model.extensions if not isinstance(e, PASSING))
    then = replace(model, extensions=kept, starts=())
    was = fit_extended(then, recordings, kept, structure=AS_IT_WAS)
    recordings = tuple(_without_outliers(was.model, recording) for recording in asked)
    if any(a is not b for a, b in zip(asked, recordings, strict=True)):
        was = fit_extended(then, recordings, kept, structure=AS_IT_WAS)
    other = fit_extended(then, recordings, (*kept, _sensitivity(recordings)), structure=AS_IT_WAS)
    progress("refitting the model")
    refitted = fit_extended(other.model, recordings, kept)
    return Change(
        axis=model.axis,
        digest=digest,
        counted=model.counted,
        against_then="" if model.verdict.applies else model.verdict.reason,
        held_out_then_m=model.quality.held_out_rms_m,
        motion_m=_motion_m(recordings, model.axis),
        as_it_was_m=was.held_out_rms_m,
        other_gain_m=other.held_out_rms_m,
        refitted_m=min(refitted.held_out_rms_m, was.held_out_rms_m),
        gain_ratio=_ratio(other),
        noise_then_m=model.quality.noise_rms_m,
        noise_m=_noise_m(refitted.model, recordings),
    )


def _without_outliers(model: AxisModel, recording: Recording) -> Recording:
    """Return a recording with readings that stand out of a model's simulation bridged."""
    measured_m = recording.displacement_m(model.axis)
    error_m = measured_m - simulate_recording(model, recording)
    parts = [part for part in recording.pieces if np.isfinite(error_m[part]).all()]
    drive_V = recording.voltage_V(model.axis)
    out = [
        part.start + k for part in parts for k in outlying(error_m[part], drive_V[part]).tolist()
    ]
    if not out:
        return recording
    place = np.arange(recording.samples)
    good = np.setdiff1d(place, [*recording.bridged, *out])
    channels = tuple(
        replace(channel, values=np.interp(place, good, measured_m[good]))
        if (channel.quantity, channel.axis) == (Quantity.DISPLACEMENT, model.axis)
        else channel
        for channel in recording.channels
    )
    return replace(recording, channels=channels, bridged=tuple(sorted({*recording.bridged, *out})))


def _noise_m(model: AxisModel, recordings: Sequence[Recording]) -> float:
    """Return the white noise of the noisiest recording, in what a model leaves of it."""
    return max(
        white_noise_rms(r.displacement_m(model.axis) - simulate_recording(model, r))
        for r in recordings
    )


def _motion_m(recordings: Sequence[Recording], axis: str) -> float:
    """Return the rms of all displacements about their own means."""
    moved_m = [r.displacement_m(axis) - r.displacement_m(axis).mean() for r in recordings]
    return float(np.sqrt(np.mean(np.concatenate(moved_m) ** 2)))


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
