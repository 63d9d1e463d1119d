"""Compare a model with later recordings: unchanged, changed sensitivity, or another change.

Three simulations of the new recordings are compared on the same held-out blocks: the unchanged
model, with the initial state and zero of each recording fitted; this model with another
sensitivity; and the refitted model.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np

from piezoid.diagnosis.signals import with_displacement
from piezoid.errors import RecordingError
from piezoid.formatting import significant, with_unit
from piezoid.identification.extended_fit import fit_extended
from piezoid.identification.extensions.gain_change import GainChange
from piezoid.identification.hysteresis.coordinates import Structure
from piezoid.identification.hysteresis.excluded_rows import outlying_samples
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import simulate_recording
from piezoid.numerics.robust import white_noise_rms
from piezoid.records.recording import Recording, counted_in
from piezoid.statement import Kind, Level, Statement

FIXED_OPERATOR = Structure(operator=False)
STUDENT_95_FIVE_FOLDS = 2.8
MIN_GAIN = 0.05  # relative reduction of the error below which nothing has changed
# Error over that of the fit: another excitation of the same stage doubles it (Preisach ceramics:
# 0.08 % on a similar sweep and 0.15 % on a staircase), a lag or a load multiplies it.
MAX_GROWTH = 3.0
MAX_SHARE = 0.2  # of the motion, rms: 8 % of the range of a triangle, where no fit applies either
NOISE_GROWTH = 2.0  # the noise of one sensor changes by less from day to day
RATIO_LIMITS = (0.11, 9.0)  # narrower than the limits of the search


@dataclass(frozen=True, kw_only=True)
class ModelComparison:
    """Errors of a model on later recordings: rms on held-out blocks.

    digest             of the file of the model
    rejection          why the model class did not apply at the fit; empty if it applied
    fitted_error_m     of the model on the recordings of the fit, without loop shape
    shaped_error_m     of the whole model, as the fit reports it; None without loop shape
    motion_m           of the new recordings about their means
    unchanged_error_m  with the model unchanged; only initial states and zeros are fitted
    rescaled_error_m   with another sensitivity as well
    refitted_error_m   with all parameters refitted
    gain_ratio         new sensitivity over old, with its 95 % interval
    fitted_noise_m     of the sensor in the recordings of the fit
    noise_m            of the sensor in the new recordings
    counted            as ``AxisModel.counted``
    """

    axis: str
    digest: str
    rejection: str = ""
    fitted_error_m: float
    shaped_error_m: float | None = None
    motion_m: float
    unchanged_error_m: float
    rescaled_error_m: float
    refitted_error_m: float
    gain_ratio: tuple[float, float, float]
    fitted_noise_m: float
    noise_m: float
    counted: tuple[str, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether the model applies to its own recordings and its error has hardly grown."""
        return not self.rejection and self.unchanged_error_m <= self.limit_m

    @property
    def sensitivity_changed(self) -> bool:
        """Whether another sensitivity is significant and reduces the error.

        A change must exceed the error of the fit: any factor improves a poor fit a little.
        """
        ratio, low, high = self.gain_ratio
        reduces = self.rescaled_error_m <= (1.0 - MIN_GAIN) * self.unchanged_error_m
        exceeds_error = abs(ratio - 1.0) * self.motion_m > self.fitted_error_m
        in_limits = RATIO_LIMITS[0] < ratio < RATIO_LIMITS[1]
        return reduces and exceeds_error and in_limits and not low <= 1.0 <= high

    @property
    def only_sensitivity_changed(self) -> bool:
        """Whether a new sensitivity alone explains the later recordings."""
        if not self.sensitivity_changed or self.rescaled_error_m > MAX_SHARE * self.motion_m:
            return False
        as_good = self.refitted_error_m > (1.0 - MIN_GAIN) * self.rescaled_error_m
        return as_good or self.rescaled_error_m <= self.limit_m

    @property
    def statement(self) -> Statement:
        """The statement of the result."""
        return Statement(
            kind=Kind.FINDING,
            level=Level.NOTE if self.holds and not self.sensitivity_changed else Level.ACTION,
            quantity="model_comparison",
            text=f"axis {self.axis}: {self._text()}",
            axis=self.axis,
            value=self.unchanged_error_m,
            unit="m",
        )

    def _text(self) -> str:
        error, noise, change = self._share(self.unchanged_error_m), "", ""
        fitted, refitted = (
            with_unit(error_m, "m") for error_m in (self.fitted_error_m, self.refitted_error_m)
        )
        if self.noise_m > NOISE_GROWTH * self.fitted_noise_m:
            noise = (
                f"; the sensor noise rose from {with_unit(self.fitted_noise_m, 'm')} to "
                f"{with_unit(self.noise_m, 'm')} rms"
            )
        if self.rejection:
            text = f"the model does not hold, and never applied ({self.rejection}); error {error}"
            return text + noise
        if self.sensitivity_changed:
            ratio, low, high = self.gain_ratio
            change = (
                f"the stage moves {100.0 * abs(ratio - 1.0):.2f} % (+- {50.0 * (high - low):.2f} "
                f"%) {'more' if ratio > 1.0 else 'less'} than at the fit"
            )
        if self.only_sensitivity_changed:
            return (
                f"only the sensitivity changed: {change}; error {error}, with the new sensitivity "
                f"{self._share(self.rescaled_error_m)}{noise}"
            )
        as_good = self.refitted_error_m > (1.0 - MIN_GAIN) * self.unchanged_error_m
        if self.holds and (as_good or self.unchanged_error_m <= self.fitted_error_m):
            limit = with_unit(self.limit_m, "m")
            return (
                f"the model still holds. Error{self._class} now {error}, at the fit {fitted}; it "
                f"may grow to {limit}{noise}."
            )
        verdict = "holds less well" if self.holds else "does not hold"
        rescaled = with_unit(self.rescaled_error_m, "m")
        return (
            f"the model {verdict}: more than the sensitivity changed. Error{self._class} now "
            f"{error}, at the fit {fitted}; {rescaled} with another sensitivity"
            f"{f' ({change})' if change else ''}, {refitted} refitted{noise}."
        )

    @property
    def _class(self) -> str:
        """The class of the compared errors, if the fit reports the error of a wider one."""
        return "" if self.shaped_error_m is None else " of plays with dead zones"

    @property
    def limit_m(self) -> float:
        """Largest error with which the model holds; it grows with the noise of the sensor."""
        added_noise_m2 = max(self.noise_m**2 - self.fitted_noise_m**2, 0.0)
        grown_m = sqrt((MAX_GROWTH * self.fitted_error_m) ** 2 + added_noise_m2)
        return min(grown_m, MAX_SHARE * self.motion_m)

    def _share(self, error_m: float) -> str:
        share = 100.0 * error_m / self.motion_m
        return f"{with_unit(error_m, 'm')} ({significant(share, 2)} % of the motion's rms)"

    def to_json(self) -> dict[str, Any]:
        """Return the content of ``since_model`` in diagnosis.json."""
        ratio, low, high = self.gain_ratio
        return {
            "axis": self.axis,
            "model_digest": self.digest,
            "holds": self.holds,
            "held_out_rms_then_m": self.fitted_error_m,
            "motion_rms_m": self.motion_m,
            "as_it_was_rms_m": self.unchanged_error_m,
            "other_gain_rms_m": self.rescaled_error_m,
            "refitted_rms_m": self.refitted_error_m,
            "gain_ratio": {"value": ratio, "unit": "1", "ci95": [low, high]},
            "explanation": self.statement.text,
        }


