"""AxisModel: the identified model of one axis, with its uncertainty."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from piezoid.errors import IdentificationError, NotInvertibleError, RecordingError
from piezoid.formatting import significant, with_unit, words
from piezoid.identification.dynamics.bandwidth import BandwidthVerdict
from piezoid.identification.dynamics.modal import JointFit, LinearDynamics, ResponseFit
from piezoid.identification.extensions.extension import Extension, Where
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.forward import Forward
from piezoid.identification.hysteresis.pieces import PieceStart, Rig, Scales
from piezoid.identification.loop_shape import (
    LoopShape,
    histories,
    history_of,
    settling_samples,
)
from piezoid.identification.minor_loops import FunctionOrder, MinorLoops
from piezoid.identification.quality import Certificate, FitQuality, Uncertainty, Verdict
from piezoid.numerics.arrays import Array, freeze
from piezoid.operators.play import play_columns
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.preisach_plays import PreisachPlays
from piezoid.records.recording import Recording
from piezoid.summary import Summarised, Summary

SCHEMA = "piezoid.model/1"


@dataclass(frozen=True, kw_only=True)
class Lag:
    """Delay or time constant behind the hysteresis.

    kind    ``none``, ``delay`` or ``first_order``; at low frequency the last two are equivalent
    time_s  >= 0
    """

    kind: str
    time_s: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Discrepancy:
    """A second hysteresis that represents the model discrepancy.

        d[u] = sum_i sum_n weight_(n, i) (z_i / reach)^n,   z_i plays of u - centre

    threshold_V       (plays,)
    weight_m          (powers, plays)
    steepest_m_per_V  largest slope of the unexplained hysteresis
    """

    centre_V: float
    reach_V: float
    threshold_V: Array
    weight_m: Array
    steepest_m_per_V: float

    def __post_init__(self) -> None:
        freeze(self, "threshold_V")
        freeze(self, "weight_m", ndim=2)
        if self.weight_m.shape[1] != len(self.threshold_V) or not self.reach_V > 0:
            raise ValueError(
                f"{len(self.threshold_V)} thresholds, weights of shape {self.weight_m.shape}, "
                f"reach {self.reach_V} V"
            )

    def run(self, voltage_V: Array) -> Array:
        """Return d along a drive whose first sample follows rest at the centre, (samples,) m."""
        drive_V = np.ascontiguousarray(voltage_V - self.centre_V)
        memory_V = np.clip(0.0, drive_V[0] - self.threshold_V, drive_V[0] + self.threshold_V)
        states = play_columns(drive_V, self.threshold_V, memory_V)[0] / self.reach_V
        powers = enumerate(self.weight_m, start=1)
        return np.asarray(sum(states**n @ weight_m for n, weight_m in powers))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AxisModel(Summarised):
    """The identified model of one axis.

    axis         name of the axis
    hysteresis   y_off + Psi(H[u - u_off]), rising with the drive
    polarity     +1, or -1 if the displacement falls as the drive rises
    lag          behind the hysteresis, beyond the poles that the rig declares
    rig          declared poles
    starts       one for every piece of every recording
    voltage_V    (low, high) range of the drive in the data: outside it the model extrapolates
    dynamics     from the output of the hysteresis, as a drive, to the displacement, including
                 declared poles; None if no recording excites them
    joint        result of the joint fit of hysteresis and dynamics; None without such a fit
    bandwidth    which pole or resonance limits the bandwidth; None if no recording excites the
                 dynamics and no bandwidth is declared
    response     quality of the fit to a measured frequency response; None without one
    extensions   effects that a diagnosis added, in the order in which they act
    minor_loops  operator that replaces ``hysteresis`` in simulation, export and bounds; a
                 diagnosis still uses ``hysteresis``. None if it predicts no better
    function_orders  plays behind functions that were tried, the largest first
    loop_shape   hysteresis that no controller inverts, in addition to the weighted operator; None
                 if it predicts no better
    discrepancy  unexplained hysteresis, for verification; None if it is unknown
    dynamics_remarks  remarks of the verdict about the identification of the dynamics
    counted      which of ``displacement`` and ``voltage`` were recorded in converter counts:
                 values named in metres or volts are then counts, and nothing can be exported
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
    minor_loops: MinorLoops | None = None
    function_orders: tuple[FunctionOrder, ...] = ()
    loop_shape: LoopShape | None = None
    discrepancy: Discrepancy | None = None
    dynamics_remarks: tuple[str, ...] = ()
    counted: tuple[str, ...] = ()

    def summary(self) -> Summary:
        """Return a table of the error, the range and the parts of the model.

        >>> print(model["x"].summary())
        Axis x
        held-out error ...
        """
        quality, (low_V, high_V) = self.quality, self.voltage_V
        parts = [self.order]
        parts += ["loop shape"] if self.loop_shape is not None else []
        parts += [words(extension.kind) for extension in self.extensions]
        lag = self.lag
        delay = (
            "none" if lag.kind == "none" else f"{words(lag.kind)}, {with_unit(lag.time_s, 's')}"
        )
        error = (
            f"{with_unit(quality.held_out_rms_m, 'm')} rms, {quality.held_out_rms_percent:.2f} %"
        )
        rows = (
            ("held-out error", error),
            ("sensor noise", f"{quality.noise_bound}{with_unit(quality.noise_rms_m, 'm')} rms"),
            ("drive", f"{significant(low_V)} to {significant(high_V)} V"),
            ("parts", ", ".join(parts)),
            ("lag", delay),
        )
        return Summary(title=f"Axis {self.axis}", rows=rows, counted=self.counted)

    @property
    def order(self) -> str:
        """Number of plays of some width and of dead zones, as text.

        >>> model["x"].order.endswith("dead zones")
        True
        """
        plays = sum(width_V > 0.0 for width_V in self.hysteresis.plays.threshold)
        return f"{plays} plays, {len(self.hysteresis.dead_zones.weight) - 1} dead zones"

    @property
    def operator(self) -> ModifiedPrandtlIshlinskii | PreisachPlays:
        """The operator of simulation and export.

        >>> model["x"].operator is model["x"].hysteresis
        True
        """
        return self.hysteresis if self.minor_loops is None else self.minor_loops.operator

    @property
    def has_dynamics(self) -> bool:
        """Whether a resonance or a pole was fitted, to a response or by a diagnosis.

        >>> model["x"].has_dynamics
        False
        """
        is_mode = (isinstance(extension, LinearMode) for extension in self.extensions)
        return self.dynamics is not None or any(is_mode)

    @property
    def unfitted_resonance_Hz(self) -> float | None:
        """Frequency of a resonance that is visible in recordings but not modelled, or None.

        >>> model["x"].unfitted_resonance_Hz
        """
        if self.bandwidth is None or self.has_dynamics:
            return None
        return self.bandwidth.resonance_Hz

    def without_loop_shape(self) -> "AxisModel":
        """Return the fit of plays with dead zones alone, without loop shape and minor loops.

        >>> model["x"].without_loop_shape().loop_shape is None
        True
        """
        if self.loop_shape is not None:
            shape_fit = self.loop_shape.plain
            axis = replace(
                self,
                loop_shape=None,
                lag=replace(self.lag, time_s=shape_fit.lag_s),
                quality=shape_fit.quality,
                starts=shape_fit.starts,
            )
            return axis.without_loop_shape()
        if self.minor_loops is None:
            return self
        plays_fit = self.minor_loops.plain
        quality = replace(
            self.quality,
            rms_m=plays_fit.rms_m,
            held_out_rms_m=plays_fit.held_out_rms_m,
            held_out_kind=plays_fit.held_out_kind,
        )
        return replace(
            self,
            minor_loops=None,
            quality=quality,
            certificate=plays_fit.certificate,
            starts=plays_fit.starts,
        )

    def starts_of(self, recording: Recording) -> tuple[PieceStart, ...]:
        """Return the starts of a recording's pieces, in their order; empty if it was not fitted.

        >>> len(model["x"].starts_of(recordings["check.csv"]))
        1
        """
        return tuple(start for start in self.starts if start.recording == recording.name)

    @property
    def virgin_memory_V(self) -> Array:
        """The de-poled state."""
        return self.hysteresis.virgin_memory()

    @property
    def zero_m(self) -> float:
        """Displacement at which the output of the hysteresis is 0, mean over the recordings."""
        return self.hysteresis.displacement_offset_m

    def simulate(
        self,
        voltage_V: ArrayLike,
        sampling_rate_Hz: float,
        memory_V: Array | None = None,
        where: Where | None = None,
        *,
        zero_m: float | None = None,
    ) -> Array:
        """Simulate the displacement of this axis for a drive.

        voltage_V         (samples,)  V
        sampling_rate_Hz  Hz
        memory_V          (plays,)    V, admissible, before the first sample; None: de-poled
        where             the piece of a recording, for extensions that depend on it
        zero_m            m; None: ``zero_m`` of the model
        returned          (samples,)  m

        A stage that was driven before is not de-poled. Let the drive begin with a loop over the
        range, and discard the displacement of that loop.

        >>> y_m = model["x"].simulate([0.0, 5.0, 10.0, 5.0], 1000.0)
        >>> bool(y_m[3] > y_m[1])  # the falling branch lies above the rising one
        True
        """
        drive_V = _finite_samples(voltage_V, f"the drive of axis {self.axis}", "V")
        piece = where or Where(recording="", rate_Hz=sampling_rate_Hz, samples=len(drive_V))
        motion_m = self.motion_m(drive_V, self._memory(memory_V), piece)
        position_m = (self.zero_m if zero_m is None else zero_m) + motion_m
        return self.forward.read(position_m, piece)

    def inverse(
        self,
        displacement_m: ArrayLike,
        memory_V: Array | None = None,
        *,
        zero_m: float | None = None,
    ) -> Array:
        """Return the voltage at which the hysteresis reaches this displacement.

            u = u_off + gamma^-1(H^-1[Psi^-1(y - y_off)])                     [Kuhnen 2003]

        If the model has loop shape, the whole displacement is iterated until plays and loop shape
        reach it (``LoopShape.inverse_V``).

        displacement_m  (samples,)  m
        memory_V        (plays,)    V, before the first sample; None: de-poled
        zero_m          m; None: ``zero_m`` of the model
        returned        (samples,)  V

        Only the hysteresis is inverted, not lag, dynamics and effects of a diagnosis; voltages
        outside ``voltage_V`` extrapolate. Raises ``NotInvertibleError`` for weights without an
        inverse.

        >>> reference_m = model["x"].zero_m + np.array([0.0, 1e-6, 0.0])
        >>> model["x"].inverse(reference_m).shape
        (3,)
        """
        if not self.hysteresis.is_invertible:
            min_slope_m_per_V, _ = self.hysteresis.slope_sector_m_per_V
            raise NotInvertibleError(
                f"axis {self.axis}: the flattest branch has a slope of {min_slope_m_per_V:g} m/V",
                needed="a hysteresis that rises everywhere",
                remedy="Fit recordings over a range in which it rises.",
            )
        name = f"the displacement of axis {self.axis}"
        reference_m = _finite_samples(displacement_m, name, "m")
        zero = self.zero_m if zero_m is None else zero_m
        output_m = self.polarity * (reference_m - zero) + self.hysteresis.displacement_offset_m
        memory = self._memory(memory_V)
        states_V = self._states_V(memory)
        if self.loop_shape is None:
            return self.operator.inverse_run(output_m, states_V)[0]
        return self.loop_shape.inverse_V(
            output_m - self.hysteresis.displacement_offset_m,
            self.operator,
            states_V,
            history_of(self.hysteresis, memory, self.loop_shape),
        )

    def memory_at(self, threshold_V: Array, memory_V: Array) -> Array:
        """Return the states of plays of other half-widths without an envelope, (plays,).

        The play of zero width shows the last drive. The differences of the states from it are
        interpolated over the half-width.

        >>> model["x"].memory_at(np.array([0.0, 1.0]), model["x"].virgin_memory_V).tolist()
        [0.0, 0.0]
        """
        drive_V = self.hysteresis.envelope.inverse().run(memory_V[:1])
        difference_V = memory_V - memory_V[0]
        threshold = self.hysteresis.plays.threshold
        return np.asarray(drive_V + np.interp(threshold_V, threshold, difference_V))

    def _states_V(self, memory_V: Array) -> Array:
        """Convert states of the plays of ``hysteresis`` to those of ``operator``."""
        if self.minor_loops is None:
            return memory_V
        return self.memory_at(self.minor_loops.operator.threshold_V, memory_V)

    def _memory(self, memory: Array | None) -> Array:
        """Return the memory before the first sample, or raise an error for another length."""
        if memory is None:
            return self.virgin_memory_V
        memory_V, plays = np.asarray(memory, dtype=np.float64), len(self.hysteresis.plays.weight)
        if memory_V.shape != (plays,):
            raise IdentificationError(
                f"axis {self.axis}: a memory of shape {memory_V.shape}",
                needed=f"the state of each of its {plays} plays",
                remedy="Pass virgin_memory_V, or memory_V of one of its starts.",
            )
        return memory_V

    def motion_m(
        self,
        voltage_V: Array,
        memory_V: Array,
        where: Where,
        history_weight: Array | None = None,
    ) -> Array:
        """Simulate the position relative to the zero, in front of the sensor, (samples,) m.

        history_weight  as in ``PieceStart``; None: no other history than that of ``memory_V``

        >>> from piezoid.identification.extensions.extension import Where
        >>> where = Where(recording="", rate_Hz=1000.0, samples=3)
        >>> memory_V = model["x"].virgin_memory_V
        >>> model["x"].motion_m(np.array([0.0, 5.0, 10.0]), memory_V, where).shape
        (3,)
        """
        forward = self.forward
        driven_V = forward.driven_V(voltage_V, where.rate_Hz)
        static_m = self.static_m(driven_V, memory_V, where.rate_Hz)
        if history_weight is not None and np.any(history_weight):
            count = len(history_weight)
            changes_m = self.history_changes_m(driven_V, memory_V, where.rate_Hz, count)
            static_m = static_m + changes_m @ history_weight
        return forward.position(static_m, where)

    @property
    def forward(self) -> Forward:
        """The forward model in volts and metres, relative to the offsets of the hysteresis.

        >>> model["x"].forward.lag == model["x"].lag.kind
        True
        """
        return Forward(
            operator=self.hysteresis,
            lag=self.lag.kind,
            lag_s=self.lag.time_s,
            amplifier_Hz=self.rig.amplifier_bandwidth_Hz,
            sensor_Hz=self.rig.sensor_bandwidth_Hz,
            extensions=self.extensions,
            scales=Scales(
                voltage_V=1.0,
                voltage_offset_V=self.hysteresis.voltage_offset_V,
                displacement_m=float(self.polarity),
            ),
        )

    def static_m(self, driven_V: Array, memory_V: Array, rate_Hz: float) -> Array:
        """Simulate the static response a Psi(H[gamma(u - u_off)]) + L[u], (samples,) m.

        Its irreversible part may be delayed, and then depends on the sampling rate.

        >>> u, memory = np.array([0.0, 5.0]), model["x"].virgin_memory_V
        >>> model["x"].static_m(u, memory, 1000.0).shape
        (2,)
        """
        static_m = self.invertible_m(driven_V, memory_V, rate_Hz)
        if self.loop_shape is None:
            return static_m
        history = history_of(self.hysteresis, memory_V, self.loop_shape)
        static_m = self.loop_shape.plays_weight * static_m
        return np.asarray(static_m + self.loop_shape.response(driven_V, history))

    def invertible_m(self, driven_V: Array, memory_V: Array, rate_Hz: float) -> Array:
        """Simulate the part of the static response that a controller inverts, (samples,) m.

        >>> u, memory = np.array([0.0, 5.0]), model["x"].virgin_memory_V
        >>> model["x"].invertible_m(u, memory, 1000.0).shape
        (2,)
        """
        if self.minor_loops is not None:
            output_m, _ = self.operator.run(driven_V, self._states_V(memory_V))
            return output_m - self.hysteresis.displacement_offset_m
        drive_V = driven_V - self.hysteresis.voltage_offset_V
        return self.forward.static(drive_V, memory_V, rate_Hz)[0]

    def memory_after(self, turns_V: Array) -> Array:
        """Simulate the states of the plays after reversals of the drive, (plays,).

        >>> x = model["x"]
        >>> x.memory_after(np.array([10.0, 0.0])).shape == x.virgin_memory_V.shape
        True
        """
        inner_V = self.forward.inner(turns_V - self.hysteresis.voltage_offset_V)
        return self.hysteresis.plays.run(inner_V, self.virgin_memory_V)[1]

    def history_changes_m(
        self, driven_V: Array, memory_V: Array, rate_Hz: float, count: int | None = None
    ) -> Array:
        """Simulate how other histories change the static response, (samples, histories) m.

        driven_V  (samples,)  V, in front of the hysteresis
        memory_V  (plays,)    V, of the reference history
        count     number of histories; None: all

        >>> u, memory = np.array([0.0, 5.0]), model["x"].virgin_memory_V
        >>> model["x"].history_changes_m(u, memory, 1000.0).shape[0]
        2
        """
        shape = self.loop_shape
        if shape is None:
            return np.zeros((len(driven_V), 0))
        scaled = shape.scaled(driven_V)
        stop = settling_samples(scaled)
        drive_V = driven_V[:stop]
        base_m = self.static_m(drive_V, memory_V, rate_Hz)
        candidates = histories(float(scaled[0]))[:count]
        changes_m = np.zeros((len(driven_V), len(candidates)))
        for number, history in enumerate(candidates):
            history_memory_V = self.memory_after(shape.turns_V(history))
            changes_m[:stop, number] = (
                shape.plays_weight * self.invertible_m(drive_V, history_memory_V, rate_Hz)
                + shape.response(drive_V, history)
                - base_m
            )
        return changes_m


def _finite_samples(signal: ArrayLike, name: str, unit: str) -> Array:
    """Convert a signal to finite samples, (samples,), or raise ``RecordingError``."""
    values = np.asarray(signal, dtype=np.float64)
    if values.ndim != 1 or not len(values):
        raise RecordingError(
            f"{name} has shape {values.shape}",
            needed=f"one number in {unit} for each sample, shape (samples,)",
            remedy="Pass each axis by itself.",
        )
    if not np.isfinite(values).all():
        sample = int(np.flatnonzero(~np.isfinite(values))[0])
        raise RecordingError(
            f"{name} is {values[sample]} at sample {sample}",
            needed="finite numbers",
            remedy="Remove or interpolate the samples that are not finite.",
        )
    return values
