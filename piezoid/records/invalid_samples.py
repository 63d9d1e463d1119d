"""Find invalid samples: numbers that a sensor wrote without a measurement.

Five kinds are found from the samples alone, without a model:

* *written*: one exact value repeatedly, far from both neighbours (0, -1, 9999, full scale);
* *held*: the previous value repeated while the stage moves on;
* *stuck*: one exact value for a long time while the drive moves on, of a sensor whose readings
  scatter by more than its step: a cable came off, a logger hung;
* *spike*: one or two samples far from both neighbours, by more than a twentieth of the range;
* *clipped*: the largest or smallest value repeatedly while the drive moves on, of a sensor whose
  readings scatter. The readings of a stage at the end of its range continue to scatter.

A deviation that coincides with a step of the drive is motion. Fit and diagnosis detect smaller
spikes by their deviation from the simulated response.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter

from piezoid.numerics.arrays import Array, runs_of
from piezoid.numerics.robust import white_noise_rms
from piezoid.records.sample_statistics import clipped_samples, runs_of_equal, step_size
from piezoid.records.units import Unit
from piezoid.statement import Statement, finding

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

MIN_REPEATS = 3  # one value far from its neighbours twice may be chance
MAX_SHARE = 0.2  # of the samples: if more are repeated, the sensor is slower than the clock
MAX_CLIPPED = 0.5  # of the samples: if more are clipped, the motion is not recorded
MIN_NOISE = 8.0  # standard deviations: one of 1e14 Gaussian readings
# Change of the drive per repeated reading, over that behind it: 1 in a uniform motion, 0 in a hold
MIN_DRIVEN = 0.25
# Change of a reading to the one that is repeated, over the change per sample across the repeats:
# median 1 for lost readings, 0.04 to 0.8 (mostly 0.2) for four converters with missing codes
MIN_UNIFORM = 0.75
MIN_NOISE_COARSE = 4.0  # the same if the converter step separates written values from readings
MIN_DEVIATION = 2.0  # times the uncertainty of the neighbours' mean, and the motion by the drive
MIN_SPIKE = 0.05  # of the range; the diagnosis estimates smaller spikes with a model
MIN_SPIKE_NOISE = 20.0  # standard deviations
MIN_SPIKE_DEVIATION = 4.0  # in place of MIN_DEVIATION: a spike has no repetition to confirm it
# Samples on either side of a spike, and the quantile of their curvatures: if so many are as large,
# the stage rings. A spike changes the curvature of three samples.
SPIKE_NEIGHBOURS, RINGING_QUANTILE = 10, 0.7
MIN_EXCESS = 5.0  # ratio of equal neighbours to those by chance, above which all are invalid
STEP_QUANTILE = 0.01  # of the gaps between distinct values: the step of their digits or converter
MAX_RUN = 64  # samples: longer runs of one value may be a rest
MAX_RESPONSE = 4  # samples: largest delay of the response to a drive
MIN_SCATTER = 1e-5  # of the range: a smaller scatter is rounding, not sensor noise
MAX_NOISE_GROWTH = 4.0  # from neighbours to every other sample: 1 for noise, 8 for a motion
MIN_DRIVE_RANGE = 0.002  # of the range of the drive: a constant drive scatters by less
MAX_PASSES = 4  # an invalid neighbour hides an invalid sample until it is removed
MAX_PLACES = 5  # in a message


def find_invalid_readings(
    values: Array, drive: Array | None = None
) -> tuple[tuple[str, Indices], ...]:
    """Return the invalid readings of one channel by kind, and the written ones also by value.

    values    (samples,)  of a sensor, any unit
    drive     (samples,)  of the stage, any unit, or None
    returned  pairs of ``written``, ``held``, ``stuck``, ``spike`` or ``clipped``, and the samples
              in increasing order

    Limits: a value written once or twice is not found unless it is a spike, nor is one within the
    noise of the true reading, which is harmless.
    """
    if len(values) < 20 or np.ptp(values) == 0.0:
        return ()
    step = step_size(values)
    noise = max(white_noise_rms(values), 0.5 * step)
    range_ = _robust_range(values)
    # Deviation from a straight line that the drive causes within a few samples.
    driven = np.zeros(len(values))
    if drive is not None and np.ptp(drive) > 0.0:
        bend = np.abs(np.diff(drive, 2, prepend=drive[0], append=drive[-1]))
        # From MAX_RESPONSE samples before to one sample behind.
        largest_bend = maximum_filter1d(
            bend, MAX_RESPONSE + 2, mode="nearest", origin=MAX_RESPONSE // 2 - 1
        )
        drive_range = _robust_range(drive)
        # Pulses alone do not show how far they move the stage.
        driven = np.where(largest_bend > 0.0, np.inf, 0.0)
        if drive_range > 0.0:
            driven = np.asarray(largest_bend * range_ / drive_range)
    # A sensor that scatters by no more than a step repeats a value while the stage stands.
    scatters = noise > max(step, MIN_SCATTER * float(np.ptp(values)))
    scatters &= white_noise_rms(values, spacing=2) < MAX_NOISE_GROWTH * noise
    clipped, stuck = _find_constant(values, drive if scatters else None)
    invalid: Mask = clipped | stuck
    written, spikes = np.zeros_like(invalid), np.zeros_like(invalid)
    for mask, find, scale in ((written, _find_written, step), (spikes, _find_spikes, range_)):
        for _ in range(MAX_PASSES):
            new = find(values, invalid, noise, driven, scale)
            mask |= new
            invalid |= new
            if not new.any():
                break
    repeats = _find_repeats(values, invalid, noise, drive) & ~(clipped | stuck)
    if (invalid | repeats)[~(clipped | stuck)].mean() > MAX_SHARE:
        return ()
    masks: list[tuple[str, Mask]] = [
        *(("written", written & (values == x)) for x in np.unique(values[written]).tolist()),
        ("held", repeats),
        ("stuck", stuck),
        ("spike", spikes),
        ("clipped", clipped),
    ]
    return tuple((kind, np.flatnonzero(mask)) for kind, mask in masks if mask.any())


def interpolate_invalid(values: Array, invalid: Mask) -> Array:
    """Interpolate invalid values linearly, (samples,)."""
    if not invalid.any():
        return values
    index = np.arange(len(values))
    return np.interp(index, index[~invalid], values[~invalid])


def _find_constant(values: Array, drive: Array | None) -> tuple[Mask, Mask]:
    """Return where the sensor is clipped, and where it is stuck, although the drive moves."""
    no_samples: Mask = np.zeros(len(values), dtype=bool)
    if drive is None:
        return no_samples, no_samples
    min_range = MIN_DRIVE_RANGE * np.ptp(drive)
    levels = [
        float(values[start])
        for start, stop in runs_of(clipped_samples(values))
        if np.ptp(drive[start:stop]) > min_range
    ]
    # Single readings next to a clipped run are clipped at the same level.
    clipped = np.isin(values, levels)
    clipped = clipped if clipped.mean() < MAX_CLIPPED else no_samples
    stuck = no_samples.copy()
    extremes = (values.min(), values.max())
    starts, stops = runs_of_equal(values)
    is_long = stops - starts > MAX_RUN
    for start, stop in zip(starts[is_long].tolist(), stops[is_long].tolist(), strict=True):
        # At the end of the range without a jump the reading is clipped, or the stage stands.
        jump = abs(values[start] - values[max(start - 1, 0)])
        if values[start] not in extremes or jump > MIN_SPIKE * np.ptp(values):
            stuck[start:stop] = np.ptp(drive[start:stop]) > min_range
    stuck = stuck if stuck.mean() < MAX_CLIPPED else no_samples
    return clipped, stuck & ~clipped


def _robust_range(values: Array) -> float:
    """Return the range of medians of nine samples, which single invalid readings do not affect."""
    low, high = np.quantile(median_filter(values, 9)[4:-4], (0.002, 0.998))
    return float(high - low)


def _constant_runs(values: Array) -> tuple[Indices, Indices]:
    """Return start and stop of runs of one value, except runs at the ends and long runs."""
    starts, stops = runs_of_equal(values)
    inner = (starts >= 2) & (stops <= len(values) - 2) & (stops - starts <= MAX_RUN)
    return starts[inner], stops[inner]


def _deviations(values: Array, starts: Indices, stops: Indices) -> tuple[Array, Array]:
    """Return the deviation of runs from the mean of their neighbours, and the mean's uncertainty.

    The uncertainty is the larger error of the extrapolations from the two samples on each side.
    """
    left_neighbour, right_neighbour = values[starts - 1], values[stops]
    mean = 0.5 * (left_neighbour + right_neighbour)
    distance = 0.5 * (stops - starts + 1)
    misses = np.stack(
        [
            left_neighbour + distance * (left_neighbour - values[starts - 2]) - mean,
            right_neighbour + distance * (right_neighbour - values[stops + 1]) - mean,
        ]
    )
    return np.abs(values[starts] - mean), np.asarray(np.abs(misses).max(axis=0))


def _find_written(values: Array, invalid: Mask, noise: float, driven: Array, step: float) -> Mask:
    """Return the samples of every value that lies far from its neighbours repeatedly."""
    valid = np.flatnonzero(~invalid)
    readings = values[valid]
    starts, stops = _constant_runs(readings)
    deviation, uncertainty = _deviations(readings, starts, stops)
    limit = np.maximum(
        MIN_NOISE * noise, MIN_DEVIATION * np.maximum(uncertainty, driven[valid[starts]])
    )
    repeated, counts = np.unique(readings[starts[deviation > limit]], return_counts=True)
    # A valid reading of a coarse converter may have the same value.
    is_coarse = (step_size(readings) if invalid.any() else step) > 0.0
    written = np.zeros(len(values), dtype=bool)
    for value in repeated[counts >= MIN_REPEATS].tolist():
        mask = (values == value) & ~invalid
        if is_coarse:
            expected = interpolate_invalid(values, mask | invalid)
            mask &= np.abs(values - expected) > np.maximum(MIN_NOISE_COARSE * noise, driven)
        for start, stop in runs_of(mask):
            if stop - start > MAX_RUN:  # may be a rest
                mask[start:stop] = False
        written |= mask
    return written


def _find_spikes(values: Array, invalid: Mask, noise: float, driven: Array, range_: float) -> Mask:
    """Return single samples and pairs that lie far from both neighbours, except ringing."""
    valid = np.flatnonzero(~invalid)
    readings = values[valid]
    if invalid.any():
        range_ = _robust_range(readings)
    limit = max(MIN_SPIKE_NOISE * noise, MIN_SPIKE * range_)
    spikes = np.zeros(len(values), dtype=bool)
    bend = np.abs(np.diff(readings, 2, prepend=readings[0], append=readings[-1])) / 2.0
    for width in (1, 2):
        left, right = readings[1 : -width - 2], readings[2 + width : -1]
        step = (right - left) / (width + 1)  # from the straight line between the neighbours
        deviation = np.abs(readings[2 : -width - 1] - left - step)
        if width == 2:
            deviation = np.minimum(deviation, np.abs(readings[3:-2] - left - 2.0 * step))
        starts = 2 + np.flatnonzero(deviation > limit)
        _, uncertainty = _deviations(readings, starts, starts + width)
        is_far = deviation[starts - 2] > MIN_SPIKE_DEVIATION * np.maximum(
            uncertainty, driven[valid[starts]]
        )
        for start in starts[is_far].tolist():
            bends = bend[max(start - SPIKE_NEIGHBOURS, 0) : start + SPIKE_NEIGHBOURS]
            if deviation[start - 2] > MIN_SPIKE_DEVIATION * np.quantile(bends, RINGING_QUANTILE):
                spikes[valid[start : start + width]] = True
    return spikes


def _find_repeats(values: Array, invalid: Mask, noise: float, drive: Array | None) -> Mask:
    """Return samples that repeat the previous one while the stage moves on in one direction.

    A drive moves by about as much during each repeat as behind them. If it moves only behind them,
    the readings are equal because of a hold.
    """
    repeats = np.zeros(len(values), dtype=bool)
    valid = np.flatnonzero(~invalid)
    readings = values[valid]
    starts, stops = _constant_runs(readings)
    is_repeated = stops - starts > 1
    starts, stops = starts[is_repeated], stops[is_repeated]
    change_before = readings[starts] - readings[starts - 2]
    change_behind = readings[stops + 1] - readings[stops]
    jump = readings[stops] - readings[starts]
    is_repeat = (
        (np.abs(jump) > MIN_NOISE * noise)
        & (jump * change_before > 0.0)
        & (jump * change_behind > 0.0)
    )
    # A reading whose noise spans few of its steps repeats by chance while the stage moves slowly:
    # readings at levels that differ by m are equal with p = q / (2 sqrt(pi) s) exp(-m^2 / 4 s^2),
    # in steps of q and with noise s.
    gaps = np.diff(np.unique(readings))
    step = float(np.quantile(gaps, STEP_QUANTILE)) if len(gaps) else 0.0
    chance, by_chance = 1.0, 0.0
    if noise > 0.0:
        chance = min(step / (2.0 * np.sqrt(np.pi) * noise), 1.0)
        level_changes = 0.5 * np.abs(readings[2:] - readings[:-2]) / noise
        level_changes = level_changes[level_changes > 0.5 * MIN_NOISE]
        by_chance = chance * float(np.sum(np.exp(-0.25 * level_changes**2)))
    if np.count_nonzero(is_repeat) < max(MIN_REPEATS, MIN_EXCESS * by_chance):
        return repeats
    # Missing codes of a converter also hold back the reading in front of a repeat.
    change_per_sample = (readings[starts] - readings[starts - 1]) * (stops - starts) / jump
    if np.median(change_per_sample[is_repeat]) < MIN_UNIFORM:
        return repeats
    if np.sum(stops - starts - 1) > MIN_EXCESS * (len(readings) * chance):
        is_repeat[:] = True
    if drive is not None:
        during = np.abs(drive[valid[stops - 1]] - drive[valid[starts]])
        behind = np.abs(drive[valid[stops]] - drive[valid[stops - 1]])
        is_repeat &= during >= MIN_DRIVEN * behind * (stops - 1 - starts)
    for start, stop in zip(starts[is_repeat].tolist(), stops[is_repeat].tolist(), strict=True):
        repeats[valid[start + 1 : stop]] = True
    return repeats


def find_invalid_rows(values: Array, drive: Array) -> Mask:
    """Return the rows in which drive and reading are both one and the same written number.

    values, drive  (samples,)  in the file's units
    """
    is_equal, no_samples = values == drive, np.zeros(len(values), dtype=bool)
    if not MIN_REPEATS <= np.count_nonzero(is_equal) <= MAX_SHARE * len(is_equal):
        return no_samples
    numbers, counts = np.unique(values[is_equal], return_counts=True)
    rows = is_equal & (values == numbers[counts.argmax()])
    runs = [(a, b) for a, b in runs_of(rows) if a >= 2 and b <= len(rows) - 2]
    if not runs:
        return no_samples
    deviation, uncertainty = _deviations(drive, *np.array(runs).T)
    is_far = deviation > MIN_DEVIATION * uncertainty
    return rows if np.count_nonzero(is_far) >= MIN_REPEATS else no_samples


def invalid_statement(
    kind: str,
    samples: Indices,
    values: Array,
    invalid: Mask,
    *,
    column: str,
    unit: Unit,
    row_name: Callable[[int], str],
) -> Statement:
    """State which readings of a column are invalid.

    kind, samples  as ``find_invalid_readings`` returns them for ``values``, in ``unit``
    invalid        (samples,)  invalid readings of all kinds
    column         name of the column in messages
    row_name       name of the line or row of a sample in messages
    """
    total = len(values)
    levels = " and ".join(f"{x:.6g}" for x in np.unique(values[samples]).tolist())
    appearance = {
        "written": f"reads exactly {levels} {unit.symbol} where its neighbours do not",
        "held": "repeats the previous reading while the stage moves",
        "stuck": f"is stuck at {levels} {unit.symbol} while the drive moves",
        "spike": "lies far from both neighbours",
        "clipped": f"is clipped at {levels} {unit.symbol} while the drive moves",
    }[kind]
    labels = [row_name(k) for k in samples.tolist()]
    if kind == "stuck":
        mask = np.isin(np.arange(total), samples)
        labels = [f"{row_name(a)} to {row_name(b - 1)}" for a, b in runs_of(mask)]
    further = f" and {len(labels) - MAX_PLACES} more" if len(labels) > MAX_PLACES else ""
    deviation = np.abs(values - interpolate_invalid(values, invalid))[samples]
    text = (
        f"{column} {appearance}, {len(samples)} times ({100 * len(samples) / total:.2g} % of the "
        f"samples), at {', '.join(labels[:MAX_PLACES])}{further}: left out as invalid."
    )
    quantity = "saturated" if kind == "clipped" else "lost_readings"
    value = float(deviation.max()) * abs(unit.factor)
    return finding(quantity, text, place=column, value=value, unit="m")
