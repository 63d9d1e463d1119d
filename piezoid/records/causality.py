"""Displacements that turn before their drive: readings smoothed afterwards, or a drive read late.

At a corner of the drive no causal stage, whatever its hysteresis and lag, knows of the turn before
it. With s_3, s_2, s_1 the mean slopes of the displacement over three stretches of L samples before
a turn, and s_+ behind it,

    phi(L) = sum over turns of (2 s_2 - s_3 - s_1) / sum over turns of (s_2 - s_+)

is the share of the turn that has been made L samples early, less the curvature of the branch. A
centred window of 2 L samples gives a quarter, a drive stamped L samples late all of it.
"""

from dataclasses import dataclass

import numpy as np

from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.numerics.noise import white_noise_rms
from piezoid.records.recording import Recording
from piezoid.records.sweep import noise_of, reversals_of
from piezoid.statement import Statement, finding

# On 273 recordings, of 30 stages of two outsiders and 39 healthy ones of the zoo, a share above
# EARLY is at most 0.8 times the bends elsewhere, and the noise there grows 1.25 times; readings
# smoothed by a centred window have 3 times the noise.
FEWEST = 2  # turns of each kind
SHORTEST = 4  # samples of a stretch
PER_BRANCH = 8  # stretches of the longest kind in a branch
EARLY = 0.1  # share of the turn
STANDS_OUT = 2.0  # times the largest bend of the branch elsewhere: ringing, fringes, codes
SHARP = 0.03  # the same of the drive: of one that bends by itself no more is told
NEARLY = 0.9  # of the largest product of share and length
SMOOTH = 2.0  # times: white noise is the same over any distance; an amplifier's end rounds as well
WHOLE = 0.5  # share: no window, but a drive that is late


@dataclass(frozen=True, kw_only=True)
class Early:
    """How much of a turn is made how early.

    samples  L
    share    phi(L), of the upper and the lower turns the smaller
    noise    of differences over L / 2 samples, times that from sample to sample
    """

    samples: int
    share: float
    noise: float


def early_turns(drive: Array, response: Array) -> Early | None:
    """Return by how much a displacement turns before its drive, None where it does not.

    drive, response  (samples,)  any unit, without gaps

    What bends a branch elsewhere as much is no early turn. Of a drive without corners, such as a
    sine, nothing is told.
    """
    if not np.ptp(drive) > 0.0 or not np.ptp(response) > 0.0:
        return None
    turns = reversals_of(drive, max(noise_of(drive), 0.02 * float(np.ptp(drive))))
    edges = np.array([0, *turns, len(drive) - 1])
    before, behind = np.diff(edges)[:-1], np.diff(edges)[1:]
    way = np.sign(drive[edges[1:-1]] - drive[edges[:-2]])
    found, step_noise = [], white_noise_rms(response)
    length = SHORTEST
    while True:
        long = (before >= PER_BRANCH * length) & (behind >= 2 * length)
        kinds = [edges[1:-1][long & (way == side)] for side in (1.0, -1.0)]
        if min(len(kind) for kind in kinds) < FEWEST:
            break
        own = max(abs(part) for kind in kinds for part in _share(drive, kind, length))
        shares = [_share(response, kind, length) for kind in kinds]
        share = min(at for at, _ in shares)
        elsewhere = max(most for _, most in shares)
        if own < SHARP and share > max(EARLY, STANDS_OUT * elsewhere):
            noise = white_noise_rms(response, max(length // 2, 2)) / max(step_noise, 1e-300)
            found.append(Early(samples=length, share=share, noise=noise))
        length = max(length + 1, int(1.25 * length))
    # beyond half its window the share falls as 1 / L
    most = max((early.share * early.samples for early in found), default=0.0)
    return next((one for one in found if one.share * one.samples > NEARLY * most), None)


def _share(values: Array, turns: Array, length: int) -> tuple[float, float]:
    """Return phi of turns of one kind, and the largest of the branch before them elsewhere."""
    window = np.arange(-PER_BRANCH * length, 2 * length + 1)
    mean = values[turns[:, None] + window].mean(axis=0)
    slope = mean[length:] - mean[:-length]  # from -8 L on
    bend = 2.0 * slope[length:-length] - slope[: -2 * length] - slope[2 * length :]
    turned = slope[6 * length] - slope[9 * length]
    if turned == 0.0:
        return 0.0, np.inf
    # bend[k] ends at -5 L + k: at the turn for k = 5 L, before it for less than 3 L
    return float(bend[5 * length] / turned), float(np.abs(bend[: 3 * length] / turned).max())


def told_early(recording: Recording, axis: str) -> list[Statement]:
    """Tell a displacement of an axis that turns before its drive.

    kinds  ``smoothed``, ``leads``
    """
    longest = max(recording.pieces, key=lambda part: part.stop - part.start)
    drive, response = recording.voltage_V(axis)[longest], recording.displacement_m(axis)[longest]
    early = early_turns(drive, response)
    if early is None or not (early.share > WHOLE or early.noise > SMOOTH):
        return []
    before = with_unit(early.samples / recording.sampling_rate_Hz, "s")
    begins = (
        f"the displacement of {axis} begins to turn {before} ({early.samples} samples) before its "
        f"drive does, and has made {100 * early.share:.0f} % of the turn when it does"
    )
    if early.share > WHOLE:
        kind, why = "leads", "is the drive read late, or are its stamps those of another clock?"
    else:
        kind = "smoothed"
        why = (
            "no stage can know of it: the readings were smoothed afterwards, it seems. Rounded "
            "turns are then no mode, the noise is not the sensor's, and delay and dynamics cannot "
            "be had. Read the file as it was recorded"
        )
    return [finding(quantity=kind, axis=axis, text=f"{begins}; {why}")]
