"""Interface of one effect between the catalogue and the search.

An effect is one file: an explanation under five headings, the trials that look for it, placebos
of the same freedom that must do clearly worse, what it adds once it is selected, and its size.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from piezoid.diagnosis.appearance import Appearance
from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.drive_response import Driven
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.segments import Places, Track
from piezoid.identification.extensions.extension import Extension, Where
from piezoid.identification.hysteresis.pieces import Scales
from piezoid.identification.joint.vector import Structure, parts_of
from piezoid.identification.model import AxisModel, Lag
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

HEADINGS = (
    "What you see",
    "Why it happens",
    "How it is detected",
    "What the extension adds",
    "Source",
)
BETWEEN = "between recordings"


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectEstimate:
    """Estimate of one effect by the search: start values of its extension.

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
    def first_coefficient(self) -> float:
        """The first linear coefficient; 1 for an effect without any."""
        return float(self.coefficient[0]) if len(self.coefficient) else 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchScaling:
    """Units of the scaled numbers of a search, and the pieces it ran on.

    voltage_V         half the range of the drive: what 1 means
    voltage_offset_V  its middle: what 0 means
    half_stroke_m     half the stroke
    pieces            in the order of the search's tracks
    recordings        names, in the order in which they were made
    """

    voltage_V: float
    voltage_offset_V: float
    half_stroke_m: float
    pieces: tuple[Where, ...]
    recordings: tuple[str, ...]

    @property
    def longest_s(self) -> float:
        """Return the duration of the longest piece."""
        return max(piece.samples / piece.rate_Hz for piece in self.pieces)


def scaling_of(model: AxisModel, recordings: Sequence[Recording], scales: Scales) -> SearchScaling:
    """Return the units of a search on these recordings."""
    return SearchScaling(
        voltage_V=scales.voltage_V,
        voltage_offset_V=scales.voltage_offset_V,
        half_stroke_m=abs(scales.displacement_m),
        pieces=tuple(part.where for part in parts_of(model, recordings)),
        recordings=tuple(recording.name for recording in recordings),
    )


