"""Lost readings: numbers that a sensor wrote where it measured nothing, found without any model.

Five kinds, from the samples alone:

* *written*: one exact value again and again, far off both neighbours (0, -1, 9999, full scale);
* *held*: the value before once more while the stage moves on;
* *stuck*: one exact value for long while the drive moves on, of a sensor whose readings scatter by
  more than its step: a cable came off, a logger hung;
* *spike*: one or two samples far off both neighbours, further than a twentieth of the range;
* *clipped*: the largest or smallest value again and again while the drive moves on, of a sensor
  whose readings scatter: at the end of its range it cannot. A stage that stands, at the end of its
  own range or its amplifier's, goes on scattering.

What the drive did at the same instant is motion, and no fault. Smaller spikes are left to the fit
and the diagnosis, which know the response they stand out of.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from piezoid.numerics.arrays import Array
from piezoid.numerics.noise import white_noise_rms
from piezoid.records.faults import clipped as clipped_readings
from piezoid.records.faults import step_size
from piezoid.records.recording import Quantity
from piezoid.statement import Statement, finding

Mask = NDArray[np.bool_]
Places = NDArray[np.intp]

AGAIN = 3  # times: one value far off its neighbours twice may be chance
MOST = 0.2  # of the samples: where more repeat themselves, the sensor is slower than the clock
FAR = 8.0  # times the noise: one of 1e14 normal readings
DRIVEN = 0.25  # of the drive's step behind a repeat: its own step; a uniform motion has all of it
OFF = 2.0  # times what the neighbours leave open, and what the drive moved
SPIKE = 0.05  # of the range: a smaller one is sized by the diagnosis, beside a model
SPIKE_OFF = 4.0  # times the same: a spike has nothing else to show for it
NEAR = 4.0  # times the noise: where, on a coarse converter, a value that is written is a reading
AROUND = 10  # samples on either side of a spike: it rings where so many of them bend as much;
RINGING = 0.7  # fewer, and three spikes at a place would, each of which bends three samples
LONGEST = 64  # samples in a row: longer ones may be a rest
BEFORE = 4  # samples: so late may a stage follow its drive and be seen to follow
PLACES = 5  # that are told
MOST_CLIPPED = 0.5  # of the samples: beyond, what is left is no recording of the motion
SCATTERS = 1e-5  # of the range: less are the digits of a number, not the noise of a sensor
GROWS = 4.0  # from neighbours to every other sample: noise stays, of a motion it is 8
MOVES = 0.002  # of its range: the drive of a rest scatters by less
PASSES = 4  # neighbours that are lost themselves hide a lost one until they are out


@dataclass(frozen=True, kw_only=True, eq=False)
class Lost:
    """Readings of one channel that are none.

    kind     ``written``, ``held``, ``stuck``, ``spike`` or ``clipped``
    value    what was written, of the kind ``written``
    samples  (count,)  increasing
    """

    kind: str
    value: float | None
    samples: Places


def lost_readings(values: Array, drive: Array | None = None) -> tuple[Lost, ...]:
    """Return the readings that are numbers without a measurement, by kind and value.

    values  (samples,)  of a sensor, any unit
    drive   (samples,)  what moved the stage, or None

    What goes wrong: a value written once or twice passes unless it is a spike; one that lies
    within the noise of what would have been measured is kept, and harms nothing.
    """
    if len(values) < 20 or np.ptp(values) == 0.0:
        return ()
    step = step_size(values)
    noise = max(white_noise_rms(values), 0.5 * step)
    travel = _range(values)
    moved = _moved(values, drive, travel)
    # Else a sensor that stands reads the same.
    scatters = drive is not None and _scatters(values, noise, step)
    clipped = _clipped(values, drive if scatters else None)
    stuck = _stuck(values, drive if scatters else None) & ~clipped
    standing = clipped | stuck
    gone: Mask = standing.copy()
    found: dict[float, Mask] = {}
    for _ in range(PASSES):
        fresh = _written(values, gone, noise, moved, step)
        if not fresh:
            break
        for value, here in fresh.items():
            found[value] = here | found.get(value, False)
            gone |= here
    spikes = np.zeros_like(gone)
    for _ in range(PASSES):
        fresh_spikes = _spikes(values, gone, noise, moved, travel)
        if not fresh_spikes.any():
            break
        spikes |= fresh_spikes
        gone |= fresh_spikes
    held = _held(values, gone, noise, drive)
    if (gone | held)[~standing].mean() > MOST:
        return ()
    said = [_lost("written", here, value) for value, here in sorted(found.items())]
    kinds = {"held": held & ~standing, "stuck": stuck, "spike": spikes, "clipped": clipped}
    said += [_lost(kind, here) for kind, here in kinds.items()]
    return tuple(one for one in said if len(one.samples))


def _clipped(values: Array, drive: Array | None) -> Mask:
    """Return where the sensor stands at the end of its range, and the drive does not rest."""
    none: Mask = np.zeros(len(values), dtype=bool)
    if drive is None:
        return none
    moves = MOVES * np.ptp(drive)
    levels = {
        float(values[begin])
        for begin, end in _stretches(clipped_readings(values))
        if np.ptp(drive[begin:end]) > moves
    }
    # Around such a rest single readings stand on the same level, cut off where they scatter.
    standing = np.isin(values, list(levels))
    return standing if standing.mean() < MOST_CLIPPED else none


def _stuck(values: Array, drive: Array | None) -> Mask:
    """Return where a sensor that scatters reads one value for long and the drive does not rest."""
    stuck: Mask = np.zeros(len(values), dtype=bool)
    if drive is None:
        return stuck
    edges = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1, [len(values)]])
    ends = (values.min(), values.max())
    for run in np.flatnonzero(np.diff(edges) > LONGEST).tolist():
        begin, end = int(edges[run]), int(edges[run + 1])
        # At the end of its range without a jump it is clipped, or the stage stands there.
        jump = abs(values[begin] - values[max(begin - 1, 0)])
        if values[begin] not in ends or jump > SPIKE * np.ptp(values):
            stuck[begin:end] = np.ptp(drive[begin:end]) > MOVES * np.ptp(drive)
    return stuck if stuck.mean() < MOST_CLIPPED else np.zeros_like(stuck)


def _scatters(values: Array, noise: float, step: float) -> bool:
    """Tell whether readings scatter by more than a step."""
    if noise <= max(step, SCATTERS * float(np.ptp(values))):
        return False
    return white_noise_rms(values, spacing=2) < GROWS * noise


def bridged(values: Array, gone: Mask) -> Array:
    """Return the values with straight lines in place of those that are gone, (samples,)."""
    place = np.arange(len(values))
    return np.interp(place, place[~gone], values[~gone])


def _lost(kind: str, here: Mask, value: float | None = None) -> Lost:
    return Lost(kind=kind, value=value, samples=np.flatnonzero(here))


def _moved(values: Array, drive: Array | None, travel: float) -> Array:
    """Return how far the drive moves the stage off a straight line within a few samples.

    travel  range of the values
    """
    if drive is None or np.ptp(drive) == 0.0:
        return np.zeros(len(values))
    bend = np.abs(np.diff(drive, 2, prepend=drive[0], append=drive[-1]))
    near = np.lib.stride_tricks.sliding_window_view(
        np.pad(bend, (BEFORE, 1), mode="edge"), BEFORE + 2
    )
    largest, moves = near.max(axis=1), _range(drive)
    if moves == 0.0:  # pulses alone: nothing tells what they move
        return np.where(largest > 0.0, np.inf, 0.0)
    return np.asarray(largest * travel / moves)


def _range(values: Array) -> float:
    """Return the range of the motion: of medians of nine, which lost readings do not reach."""
    middle = median_filter(values, 9)[4:-4]
    low, high = np.quantile(middle, (0.002, 0.998))
    return float(high - low)


def _runs(values: Array) -> tuple[Places, Places]:
    """Return where runs of one value begin and end, without those at the ends of the record."""
    edges = np.flatnonzero(np.diff(values)) + 1
    begins, ends = edges[:-1], edges[1:]
    inside = (begins >= 2) & (ends <= len(values) - 2) & (ends - begins <= LONGEST)
    return begins[inside], ends[inside]


def _apart(kept: Array, begins: Places, ends: Places) -> tuple[Array, Array]:
    """Return how far runs lie from the middle of their neighbours, and how sure that middle is.

    The neighbours on either side, gone on with, miss it by so much.
    """
    before, after = kept[begins - 1], kept[ends]
    middle = 0.5 * (before + after)
    reach = 0.5 * (ends - begins + 1)
    misses = np.stack(
        [
            before + reach * (before - kept[begins - 2]) - middle,
            after + reach * (after - kept[ends + 1]) - middle,
        ]
    )
    return np.abs(kept[begins] - middle), np.asarray(np.abs(misses).max(axis=0))


def _written(
    values: Array, gone: Mask, noise: float, moved: Array, step: float
) -> dict[float, Mask]:
    """Return the samples of every value that stands far off its neighbours again and again."""
    place = np.flatnonzero(~gone)
    kept = values[place]
    begins, ends = _runs(kept)
    away, differ = _apart(kept, begins, ends)
    off = away > np.maximum(FAR * noise, OFF * np.maximum(differ, moved[place[begins]]))
    # Of a coarse column a value comes again by itself.
    coarse = (step_size(kept) if gone.any() else step) > 0.0
    value, times = np.unique(kept[begins[off]], return_counts=True)
    found = {}
    for one in value[times >= AGAIN].tolist():
        here = (values == one) & ~gone
        if coarse:
            rest = np.flatnonzero(~here & ~gone)
            expected = np.interp(np.arange(len(values)), rest, values[rest])
            here &= np.abs(values - expected) > np.maximum(NEAR * noise, moved)
        found[one] = here & ~_long(here)
    return found


def _long(here: Mask) -> Mask:
    """Return the samples of runs that may be a rest."""
    long = np.zeros(len(here), dtype=bool)
    for begin, end in _stretches(here):
        long[begin:end] = end - begin > LONGEST
    return long


def _stretches(here: Mask) -> list[tuple[int, int]]:
    """Return where the stretches of a mask begin and end."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], here.astype(int), [0]]))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def _spikes(values: Array, gone: Mask, noise: float, moved: Array, travel: float) -> Mask:
    place = np.flatnonzero(~gone)
    kept = values[place]
    least = max(20.0 * noise, SPIKE * (_range(kept) if gone.any() else travel))
    wrong: Mask = np.zeros(len(values), dtype=bool)
    rough = np.abs(np.diff(kept, 2, prepend=kept[0], append=kept[-1])) / 2.0
    for width in (1, 2):
        middle = 0.5 * (kept[1 : -width - 2] + kept[2 + width : -1])
        away = np.abs(kept[2 : -width - 1] - middle)
        if width == 2:  # and the second of the two as well, from the same middle
            away = np.minimum(away, np.abs(kept[3:-2] - middle))
        begins = 2 + np.flatnonzero(away > least)
        _, differ = _apart(kept, begins, begins + width)
        far = away[begins - 2] > SPIKE_OFF * np.maximum(differ, moved[place[begins]])
        for begin in begins[far].tolist():
            near = rough[max(begin - AROUND, 0) : begin + AROUND]
            if away[begin - 2] > SPIKE_OFF * np.quantile(near, RINGING):
                wrong[place[begin : begin + width]] = True
    return wrong


