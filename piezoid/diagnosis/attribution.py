"""What a search found, put into the fitted model of an axis: errors with and without each finding.

A fault is repaired in the recordings themselves, so that the model meets what the search met.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.budget import relative_scatter
from piezoid.diagnosis.effect import EffectEstimate
from piezoid.diagnosis.refit import Refitted, refitted
from piezoid.diagnosis.residual_structure import SearchResult, with_it
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.selection import Outcome
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, Scales
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording


@dataclass(frozen=True, kw_only=True)
class ModelErrors:
    """Errors on rows left out, in scaled units.

    baseline  of the raw recordings
    final     with everything found
    without   with everything found but one, by its name
    scatter   relative standard error of the mean square of the final error
    model     what ships with everything found
    """

    baseline: float
    final: float
    without: Mapping[str, float]
    scatter: float
    model: AxisModel


Tracks = Sequence[Track]


def attribute_errors(
    result: SearchResult,
    recordings: Sequence[Recording],
    *,
    model: AxisModel,
    lab: Lab,
    scales: Scales,
    progress: Callable[[str], None] = lambda _: None,
) -> ModelErrors:
    """Return what the model leaves before, after, and without each thing that was found.

    recordings  those of the search, as they came
    model       the axis as fitted to them, or to earlier ones
    scales      of the search
    """
    outcome = result.outcome
    found = [
        EffectEstimate(
            effect=cause.effect.name,
            parameters=cause.selected.parameters,
            coefficient=cause.cv.coefficient,
            from_jumps=cause.selected.from_jumps,
        )
        for cause in outcome.causes
    ]
    mended = mending(outcome)
    clean, raw, whole = outcome.clean.tracks, result.raw.tracks, None
    before = clean
    if result.discovered is not None:
        before = with_it(outcome.clean, result.discovered).tracks
        whole = repaired(recordings, model.axis, raw, before, scales)
    left_out = any(len(a.place) > len(b.place) for a, b in zip(before, clean, strict=True))
    numbers = refitted(
        repaired(recordings, model.axis, raw, clean, scales),
        found,
        model=model,
        lab=lab,
        scales={
            "voltage_V": scales.voltage_V,
            "voltage_offset_V": scales.voltage_offset_V,
            "stroke_m": abs(scales.displacement_m),
        },
        raw=recordings if mended or whole is not None else None,
        faults=mended,
        whole=whole,
        places=[track.place for track in clean] if mended or left_out else None,
        places_of_whole=[track.place for track in before] if mended or left_out else None,
        progress=progress,
    )
    return _scaled(numbers, abs(scales.displacement_m))


def mending(outcome: Outcome) -> tuple[str, ...]:
    """Return the faults that were repaired; the others ask for a new measurement."""
    before, found = outcome.first.tracks, []
    for name, fault in outcome.faults.items():
        if any(a is not b for a, b in zip(before, fault.tracks, strict=True)):
            found.append(name)
        before = fault.tracks
    return tuple(found)


def _scaled(numbers: Refitted, stroke_m: float) -> ModelErrors:
    return ModelErrors(
        baseline=numbers.baseline.held_out_rms_m / stroke_m,
        final=numbers.final.held_out_rms_m / stroke_m,
        without={n: one.held_out_rms_m / stroke_m for n, one in numbers.without.items()},
        scatter=relative_scatter(numbers.final.held_m),
        model=numbers.model,
    )


def repaired(
    recordings: Sequence[Recording], axis: str, before: Tracks, after: Tracks, scales: Scales
) -> tuple[Recording, ...]:
    """Return recordings with the changes that repairs made to their tracks."""
    pairs = iter(zip(before, after, strict=True))
    found = []
    for recording in recordings:
        change_V, change_m = np.zeros(recording.samples), np.zeros(recording.samples)
        for part in recording.pieces:
            if part.stop - part.start < MINIMUM_SAMPLES:
                continue
            old, new = next(pairs)
            change_V[part] = scales.voltage_V * (new.drive - old.drive)
            change_m[part] = scales.displacement_m * (new.response - old.response)
        found.append(_changed(recording, axis, change_V, change_m))
    return tuple(found)


def _changed(recording: Recording, axis: str, change_V: Array, change_m: Array) -> Recording:
    if not change_V.any() and not change_m.any():
        return recording
    changes = {Quantity.VOLTAGE: change_V, Quantity.DISPLACEMENT: change_m}
    channels = tuple(
        replace(channel, values=channel.values + changes[channel.quantity])
        if channel.axis == axis and channel.quantity in changes
        else channel
        for channel in recording.channels
    )
    return replace(recording, channels=channels)
