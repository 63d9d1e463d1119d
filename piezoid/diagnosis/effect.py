"""Interface of one effect between the catalogue and the search.

An effect is one file: an explanation under five headings, trials, placebos with the same freedom
that must explain clearly less, the contribution of the selected effect, its size, and its
appearance along a coordinate, over time, or in the spectrum. This module defines the coordinates
of several effects; the file of an effect defines its own.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.drive_response import DriveResponse
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.segments import Places, Track
from piezoid.identification.extensions.extension import Extension, Where
from piezoid.identification.hysteresis.coordinates import Structure
from piezoid.identification.model import AxisModel, Lag
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

Along = Callable[[Recording], tuple[Array, Array]]


@dataclass(frozen=True, kw_only=True)
class Appearance:
    """Coordinate against which a residual is drawn.

    label    of the coordinate
    unit     SI
    kind     ``classes`` of all recordings, or ``time`` or ``spectrum`` of one recording
    along    (recording) -> coordinate of every sample, (samples,), NaN for samples that are left
             out, and a sign by which the residual is multiplied, (samples,)
    reading  how to read the picture
    decades  whether coordinates are log10 of numbers in ``unit``
    """

    label: str
    unit: str
    kind: str
    along: Along
    reading: str
    decades: bool = False


def unsigned(positions: Array) -> tuple[Array, Array]:
    """Return positions, and the sign 1 for all of them."""
    return positions, np.ones(len(positions))


OVER_TIME = Appearance(
    label="time",
    unit="s",
    kind="time",
    along=lambda recording: unsigned(recording.time_s),
    reading="Drift: one slow motion whatever the drive does. A slip: small before, large "
    "after. Outliers: single spikes. A wrong initial state: gone after the first large cycle.",
)
OVER_SPEED = Appearance(
    label="speed of the drive",
    unit="V/s",
    kind="classes",
    along=lambda recording: unsigned(
        np.gradient(recording.voltage_V()) * recording.sampling_rate_Hz
    ),
    reading="Delay and lag: a straight line through zero. Rate dependence: bent. A slew "
    "limit: flat, then steep beyond the limit.",
)
IN_SPECTRUM = Appearance(
    label="frequency",
    unit="Hz",
    decades=True,
    kind="spectrum",
    along=lambda recording: unsigned(recording.time_s),
    reading="A mode appears as a hill at its frequency, hum as needles at 50 or 60 Hz and "
    "multiples.",
)
OVER_DRIVE = Appearance(
    label="drive",
    unit="V",
    kind="classes",
    along=lambda recording: unsigned(recording.voltage_V()),
    reading="Saturation is flat, then steep at one end. Asymmetry bends one side. Loop shape "
    "waves over the whole range.",
)


def over_time(coordinate: Appearance) -> Appearance:
    """Return the appearance over time, for recordings with too few samples of a coordinate."""
    return replace(
        OVER_TIME,
        reading="Drawn over time, because too few samples of these recordings have a "
        f"{coordinate.label}, where this effect shows best.",
    )


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

    effect       name of the effect
    parameters   nonlinear parameters, by name with unit; drives in half ranges
    coefficient  (columns,)  linear coefficients
    from_jumps   whether the effect was detected in step responses
    """

    effect: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    coefficient: Array = field(default_factory=lambda: np.ones(1))
    from_jumps: bool = False

    @property
    def first_coefficient(self) -> float:
        """The first linear coefficient; 1 for an effect without linear coefficients."""
        return float(self.coefficient[0]) if len(self.coefficient) else 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchScaling:
    """Units of the scaled numbers of a search, and the pieces it ran on.

    voltage_V         half the range of the drive: 1 in scaled units
    voltage_offset_V  middle of the drive: 0 in scaled units
    half_stroke_m     half the stroke
    pieces            in the order of the tracks of the search
    recordings        names, in the order in which they were made
    """

    voltage_V: float
    voltage_offset_V: float
    half_stroke_m: float
    pieces: tuple[Where, ...]
    recordings: tuple[str, ...]


