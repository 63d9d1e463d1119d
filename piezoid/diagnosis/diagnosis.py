"""Diagnosis: findings, effects that were not detected, and detection limits."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from piezoid.formatting import interval_digits, p_value, significant, with_unit, words
from piezoid.identification.model import AxisModel
from piezoid.summary import Summarised, Summary

NO_RECORDING = "No recording is needed"  # begins a ``next_experiment`` that is answered
SOMETHING_ELSE = "something_else"  # finding of a residual that no effect of the catalogue explains
NOT_EXCITED = "the drive rests, and nothing in these recordings excites it"
NOISE_RATIO = 1.3  # final error over noise above which the largest remaining part is named


@dataclass(frozen=True, kw_only=True)
class Size:
    """A number with its unit and 95 % interval."""

    value: float
    unit: str
    ci95: tuple[float, float]

    @classmethod
    def of_rms(cls, rms_m: float, low_m: float, high_m: float) -> "Size":
        """Return an rms in nm with the limits of its interval."""
        return cls(value=1e9 * rms_m, unit="nm, rms", ci95=(1e9 * low_m, 1e9 * high_m))

    @property
    def half_width(self) -> float:
        """Return half the width of the interval."""
        low, high = self.ci95
        return 0.5 * (high - low)

    @property
    def relative_width(self) -> float:
        """Return half the width of the interval over the size."""
        return self.half_width / max(abs(self.value), 1e-30)


@dataclass(frozen=True, kw_only=True)
class CoordinateProfile:
    """Residual in classes of one coordinate, with the curve fitted to it.

    unit                     SI, of ``place``; empty: parts of a period
    place                    (classes,)  mean of the coordinate
    low_m, median_m, high_m  (classes,)  quartiles of the residual
    fitted_m                 (classes,)  mean of the curve
    recording                the recording, if the coordinate is time; else empty
    """

    unit: str
    place: tuple[float, ...]
    low_m: tuple[float, ...]
    median_m: tuple[float, ...]
    high_m: tuple[float, ...]
    fitted_m: tuple[float, ...]
    recording: str = ""


@dataclass(frozen=True, kw_only=True)
class Unexplained:
    """Residual that no effect of the catalogue explains.

    rms_m       beyond the noise, of the widest class of hysteresis with every selected effect,
                before any structure along a coordinate is subtracted
    share       of the power of the residual, noise included
    p_value     probability that a healthy stage has as systematic a residual, by its rank among
                healthy stages of every law of the zoo; at constant drive: of the highest line in
                white noise
    coordinate  that explains most of the residual on left-out blocks
    gain        share of the power of the residual, noise included, that this coordinate explains
    """

    rms_m: float
    share: float
    p_value: float
    coordinate: str
    gain: float


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A detected cause of the residual.

    held_out_gain           1 - rms with / rms without the cause, both refitted, on left-out rows
    held_out_rms_before_m   rms without the cause
    held_out_rms_after_m    rms with the cause
    p_value                 of an effect and of something else: the probability that a healthy
                            stage shows as much, by its rank among healthy stages of every law of
                            the zoo, at least one over their number; of noise that varies along a
                            coordinate: by shifts of the noise; of a fault of the data: of such
                            evidence without a fault, times the number of effects
    rms_percent             rms of the contribution, in percent of the stroke
    not_separable_from      effects that would explain nearly as much
    parameters              nonlinear parameters, by name with unit
    coordinate              of something else: the coordinate on which it depends
    law                     of something else: the formula, if it predicts other recordings
    seen                    of something else: the profile along the coordinate
    """

    effect: str
    held_out_gain: float
    held_out_rms_before_m: float
    held_out_rms_after_m: float
    p_value: float
    size: Size
    rms_percent: float
    parameters: Mapping[str, float]
    not_separable_from: tuple[str, ...]
    explanation: str
    next_experiment: str
    coordinate: str = ""
    law: str = ""
    seen: CoordinateProfile | None = None

    @property
    def share(self) -> float:
        """Return the rms contribution as a share of the stroke."""
        return self.rms_percent / 100.0

    @property
    def needs_recording(self) -> bool:
        """Whether no recording of the fit settles what the finding leaves open."""
        return not self.next_experiment.startswith(NO_RECORDING)


@dataclass(frozen=True, kw_only=True)
class NotDetected:
    """An effect that was not detected, with its bound.

    upper_bound_m      upper bound of its rms, one-sided 95 %; None if it was not tested
    detection_limit_m  rms from which it would have been detected in four of five cases
    reason             one sentence with numbers
    """

    effect: str
    upper_bound_m: float | None
    detection_limit_m: float | None
    reason: str
    next_experiment: str


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """An error on left-out data, in metres and in percent of the stroke.

    explained_rms_m  of the final model: its error in sample, corrected for the number of
                     parameters; None in older files
    """

    rms_m: float
    rms_percent: float
    explained_rms_m: float | None = None

    @classmethod
    def of(cls, rms_m: float, stroke_m: float) -> "HeldOut":
        """Return an error of a stage with this stroke."""
        return cls(rms_m=rms_m, rms_percent=100.0 * rms_m / stroke_m)


