"""ActuatorModel: what is known of a stage, axis by axis, with how well it is known."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from piezoid.errors import IdentificationError
from piezoid.identification.dynamics.hammerstein_record import JointFit
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.extensions.extension import Extension, Where
from piezoid.identification.hysteresis.filters import filter_columns, first_order, lag_of
from piezoid.identification.hysteresis.pieces import Rig, behind_pole
from piezoid.identification.tunnelling.model import TunnellingModel
from piezoid.numerics.arrays import Array, frozen
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.showing import shown

SCHEMA = "piezoid.model/1"


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
class Lag:
    """One time constant behind the hysteresis.

    kind     ``none``, ``delay`` or ``first_order``; at low frequency the last two are the same
    time_s   >= 0
    """

    kind: str
    time_s: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PieceStart:
    """Where one uninterrupted piece of a recording began.

    recording    its name
    memory_V     (plays,)  admissible states of u - u_off before the first sample
    zero_m       (knots,)  displacement at which the operator's output is 0, spread over the rows
    first, last  rows of the piece that counted
    """

    recording: str
    memory_V: Array
    zero_m: Array
    first: int
    last: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "memory_V", frozen(self.memory_V, "memory_V"))
        object.__setattr__(self, "zero_m", frozen(self.zero_m, "zero_m"))


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


@dataclass(frozen=True, kw_only=True)
class FitQuality:
    """How good the fit is, on what it saw and on what it did not.

    rms_m                residual on the data of the fit
    held_out_rms_m       free-run simulation error on rows the fit did not see
    held_out_kind        ``other recordings`` or ``second half``
    range_m              displacement range of the rows that counted
    noise_rms_m          white noise of the sensor, from third differences
    rows                 rows of the final search
    kkt_gap              of the convex start
    gradient             largest scaled derivative no bound holds, at the end of the search
    converged            whether the last step changed the cost by less than one part in 1e5
    orders               every shape tried, with its held-out error
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

    @property
    def held_out_rms_percent(self) -> float:
        """Held-out error in percent of the displacement range."""
        return 100.0 * self.held_out_rms_m / self.range_m


