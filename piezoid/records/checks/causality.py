"""Report displacement that leads its drive, by the direction of its loop or the time of its turns.

The share of the box of a cycle that loops enclose is, with the correlation r of drive v and
displacement y, the path p of the drive and its spans v_i from turn to turn,

    A = sgn(r) * integral of v dy / (range y / range v * p / 2 * sum of v_i^2 / sum of v_i)

It is positive for hysteresis and for any lag. Only narrow loops are tested, since above a
resonance any phase is possible.

At a corner of the drive no causal stage moves ahead of the turn, for any hysteresis and lag. With
s_3, s_2, s_1 the mean slopes of the displacement over three spans of L samples before a turn and
s_+ behind it,

    phi(L) = sum over turns of (2 s_2 - s_3 - s_1) / sum over turns of (s_2 - s_+)

is the share of the turn made L samples early, less the curvature of the branch. It is a quarter
for a centred window of 2 L samples, and 1 for a drive stamped L samples late.
"""

import numpy as np

from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import white_noise_rms
from piezoid.records.drive_signal import noise_of, reversals_of
from piezoid.records.recording import Quantity, Recording
from piezoid.statement import Statement, finding
from piezoid.toml_files import toml_string

# Share of their box that loops enclose: 6.0 to 9.8 % for thirteen published laws (negative with
# exchanged columns), 5.5 to 7.9 % for the bundled stage; a lag makes loops wider.
MIN_AREA = 0.01
MIN_BRANCH = 0.02  # of the range of the drive
MIN_CORRELATION = 0.9  # at least 0.986 for the same loops