def _held(values: Array, gone: Mask, noise: float, drive: Array | None) -> Mask:
    """Return samples that repeat the one before while the stage moves on in one direction.

    Where the drive is known it moves during the repeats by about as much in each sample as behind
    them. Equal readings at the end of a hold, where it moves behind them only, are no fault.
    """
    wrong: Mask = np.zeros(len(values), dtype=bool)
    place = np.flatnonzero(~gone)
    kept = values[place]
    begins, ends = _runs(kept)
    longer = ends - begins > 1
    begins, ends = begins[longer], ends[longer]
    before, after = kept[begins] - kept[begins - 2], kept[ends + 1] - kept[ends]
    jump = kept[ends] - kept[begins]
    off = (np.abs(jump) > FAR * noise) & (jump * before > 0.0) & (jump * after > 0.0)
    if np.count_nonzero(off) < AGAIN:
        return wrong
    if step_size(kept) == 0.0:  # no fine reading comes again by itself, however slowly it moves
        off[:] = True
    if drive is not None:
        during = np.abs(drive[place[ends - 1]] - drive[place[begins]])
        behind = np.abs(drive[place[ends]] - drive[place[ends - 1]])
        off &= during >= DRIVEN * behind * (ends - 1 - begins)
    for begin, end in zip(begins[off].tolist(), ends[off].tolist(), strict=True):
        wrong[place[begin + 1 : end]] = True
    return wrong


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensed:
    """One column as the file holds it, with its part in the recording.

    quantity, axis  what it measures, and of which axis
    place           how messages call the column
    unit            symbol of the unit found
    factor          SI units for one of these
    values          (samples,)  as found
    """

    quantity: Quantity
    axis: str
    place: str
    unit: str
    factor: float
    values: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class LeftOut:
    """Which samples of a recording are no measurement.

    by_column  (samples,) by the number of the column among those given
    statements   one for each column and kind
    """

    by_column: Mapping[int, Mask]
    statements: tuple[Statement, ...]

    def of(self, number: int, values: Array) -> Array:
        """Return a column's values with straight lines where it measured nothing."""
        gone = self.by_column.get(number)
        return values if gone is None else bridged(values, gone)

    @property
    def samples(self) -> tuple[int, ...]:
        """All samples at which some column measured nothing, increasing."""
        if not self.by_column:
            return ()
        return tuple(np.flatnonzero(np.logical_or.reduce(list(self.by_column.values()))).tolist())