Parameters = Mapping[str, float]
Filter = Callable[[Array, float, Parameters], Array]  # (signal, rate_Hz, parameters) -> signal


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One hypothesis of an effect: its columns and parameters.

    columns              (rows, columns)  predicted contribution to the response; zeros: no
                         prediction, the trial is only a start value of refits
    parameters           nonlinear parameters, by name with unit; a name without unit is a number
                         in half strokes or half ranges of the drive
    physical             False: a placebo with the same freedom
    coefficient_range    physically possible range of the first coefficient; of a filter only the
                         sign is tested, because its tangent is off by factors
    minimum_coefficient  size below which the first coefficient counts as zero
    needs_time           whether the effect only changes the loop width if all branches have one
                         speed, as a lag does
    unique               whether this is the only missing shape of its family; if many are missing,
                         the trial is only the nearest
    free                 parameters to refine, with the factor (above 1) or step (below 1) of a
                         trial
    limits               ranges of these parameters; an estimate at a limit is rejected
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
    """A fault of the data.

    tracks     with the fault repaired; unchanged tracks if it cannot be repaired
    value      size
    spread     standard error of the size
    p_value    of such evidence without a fault
    locations  recordings with the fault and its location in each, as text
    """

    tracks: tuple[Track, ...]
    value: float
    spread: float
    p_value: float
    locations: tuple[str, ...] = ()

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
            locations=tuple(dict.fromkeys((*earlier.locations, *self.locations))),
        )


@dataclass(frozen=True, kw_only=True)
class Tangent:
    """Predicted contribution of an effect along a planned drive, for ``piezoid plan``.

    columns          (drive, scale) -> (samples, columns), in m for a strength of 1, computed from
                     the fitted model
    per_drive        whether every drive has separate coefficients
    lags             whether the effect is a lag, which a fitted lag would absorb
    scale            where a finding states none, in the unit of ``scale_parameter``, if the shape
                     of the effect depends on its size; else 0. A lag has a scale below 1, and the
                     time at which it has its size replaces it
    scale_parameter  name of the parameter of a finding that is this scale, or empty
    advised          names of the planned drives that carry out the ``experiment`` of the effect
    """

    columns: Callable[[DriveResponse, float], Array]
    per_drive: bool = False
    lags: bool = False
    scale: float = 0.0
    scale_parameter: str = ""
    advised: tuple[str, ...] = ()


def delay_tangent(response_filter: Filter, name: str) -> Tangent:
    """Return the tangent of a filter that delays by its only parameter, a time in s."""

    def columns(drive: DriveResponse, time_s: float) -> Array:
        read_m = response_filter(drive.static_m, drive.rate_Hz, {name: time_s})
        return np.asarray((read_m - drive.static_m)[:, None] / time_s)

    return Tangent(columns=columns, lags=True, scale=1e-4, advised=("small_multisine",))


@dataclass(frozen=True, kw_only=True, eq=False)
class ConstantDriveData:
    """Displacement recorded at constant drive.

    recording    with these readings
    axis         of the stage
    rows         (rows,)  samples that are used
    time_s       (rows,)
    detrended_m  (rows,)  readings without drift
    """

    recording: Recording
    axis: str
    rows: Places
    time_s: Array
    detrended_m: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultTest:
    """Detection of a fault of the data.

    find   (view) -> the fault, or None
    bound  (view) -> size of the largest undetected fault, as a share of the stroke
    """

    find: Callable[[View], Fault | None]
    bound: Callable[[View], float]


Without = Callable[[AxisModel, Recording], AxisModel | None]


def without_part(kind: type[Extension], *, lag: bool = False) -> Without:
    """Return a function that removes extensions of one kind; it returns None if there are none.

    lag  whether the effect is also represented by the lag of the model
    """

    def remove(axis: AxisModel, _: Recording) -> AxisModel | None:
        remaining = tuple(e for e in axis.extensions if not isinstance(e, kind))
        has_lag = lag and axis.lag.time_s > 0.0
        if len(remaining) == len(axis.extensions) and not has_lag:
            return None
        lag_model = Lag(kind="none", time_s=0.0) if lag else axis.lag
        return replace(axis, extensions=remaining, lag=lag_model)

    return remove


