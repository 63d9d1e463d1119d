"""Quality of a fitted axis: verdict, errors, uncertainty of parameters, bound."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from piezoid.numerics.arrays import Array, freeze


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Whether this class of model applies to the axis, and why not.

    applies  False: the fit must not be used as a hysteresis model
    reason   one sentence with numbers; empty where it applies without remark
    remarks  weaknesses the reader should know: at-bound weights, unexcited thresholds, ...
    """

    applies: bool
    reason: str = ""
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Order:
    """One shape that was tried.

    plays, dead_zones  moving plays; dead zones besides the one at 0
    bends              kinks of the envelope, 0 for Kuhnen's model
    lag                kind
    held_out_rms_m     on rows the fit did not see
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


CLEAR_EXCESS = 1.1  # noise over the error of the model: third differences scatter by a few percent


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A gap of the recordings that no fit can close.

    lack    ``branch``, ``loop``, ``speed``, ``amplitude`` or ``recording``: there is only one;
            or the kind of what reading found odd, such as ``stands``
    reason  half a sentence
    most    score that a fit can have with it, 0 to 100
    """

    lack: str
    reason: str
    most: int


@dataclass(frozen=True, kw_only=True)
class FitQuality:
    """Errors of a fit, in sample and held out, and limits of its recordings.

    rms_m                residual on the data of the fit
    held_out_rms_m       free-run simulation error on rows the fit did not see
    held_out_kind        ``OTHER_RECORDINGS``, ``WIDEST_HALVED``, ``SECOND_HALF``, ``BLOCKS``, or
                         ``IN_SAMPLE``: then it is the residual on the data of the fit
    range_m              displacement range of the rows that counted
    noise_rms_m          of the sensor, from repeated periods or from third differences
    rows                 rows of the final search
    effective_parameters  numbers that the data determined: trace of the estimator's hat matrix
    kkt_gap              of the convex start
    gradient             largest scaled derivative no bound holds, at the end of the search
    converged            whether the last step changed the cost by less than one part in 1e5
    orders               every shape tried, with its held-out error
    limits               what was never measured, the gravest first
    noise_is_most        whether the drive moves the stage from sample to sample and never repeats,
                         so that the noise told is no more than what the model leaves
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

        Above the noise it says that a cause is missing; ``held_out_rms_m`` says what the same
        model is worth for drives that it has not seen.
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
    def lag_is_open(self) -> bool:
        """Whether lag and loop width cannot be separated: no loop was driven at two speeds."""
        return any(limit.lack in ("speed", "branch") for limit in self.limits)

    @property
    def held_out_rms_percent(self) -> float:
        """Held-out error in percent of the displacement range."""
        return 100.0 * self.held_out_rms_m / self.range_m


def with_noise_bound(quality: FitQuality) -> FitQuality:
    """Return the quality with a sensor noise that does not exceed the error of the model.

    The residual contains the noise. A noise that exceeds it clearly was estimated from the
    residual of a worse model, and is known as an upper limit only.
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

    blocks            how many blocks
    names             (parameters,)
    values            (parameters,)
    covariance        (parameters, parameters)
    upper_limit       one-sided limit by name, of weights that lie on 0
    reach_V           (points,)  rise of the drive from the middle of its range
    loading_m         (points,)  loading curve: what the de-poled model answers to that rise
    loading_half_m    (points,)  half its interval
    loop_width_m      opening of the full loop in its middle, and half its interval
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

    def updated(self, name: str, value: float, standard: float) -> "Uncertainty":
        """Replace the estimate of one number by that of another fit, uncorrelated with the rest.

        standard  error of the number; 0: unknown. Nothing changes if it is unknown, or not
                  smaller than the present error
        """
        index = self.names.index(name)
        if not 0.0 < standard < np.sqrt(self.covariance[index, index]):
            return self
        values, covariance = self.values.copy(), self.covariance.copy()
        values[index] = value
        covariance[index, :] = covariance[:, index] = 0.0
        covariance[index, index] = standard**2
        return replace(self, values=values, covariance=covariance)


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """A bound on the model's error for every drive in the range, at 95 % confidence.

        |error| <= plays_m + dead_zones_m + remainder_m
    plays_m       Lip(Psi) * integral |W_b - W| dr, 95 % quantile over refits
    dead_zones_m  sup |Psi_b - Psi|, 95 % quantile over refits
    remainder_m   99.9 % quantile of the held-out residual
    found_m       largest model difference an adversarial search of drives reached, 95 % quantile
                  over the same refits: how far the sum of the first two terms is from attained
    reach_V       valid for |u - u_off| <= reach_V
    slew_V_per_s  fastest drive in the data: valid up to there
    """

    plays_m: float
    dead_zones_m: float
    remainder_m: float
    found_m: float
    reach_V: float
    slew_V_per_s: float

    @property
    def bound_m(self) -> float:
        """The sum of the three terms."""
        return self.plays_m + self.dead_zones_m + self.remainder_m
