"""ActuatorModel: what is known of a stage, axis by axis, with how well it is known."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from piezoid.errors import IdentificationError
from piezoid.identification.dynamics.bandwidth import BandwidthVerdict
from piezoid.identification.dynamics.hammerstein_record import JointFit
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.response_record import ResponseFit
from piezoid.identification.extensions.extension import Extension, Where
from piezoid.identification.hysteresis.filters import lagged, relaxed
from piezoid.identification.hysteresis.pieces import Rig, behind_pole
from piezoid.identification.quality import Certificate, FitQuality, Uncertainty, Verdict
from piezoid.identification.tunnelling.model import TunnellingModel
from piezoid.numerics.arrays import Array, frozen
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.readable import told
from piezoid.showing import shown

SCHEMA = "piezoid.model/1"


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Discrepancy:
    """A second hysteresis that stands for what the model class does not follow.

        d[u] = sum_i sum_n weight_(n, i) (z_i / reach)^n,   z_i plays of u - centre

    threshold_V  (plays,)
    weight_m     (powers, plays)
    steepest_m_per_V  by how much it changes the slope of the response, at most
    """

    centre_V: float
    reach_V: float
    threshold_V: Array
    weight_m: Array
    steepest_m_per_V: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "threshold_V", frozen(self.threshold_V, "threshold_V"))
        object.__setattr__(self, "weight_m", frozen(self.weight_m, "weight_m", ndim=2))
        if self.weight_m.shape[1] != len(self.threshold_V) or not self.reach_V > 0:
            raise ValueError(
                f"{len(self.threshold_V)} thresholds, weights of shape {self.weight_m.shape}, "
                f"reach {self.reach_V} V"
            )


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
    bandwidth    what limits the stage first, a pole or a resonance; None where no recording
                 excites dynamics and no bandwidth is stated
    response     how the dynamics were found in a measured frequency response; None where they
                 were not
    extensions   what a diagnosis added, in the order in which they act
    discrepancy  what this class leaves of the recordings, for verification; None: not known
    dynamics_remarks  those of the verdict's remarks that tell how the dynamics were found
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
    bandwidth: BandwidthVerdict | None = None
    response: ResponseFit | None = None
    extensions: tuple[Extension, ...] = ()
    discrepancy: Discrepancy | None = None
    dynamics_remarks: tuple[str, ...] = ()

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
        total_m = lagged(moved_m, self.lag.kind, self.lag.time_s, where.rate_Hz)
        if self.rig.sensor_bandwidth_Hz is not None:
            time_s = 1.0 / (2 * np.pi * self.rig.sensor_bandwidth_Hz)
            total_m = relaxed(total_m, time_s, where.rate_Hz)
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
        f"error {told(quality.held_out_rms_m, 'm')} rms, {quality.held_out_rms_percent:.3f} % "
        f"of the range; noise {told(quality.noise_rms_m, 'm')} rms",
    )
