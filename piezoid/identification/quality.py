"""Quality of a fit: verdict, errors, uncertainty of parameters, error bound, confidence."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.robust import student_quantile


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Whether the model class applies to the axis, with the reason if it does not.

    applies  False: the fit must not be used as a hysteresis model
    reason   one sentence with numbers, or empty
    remarks  limitations of the fit: weights at bounds, thresholds beyond the drive, ...
    """

    applies: bool
    reason: str = ""
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Order:
    """One order of the hysteresis that was tried, with its error.

    plays           number of plays of non-zero width
    dead_zones      number of dead zones besides the linear one
    bends           number of kinks of the envelope, 0 for Kuhnen's model
    lag             kind of the lag
    held_out_rms_m  error on left-out rows
    """

    plays: int
    dead_zones: int
    bends: int
    lag: str
    held_out_rms_m: float


OTHER_RECORDINGS = "other recordings"
SECOND_HALF = "second half"
WIDEST_HALVED = "other recordings, second half of the widest"
BLOCKS = "blocks of several seconds, in five folds"
IN_SAMPLE = "none, one loop"
FOLDS = 5  # of ``BLOCKS``
NEVER_OUT = -1  # fold number of rows that are always used for training
CLEAR_EXCESS = 1.1  # noise over the error of the model: third differences scatter by a few percent


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A gap of the recordings that no fit can close.

    lack    ``branch``, ``loop``, ``speed``, ``amplitude`` or ``recording``, of which there is only
            one; or a fault of a recording, such as ``stands``
    reason  clause without capital and full stop
    most    largest score of a fit with this gap, 0 to 100
    """

    lack: str
    reason: str
    most: int


@dataclass(frozen=True, kw_only=True)
class FitQuality:
    """Errors of a fit, in sample and held out, and limits of its recordings.

    rms_m           residual on the rows of the fit
    held_out_rms_m  simulation error on left-out rows
    held_out_kind   ``OTHER_RECORDINGS``, ``WIDEST_HALVED``, ``SECOND_HALF``, ``BLOCKS``, or
                    ``IN_SAMPLE``: then ``held_out_rms_m`` is the residual on the rows of the fit
    range_m         displacement range of the fitted rows
    noise_rms_m     of the sensor, from repeated periods or from third differences
    rows            number of rows of the final search
    effective_parameters  number of parameters that the data determine: trace of the hat matrix
    kkt_gap         of the convex start
    gradient        largest scaled derivative of a parameter that is not at a bound, at the end
    converged       whether the last step changed the cost by less than the search's tolerance
    orders          all orders that were tried
    limits          gaps of the recordings, the most severe first
    noise_is_most   whether the noise is only an upper bound: the drive moves the stage between
                    samples and never repeats, so that noise cannot be separated from the residual
    """

    rms_m: float
    held_out_rms_m: float
    held_out_kind: str
    range_m: float
    noise_rms_m: float
    rows: int
    kkt_gap: float
    gradient: float
    converged: bool
    orders: tuple[Order, ...]
    limits: tuple[Limit, ...] = ()
    noise_is_most: bool = False
    effective_parameters: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rms_m", "held_out_rms_m", "range_m", "noise_rms_m"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)}, expected zero or more")

    @property
    def explained_rms_m(self) -> float:
        """Residual on the data of the fit, corrected for the effective number of parameters.

            explained^2 = rms^2 rows / (rows - effective parameters)

        If it exceeds the noise, the model lacks an effect. ``held_out_rms_m`` is the error to
        expect for other drives.
        """
        free = max(self.rows - self.effective_parameters, 1.0)
        return float(self.rms_m * np.sqrt(max(self.rows, 1) / free))

    @property
    def is_tested(self) -> bool:
        """Whether there are held-out data."""
        return self.held_out_kind != IN_SAMPLE

    @property
    def noise_bound(self) -> str:
        """Text in front of the noise: "at most " if it is an upper bound."""
        return "at most " if self.noise_is_most else ""

    @property
    def is_lag_ambiguous(self) -> bool:
        """Whether lag and loop width cannot be separated: no loop was recorded at two speeds."""
        return any(limit.lack in ("speed", "branch") for limit in self.limits)

    @property
    def held_out_rms_percent(self) -> float:
        """Held-out error in percent of the displacement range."""
        return 100.0 * self.held_out_rms_m / self.range_m


def with_noise_bound(quality: FitQuality) -> FitQuality:
    """Return the quality with a sensor noise that does not exceed the error of the model.

    The residual contains the noise. A noise that clearly exceeds the residual was estimated from
    the residual of a worse model; the smaller residual is then an upper bound of the noise.
    """
    bound_m = quality.explained_rms_m
    if quality.is_tested:
        bound_m = min(bound_m, quality.held_out_rms_m)
    if quality.noise_rms_m <= bound_m:
        return quality
    is_most = quality.noise_is_most or quality.noise_rms_m > CLEAR_EXCESS * bound_m
    return replace(quality, noise_rms_m=bound_m, noise_is_most=is_most)


@dataclass(frozen=True, kw_only=True, eq=False)
class Uncertainty:
    """Uncertainty of the parameters: 95 % intervals, from leaving out blocks of cycles.

    blocks          number of blocks
    names           (parameters,)
    values          (parameters,)
    covariance      (parameters, parameters)
    upper_limit     one-sided limits of weights that are 0, by name
    reach_V         (points,)  rise of the drive from the middle of its range
    loading_m       (points,)  response of the de-poled model to that rise
    loading_half_m  (points,)  half the interval of the response
    loop_width_m    width of the full loop in its middle, and half its interval
    """

    blocks: int
    names: tuple[str, ...]
    values: Array
    covariance: Array
    upper_limit: Mapping[str, float]
    reach_V: Array
    loading_m: Array
    loading_half_m: Array
    loop_width_m: tuple[float, float]

    def __post_init__(self) -> None:
        freeze(self, "values", "reach_V", "loading_m", "loading_half_m")
        freeze(self, "covariance", ndim=2)
        count = len(self.names)
        if self.values.shape != (count,) or self.covariance.shape != (count, count):
            raise ValueError(
                f"{count} names, values of shape {self.values.shape}, covariance of shape "
                f"{self.covariance.shape}"
            )

    @property
    def coverage(self) -> float:
        """Half a 95 % interval in standard errors, from Student's t for the number of blocks."""
        return float(student_quantile(0.975, max(self.blocks - 1, 1)))

    def standard_error(self, name: str) -> float:
        """Return the standard error of one parameter."""
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))

    def updated(self, name: str, value: float, standard: float) -> "Uncertainty":
        """Replace the estimate of one parameter by a more accurate one from another fit.

        standard  standard error of the value; nothing changes if it is 0, which means unknown, or
                  not smaller than the present one

        The new estimate is uncorrelated with the other parameters.
        """
        if not 0.0 < standard < self.standard_error(name):
            return self
        index = self.names.index(name)
        values, covariance = self.values.copy(), self.covariance.copy()
        values[index] = value
        covariance[index, :] = covariance[:, index] = 0.0
        covariance[index, index] = standard**2
        return replace(self, values=values, covariance=covariance)


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Bound on the model error for every drive in the range, at 95 % confidence.

        |error| <= plays_m + dead_zones_m + remainder_m

    plays_m       Lip(Psi) * integral |W_b - W| dr, 95 % quantile over refits
    dead_zones_m  sup |Psi_b - Psi|, 95 % quantile over refits
    remainder_m   99.9 % quantile of the held-out residual
    found_m       largest difference of two models in an adversarial search over drives, 95 %
                  quantile over the same refits; compare with plays_m + dead_zones_m
    reach_V       valid for |u - u_off| <= reach_V
    slew_V_per_s  fastest drive in the fitted rows, up to which the bound is valid
    """

    plays_m: float
    dead_zones_m: float
    remainder_m: float
    found_m: float
    reach_V: float
    slew_V_per_s: float

    @property
    def bound_m(self) -> float:
        """Sum of the three terms."""
        return self.plays_m + self.dead_zones_m + self.remainder_m


class Confidence(Enum):
    """Rating of a result of the tunnelling junction, from best to worst."""

    HIGH = "high"
    MEDIUM = "medium"
    LOW = "low"


Reason = tuple[Confidence, str]  # highest possible rating, and a sentence with numbers


def lowest_grade(reasons: Iterable[Reason]) -> tuple[Confidence, tuple[str, ...]]:
    """Return the lowest rating of the reasons (high without any), and their texts, worst first."""
    by_grade = sorted(reasons, key=lambda reason: reason[0] is not Confidence.LOW)
    grade = by_grade[0][0] if by_grade else Confidence.HIGH
    return grade, tuple(text for _, text in by_grade)
