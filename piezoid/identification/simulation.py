"""What the model says a whole recording should look like, piece by piece, from its own start."""

import numpy as np

from piezoid.errors import IdentificationError
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES
from piezoid.identification.model import AxisModel, PieceStart
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording


def starts_of(axis_model: AxisModel, recording: Recording) -> tuple[PieceStart, ...]:
    """Return the starts of a recording's pieces, in their order; empty if it was not fitted."""
    return tuple(start for start in axis_model.starts if start.recording == recording.name)


def simulate_recording(axis_model: AxisModel, recording: Recording) -> Array:
    """Return the displacement the model makes of a recording it was fitted on.

        y[k] = Gamma[u](k) - y_off + sum_j zero_j hat_j(k)
    Every piece runs free from its fitted memory; its zero is interpolated between its own knots.

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
    voltage_V = recording.voltage_V(axis_model.axis)
    displacement_m = np.full(recording.samples, np.nan)
    for part, start in zip(pieces, starts, strict=True):
        displacement_m[part] = _piece(axis_model, voltage_V[part], recording, start)
    return displacement_m


def _piece(
    axis_model: AxisModel, voltage_V: Array, recording: Recording, start: PieceStart
) -> Array:
    moved_m = axis_model.simulate(voltage_V, recording.sampling_rate_Hz, start.memory_V)
    zero_m = zero_of(start, len(voltage_V))
    return np.asarray(moved_m - axis_model.hysteresis.displacement_offset_m + zero_m)


def zero_of(start: PieceStart, samples: int) -> Array:
    """Return a piece's zero at its samples, (samples,), constant outside the rows that counted."""
    knots = np.linspace(start.first, max(start.last - 1, start.first), len(start.zero_m))
    if len(knots) == 1:
        return np.full(samples, start.zero_m[0])
    return np.interp(np.arange(samples), knots, start.zero_m)