Parameters = Mapping[str, float]
Filter = Callable[[Array, float, Parameters], Array]  # (signal, rate_Hz, parameters) -> signal


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One hypothesis of an effect: its columns and parameters.

    columns              (rows, columns)  what it would add to the response; zeros: nothing tells
                         in advance, and it is only put in place where its effect is refitted
    parameters           nonlinear ones, by name with unit
    physical             False: a placebo of the same freedom, to calibrate by
    coefficient_range    of the first coefficient, as physics allows it; the tangent of a filter
                         errs by factors, and only its sign is tested
    minimum_coefficient  size below which the first coefficient counts as zero
    needs_time           whether at one speed this is a width of the loop, as a lag is
    unique               whether no other shape of its kind is missing; where many are, one of
                         them is only the nearest
    free                 parameters to refine: by which factor (above 1) or step (below)
    limits               their ranges; an estimate at its limit was not found
    """

    columns: Array
    parameters: Parameters = field(default_factory=dict)
    physical: bool = True
    coefficient_range: tuple[float, float] = (-float("inf"), float("inf"))
    minimum_coefficient: float = 0.0
    needs_time: bool = False
    unique: bool = True
    free: Parameters = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fault:
    """A fault of the data themselves, found without any model of the stage.

    tracks   repaired, or as they were where nothing can be repaired
    value    size
    spread   its standard error
    p_value  of such evidence where there is no fault
    alike    effects that these recordings do not tell from it
    where    recordings that have it, with places, for people
    """

    tracks: tuple[Track, ...]
    value: float
    spread: float
    p_value: float
    alike: tuple[str, ...] = ()
    where: tuple[str, ...] = ()

    def merged_with(self, earlier: "Fault | None") -> "Fault":
        """Merge with an earlier detection, keeping the larger size and the smaller p-value."""
        if earlier is None:
            return self
        larger = max(earlier, self, key=lambda fault: abs(fault.value))
        return replace(
            self,
            value=larger.value,
            spread=larger.spread,
            p_value=min(earlier.p_value, self.p_value),
            alike=tuple(dict.fromkeys((*earlier.alike, *self.alike))),
            where=tuple(dict.fromkeys((*earlier.where, *self.where))),
        )


@dataclass(frozen=True, kw_only=True)
class Tangent:
    """Predicted contribution of an effect along a planned drive, for ``piezoid plan``.

    columns  (drive, scale) -> (samples, columns), m for a strength of one, made from the fitted
             model alone
    per_drive        whether every drive has coefficients of its own
    lags     whether it is a lag itself, so that a fitted lag must not take it away
    scale    in s or Hz: for effects whose shape depends on their size; 0: it does not
    scale_parameter  name of a finding's parameter that is this scale, or empty
    """

    columns: Callable[[Driven, float], Array]
    per_drive: bool = False
    lags: bool = False
    scale: float = 0.0
    scale_parameter: str = ""


def delay_tangent(response_filter: Filter, name: str) -> Tangent:
    """Return the tangent of a filter that delays by its one parameter, a time in s."""

    def columns(drive: Driven, time_s: float) -> Array:
        read_m = response_filter(drive.static_m, drive.rate_Hz, {name: time_s})
        return np.asarray((read_m - drive.static_m)[:, None] / time_s)

    return Tangent(columns=columns, lags=True, scale=1e-4)


@dataclass(frozen=True, kw_only=True, eq=False)
class ConstantDriveData:
    """Displacement recorded at constant drive.

    recording  whose they are
    axis       of the stage
    keep       (rows,)  samples that are used
    time_s     (rows,)
    calm_m     (rows,)  readings less what drifts
    """

    recording: Recording
    axis: str
    keep: Places
    time_s: Array
    calm_m: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultTest:
    """How a fault of the data is looked for.

    find   (view) -> the fault, or None
    bound  (view) -> share of the stroke that could be missed
    """

    find: Callable[[View], Fault | None]
    bound: Callable[[View], float]


Without = Callable[[AxisModel, Recording], AxisModel | None]


def without_part(kind: type[Extension], *, lag: bool = False) -> Without:
    """Return a function that removes extensions of one kind; it returns None if there are none.

    lag  whether the effect is also represented by the lag of the model
    """

    def taken_out(axis: AxisModel, _: Recording) -> AxisModel | None:
        remaining = tuple(e for e in axis.extensions if not isinstance(e, kind))
        has_lag = lag and axis.lag.time_s > 0.0
        if len(remaining) == len(axis.extensions) and not has_lag:
            return None
        lag_model = Lag(kind="none", time_s=0.0) if lag else axis.lag
        return replace(axis, extensions=remaining, lag=lag_model)

    return taken_out


@dataclass(frozen=True, kw_only=True, eq=False)
class Structural:
    """A part of the nuisance class and of the static model themselves, judged last.

    null_without         (view) -> the nuisance class without it: the null to beat
    structure            (structure, model, found) -> the static structure to refit with it, or
                         without it
    largest_noise_ratio  residual over noise above which that null counts as misspecified
    may_be_bouc_wen      whether a Bouc-Wen state may do what it seems to do
    """

    null_without: Callable[[View], Null]
    structure: Callable[[Structure, AxisModel, bool], Structure]
    largest_noise_ratio: float
    may_be_bouc_wen: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
    """Definition of one effect of the catalogue.

    name                      as in diagnosis.json
    explanation               the file's docstring
    unit                      of its size
    experiment                what to record to see it better, or to separate it from its
                              confounded effects
    control                   what it means for who controls the stage
    shows                     the coordinate in which it is seen
    tangent                   what it would add along a drive; or why no drive exposes it better
    confounded                names of the effects that look alike
    untestable                (view) -> why these recordings cannot show it; empty where they can
    trials                    (view) -> physical trials and placebos
    columns                   (view, parameters) -> what it adds once selected, (rows, columns)
    covariates                (view) -> columns that come with it and are no evidence of it
    drive_filter              (drive, rate_Hz, parameters) -> what reaches the stage, for effects
                              in front of the hysteresis
    response_filter           (response, rate_Hz, parameters) -> what is read, for filters that
                              the whole response passes
    other_side                the same cause on the other side of the hysteresis
    between_recordings        the same cause where it acts between two recordings
    fault                     how it is looked for, for faults of the data
    size                      (view, parameters, coefficients) -> size in ``unit``; None: rms in
                              percent
    note                      (parameters) -> what the parameters mean, for its explanation
    at_rest                   (standing) -> what it adds while the drive rests, (rows, columns), or
                              why these readings cannot show it; None: it needs a drive
    model_error               part of the size that the law itself may be wrong by (a spectrum
                              that is not even, a hold between samples), which blocks of rows
                              cannot show. Two to three times the worst of thirteen laws
                              (``python -m benchmarks.zoo.sizes``)
    may_be_absorbed           whether the nuisance class may have been fitted to it, so that its
                              columns are made from a response without it
    inject                    (recording, share) -> the recording with it, share of the stroke
    extend                    (found, setting) -> the model's extension to refit from there
    structural                for what nuisance class and static model have themselves
    without                   (model, recording) -> the model without it, None where the model
                              does not have it
    minimum_gain              part of the held-out error that it must take off
    detectable_share          share of the stroke from which it is found at 0.05 % of noise
    """

    name: str
    explanation: str
    unit: str
    experiment: str
    control: str
    shows: Appearance
    tangent: Tangent | str
    inject: Callable[[Recording, float], Recording]
    confounded: tuple[str, ...] = ()
    untestable: Callable[[View], str] = lambda _: ""
    trials: Callable[[View], Sequence[Trial]] | None = None
    columns: Callable[[View, Parameters], Array] | None = None
    covariates: Callable[[View], Array] | None = None
    drive_filter: Filter | None = None
    response_filter: Filter | None = None
    other_side: "Effect | None" = None
    between_recordings: "Effect | None" = None
    fault: FaultTest | None = None
    size: Callable[[View, Parameters, Array], float] | None = None
    note: Callable[[Parameters], str] | None = None
    at_rest: Callable[[ConstantDriveData], Array | str] | None = None
    extend: Callable[[EffectEstimate, SearchScaling], tuple[Extension, ...]] | None = None
    structural: Structural | None = None
    without: Without = lambda *_: None
    model_error: float = 0.02
    minimum_gain: float = 0.05
    may_be_absorbed: bool = False
    detectable_share: float = 2e-3

    @property
    def summary(self) -> str:
        """Return the first paragraph of the explanation, on one line."""
        return " ".join(self.explanation.partition("\n\n")[0].split())

    @property
    def moves_zero(self) -> bool:
        """Whether the effect moves the zero: drift over time that is no fault of the data."""
        return self.shows.unit == "s" and self.fault is None

    def resembles(self, effect: "Effect") -> bool:
        """Tell whether the two effects are confounded."""
        return effect.name in self.confounded or self.name in effect.confounded
