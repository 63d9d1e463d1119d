"""Simulate recordings of the fit from their fitted starts, and predict any recordings.

A recording begins with a memory and at a zero that no model can know. For a prediction both are
taken from its own displacement, and nothing else of it; the operator stays what was fitted.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

from piezoid.formatting import with_unit
from piezoid.identification.extensions.extension import Where
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array, freeze, same_length
from piezoid.records.recording import Quantity, Recording
from piezoid.summary import Summarised, Summary

if TYPE_CHECKING:
    from pandas import DataFrame


from piezoid.errors import IdentificationError
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES
from piezoid.identification.piece_start import PieceStart

ROWS = 4000  # of a piece, to which memory and zero are fitted: hundreds of each would do
# Memory slopes from which the search begins: at rest, left by a fall, left by a rise.
BEGINNINGS = (0.0, 1.0, -1.0)
STEPS = 40


def starts_of(axis_model: AxisModel, recording: Recording) -> tuple[PieceStart, ...]:
    """Return the starts of a recording's pieces, in their order; empty if it was not fitted."""
    return tuple(start for start in axis_model.starts if start.recording == recording.name)


def simulate_recording(axis_model: AxisModel, recording: Recording) -> Array:
    """Simulate the displacement of a recording that the model was fitted to.

        y[k] = Gamma[u](k) - y_off + sum_j zero_j hat_j(k)
    with the model's extensions around Gamma. Every piece runs free from its fitted memory; its
    zero is interpolated between its own knots.

    returned  (samples,)  m; NaN in pieces too short to have been fitted

    Raises ``IdentificationError`` where the recording's pieces are not those the model knows.
    """
    starts = starts_of(axis_model, recording)
    pieces = [p for p in recording.pieces if p.stop - p.start >= MINIMUM_SAMPLES]
    if len(starts) != len(pieces) or not starts:
        raise IdentificationError(
            f"{recording.name}: {len(pieces)} uninterrupted pieces of at least {MINIMUM_SAMPLES} "
            f"samples, the model of axis {axis_model.axis} holds the start of {len(starts)}",
            needed="the recording the model was fitted on, each under a name of its own",
            remedy="Give the recordings of the fit, or fit again with this one.",
        )
    displacement_m = np.full(recording.samples, np.nan)
    for part, start in zip(pieces, starts, strict=True):
        where = where_of(recording, axis_model.axis, part)
        voltage_V = recording.voltage_V(axis_model.axis)[part]
        moved_m = axis_model.moved(voltage_V, start.memory_V, where, start.history_weight)
        position_m = zero_of(start, where.samples) + moved_m
        displacement_m[part] = axis_model.forward.read(position_m, where)
    return displacement_m


def simulate_fitted_rows(axis_model: AxisModel, recording: Recording) -> Array:
    """Return ``simulate_recording`` at the rows of the fit, and NaN at rows that it left out.

    Raises ``IdentificationError`` as ``simulate_recording`` does.
    """
    displacement_m = simulate_recording(axis_model, recording)
    is_fitted = np.zeros(recording.samples, dtype=bool)
    parts = [p for p in recording.pieces if np.isfinite(displacement_m[p]).all()]
    for part, start in zip(parts, starts_of(axis_model, recording), strict=True):
        is_fitted[part.start + start.first : part.start + start.last] = True
    is_fitted[list(recording.bridged)] = False
    displacement_m[~is_fitted] = np.nan
    return displacement_m


def where_of(recording: Recording, axis: str, part: slice) -> Where:
    """Return the location of a piece for extensions, with the drives of other axes that move."""
    other_drives = {
        channel.axis: channel.values[part]
        for channel in recording.channels
        if channel.quantity is Quantity.VOLTAGE
        and channel.axis != axis
        and np.ptp(channel.values) > 0.0
    }
    return Where(
        recording=recording.name,
        rate_Hz=recording.sampling_rate_Hz,
        first=part.start,
        samples=part.stop - part.start,
        others_V=other_drives,
    )


def zero_of(start: PieceStart, samples: int) -> Array:
    """Return a piece's zero at its samples, (samples,), constant outside the rows that counted."""
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
        """Measured less predicted, (samples,)."""
        return np.asarray(self.measured_m - self.predicted_m)

    @property
    def rms_m(self) -> float:
        """Root of the mean squared error."""
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

    The drive runs free through the model, piece by piece. Where the recording holds the axis'
    displacement, each piece's memory and constant zero are fitted to it, or those of the fit
    taken, whichever leaves less; without, it begins de-poled at the zero of the fit.

    Raises ``RecordingError`` where the axis' drive is missing. What goes wrong: drift, hum and
    gain changes belong to recordings of the fit, of others they are left out; a constant error
    cannot show, for the zero is fitted.
    """
    voltage_V = recording.voltage_V(model.axis)
    channel = recording.find(Quantity.DISPLACEMENT, model.axis)
    predicted_m = np.empty(recording.samples)
    for part in recording.pieces:
        where = where_of(recording, model.axis, part)
        if channel is None:
            free = model.simulate(voltage_V[part], where.rate_Hz, None, where)
        else:
            free = _followed(model, voltage_V[part], channel.values[part], where)
        predicted_m[part] = free
    return predicted_m


def compare(model: AxisModel, recording: Recording) -> Comparison:
    """Return a recording beside ``predict``; it must hold the axis' displacement."""
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


