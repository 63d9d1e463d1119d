"""Simulate whole recordings of the fit, piece by piece, from their fitted starts."""

import numpy as np

from piezoid.errors import IdentificationError
from piezoid.identification.extensions.extension import Where
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES
from piezoid.identification.model import AxisModel
from piezoid.identification.piece_start import PieceStart
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Quantity, Recording


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
        displacement_m[part] = axis_model.forward.read(zero_of(start, where.samples) + moved_m)
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
