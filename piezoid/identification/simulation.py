"""Simulate recordings of the fit from their fitted starts, and predict any recordings.

No model contains the initial state and the zero of a new recording. A prediction fits both, and
nothing else, to the displacement of the recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

from piezoid.errors import IdentificationError
from piezoid.formatting import with_unit
from piezoid.identification.extensions.extension import Where
from piezoid.identification.extensions.linear_mode import ROWS_AFTER_STEP, rows_after_steps
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, PieceStart, where_of
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array, freeze, same_length
from piezoid.records.recording import Quantity, Recording
from piezoid.summary import Summarised, Summary

if TYPE_CHECKING:
    from pandas import DataFrame

MAX_ROWS = 4000  # of a piece, to which memory and zero are fitted: hundreds of each would do
# Memory slopes from which the search starts: plays at the drive, after a fall, after a rise.
START_SLOPES = (0.0, 1.0, -1.0)
MAX_EVALUATIONS = 40


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedPiece:
    """One uninterrupted piece of a recording of the fit.

    samples    of the recording
    voltage_V  (samples,)
    where      location of the piece, for extensions
    start      fitted memory and zero
    """

    samples: slice
    voltage_V: Array
    where: Where
    start: PieceStart

    def simulate(self, axis_model: AxisModel) -> Array:
        """Simulate the displacement from the fitted start, (samples,) m."""
        start, where = self.start, self.where
        motion_m = axis_model.motion_m(self.voltage_V, start.memory_V, where, start.history_weight)
        return axis_model.forward.read(zero_of(start, where.samples) + motion_m, where)


def fitted_pieces(axis_model: AxisModel, recording: Recording) -> tuple[FittedPiece, ...]:
    """Return the pieces of a recording with their starts; empty if it was not fitted."""
    starts, pieces = axis_model.starts_of(recording), _long_pieces(recording)
    if not starts or len(starts) != len(pieces):
        return ()
    voltage_V = recording.voltage_V(axis_model.axis)
    return tuple(
        FittedPiece(
            samples=samples,
            voltage_V=voltage_V[samples],
            where=where_of(recording, axis_model.axis, samples),
            start=start,
        )
        for samples, start in zip(pieces, starts, strict=True)
    )


def _long_pieces(recording: Recording) -> list[slice]:
    return [p for p in recording.pieces if p.stop - p.start >= MINIMUM_SAMPLES]


def simulate_recording(axis_model: AxisModel, recording: Recording) -> Array:
    """Simulate the displacement of a recording that the model was fitted to.

        y[k] = Gamma[u](k) - y_off + sum_j zero_j hat_j(k)

    Gamma is the hysteresis with the extensions of the model. Each piece is simulated from its
    fitted memory, without feedback of measured values; its zero is interpolated between its knots.

    returned  (samples,)  m; NaN in pieces that are too short for a fit

    Raises ``IdentificationError`` if the model contains no starts for these pieces.
    """
    pieces = fitted_pieces(axis_model, recording)
    if not pieces:
        count, starts = len(_long_pieces(recording)), len(axis_model.starts_of(recording))
        raise IdentificationError(
            f"{recording.name}: {count} uninterrupted pieces of at least {MINIMUM_SAMPLES} "
            f"samples; the model of axis {axis_model.axis} contains the starts of {starts}",
            needed="a recording to which the model was fitted, under the same name",
            remedy="Pass the recordings of the fit, or fit again with this recording.",
        )
    displacement_m = np.full(recording.samples, np.nan)
    for piece in pieces:
        displacement_m[piece.samples] = piece.simulate(axis_model)
    return displacement_m


def simulate_fitted_rows(axis_model: AxisModel, recording: Recording) -> Array:
    """Return ``simulate_recording`` at the rows of the fit, and NaN at all other rows.

    A model with extensions or loop shape is not fitted to rows after an isolated step of the
    drive, whose instant between two samples is unknown.

    Raises ``IdentificationError`` as ``simulate_recording`` does.
    """
    displacement_m = simulate_recording(axis_model, recording)
    is_fitted = np.zeros(recording.samples, dtype=bool)
    half_range_V = 0.5 * (axis_model.voltage_V[1] - axis_model.voltage_V[0])
    for piece in fitted_pieces(axis_model, recording):
        first = piece.samples.start
        is_fitted[first + piece.start.first : first + piece.start.last] = True
        ringing = rows_after_steps(
            piece.voltage_V / half_range_V,
            piece.where.rate_Hz,
            axis_model.extensions,
            min_rows=0 if axis_model.loop_shape is None else ROWS_AFTER_STEP,
        )
        is_fitted[first + ringing] = False
    is_fitted[list(recording.bridged)] = False
    displacement_m[~is_fitted] = np.nan
    return displacement_m


def zero_of(start: PieceStart, samples: int) -> Array:
    """Return a piece's zero at its samples, (samples,), constant outside the fitted rows."""
    knots = np.linspace(start.first, max(start.last - 1, start.first), len(start.zero_m))
    if len(knots) == 1:
        return np.full(samples, start.zero_m[0])
    return np.interp(np.arange(samples), knots, start.zero_m)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Comparison(Summarised):
    """Measured and predicted displacement of one axis in one recording.

    time_s                   (samples,)  s from the first sample
    voltage_V                (samples,)
    measured_m, predicted_m  (samples,)
    counted                  as ``AxisModel.counted``
    """

    recording: str
    axis: str
    time_s: Array
    voltage_V: Array
    measured_m: Array
    predicted_m: Array
    counted: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        names = ("time_s", "voltage_V", "measured_m", "predicted_m")
        freeze(self, *names)
        same_length([(name, getattr(self, name)) for name in names])

    @property
    def error_m(self) -> Array:
        """Measured minus predicted displacement, (samples,)."""
        return np.asarray(self.measured_m - self.predicted_m)

    @property
    def rms_m(self) -> float:
        """Root mean square of the error."""
        return float(np.sqrt(np.mean(self.error_m**2)))

    @property
    def rms_percent(self) -> float:
        """Error in percent of the range of the displacement; infinite if it is constant."""
        range_m = float(np.ptp(self.measured_m))
        return 100.0 * self.rms_m / range_m if range_m > 0.0 else np.inf

    @property
    def largest_m(self) -> float:
        """Largest magnitude of the error."""
        return float(np.abs(self.error_m).max())

    def to_frame(self) -> "DataFrame":
        """Return a pandas DataFrame of the arrays and the error, a row for each sample.

        >>> list(model.compare(recordings["check.csv"]).to_frame())
        ['time_s', 'voltage_V', 'measured_m', 'predicted_m', 'error_m']
        """
        from pandas import DataFrame

        names = ("time_s", "voltage_V", "measured_m", "predicted_m", "error_m")
        return DataFrame({name: getattr(self, name) for name in names})

    def summary(self) -> Summary:
        """Return a table of the error: rms, share of the range, largest.

        >>> print(model.compare(recordings["check.csv"]).summary())
        Prediction of check.csv, axis x
        ...
        """
        return Summary(
            title=f"Prediction of {self.recording}, axis {self.axis}",
            rows=[
                ("error, rms", with_unit(self.rms_m, "m")),
                ("share of the range", f"{self.rms_percent:.2f} %"),
                ("largest error", with_unit(self.largest_m, "m")),
                ("samples", str(len(self.time_s))),
            ],
            counted=self.counted,
        )


