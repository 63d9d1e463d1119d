"""Effects of the acquisition: coarse converters, disturbed readings and shifted rows."""

import math

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Bench,
    Fault,
    Measure,
    Place,
    Scene,
    Trace,
    bisected,
    effect,
)
from piezoid_datasets.virtual_lab.signals import Array, shifted

SHARES = (2e-4, 1e-3)  # of rows that are outliers
AT_LEAST = 4  # outliers
ROWS = (0.3, 3000.0)  # lost or repeated


@effect(0.08, shown_by=("sweep",))
def quantisation(size_m: float, _bench: Bench, _: np.random.Generator) -> Fault:
    """Quantisation: a converter with too few bits or too wide a range.

        y = q round(x / q)

    Set the step from the rms of its rounding error.

    Source: Widrow & Kollar, Quantization Noise (2008): the error of a busy signal has rms
    q / sqrt(12).
    """
    step_m = float(np.sqrt(12.0)) * size_m
    return Fault(
        Place.CONVERTER,
        lambda sampled_m, _scene, _: step_m * np.round(sampled_m / step_m),
        {"step_m": step_m},
    )


@effect(0.8, shown_by=("sweep",), measure=Measure.PEAK)
def outliers(size_m: float, _: Bench, rng: np.random.Generator) -> Fault:
    """Outliers: single readings disturbed by a spark, a bit error, or a switching relay.

    Rare, of either sign, one row long.

    Draw the outliers, between half the size and the size; the largest has the size.

    Source: Hampel's contamination model: a small share of samples from another distribution.
    """
    share = float(np.exp(rng.uniform(*np.log(SHARES))))

    def spike(sampled_m: Array, _: Scene, rng: np.random.Generator) -> Array:
        count = max(round(share * len(sampled_m)), AT_LEAST)
        rows = rng.choice(len(sampled_m), size=count, replace=False)
        height_m = size_m * np.linspace(0.5, 1.0, count) * rng.choice([-1.0, 1.0], count)
        disturbed_m = sampled_m.copy()
        disturbed_m[rows] += height_m
        return disturbed_m

    numbers = {"share_of_rows": share, "largest_m": size_m}
    return Fault(Place.RECORD, spike, numbers)


@effect(0.2, shown_by=("rates", "check"))
def timestamp_fault(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Timestamp fault: the readings of the sensor shift relative to the drive without notice.

    Lost: a buffer overruns and some readings are missing; the file closes the gap, and all later
    readings are early. Stalled: the reader repeats its latest value, and all later readings are
    late. The time column does not show the fault.

    Draw type, recordings and instants of the fault; search for the number of rows.

    Source: behaviour of acquisition programs on a busy disk.
    """
    kind = str(rng.choice(["lost", "stalled"]))

    def late_m(trace: Trace, rows: float) -> Array:
        """Return the change of the displacement by a delay of some rows."""
        delay_s, still_m = rows / trace.scene.record_rate_Hz, trace.displacement_m
        return shifted(still_m, delay_s, trace.scene.rate_Hz) - still_m

    row_size_m = np.array([Measure.RMS.of(late_m(t, 1.0)) for t in bench.traces])
    # one row must not be worth more than the size, or no number of rows has it
    largest = int(np.argmax(np.where(row_size_m <= size_m, row_size_m, -row_size_m)))
    is_affected = (row_size_m <= row_size_m[largest]) & (rng.random(len(row_size_m)) < 0.5)
    is_affected[largest] = True
    positions = {int(order): float(rng.uniform(0.2, 0.6)) for order in np.flatnonzero(is_affected)}
    affected = [bench.traces[order] for order in positions]

    def change(trace: Trace, rows: float) -> Array:
        change_m = late_m(trace, rows)
        is_after = np.arange(len(change_m)) > positions[trace.scene.order] * len(change_m)
        return np.asarray(np.where(is_after, change_m, 0.0))

    rows = max(round(bisected(size_m, affected, change, ROWS)), 1)

    def slip(sampled_m: Array, scene: Scene, _: np.random.Generator) -> Array:
        if scene.order not in positions:
            return sampled_m
        row = math.floor(positions[scene.order] * len(sampled_m))
        if kind == "lost":
            return np.delete(sampled_m, slice(row, row + rows))
        repeated = np.full(rows, sampled_m[row])
        return np.concatenate((sampled_m[:row], repeated, sampled_m[row:]))[: len(sampled_m)]

    numbers: dict[str, float | str] = {"kind": kind, "rows": float(rows)}
    numbers |= {f"place_in_recording_{order}": position for order, position in positions.items()}
    return Fault(Place.RECORD, slip, numbers)