def left_out(columns: Sequence[Sensed], place_of: Callable[[int], str]) -> LeftOut:
    """Find the lost readings of all displacements, and of drives where the whole row was lost.

    place_of  how messages call a sample: its line or row
    """
    gone: dict[int, Mask] = {}
    statements: list[Statement] = []
    for number, column in enumerate(columns):
        if column.quantity is not Quantity.DISPLACEMENT:
            continue
        drives = [
            (k, other)
            for k, other in enumerate(columns)
            if (other.quantity, other.axis) == (Quantity.VOLTAGE, column.axis)
        ]
        drive = drives[0][1].values if drives else None
        whole = None if drive is None else _whole_rows(column.values, drive)
        if drive is not None and whole is not None:
            gone[drives[0][0]] = whole
            drive = bridged(drive, whole)
        for one in lost_readings(column.values, drive):
            here = gone.setdefault(number, np.zeros(len(column.values), dtype=bool))
            here[one.samples] = True
            statements.append(_told(column, one, here, place_of))
    return LeftOut(by_column=gone, statements=tuple(statements))


def _whole_rows(values: Array, drive: Array) -> Mask | None:
    """Return the rows in which drive and reading are one number, written again and again."""
    same = values == drive
    if not AGAIN <= np.count_nonzero(same) <= MOST * len(same):
        return None
    number, times = np.unique(values[same], return_counts=True)
    here = same & (values == number[times.argmax()])
    off, differ = _apart(drive, *_inner(here))
    return here if np.count_nonzero(off > OFF * differ) >= AGAIN else None


