"""Outliers: single readings that are wrong.

What you see
    Isolated spikes, one sample long, of either sign.
Why it happens
    Sparks, bit errors, switching relays.
How it is detected
    A reading far from the median of itself and its four neighbours, where the drive does not jump
    and the neighbours agree with one another.
What the extension adds
    Nothing: such readings are replaced by their neighbours' median and said.
Source
    Hampel (1974)
"""

from dataclasses import replace

import numpy as np
from scipy.special import erfc

from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.signals import stroke_of, with_displacement
from piezoid.diagnosis.tracks import Track
from piezoid.diagnosis.view import View
from piezoid.numerics.arrays import Array
from piezoid.records.faults import step_size
from piezoid.records.recording import Recording

FAR = 8.0  # times the typical distance
LEAST = 1.5e-3  # of half the stroke
STEPS = 2.5
MEDIAN_OF_FIVE = 1.14  # sample less the median of it and four others, in deviations of the noise


def spikes(track: Track) -> tuple[Array, Array, float]:
    """Return which samples are spikes, each one's distance from its neighbours' median, the noise.

    The noise is what such a distance is in a sample that is none, as a standard deviation.
    """
    y = track.response
    near = np.lib.stride_tricks.sliding_window_view(np.pad(y, 2, mode="reflect"), 5)
    middle = np.median(near, axis=1)
    distance = np.asarray(y - middle)
    around = np.delete(near, 2, axis=1)
    agree = np.ptp(around, axis=1)
    typical = 1.4826 * float(np.median(np.abs(np.diff(y, 2)))) / np.sqrt(6.0)
    typical = max(typical, 1e-12)
    high = float(np.quantile(np.abs(distance), 0.99))
    # on a coarse converter a reading may be one step beside its neighbours
    coarse = STEPS * step_size(np.round(y, 9))
    far = np.maximum(max(FAR * typical, coarse), 3.0 * agree)
    wrong = np.abs(distance) > np.maximum(far, max(LEAST, 2.0 * high))
    return wrong, distance, MEDIAN_OF_FIVE * typical


def _fault(view: View) -> Fault | None:
    tracks, sizes, deviations, samples = [], [], [], 0
    for track in view.tracks:
        wrong, distance, noise = spikes(track)
        samples += len(distance)
        deviations += (np.abs(distance[wrong]) / noise).tolist()
        y = np.where(wrong, track.response - distance, track.response)
        tracks.append(replace(track, response=y) if wrong.any() else track)
        sizes += np.abs(distance[wrong]).tolist()
    if not sizes:
        return None
    # how often normal noise would put the nearest of them so far out among so many samples
    p_value = min(1.0, samples * float(erfc(min(deviations) / np.sqrt(2.0))))
    size_m = view.stroke_m * max(sizes)
    spread_m = view.stroke_m * float(np.std(sizes)) / np.sqrt(len(sizes)) + 0.02 * size_m
    return Fault(tracks=tuple(tracks), value=1e9 * size_m, spread=1e9 * spread_m, p_value=p_value)


def inject(recording: Recording, share: float) -> Recording:
    """Put a spike into every five-hundredth sample."""
    moved_m = np.array(recording.displacement_m())
    places = np.arange(137, len(moved_m), 500)
    moved_m[places] += share * stroke_of(recording) * np.where(places % 2, 1.0, -1.0)
    return with_displacement(recording, moved_m)


EFFECT = Effect(
    name="outliers",
    explanation=__doc__ or "",
    unit="nm, the largest",
    experiment="Record with the sensor's cable moved away from relays and supplies, at twice the "
    "rate: a spark stays one sample long.",
    fault=_fault,
    inject=inject,
)
