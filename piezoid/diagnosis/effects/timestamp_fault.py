"""Timestamp fault: the reader of the sensor loses step with the drive.

What you see
    From one instant on the displacement comes early or late by a fixed number of samples.
Why it happens
    A buffer overran and readings are gone, or the reader stalled and repeated its last value.
How it is detected
    The delay between the static response and the reading, window by window, is zero up to an
    instant and another constant from there to the end.
What the extension adds
    Nothing: the readings are put back in step and the rows in between are left out.
Source
    what acquisition programs do when the disk is busy
"""

from dataclasses import replace

import numpy as np

from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.signals import rate_of, with_displacement
from piezoid.diagnosis.tracks import Places, Track
from piezoid.diagnosis.view import View
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

WINDOWS = 16
FARTHEST = 0.1  # of a track
LEAST_SHARE = 1.5e-3  # of half the stroke: what the slip must be worth in rms
CLEAR = 0.55  # of the rms: what is left once the slip is undone


def slip_of(response: Array, static: Array) -> tuple[int, int, float]:
    """Return (instant, samples, share of rms left) of the one slip that explains most.

    samples > 0: what follows the instant comes late
    """
    n = len(response)
    reach = max(int(FARTHEST * n), 3)
    best = (0, 0, 1.0)
    error = response - static
    base = _spread(error)
    shifts = np.unique(np.round(np.geomspace(1, reach, 40)).astype(int))
    kept = np.arange(0, n, max(n // 3000, 1))
    for shift in (*shifts.tolist(), *(-shifts).tolist()):
        moved = response[kept] - static[np.clip(kept - shift, 0, n - 1)]
        best = min(best, _best_place(error[kept], moved, kept, shift, base), key=lambda b: b[2])
    shift = best[1]
    for near in range(shift - abs(shift) // 6 - 2, shift + abs(shift) // 6 + 3):
        moved = response[kept] - static[np.clip(kept - near, 0, n - 1)]
        best = min(best, _best_place(error[kept], moved, kept, near, base), key=lambda b: b[2])
    return best


def _spread(values: Array) -> float:
    return float(np.std(values)) + 1e-12


def _best_place(
    error: Array, moved: Array, kept: Places, shift: int, base: float
) -> tuple[int, int, float]:
    before, after = np.cumsum(error**2), np.cumsum(moved[::-1] ** 2)[::-1]
    total = (before[:-1] + after[1:])[WINDOWS:-WINDOWS]
    place = int(np.argmin(total))
    left = float(np.sqrt(total[place] / len(error))) / base
    return int(kept[place + WINDOWS]), shift, left


def _fault(view: View) -> Fault | None:
    tracks, found = list(view.tracks), []
    for k, track in enumerate(view.tracks):
        if len(track.response) < 4 * WINDOWS:
            continue
        zero = float(np.mean(track.response - view.static[k]))
        instant, samples, left = slip_of(track.response, view.static[k] + zero)
        worth = abs(samples) / track.rate_Hz * rate_of(view.static[k], track.rate_Hz)[instant:]
        if (
            samples == 0
            or left > min(CLEAR, 0.7 * _whole(track, view.static[k], samples))
            or float(np.sqrt(np.mean(worth**2))) < LEAST_SHARE
        ):
            continue
        found.append((_chance(track.response - view.static[k], left), samples))
        tracks[k] = _in_step(track, instant, samples)
    if not found:
        return None
    samples = max((s for _, s in found), key=abs)
    return Fault(
        tracks=tuple(tracks),
        value=float(samples),
        spread=1.0 + 0.02 * abs(samples),
        p_value=min(chance for chance, _ in found),
    )


def _chance(error: Array, left: float) -> float:
    """Return an upper limit of the chance that no slip looks as good as this one.

        p <= tried / LR,  LR = left^-n,  n = N (1 - rho) / (1 + rho)

    A likelihood ratio exceeds c with a chance of at most 1 / c where the simple model holds
    (Markov); n counts the rows that are independent, rho is the correlation of neighbours.
    """
    free = error - error.mean()
    rho = float(np.clip(free[1:] @ free[:-1] / max(free @ free, 1e-300), 0.0, 1.0 - 1e-9))
    independent = len(free) * (1.0 - rho) / (1.0 + rho)
    tried = 80.0 * len(free)
    return float(min(1.0, np.exp(np.log(tried) + independent * np.log(max(left, 1e-12)))))


def _whole(track: Track, static: Array, samples: int) -> float:
    """Return the share of the rms that is left if all readings are late, not some: a delay."""
    place = np.clip(np.arange(len(static)) - samples, 0, len(static) - 1)
    return _spread(track.response - static[place]) / _spread(track.response - static)


def _in_step(track: Track, instant: int, samples: int) -> Track:
    """Put the readings behind an instant back in step; what is missing at the end is held."""
    place = np.arange(len(track.response))
    source = np.where(place > instant, np.clip(place + samples, 0, len(place) - 1), place)
    lost = (track.place > instant - 2 - max(-samples, 0)) & (
        track.place <= instant + 2 + max(-samples, 0)
    )
    lost |= track.place + max(samples, 0) >= len(place)
    kept = ~lost
    return replace(
        track,
        response=track.response[source],
        place=track.place[kept],
        block=track.block[kept],
    )


def inject(recording: Recording, share: float) -> Recording:
    """Lose readings in the middle, as many as are worth the share."""
    moved_m = recording.displacement_m()
    step_m = float(np.sqrt(np.mean(np.diff(moved_m) ** 2)))
    rows = max(round(2.0 * share * float(np.ptp(moved_m)) / max(step_m, 1e-30)), 1)
    place = np.arange(len(moved_m))
    source = np.where(place > len(place) // 2, np.minimum(place + rows, len(place) - 1), place)
    return with_displacement(recording, moved_m[source])


EFFECT = Effect(
    name="timestamp_fault",
    explanation=__doc__ or "",
    unit="samples",
    experiment="Record a steady sine for as long, with the acquisition's own sample counter in a "
    "column, and nothing else running on the computer.",
    rivals=("delay",),
    fault=_fault,
    shows_at=1.2e-2,
    inject=inject,
)
