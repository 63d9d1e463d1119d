"""What may move a stage whose drive rests, as columns of its readings.

drift   t, t^2, t^3, and where they do better ln(1 + t / s) of three scales s
jump    0 before an instant and 1 after it, where that leaves least beside drift
line    one frequency besides

and what the effects say that they add while the drive rests (hum, other axes).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from piezoid.diagnosis.coordinate_tests import highest
from piezoid.diagnosis.effect import ConstantDriveData, Effect
from piezoid.diagnosis.segments import Places
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

DRIFT = "thermal_drift"  # the trend that everything else stands beside
JUMP, LINE = "jump", "line"  # of no effect that needs no drive: told as something else
BLOCKS, FOLDS = 40, 5  # blocks of time, each fold every fifth of them
SLOW = (0.003, 0.03, 0.1)  # of the recording: scales of a logarithm of time
SLOWS = 1.02  # times what a cubic leaves: a logarithm of time that leaves no more does as well
LOWEST = 4  # periods in the recording: what is slower is no line
MEANS = 1000  # means in which a jump is sought

Columns = Mapping[str, Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class Rest:
    """What may move a stage at rest.

    recording whose it is
    time_s    (rows,)
    columns   (rows, columns) by cause, each about its mean
    is_creep  whether a logarithm of time does as well as a cubic
    jump_s    instant of the jump, since the recording began
    line_Hz   of the line, where one was asked for
    unseen    why an effect cannot be seen here, by its name
    """

    recording: str
    time_s: Array
    columns: Columns
    is_creep: bool
    jump_s: float
    line_Hz: float = 0.0
    unseen: Mapping[str, str] = field(default_factory=dict)

    def with_line(self, frequency_Hz: float) -> "Rest":
        """Return the same with a line of its own."""
        columns = {**self.columns, LINE: waves(self.time_s, [frequency_Hz])}
        return replace(self, columns=columns, line_Hz=frequency_Hz)


def rest_columns(
    recording: Recording,
    axis: str,
    keep: Places,
    time_s: Array,
    y: Array,
    effects: Iterable[Effect],
) -> Rest:
    """Return the columns of every cause that these rows can show.

    keep     (rows,)  samples that are used
    time_s   (rows,)  of them
    y        (rows,)  their readings, m
    effects  of which those are asked that need no drive
    """
    smooth, slow = cubic(time_s), _logarithms(time_s)
    jump, jump_s = _jump(time_s, y, (smooth, slow))
    block = np.arange(len(y)) * BLOCKS // len(y)
    left, slower = _left(y, smooth, block), _left(y, slow, block)
    found = {DRIFT: slow if slower < left else smooth, JUMP: jump}
    least = min(_left(y, slow[:, k : k + 1], block) for k in range(len(SLOW)))
    drift = found[DRIFT]
    calm_m = y - drift @ np.linalg.lstsq(drift, y, rcond=None)[0]
    standing = ConstantDriveData(
        recording=recording, axis=axis, keep=keep, time_s=time_s, calm_m=calm_m
    )
    said = {one.name: one.at_rest(standing) for one in effects if one.at_rest is not None}
    unseen = {name: why for name, why in said.items() if isinstance(why, str)}
    found |= {name: added for name, added in said.items() if not isinstance(added, str)}
    columns = {name: values - values.mean(axis=0) for name, values in found.items()}
    return Rest(
        recording=recording.name,
        time_s=time_s,
        columns=columns,
        is_creep=least <= SLOWS**2 * left,
        jump_s=jump_s,
        unseen=unseen,
    )


def held(y: Array, parts: Sequence[Array], block: Places) -> Array:
    """Return what columns and a constant leave of rows they were not fitted to, (rows,)."""
    design = np.column_stack([np.ones(len(y)), *parts])
    left, fold = np.empty(len(y)), block % FOLDS
    for out in range(FOLDS):
        inside = fold != out
        found = np.linalg.lstsq(design[inside], y[inside], rcond=None)[0]
        left[~inside] = y[~inside] - design[~inside] @ found
    return left


def _left(y: Array, columns: Array, block: Places) -> float:
    return float(np.mean(held(y, [columns], block) ** 2))


def waves(time_s: Array, frequencies_Hz: Sequence[float]) -> Array:
    """Return cosine and sine of each frequency, about their means, (rows, 2 frequencies)."""
    angles_rad = [2.0 * np.pi * frequency_Hz * time_s for frequency_Hz in frequencies_Hz]
    columns = np.column_stack([wave(angle) for angle in angles_rad for wave in (np.cos, np.sin)])
    return np.asarray(columns - columns.mean(axis=0))


def spectrum_of(left: Array) -> Array:
    """Return the power of a remainder by frequency, without what is too slow for a line."""
    power = np.asarray(np.abs(np.fft.rfft(left - left.mean())) ** 2)
    power[:LOWEST] = 0.0
    return power


def line_in(left: Array, time_s: Array, chance: float) -> float | None:
    """Return the frequency of the highest line of a remainder, or None where none stands out.

    chance  largest p-value of a line that does
    """
    lines = highest(spectrum_of(left))
    if not lines or lines[0][1] > chance:
        return None
    per_s = (len(left) - 1) / (len(left) * float(np.ptp(time_s)))
    return peak_Hz(left, time_s, per_s * lines[0][2], per_s)


def peak_Hz(signal: Array, time_s: Array, near_Hz: float, reach_Hz: float) -> float:
    """Return the frequency of a signal's line, at the vertex of its power.

    A line that is off by an eighth of one period in the record leaves a fifth of itself, which is
    another line.
    """
    tried = near_Hz + reach_Hz * np.linspace(-1.0, 1.0, 41)
    power = np.array([abs(np.exp(-2j * np.pi * f * time_s) @ signal) for f in tried.tolist()])
    peak = int(np.clip(np.argmax(power), 1, len(tried) - 2))
    before, at, after = power[peak - 1 : peak + 2].tolist()
    curved = 2.0 * at - before - after
    off = 0.5 * (after - before) / curved if curved > 0.0 else 0.0
    return float(tried[peak] + (tried[1] - tried[0]) * np.clip(off, -1.0, 1.0))


def cubic(time_s: Array) -> Array:
    """Return a cubic of time, (rows, 3)."""
    along = 2.0 * (time_s - time_s[0]) / max(float(np.ptp(time_s)), 1e-30) - 1.0
    return np.column_stack([along, along**2, along**3])


def _logarithms(time_s: Array) -> Array:
    since_s, span_s = time_s - time_s[0], max(float(np.ptp(time_s)), 1e-30)
    return np.column_stack([np.log1p(since_s / (share * span_s)) for share in SLOW])


def _jump(time_s: Array, y: Array, drifts: Sequence[Array]) -> tuple[Array, float]:
    """Return a step where it takes off most beside drift, (rows, 1), and its instant."""
    size = max(len(y) // MEANS, 1)
    count = len(y) // size
    means = y[: count * size].reshape(count, size).mean(axis=1)
    steps = np.tri(count, count, -1)[:, max(count // 50, 1) : -max(count // 50, 1)]
    best, place = -1.0, 0
    for drift in drifts:
        base = np.column_stack([np.ones(count), drift[: count * size : size]])
        own = np.linalg.qr(base)[0]
        rest = means - own @ (own.T @ means)
        free = steps - own @ (own.T @ steps)
        taken = (free.T @ rest) ** 2 / np.maximum((free**2).sum(axis=0), 1e-12)
        left = float(rest @ rest) - float(taken.max())
        if best < 0.0 or left < best:
            best, place = left, int(np.argmax(taken)) + max(count // 50, 1) + 1
    at = _refined(y, place * size, size)
    column = (np.arange(len(y)) >= at).astype(np.float64)[:, None]
    return column, float(time_s[at] - time_s[0])


def _refined(y: Array, near: int, size: int) -> int:
    """Return the row near a jump that parts its neighbours best."""
    low, high = max(near - 4 * size, 0), min(near + 4 * size, len(y))
    part = y[low:high]
    sums, count = np.cumsum(part - part.mean())[:-1], np.arange(1, len(part))
    return low + 1 + int(np.argmax(np.abs(sums) / np.sqrt(count * (len(part) - count))))