def _inner(here: Mask) -> tuple[Places, Places]:
    """Return where stretches of a mask begin and end, without those near the ends."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], here.astype(int), [0]])))
    begins, ends = edges[::2], edges[1::2]
    inside = (begins >= 2) & (ends <= len(here) - 2)
    return begins[inside], ends[inside]


def _mask(samples: Places, count: int) -> Mask:
    here: Mask = np.zeros(count, dtype=bool)
    here[samples] = True
    return here


def _levels(column: Sensed, one: Lost) -> str:
    return " and ".join(f"{level:.6g}" for level in np.unique(column.values[one.samples]).tolist())


def _told(column: Sensed, one: Lost, gone: Mask, place_of: Callable[[int], str]) -> Statement:
    count, total = len(one.samples), len(column.values)
    what = {
        "written": f"reads exactly {one.value:.6g} {column.unit} where its neighbours do not"
        if one.value is not None
        else "",
        "held": "repeats the reading before while the stage moves on",
        "stuck": f"stands at {_levels(column, one)} {column.unit} while the drive moves on",
        "spike": "stands far off both neighbours",
        "clipped": f"is clipped at {_levels(column, one)} {column.unit} while the drive moves on",
    }[one.kind]
    if one.kind == "stuck":
        stretches = [(begin, end - 1) for begin, end in _stretches(_mask(one.samples, total))]
        found = [f"{place_of(first)} to {place_of(last)}" for first, last in stretches]
    else:
        found = [place_of(int(k)) for k in one.samples]
    places = ", ".join(found[:PLACES])
    more = f" and {len(found) - PLACES} more" if len(found) > PLACES else ""
    away = np.abs(column.values - bridged(column.values, gone))[one.samples]
    return finding(
        quantity="saturated" if one.kind == "clipped" else "lost_readings",
        place=column.place,
        text=f"{column.place} {what}, {count} times ({100 * count / total:.2g} % of the samples), "
        f"at {places}{more}: left out as no measurement",
        value=float(away.max()) * abs(column.factor),
        unit="m",
    )