def compare(
    model: AxisModel,
    recordings: Sequence[Recording],
    *,
    digest: str = "",
    progress: Callable[[str], None] = lambda _: None,
) -> ModelComparison:
    """Compare a fitted axis with recordings made later.

    Args:
        model: as it was fitted.
        recordings: new ones in which the axis moves.
        digest: of the model's file.
        progress: called with a sentence at each step.

    Raises:
        RecordingError: the recordings are in other units than the model.
    """
    if counted_in(recordings) != model.counted:
        units = [" and ".join(c) or "nothing" for c in (model.counted, counted_in(recordings))]
        raise RecordingError(
            f"the model has {units[0]} in counts of the converter, the recordings {units[1]}",
            needed="recordings in the units of the model",
            remedy="Write scale = { ... } into lab.toml as at the fit.",
        )
    progress("simulating the earlier model")
    shaped, model = model, model.without_loop_shape()  # plays with dead zones are refitted
    stage_effects = tuple(e for e in model.extensions if not e.is_of_recordings)
    start = replace(model, extensions=stage_effects, starts=())
    unchanged = fit_extended(start, recordings, stage_effects, structure=FIXED_OPERATOR)
    cleaned = [_without_outliers(unchanged.model, recording) for recording in recordings]
    if any(new is not old for old, new in zip(recordings, cleaned, strict=True)):
        unchanged = fit_extended(start, cleaned, stage_effects, structure=FIXED_OPERATOR)
    first, *later = (recording.name for recording in cleaned)
    change = GainChange(recording=first, instant_s=0.0, ratio=1.0, later=tuple(later))
    rescaled = fit_extended(start, cleaned, (*stage_effects, change), structure=FIXED_OPERATOR)
    progress("refitting the model")
    refitted = fit_extended(rescaled.model, cleaned, stage_effects)
    index = next(k for k, e in enumerate(rescaled.model.extensions) if isinstance(e, GainChange))
    ratio = float(rescaled.model.extensions[index].free().value[0])
    ratio_margin = STUDENT_95_FIVE_FOLDS * float(np.asarray(rescaled.spread[index])[0])
    measured_m = [recording.displacement_m(model.axis) for recording in cleaned]
    centred_m = np.concatenate([values - values.mean() for values in measured_m])
    errors_m = [
        values - simulate_recording(refitted.model, recording)
        for values, recording in zip(measured_m, cleaned, strict=True)
    ]
    return ModelComparison(
        axis=model.axis,
        digest=digest,
        counted=model.counted,
        rejection="" if model.verdict.applies else model.verdict.reason,
        fitted_error_m=model.quality.held_out_rms_m,
        shaped_error_m=None if shaped is model else shaped.quality.held_out_rms_m,
        motion_m=float(np.sqrt(np.mean(centred_m**2))),
        unchanged_error_m=unchanged.held_out_rms_m,
        rescaled_error_m=rescaled.held_out_rms_m,
        refitted_error_m=min(refitted.held_out_rms_m, unchanged.held_out_rms_m),
        gain_ratio=(ratio, ratio - ratio_margin, ratio + ratio_margin),
        fitted_noise_m=model.quality.noise_rms_m,
        noise_m=max(map(white_noise_rms, errors_m)),
    )


def _without_outliers(model: AxisModel, recording: Recording) -> Recording:
    """Return a recording with its outliers from the simulation of a model interpolated."""
    measured_m, drive_V = recording.displacement_m(model.axis), recording.voltage_V(model.axis)
    error_m = measured_m - simulate_recording(model, recording)
    outliers = [
        piece.start + int(k)
        for piece in recording.pieces
        if np.isfinite(error_m[piece]).all()
        for k in outlying_samples(error_m[piece], drive_V[piece], measured_m[piece])
    ]
    if not outliers:
        return recording
    rows = np.arange(recording.samples)
    valid = np.setdiff1d(rows, [*recording.bridged, *outliers])
    interpolated_m = np.interp(rows, valid, measured_m[valid])
    cleaned = with_displacement(recording, interpolated_m, model.axis)
    return replace(cleaned, bridged=tuple(sorted({*recording.bridged, *outliers})))