def check_loop_direction(recording: Recording, axis: str) -> list[Statement]:
    """Report a displacement that leads its drive: exchanged columns, or a drive sampled late."""
    drive, displacement = recording.voltage_V(axis), recording.displacement_m(axis)
    middle = 0.5 * float(drive.max() + drive.min())
    rises = np.flatnonzero((drive[:-1] < middle) & (drive[1:] >= middle))
    if len(rises) < 2:
        return []
    cycles = slice(int(rises[0]), int(rises[-1]) + 1)
    v, y = (values[cycles] - values[cycles].mean() for values in (drive, displacement))
    if not np.ptp(v) > 0.0 or not np.ptp(y) > 0.0:
        return []
    correlation = float(np.corrcoef(v, y)[0, 1])
    if abs(correlation) < MIN_CORRELATION:
        return []
    turns = reversals_of(v, max(noise_of(v), MIN_BRANCH * float(np.ptp(v))))
    if not turns:  # the noise of the drive crosses the middle
        return []
    spans = np.abs(np.diff(v[[0, *turns, len(v) - 1]]))
    # Half the path for each mean span: turns of a multisine are not all resolved.
    squares = float(np.abs(np.diff(v)).sum() * (spans**2).sum() / spans.sum())
    integral = float(np.sum(0.5 * (v[1:] + v[:-1]) * np.diff(y)))
    area = float(np.sign(correlation)) * integral / (0.5 * squares * float(np.ptp(y) / np.ptp(v)))
    if area > -MIN_AREA:
        return []
    drive_label, response_label = (
        toml_string(channel.label)
        for quantity in (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
        if (channel := recording.find(quantity, axis)) is not None
    )
    text = (
        f"The displacement leads the drive; the loop encloses {100 * -area:.2g} % of its "
        "box in the wrong direction. If the headings are exchanged, write columns = "
        f"{{ voltage = {response_label}, displacement = {drive_label}, ... }} into lab.toml; else "
        "check whether the drive is sampled late."
    )
    return [finding("leads", text, axis=axis, value=area, unit="1")]


# In 273 recordings, of 30 stages of two other simulators and 39 healthy ones of the zoo, a share
# above MIN_SHARE is at most 0.8 times the largest bend elsewhere, and the noise grows 1.25 times.
# In readings smoothed by a centred window it grows 3 times.
MIN_TURNS = 2  # upper and lower turns each
MIN_SPAN = 4  # samples
SPANS_PER_BRANCH = 8
MIN_SHARE = 0.1
MIN_CONTRAST = 2.0  # over the largest bend of the branch elsewhere: ringing, fringes, codes
MAX_DRIVE_SHARE = 0.03  # phi of the drive itself: a drive without corners (a sine) is not tested
NEAR_MAXIMUM = 0.9  # of the largest product of share and span
MIN_NOISE_GROWTH = 2.0  # white noise is equal over any distance; smoothed noise grows
LATE_SHARE = 0.5  # larger than by a window: the drive is late


def check_early_turns(recording: Recording, axis: str) -> list[Statement]:
    """Report a displacement that turns before its drive, as ``leads`` or ``smoothed``.

    The span is the shortest one with a product of share and span near the maximum: for spans
    longer than half the window of a filter the share falls as 1 / L.
    """
    longest = max(recording.pieces, key=lambda piece: piece.stop - piece.start)
    drive, displacement = (
        recording.voltage_V(axis)[longest],
        recording.displacement_m(axis)[longest],
    )
    if not np.ptp(drive) > 0.0 or not np.ptp(displacement) > 0.0:
        return []
    turns = reversals_of(drive, max(noise_of(drive), MIN_BRANCH * float(np.ptp(drive))))
    edges = np.array([0, *turns, len(drive) - 1])
    branch, next_branch = np.diff(edges)[:-1], np.diff(edges)[1:]
    direction = np.sign(drive[edges[1:-1]] - drive[edges[:-2]])
    candidates: list[tuple[int, float]] = []  # span L and share phi(L) of upper and lower turns
    span = MIN_SPAN
    while True:
        is_long = (branch >= SPANS_PER_BRANCH * span) & (next_branch >= 2 * span)
        sides = [edges[1:-1][is_long & (direction == sign)] for sign in (1.0, -1.0)]
        if min(len(side) for side in sides) < MIN_TURNS:
            break
        drive_share = max(abs(part) for side in sides for part in _shares(drive, side, span))
        at_turn, elsewhere = zip(*(_shares(displacement, s, span) for s in sides), strict=True)
        if drive_share < MAX_DRIVE_SHARE and min(at_turn) > max(
            MIN_SHARE, MIN_CONTRAST * max(elsewhere)
        ):
            candidates.append((span, min(at_turn)))
        span = max(span + 1, int(1.25 * span))
    if not candidates:
        return []
    largest = max(share * samples for samples, share in candidates)
    samples, share = next(c for c in candidates if c[0] * c[1] > NEAR_MAXIMUM * largest)
    # Noise of differences over L / 2 samples over that from sample to sample.
    noise = white_noise_rms(displacement, max(samples // 2, 2))
    if share > LATE_SHARE:
        quantity = "leads"
        advice = "Check whether the drive is sampled late or has another clock."
    elif noise / max(white_noise_rms(displacement), 1e-300) > MIN_NOISE_GROWTH:
        quantity = "smoothed"
        advice = (
            "The readings were smoothed afterwards; delay, dynamics and sensor noise cannot be "
            "identified from them. Use the file as it was recorded."
        )
    else:
        return []
    early_s = samples / recording.sampling_rate_Hz
    text = (
        f"The displacement begins to turn {with_unit(early_s, 's')} ({samples} "
        f"samples) before its drive and has then made {100 * share:.0f} % of the turn. "
        f"{advice}"
    )
    return [finding(quantity, text, axis=axis, value=early_s, unit="s")]


def _shares(values: Array, turns: Array, span: int) -> tuple[float, float]:
    """Return phi at turns of one kind, and the largest phi of the branch before them."""
    window = np.arange(-SPANS_PER_BRANCH * span, 2 * span + 1)
    mean = values[turns[:, None] + window].mean(axis=0)
    slope = mean[span:] - mean[:-span]  # from -8 L on
    bend = 2.0 * slope[span:-span] - slope[: -2 * span] - slope[2 * span :]
    turned = slope[6 * span] - slope[9 * span]
    if turned == 0.0:
        return 0.0, np.inf
    # bend[k] ends at -5 L + k: at the turn for k = 5 L, before it for less than 3 L
    return float(bend[5 * span] / turned), float(np.abs(bend[: 3 * span] / turned).max())