def predict(model: AxisModel, recording: Recording) -> Array:
    """Predict the displacement for the drive of a recording, (samples,) m.

    The model is simulated piece by piece, without feedback of measured values. If the recording
    contains the displacement of the axis, the memory and a constant zero of each piece are fitted
    to it; for a recording of the fit, the fitted start is used if its residual is smaller.
    Without displacement, a piece starts de-poled at the zero of the model.

    Raises ``RecordingError`` if the drive of the axis is missing. Drift, hum and gain changes
    belong to recordings of the fit and are omitted for others. A constant error is not visible,
    because the zero is fitted.
    """
    drive_V = recording.voltage_V(model.axis)
    channel = recording.find(Quantity.DISPLACEMENT, model.axis)
    plays_only = replace(model, loop_shape=None)
    slopes = [np.full(len(model.hysteresis.gap), slope) for slope in START_SLOPES]
    predicted_m = np.empty(recording.samples)
    for piece in recording.pieces:
        voltage_V, where = drive_V[piece], where_of(recording, model.axis, piece)
        if channel is None:
            predicted_m[piece] = model.simulate(voltage_V, where.rate_Hz, None, where)
            continue
        # First the memory of the plays, with the loop shape of a de-poled state.
        measured_m = plays_m = channel.values[piece]
        if model.loop_shape is not None:
            depoled_V = model.virgin_memory_V
            shape_m = model.motion_m(voltage_V, depoled_V, where)
            plays_m = measured_m - (shape_m - plays_only.motion_m(voltage_V, depoled_V, where))
        memory_V, zero_m = fit_start(plays_only, voltage_V, plays_m, where, slopes)
        motion_m = model.motion_m(voltage_V, memory_V, where)
        if model.loop_shape is not None:
            driven_V = model.forward.driven_V(voltage_V, where.rate_Hz)
            changes_m = model.history_changes_m(driven_V, memory_V, where.rate_Hz)
            columns_m = model.polarity * model.forward.linear_response(changes_m, where)
            residual_m = measured_m - model.forward.read(zero_m + motion_m, where)
            # Then the weights of histories, which are of order one, by ridge regression:
            # a minimises |residual - columns a|^2 / error^2 + |a|^2, without the mean.
            error_m = max(model.quality.held_out_rms_m, np.finfo(float).tiny)
            columns = (columns_m - columns_m.mean(axis=0)) / error_m
            normal = columns.T @ columns + np.eye(columns.shape[1])
            weight = np.asarray(np.linalg.solve(normal, columns.T @ residual_m / error_m))
            motion_m = model.motion_m(voltage_V, memory_V, where, weight)
            zero_m += float(np.mean(measured_m - model.forward.read(zero_m + motion_m, where)))
        candidates = [model.forward.read(zero_m + motion_m, where)]
        for start in model.starts_of(recording):
            if start.last <= len(voltage_V):
                fit = FittedPiece(samples=piece, voltage_V=voltage_V, where=where, start=start)
                candidates.append(fit.simulate(model))
        errors = [float(np.sum((candidate - measured_m) ** 2)) for candidate in candidates]
        predicted_m[piece] = candidates[int(np.argmin(errors))]
    return predicted_m


