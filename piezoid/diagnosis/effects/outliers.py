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

from piezoid.diagnosis.appearance import OVER_TIME
from piezoid.diagnosis.effect import Effect, Fault, FaultTest
from piezoid.diagnosis.effects.quantisation import drive_step
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.signals import stroke_of, with_displacement
from piezoid.numerics.arrays import Array
from piezoid.numerics.noise import white_noise_rms
from piezoid.records.recording import Recording
from piezoid.records.sample_statistics import step_size

FAR = 8.0  # times the typical distance
LEAST = 1.5e-3  # of half the stroke
STEPS = 2.5
RARE = 0.01  # of the samples: what there is more of is no outlier
TAIL = 0.99  # of all distances: where their tail begins
CLEAR = 2.0  # times the tail's beginning
SURE = 1e-3  # chance of one such sample in a recording whose tail goes on as it began
KEPT = 0.5  # of its size that a spike must keep when the static response is taken off


def _far(values: Array, width: int, spread: Array) -> tuple[Array, Array]:
    """Return the distance of every value from the median around it, and how far its peers are.

    spread  (2,)  places among the sorted ones between which those lie that are surely good
    """
    reach = width // 2
    # turned round at its ends, a slope would have a tip there that stands apart by itself
    padded = np.pad(values, reach, mode="reflect", reflect_type="odd")
    near = np.lib.stride_tricks.sliding_window_view(padded, width)
    ordered = np.sort(near, axis=1)
    low, high = (int(place) for place in spread)
    return np.asarray(values - ordered[:, reach]), np.asarray(ordered[:, high] - ordered[:, low])


# width of the neighbourhood, places of what must agree: one wrong sample of five, three of nine
NEIGHBOURHOODS = ((5, np.array([1, 3])), (9, np.array([3, 5])))


def spikes(track: Track, static: Array, step: float = 0.0) -> tuple[Array, float]:
    """Return which samples are spikes, and the chance of the least of them were it none.

    step  of the drive's converter, where it is coarse: near a turning point such a drive may go to
          the next step for one sample

    The tail of all distances is taken to fall off exponentially, as it does from its beginning to
    the samples that are no spikes.
    """
    y = track.response
    wrong, chance = np.zeros(len(y), dtype=bool), 0.0
    typical, least = _typical(y), _least(y, step)
    for width, spread in NEIGHBOURHOODS:
        if len(y) < 4 * width:
            continue
        size, distance, agree = _sizes(track, static, width, spread)
        begins = float(np.quantile(size, TAIL))
        here = size > np.maximum(3.0 * agree, max(least, CLEAR * begins))
        here &= size > KEPT * distance
        tail = size[(size > begins) & ~here]
        if not here.any() or not len(tail):
            continue
        falls = max(float(np.mean(tail - begins)), 0.1 * typical)
        exceeds = (float(size[here].min()) - begins) / falls
        found = len(y) * (1.0 - TAIL) * float(np.exp(-min(exceeds, 700.0)))
        if found < SURE and here.mean() < RARE:
            wrong, chance = wrong | here, max(chance, found)
    return wrong, chance


def _sizes(track: Track, static: Array, width: int, spread: Array) -> tuple[Array, Array, Array]:
    """Return what of every distance is no motion of the stage, the distance, and its peers'.

    Where the drive turns sharply a good reading stands apart as far as the drive does.
    """
    y = track.response
    distance, agree = _far(y, width, spread)
    apart, _ = _far(y - static, width, spread)
    turn, _ = _far(track.drive, width, spread)
    agree = np.maximum(agree, np.abs(turn))
    whole = np.abs(distance)
    return np.where(distance * apart > 0.0, np.minimum(whole, np.abs(apart)), 0.0), whole, agree


def _typical(y: Array) -> float:
    """Return the typical distance of a reading from what its neighbours say."""
    return float(max(1.4826 * np.median(np.abs(np.diff(y, 2))) / np.sqrt(6.0), 1e-12))


def _least(y: Array, step: float) -> float:
    # on a coarse converter a reading may be one step beside its neighbours
    stairs = max(step, step_size(np.round(y, 9)))
    return float(max(FAR * _typical(y), STEPS * stairs, LEAST))


def _bound(view: View) -> float:
    """Return the height of a spike that would not be found, of the stroke, at nearly all places.

    At most a twentieth of all places hide a larger one: there the stage moves too fast.
    """
    step = drive_step(view)
    pairs = zip(view.tracks, view.static, strict=True)
    return max(_hides(track, static, step) for track, static in pairs) / 2.0


def _hides(track: Track, static: Array, step: float) -> float:
    y = track.response
    heights = [_least(y, step)]
    for width, spread in NEIGHBOURHOODS:
        if len(y) < 4 * width:
            continue
        size, _, agree = _sizes(track, static, width, spread)
        begins = float(np.quantile(size, TAIL))
        falls = max(float(np.mean(size[size >= begins] - begins)), 0.1 * _typical(y))
        tail = begins + falls * float(np.log(max(len(y) * (1.0 - TAIL) / SURE, 1.0)))
        fast = float(np.quantile(3.0 * agree, 0.95))
        heights.append(max(heights[0], CLEAR * begins, tail, fast))
    return min(heights[1:], default=heights[0])


def without_spikes(track: Track, static: Array) -> Track:
    """Return the track with straight lines in place of spikes; itself if it has none."""
    wrong, _ = spikes(track, static)
    return _bridged(track, wrong) if wrong.any() else track


def _bridged(track: Track, wrong: Array) -> Track:
    place = np.arange(len(wrong))
    good = ~wrong.astype(bool)
    return replace(track, response=np.interp(place, place[good], track.response[good]))


def _fault(view: View) -> Fault | None:
    tracks, largest, chances, where = [], [], [], []
    step = drive_step(view)
    for track, static in zip(view.tracks, view.static, strict=True):
        wrong, chance = spikes(track, static, step)
        if not wrong.any():
            tracks.append(track)
            continue
        bridged = _bridged(track, wrong)
        size = np.abs(track.response - bridged.response)
        largest.append((float(size.max()), white_noise_rms(bridged.response)))
        chances.append(chance)
        where.append(f"{track.name} ({int(wrong.sum())})")
        tracks.append(bridged)
    if not largest:
        return None
    height, noise = max(largest)
    # its own noise, and half of that of the two it lies between
    return Fault(
        tracks=tuple(tracks),
        value=1e9 * view.stroke_m * height,
        spread=1e9 * view.stroke_m * float(np.hypot(noise * np.sqrt(1.5), 0.01 * height)),
        p_value=max(chances),
        where=tuple(where),
    )


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
    control="A single false sample kicks the loop; limit the rate of the reading and find the bad "
    "contact.",
    shows=OVER_TIME,
    tangent="its remedy is the wiring, not another drive",
    fault=FaultTest(find=_fault, bound=_bound),
    inject=inject,
)