@dataclass(frozen=True, kw_only=True, eq=False)
class Structural:
    """Test of an effect that is part of the nuisance class and of the static model.

    null_without         (view) -> the nuisance class without the effect, as the null hypothesis
    structure            (structure, model, is_selected) -> the static structure of refits
    largest_noise_ratio  residual over noise above which this null counts as misspecified
    may_be_bouc_wen      whether a Bouc-Wen state may represent the effect
    """

    null_without: Callable[[View], Null]
    structure: Callable[[Structure, AxisModel, bool], Structure]
    largest_noise_ratio: float
    may_be_bouc_wen: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
    """Definition of one effect of the catalogue.

    name                as in diagnosis.json
    explanation         docstring of the file
    unit                of the size
    experiment          recording that shows the effect better or separates it from confounded
                        effects
    control             consequence for the control of the stage
    shows               coordinate along which the effect is visible
    tangent             predicted contribution along a drive; or why no drive shows it better
    confounded          names of effects that resemble it
    untestable          (view) -> why these recordings cannot show the effect; empty if they can
    trials              (view) -> physical trials and placebos
    columns             (view, parameters) -> contribution of the selected effect, (rows, columns),
                        linear in its coefficients; ignored beside a filter
    covariates          (view) -> columns that accompany the effect and are no evidence of it
    drive_filter        (drive, rate_Hz, parameters) -> drive of the stage, for effects in front of
                        the hysteresis; in half ranges
    response_filter     (response, rate_Hz, parameters) -> reading, for effects behind the
                        hysteresis without coefficients; in half strokes. The first parameter of
                        ``free`` must agree between recordings
    mode_filter         (response, rate_Hz, parameters) -> response through the whole mode, for an
                        effect whose coefficient is the share of the motion that takes part in it
    other_side          the same cause on the other side of the hysteresis
    between_recordings  the same cause if it acts between two recordings
    fault               detection, for faults of the data
    is_sensor_error     whether the effect is an error of the reading along the motion of the stage
    size                (view, parameters, coefficients) -> size in ``unit``; None: rms in percent
    note                (parameters) -> meaning of the parameters, for the explanation
    at_rest             (data) -> contribution at constant drive, (rows, columns), or why these
                        readings cannot show it; None: the effect needs a drive
    model_error         relative error of the size by the law of the effect (a spectrum that is not
                        even, a hold between samples), which blocks of rows cannot show. Two to
                        three times the worst of thirteen laws
                        (``python -m benchmarks.zoo.sizes``)
    may_be_absorbed     whether the nuisance class can follow the effect, so that its columns are
                        computed from a response without it
    may_be_loop_shape   whether the widest class of hysteresis can follow the effect along one
                        loop; a single recording then does not separate it from loop shape
    inject              (recording, share) -> the recording with the effect, a share of the stroke
    extend              (estimate, setting) -> extensions of the model with start values of a refit
    structural          test of an effect that is part of the nuisance class
    without             (model, recording) -> the model without the effect; None if it has none
    minimum_gain        smallest relative reduction of the held-out error
    detectable_share    share of the stroke from which it is detected at a noise of 0.05 %
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
    mode_filter: Filter | None = None
    other_side: "Effect | None" = None
    between_recordings: "Effect | None" = None
    fault: FaultTest | None = None
    is_sensor_error: bool = False
    size: Callable[[View, Parameters, Array], float] | None = None
    note: Callable[[Parameters], str] | None = None
    at_rest: Callable[[ConstantDriveData], Array | str] | None = None
    extend: Callable[[EffectEstimate, SearchScaling], tuple[Extension, ...]] | None = None
    structural: Structural | None = None
    without: Without = lambda *_: None
    model_error: float = 0.02
    minimum_gain: float = 0.05
    may_be_absorbed: bool = False
    may_be_loop_shape: bool = False
    detectable_share: float = 2e-3

    @property
    def summary(self) -> str:
        """Return the first paragraph of the explanation, on one line."""
        return " ".join(self.explanation.partition("\n\n")[0].split())

    def resembles(self, effect: "Effect") -> bool:
        """Tell whether the two effects are confounded."""
        return effect.name in self.confounded or self.name in effect.confounded