def compare(model: AxisModel, recording: Recording) -> Comparison:
    """Compare a recording, which must contain the axis' displacement, with ``predict``."""
    measured_m = recording.displacement_m(model.axis)
    return Comparison(
        recording=recording.name,
        axis=model.axis,
        time_s=recording.time_s,
        voltage_V=recording.voltage_V(model.axis),
        measured_m=measured_m,
        predicted_m=predict(model, recording),
        counted=model.counted,
    )


def fit_start(
    model: AxisModel,
    voltage_V: Array,
    measured_m: Array,
    where: Where,
    slopes: Sequence[Array],
    zero_m: Array | float = 0.0,
) -> tuple[Array, float]:
    """Return the memory that fits a piece best, and the constant that is added to its zero.

        z_i(0) = v(0) + sum_(j<=i) d_j s_j,   -1 <= s_j <= 1, d_j between thresholds

    v is the drive behind declared amplifier and envelope; every such memory is admissible.

    slopes  (plays - 1,) each: s from which the search may start
    zero_m  (samples,) or one number
    """
    forward, gaps = model.forward, len(model.hysteresis.gap)
    driven_V = forward.driven_V(voltage_V[:1], where.rate_Hz)
    first = float(driven_V[0]) - model.hysteresis.voltage_offset_V
    every = max(1, len(voltage_V) // MAX_ROWS)
    scale_m = max(float(np.ptp(measured_m)), np.finfo(float).tiny)

    def response(slope: Array) -> Array:
        return zero_m + model.motion_m(voltage_V, forward.memory(first, slope), where)

    def residual(numbers: Array) -> Array:
        predicted_m = forward.read(numbers[-1] * scale_m + response(numbers[:-1]), where)
        return np.asarray((predicted_m - measured_m)[::every] / scale_m)

    starts = [
        np.append(slope, float(np.mean(measured_m - response(slope))) / scale_m)
        for slope in slopes
    ]
    best = min(starts, key=lambda numbers: float(np.sum(residual(numbers) ** 2)))
    limits = np.append(np.ones(gaps), np.inf)
    minimum = least_squares(
        residual,
        np.clip(best, -0.99 * limits, 0.99 * limits),
        bounds=(-limits, limits),
        diff_step=1e-4,
        max_nfev=MAX_EVALUATIONS,
    )
    return forward.memory(first, minimum.x[:-1]), float(minimum.x[-1] * scale_m)