@dataclass(frozen=True, kw_only=True)
class BudgetPart:
    """A part of the held-out error of the baseline; the squares of all parts add up to its square.

    part          name of an effect, ``noise``, ``extrapolation`` or ``unexplained``
    is_explained  whether the final model removes the part
    text          description in one or two sentences
    """

    part: str
    rms_m: float
    is_explained: bool
    text: str


def fraction_explained(baseline: float, residual: float, noise: float) -> float:
    """Return the explained share of the power above the noise, from rms values."""
    explainable = baseline**2 - noise**2
    if explainable <= 0.0:
        return 0.0
    return min(max((baseline**2 - residual**2) / explainable, 0.0), 1.0)


def held_out_gain(before_m: float, after_m: float) -> float:
    """Return the relative reduction of an error, 0 if it increases."""
    return min(max(1.0 - after_m / before_m, 0.0), 1.0) if before_m > 0.0 else 0.0


@dataclass(frozen=True, kw_only=True, repr=False)
class Diagnosis(Summarised):
    """Diagnosis of one axis: findings, effects that were not detected, and the error budget.

    baseline            error of the simulation without any effect
    final               error of the model with all findings
    envelope_rms_m      error of the widest class of hysteresis with all findings
    noise_floor_rms_m   of the sensor
    explained_fraction  of the variance above the noise floor
    unexplained         residual that no effect explains; None in files of older versions
    budget              parts of the error of ``baseline``: effects in the model, largest first,
                        then the parts of the final error, then the noise
    findings            the largest gain first
    strengths           of every selected effect, named or not: its rms over that of the structure
                        of the residual. Not in diagnosis.json
    model               the axis with all findings, as it ships; None for a stage at constant
                        drive. It is written to model.json, not to diagnosis.json
    counted             as ``AxisModel.counted``
    """

    axis: str
    stroke_m: float
    baseline: HeldOut
    noise_floor_rms_m: float
    envelope_rms_m: float
    findings: tuple[Finding, ...]
    not_detected: tuple[NotDetected, ...]
    final: HeldOut
    explained_fraction: float
    unexplained: Unexplained | None = None
    budget: tuple[BudgetPart, ...] = ()
    counted: tuple[str, ...] = ()
    strengths: Mapping[str, float] = field(default_factory=dict, compare=False, repr=False)
    model: AxisModel | None = field(default=None, compare=False, repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the findings, largest gain first."""
        return tuple(finding.effect for finding in self.findings)

    @property
    def largest_remaining(self) -> BudgetPart | None:
        """Return the largest part of the final error other than noise.

        None where the final error is at most 1.3 times the noise.
        """
        if self.final.rms_m <= NOISE_RATIO * self.noise_floor_rms_m:
            return None
        remaining = [p for p in self.budget if not p.is_explained and p.part != "noise"]
        return max(remaining, key=lambda part: part.rms_m, default=None)

    def summary(self) -> Summary:
        """Return a table with one row per finding, and the error before and after.

        >>> print(diagnosis.summary())
        Diagnosis of axis x
        effect ...
        """
        rows = []
        for finding in self.findings:
            size, digits = finding.size, interval_digits(*finding.size.ci95)
            value, low, high = (significant(n, digits) for n in (size.value, *size.ci95))
            rows.append(
                (
                    words(finding.effect),
                    f"{value} ({low} to {high}) {size.unit}".strip(),
                    f"{with_unit(1e-2 * finding.rms_percent * self.stroke_m, 'm')} rms",
                    f"{100 * finding.held_out_gain:.1f} %",
                    p_value(finding.p_value),
                )
            )
        notes = (
            f"held-out error: {with_unit(self.baseline.rms_m, 'm')} rms of the base model, "
            f"{with_unit(self.final.rms_m, 'm')} with all findings; "
            f"sensor noise {with_unit(self.noise_floor_rms_m, 'm')}",
            f"effects not detected: {len(self.not_detected)}",
        )
        return Summary(
            title=f"Diagnosis of axis {self.axis}",
            headings=("effect", "size (95 % interval)", "contribution", "held-out gain", "p"),
            rows=rows or [("none found", "", "", "", "")],
            notes=notes,
            counted=self.counted,
        )


def with_finding(diagnosis: Diagnosis, finding: Finding) -> Diagnosis:
    """Return a diagnosis with a finding added, replacing earlier entries of the same effect."""
    findings = [
        *(entry for entry in diagnosis.findings if entry.effect != finding.effect),
        finding,
    ]
    return replace(
        diagnosis,
        findings=tuple(sorted(findings, key=lambda entry: entry.held_out_gain, reverse=True)),
        not_detected=tuple(n for n in diagnosis.not_detected if n.effect != finding.effect),
    )
