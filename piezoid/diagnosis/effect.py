"""What one effect must provide; the engine knows nothing else of it.

An effect is one file: an explanation in five headings, the trials that look for it, unphysical
twins of the same freedom that must do clearly worse, what it adds once it is accepted, its size.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from piezoid.diagnosis.folds import Null
from piezoid.diagnosis.found import Found, Setting
from piezoid.diagnosis.tracks import Track
from piezoid.diagnosis.view import View
from piezoid.identification.extensions.extension import Extension
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

HEADINGS = (
    "What you see",
    "Why it happens",
    "How it is detected",
    "What the extension adds",
    "Source",
)


Parameters = Mapping[str, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One way in which an effect may be there.

    columns     (rows, columns)  what it would add to the response
    parameters  nonlinear ones, by name with unit
    real        False: an unphysical twin, to calibrate by
    within      range of the first coefficient that physics allows
    least       size below which the first coefficient is none
    apart       part of the first column, by length, that the null must leave over: a lag at one
                frequency is a width of the loop
    alone       whether it is all that is wrong of its kind: where many shapes are missing, one of
                them is no more than the nearest
    free        parameters worth refining: by which factor (above 1) or step (below) to try
    limits      ranges of these; one that ends at its limit was not found
    """

    columns: Array
    parameters: Parameters = field(default_factory=dict)
    real: bool = True
    within: tuple[float, float] = (-float("inf"), float("inf"))
    least: float = 0.0
    apart: float = 0.0
    alone: bool = True
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

    def after(self, earlier: "Fault | None") -> "Fault":
        """Return this fault with what was found of it before: the larger size, the surer p."""
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


BETWEEN = "between recordings"


@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
    """One effect.

    name         as in diagnosis.json
    explanation  the file's docstring
    unit         of its size
    experiment   what to record to see it better, or to tell it from its rivals
    rivals       effects that look alike
    untestable   (view) -> why these recordings cannot show it, empty where they can
    trials       (view) -> trials, real ones and twins
    columns      (view, parameters) -> what the accepted effect adds, (rows, columns)
    beside       (view) -> columns that come with the effect and are no evidence of it
    drive        (drive, rate_Hz, parameters) -> what reaches the stage, for effects in front of it
    passes       (response, rate_Hz, parameters) -> what is read of it, for filters that all of the
                 response passes
    elsewhere    the same cause on the other side of the hysteresis, for filters that may be there
    between      the same cause where it comes between two recordings
    fault        (view) -> Fault or None, for faults of the data
    size         (view, parameters, coefficients) -> size in ``unit``; None: rms in percent
    against      (view) -> the null to beat, where it is not the view's own; such an effect is
                 judged at the end, when everything else is in
    known_to     part of the size that the law itself may be wrong by: a spectrum that is not even,
                 a hold between samples; blocks of rows know nothing of it. Two to three times
                 what the worst of thirteen laws asked for (``python -m benchmarks.zoo.sizes``)
    knee         part of the error that it must take off of a material that no class follows, or
                 it must be there beside a Bouc-Wen state in the class without it; 0: not asked
    rings        whether hysteresis may have been fitted to it, so that it must begin without
    inject       (recording, share) -> the recording with the effect, share of the stroke
    extend       (found, setting) -> what the model takes in, to be refitted from there
    sure         standard errors to ask for
    quiet        times the sensor's noise: where more is left, its null itself does not hold
    worth        part of the error on rows left out that it must take off
    common       whether ceramics have a little of it by themselves: all of that is then asked for
    shows_at     share of the stroke from which it is found on a rig with 0.05 % of noise
    least        share of the stroke below which it is not looked for
    bound        (view) -> share of the stroke that could be there and not be found, for faults
    """

    name: str
    explanation: str
    unit: str
    experiment: str
    inject: Callable[[Recording, float], Recording]
    rivals: tuple[str, ...] = ()
    untestable: Callable[[View], str] = lambda _: ""
    trials: Callable[[View], Sequence[Trial]] | None = None
    columns: Callable[[View, Parameters], Array] | None = None
    beside: Callable[[View], Array] | None = None
    drive: Callable[[Array, float, Parameters], Array] | None = None
    passes: Callable[[Array, float, Parameters], Array] | None = None
    elsewhere: "Effect | None" = None
    between: "Effect | None" = None
    fault: Callable[[View], Fault | None] | None = None
    bound: Callable[[View], float] | None = None
    size: Callable[[View, Parameters, Array], float] | None = None
    against: Callable[[View], Null] | None = None
    extend: Callable[[Found, Setting], tuple[Extension, ...]] | None = None
    known_to: float = 0.02
    quiet: float = float("inf")
    sure: float = 3.3  # 0.0005 on one side: a wrong cause is worse than one not named
    least: float = 1.2e-4
    worth: float = 0.03
    common: bool = False
    knee: float = 0.0
    rings: bool = False
    shows_at: float = 2e-3

    def resembles(self, other: "Effect") -> bool:
        """Tell whether one of the two may stand in the place of the other."""
        return other.name in self.rivals or self.name in other.rivals
