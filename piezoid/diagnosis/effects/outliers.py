"""Outliers: single readings that are wrong.

What you see
    Isolated spikes, one sample or a few long, of either sign.
Why it happens
    Sparks, bit errors, switching relays.
How it is detected
    A few readings lie far from the median of the five or nine readings around them, beyond the
    tail of all such distances. Their neighbours agree with each other, and the static response
    has no such jump.
What the extension adds
    Nothing: such readings are replaced by linear interpolation and reported.
Source
    Hampel (1974)
"""

from dataclasses import replace

import numpy as np

from piezoid.diagnosis.converter_steps import drive_step
from piezoid.diagnosis.effect import OVER_TIME, Effect, Fault, FaultTest
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.signals import stroke_of, with_displacement
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import white_noise_rms
from piezoid.records.recording import Recording
from piezoid.records.sample_statistics import step_size

MIN_NOISE_RATIO = 8.0  # size of a spike over the noise of the readings
MIN_HEIGHT = 1.5e-3  # of half the stroke
MIN_STEPS = 2.5  # of a coarse converter
MAX_SHARE = 0.01  # of the samples: a larger share are no outliers
TAIL = 0.99  # quantile of all distances at which their tail begins
MIN_TAIL_RATIO = 2.0  # distance over that quantile
MAX_CHANCE = 1e-3  # expected number of such samples from an exponential tail
MIN_UNMOVED = 0.5  # share of a spike that remains when the static response is subtracted
# Width of a neighbourhood, and ranks of its sorted values between which no value is an outlier if
# at most one of five samples, or three of nine, are outliers.
NEIGHBOURHOODS = ((5, (1, 3)), (9, (3, 5)))
Ranks = tuple[int, int]


def _median_distance(values: Array, width: int, ranks: Ranks) -> tuple[Array, Array]:
    """Return the distance of every value from its local median, and the spread around it."""
    reach = width // 2
    # reflected without a change of sign, a slope would have a tip at its end
    padded = np.pad(values, reach, mode="reflect", reflect_type="odd")
    ordered = np.sort(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1)
    low, high = ranks
    return np.asarray(values - ordered[:, reach]), np.asarray(ordered[:, high] - ordered[:, low])


def _spike_sizes(
    track: Track, static: Array, width: int, ranks: Ranks
) -> tuple[Array, Array, Array]:
    """Return the part of each distance that is not motion, the distance, and the local spread.

    At a sharp reversal the distance of a good reading from its median is as large as that of the
    drive.
    """
    distance, spread = _median_distance(track.response, width, ranks)
    unmoved, _ = _median_distance(track.response - static, width, ranks)
    drive_distance, _ = _median_distance(track.drive, width, ranks)
    distance_size = np.abs(distance)
    size = np.where(distance * unmoved > 0.0, np.minimum(distance_size, np.abs(unmoved)), 0.0)
    return size, distance_size, np.maximum(spread, np.abs(drive_distance))


def spikes(track: Track, static: Array, step: float = 0.0) -> tuple[Array, float]:
    """Return which samples are spikes, and the expected number of as large spikes by chance.

    step  of the drive's converter, if coarse: near a turning point such a drive may reach the next
          step for one sample

    The tail of the distances is extrapolated exponentially from samples that are not spikes.
    """
    y = track.response
    is_spike, chance = np.zeros(len(y), dtype=bool), 0.0
    noise, min_size = _noise(y), _min_size(y, step)
    for width, ranks in NEIGHBOURHOODS:
        if len(y) < 4 * width:
            continue
        size, distance, spread = _spike_sizes(track, static, width, ranks)
        tail_start = float(np.quantile(size, TAIL))
        is_far = size > np.maximum(3.0 * spread, max(min_size, MIN_TAIL_RATIO * tail_start))
        is_far &= size > MIN_UNMOVED * distance
        tail = size[(size > tail_start) & ~is_far]
        if not is_far.any() or not len(tail):
            continue
        decay = max(float(np.mean(tail - tail_start)), 0.1 * noise)
        excess = (float(size[is_far].min()) - tail_start) / decay
        expected = len(y) * (1.0 - TAIL) * float(np.exp(-min(excess, 700.0)))
        if expected < MAX_CHANCE and is_far.mean() < MAX_SHARE:
            is_spike, chance = is_spike | is_far, max(chance, expected)
    return is_spike, chance