def _followed(model: AxisModel, voltage_V: Array, measured_m: Array, where: Where) -> Array:
    """Predict a piece from the start with the smallest residual."""
    prediction = _from_own_start(model, voltage_V, measured_m, where)
    for start in model.starts:
        if start.recording == where.recording and start.last <= len(voltage_V):
            moved_m = model.moved(voltage_V, start.memory_V, where, start.history_weight)
            alternative = model.forward.read(zero_of(start, where.samples) + moved_m, where)
            prediction = min(
                prediction,
                alternative,
                key=lambda candidate: float(np.sum((candidate - measured_m) ** 2)),
            )
    return prediction


def _from_own_start(model: AxisModel, voltage_V: Array, measured_m: Array, where: Where) -> Array:
    """Predict a piece from the memory, the history and the zero that fit it best.

    The memory of the plays is fitted first, beside loop shape from a de-poled state; then the
    weights of histories, numbers of order one, by ridge regression.
    """
    if model.loop_shape is None:
        memory_V, zero_m = _fitted_start(model, voltage_V, measured_m, where)
        return model.forward.read(zero_m + model.moved(voltage_V, memory_V, where), where)
    plays_only, depoled_V = replace(model, loop_shape=None), model.virgin_memory_V
    shape_m = model.moved(voltage_V, depoled_V, where) - plays_only.moved(
        voltage_V, depoled_V, where
    )
    memory_V, zero_m = _fitted_start(plays_only, voltage_V, measured_m - shape_m, where)
    driven_V = model.forward.driven_V(voltage_V, where.rate_Hz)
    changes_m = model.history_changes_m(driven_V, memory_V, where.rate_Hz)
    columns_m = model.polarity * model.forward.behind(changes_m, where)
    moved_m = model.moved(voltage_V, memory_V, where)
    residual_m = measured_m - model.forward.read(zero_m + moved_m, where)
    # The a with |residual - columns a|^2 / error^2 + |a|^2 least, beside a constant.
    error_m = max(model.quality.held_out_rms_m, np.finfo(float).tiny)
    columns = (columns_m - columns_m.mean(axis=0)) / error_m
    normal = columns.T @ columns + np.eye(columns.shape[1])
    weight = np.asarray(np.linalg.solve(normal, columns.T @ residual_m / error_m))
    moved_m = model.moved(voltage_V, memory_V, where, weight)
    zero_m += float(np.mean(measured_m - model.forward.read(zero_m + moved_m, where)))
    return model.forward.read(zero_m + moved_m, where)


def _fitted_start(
    model: AxisModel, voltage_V: Array, measured_m: Array, where: Where
) -> tuple[Array, float]:
    """Return the memory and the zero that fit a piece best.

        z_i(0) = v(0) + sum_(j<=i) d_j s_j,   -1 <= s_j <= 1, d_j between thresholds

    v is the drive behind envelope and declared amplifier; every such memory is admissible.
    """
    forward, gaps = model.forward, len(model.hysteresis.gap)
    driven_V = forward.driven_V(voltage_V[:1], where.rate_Hz)
    first = float(driven_V[0]) - model.hysteresis.voltage_offset_V
    every = max(1, len(voltage_V) // ROWS)
    scale_m = max(float(np.ptp(measured_m)), np.finfo(float).tiny)

    def response(slope: Array) -> Array:
        return model.moved(voltage_V, forward.memory(first, slope), where)

    def residual(numbers: Array) -> Array:
        predicted_m = forward.read(numbers[-1] * scale_m + response(numbers[:-1]), where)
        return np.asarray((predicted_m - measured_m)[::every] / scale_m)

    def start_at(slope: float) -> Array:
        slopes = np.full(gaps, slope)
        return np.append(slopes, float(np.mean(measured_m - response(slopes))) / scale_m)

    starts = map(start_at, BEGINNINGS)
    best = min(starts, key=lambda numbers: float(np.sum(residual(numbers) ** 2)))
    limits = np.append(np.ones(gaps), np.inf)
    minimum = least_squares(
        residual,
        np.clip(best, -0.99 * limits, 0.99 * limits),
        bounds=(-limits, limits),
        diff_step=1e-4,
        max_nfev=STEPS,
    )
    return forward.memory(first, minimum.x[:-1]), float(minimum.x[-1] * scale_m)
