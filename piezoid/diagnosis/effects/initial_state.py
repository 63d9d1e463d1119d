"""Initial state: the hysteresis depends on the drive before the recording.

What you see
    The error is large at the beginning of a recording and disappears once the drive has covered
    its range.
Why it happens
    The hysteresis depends on turning points of the drive that were not recorded.
How it is detected
    An initial state fitted for each recording explains its beginning better than the usual
    histories of a laboratory: a drive cycled over its range, a drive at rest, or recordings one
    after another.
What the extension adds
    An initial state for each recording.
Source
    Mayergoyz (1991); Krejci (1996)
"""

from dataclasses import replace

import numpy as np

from piezoid.diagnosis.effect import OVER_TIME, Effect, Structural, Trial
from piezoid.diagnosis.nuisance_search import with_shared_state_if_as_good
from piezoid.diagnosis.residual_view import View, with_free_memory
from piezoid.diagnosis.signals import with_added
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES
from piezoid.identification.model import AxisModel
from piezoid.records.recording import Recording

MIN_CHANGE = 1e-6  # of half the stroke: initial states that differ by less are equal


def _trials(view: View) -> list[Trial]:
    shared, free = with_shared_state_if_as_good(view), with_free_memory(view)
    columns = []
    for k in range(len(view.tracks)):
        drive = view.tracks[k].drive
        static = shared.nuisance.static_rows(k, view.weight, drive)
        columns.append(view.track_column(k, view.static[k][view.tracks[k].rows] - static))
    memory = free.nuisance.columns[:, list(free.nuisance.memory_columns)]
    columns_and_memory = np.column_stack([*columns, memory])
    has_change = np.abs(columns_and_memory).max(axis=0) > MIN_CHANGE
    return [Trial(columns=columns_and_memory[:, has_change])]


def _cycled(axis: AxisModel, recording: Recording) -> AxisModel:
    """Return the model with initial states of a drive that was cycled before each piece.

    This is the usual assumption about a stage with an unknown history.
    """
    voltage_V, (low_V, high_V) = recording.voltage_V(axis.axis), axis.voltage_V
    first_samples = (p.start for p in recording.pieces if p.stop - p.start >= MINIMUM_SAMPLES)
    starts = [start for start in axis.starts if start.recording != recording.name]
    for start, first in zip(axis.starts_of(recording), first_samples, strict=True):
        history_V = np.array([low_V, high_V, voltage_V[first]])
        _, memory_V = axis.hysteresis.run(history_V, axis.virgin_memory_V)
        starts.append(replace(start, memory_V=memory_V))
    return replace(axis, starts=tuple(starts))


def inject(recording: Recording, share: float) -> Recording:
    """Change the initial state: an error until the drive has moved by half its range."""
    drive_V = recording.voltage_V()
    span_V = np.maximum.accumulate(drive_V) - np.minimum.accumulate(drive_V)
    error = np.clip(1.0 - 2.0 * span_V / max(float(np.ptp(drive_V)), 1e-30), 0.0, 1.0)
    return with_added(recording, error, share)


EFFECT = Effect(
    name="initial_state",
    explanation=__doc__ or "",
    unit="% of the stroke, rms",
    experiment="Cycle the drive twice over its whole range before every recording, and begin the "
    "recording with one full cycle.",
    control="The first motion after switching on follows another branch: cycle the drive "
    "before precise work.",
    shows=OVER_TIME,
    tangent="its remedy is to cycle the drive first, as every planned drive does",
    confounded=("creep", "thermal_drift", "gain_change", "amplifier_saturation"),
    may_be_loop_shape=True,
    trials=_trials,
    structural=Structural(
        # one initial state shared by all recordings
        null_without=lambda view: with_shared_state_if_as_good(view).null,
        structure=lambda structure, _, is_selected: replace(structure, memory=is_selected),
        largest_noise_ratio=1.6,
    ),
    # On laws with slow decay of memory, usual laboratory histories appear as initial states of
    # 0.35 to 1.2 times the noise (rms), injected initial states of full size of 1.9 times and
    # more. A gain of 0.25 requires about 0.9 times.
    minimum_gain=0.25,
    inject=inject,
    without=_cycled,
)