def _noise(y: Array) -> float:
    """Return the typical deviation of a reading from its neighbours."""
    return float(max(1.4826 * np.median(np.abs(np.diff(y, 2))) / np.sqrt(6.0), 1e-12))


def _min_size(y: Array, step: float) -> float:
    """Return the smallest spike; on a coarse converter a good reading may be a step off."""
    coarse_step = max(step, step_size(np.round(y, 9)))
    return float(max(MIN_NOISE_RATIO * _noise(y), MIN_STEPS * coarse_step, MIN_HEIGHT))


def largest_undetected(view: View) -> float:
    """Return the height of the largest undetected spike, of the stroke.

    At a twentieth of all instants, where the stage moves fast, a larger spike may be undetected.
    """
    step, largest = drive_step(view), []
    for track, static in zip(view.tracks, view.static, strict=True):
        y = track.response
        min_size, heights = _min_size(y, step), []
        for width, ranks in NEIGHBOURHOODS:
            if len(y) < 4 * width:
                continue
            size, _, spread = _spike_sizes(track, static, width, ranks)
            tail_start = float(np.quantile(size, TAIL))
            decay = max(float(np.mean(size[size >= tail_start] - tail_start)), 0.1 * _noise(y))
            decades = float(np.log(max(len(y) * (1.0 - TAIL) / MAX_CHANCE, 1.0)))
            fast = float(np.quantile(3.0 * spread, 0.95))
            tail_end = tail_start + decay * decades
            heights.append(max(min_size, MIN_TAIL_RATIO * tail_start, tail_end, fast))
        largest.append(min(heights, default=min_size))
    return max(largest) / 2.0


def without_spikes(track: Track, is_spike: Array) -> Track:
    """Return the track with spikes interpolated linearly; the same track if it has none."""
    if not is_spike.any():
        return track
    samples, is_good = np.arange(len(is_spike)), ~is_spike.astype(bool)
    response = np.interp(samples, samples[is_good], track.response[is_good])
    return replace(track, response=response)


def find_outliers(view: View) -> Fault | None:
    """Find spikes, and interpolate them."""
    tracks, largest, chances, locations = [], [], [], []
    step = drive_step(view)
    for track, static in zip(view.tracks, view.static, strict=True):
        is_spike, chance = spikes(track, static, step)
        repaired = without_spikes(track, is_spike)
        tracks.append(repaired)
        if repaired is track:
            continue
        size = np.abs(track.response - repaired.response)
        largest.append((float(size.max()), white_noise_rms(repaired.response)))
        chances.append(chance)
        locations.append(f"{track.name} ({int(is_spike.sum())})")
    if not largest:
        return None
    height, noise = max(largest)
    # noise of the spike, and half of that of the two samples it is interpolated between
    return Fault(
        tracks=tuple(tracks),
        value=1e9 * view.half_stroke_m * height,
        spread=1e9 * view.half_stroke_m * float(np.hypot(noise * np.sqrt(1.5), 0.01 * height)),
        p_value=max(chances),
        locations=tuple(locations),
    )


def inject(recording: Recording, share: float) -> Recording:
    """Add a spike to every 500th sample."""
    moved_m = np.array(recording.displacement_m())
    spikes = np.arange(137, len(moved_m), 500)
    moved_m[spikes] += share * stroke_of(recording) * np.where(spikes % 2, 1.0, -1.0)
    return with_displacement(recording, moved_m)


EFFECT = Effect(
    name="outliers",
    explanation=__doc__ or "",
    unit="nm, the largest",
    experiment="Record with the sensor's cable moved away from relays and supplies, at twice the "
    "rate: a spark stays one sample long.",
    control="A single false sample kicks the loop; limit the rate of the reading and find the bad "
    "contact.",
    shows=OVER_TIME,
    tangent="its remedy is the wiring, not another drive",
    fault=FaultTest(find=find_outliers, bound=largest_undetected),
    inject=inject,
)