@dataclass(frozen=True, kw_only=True, eq=False)
class Uncertainty:
    """How well the parameters are known; intervals are 95 %, from leaving out blocks of cycles.

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
        for name, ndim in (
            ("values", 1),
            ("covariance", 2),
            ("reach_V", 1),
            ("loading_m", 1),
            ("loading_half_m", 1),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), name, ndim=ndim))


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


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisModel:
    """One axis of a stage.

    axis         its name
    hysteresis   y_off + Psi(H[u - u_off]), rising with the drive
    polarity     +1, or -1 where the displacement falls as the drive rises
    lag          behind the hysteresis, beyond what the rig declares
    rig          declared poles
    starts       one for every piece of every recording
    voltage_V    (low, high) range of the drive in the data: outside it the model extrapolates
    dynamics     from the hysteresis' output, as a drive, to the displacement, declared poles
                 included; None where no recording excites them
    joint        what the fit of hysteresis and dynamics together says; None where there is none
    extensions   what a diagnosis added, in the order in which they act
    """

    axis: str
    hysteresis: ModifiedPrandtlIshlinskii
    polarity: int
    lag: Lag
    rig: Rig
    starts: tuple[PieceStart, ...]
    voltage_V: tuple[float, float]
    verdict: Verdict
    quality: FitQuality
    uncertainty: Uncertainty
    certificate: Certificate
    dynamics: LinearDynamics | None = None
    joint: JointFit | None = None
    extensions: tuple[Extension, ...] = ()

    @property
    def virgin_memory_V(self) -> Array:
        """The de-poled state."""
        return self.hysteresis.virgin_memory()

    def simulate(
        self,
        voltage_V: Array,
        sampling_rate_Hz: float,
        memory_V: Array,
        where: Where | None = None,
    ) -> Array:
        """Return the displacement this axis makes of a drive.

        voltage_V         (samples,)  V
        sampling_rate_Hz  Hz
        memory_V          (plays,)    V, admissible, before the first sample
        where             the piece of a recording, for extensions that belong to one
        returned          (samples,)  m
        """
        here = where or Where(recording="", rate_Hz=sampling_rate_Hz, samples=len(voltage_V))
        moved_m = self.moved(voltage_V, memory_V, here)
        return self.read(self.hysteresis.displacement_offset_m + moved_m)

    def moved(self, voltage_V: Array, memory_V: Array, where: Where) -> Array:
        """Return the displacement away from the zero, before the sensor reads it, (samples,)."""
        driven = behind_pole(voltage_V, self.rig.amplifier_bandwidth_Hz, where.rate_Hz)
        for extension in self.extensions:
            driven = extension.drive(driven, where.rate_Hz)
        output_m = self._hysteresis_of(driven, memory_V, where.rate_Hz)
        moved_m = self.polarity * (output_m - self.hysteresis.displacement_offset_m)
        for extension in self.extensions:
            moved_m = extension.response(moved_m, where)
        lag = lag_of(self.lag.kind, self.lag.time_s, where.rate_Hz)
        lagged, _ = lag.run(moved_m[:, None])
        if self.rig.sensor_bandwidth_Hz is not None:
            time_s = 1.0 / (2 * np.pi * self.rig.sensor_bandwidth_Hz)
            state = np.repeat(lagged[:1], 2, axis=0)
            lagged = filter_columns(lagged, first_order(time_s, where.rate_Hz), state)
        total_m: Array = lagged[:, 0]
        for extension in self.extensions:
            total_m = total_m + extension.added(where)
        return total_m

    def read(self, position_m: Array) -> Array:
        """Return what the sensor says of a position."""
        for extension in self.extensions:
            position_m = extension.reading(position_m)
        return position_m

    def _hysteresis_of(self, driven_V: Array, memory_V: Array, rate_Hz: float) -> Array:
        """Return y_off + Psi(H[gamma(u - u_off)]), with what delays the irreversible part."""
        operator = self.hysteresis
        inner_V = operator.envelope.run(driven_V - operator.voltage_offset_V)
        h_m, _ = operator.plays.run(inner_V, memory_V)
        reversible_m = operator.plays.weight[0] * inner_V
        for extension in self.extensions:
            walls_m = h_m - reversible_m
            later_m = extension.irreversible(walls_m, rate_Hz)
            h_m = h_m if later_m is walls_m else reversible_m + later_m
        return operator.dead_zones.run(h_m) + operator.displacement_offset_m


@dataclass(frozen=True, kw_only=True, eq=False)
class ActuatorModel:
    """A whole stage.

    stage       its name
    axes        by name; none where only the tunnelling current was recorded
    sources     digest of every recording by name
    lab         digest of what lab.toml declared, or None
    tunnelling  the junction, where its current was recorded
    remarks     what was recorded and could not be used
    controller_rate_Hz  at which a controller will run, as the laboratory declares; None: unknown
    """

    stage: str
    axes: Mapping[str, AxisModel]
    sources: Mapping[str, str]
    lab: str | None = None
    tunnelling: TunnellingModel | None = None
    remarks: tuple[str, ...] = ()
    controller_rate_Hz: float | None = None

    def __getitem__(self, axis: str) -> AxisModel:
        """Return one axis, or refuse naming those there are."""
        if axis not in self.axes:
            raise IdentificationError(
                f"{self.stage}: no axis {axis!r} in the model, only {', '.join(self.axes)}",
                needed="an axis that was fitted",
                remedy="Fit a recording of that axis, or name another one.",
            )
        return self.axes[axis]

    def _repr_html_(self) -> str:
        return shown(f"Stage {self.stage}", [_shown(axis) for axis in self.axes.values()])

    @property
    def applies(self) -> bool:
        """Whether the model class applies to every axis."""
        return all(axis.verdict.applies for axis in self.axes.values())


def _shown(axis: AxisModel) -> tuple[str, str]:
    """Return one axis as a notebook shows it."""
    held, quality = axis.hysteresis, axis.quality
    if not axis.verdict.applies:
        return f"axis {axis.axis}", f"the model class does not apply: {axis.verdict.reason}"
    return (
        f"axis {axis.axis}",
        f"{len(held.plays.weight)} plays, {len(held.dead_zones.weight) - 1} dead zones; held-out "
        f"error {1e9 * quality.held_out_rms_m:.1f} nm rms, {quality.held_out_rms_percent:.3f} % "
        f"of the range; noise {1e9 * quality.noise_rms_m:.1f} nm rms",
    )
