"""Response of the fitted model to a recorded or planned drive, and its derivatives.

    y = Psi(h),   h = sum_i w_i z_i,   z_i the plays' states

The Jacobian of the model along the drive has the columns

    Psi'(h) z_i,  Psi'(h) w_i dz_i/dr_i,  s_j(h),  1{h beyond r_j},  Psi'(h) D[u^p],  dy/dt

of play weights and thresholds, dead-zone weights and thresholds, a bent input (p = 0, 2, 3), and
a lag. Each drive also has columns of its zero and of changes by other initial states.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.operators.chain import Chain, Following
from piezoid.operators.dead_zone import LINEAR
from piezoid.records.recording import Quantity, Recording

ROWS = 700  # of each drive
BEND_POWERS = (0, 2, 3)  # of the input, by which the envelope of the model may be wrong
BEND = 1e-3  # of half the range, for the finite difference
HISTORY_CYCLES = 2  # over the range, before a drive whose initial state is unknown


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveResponse:
    """Response of the model of one axis to one drive.

    model          of the axis
    rate_Hz        sampling rate of the drive
    voltage_V      (samples,)
    others_V       (samples,)  drives of other axes, by axis
    memory_V       (plays,)  before the first sample; None: that after cycles over the range
    selected_rows  (rows,)   samples at which columns are computed; None: spread over the drive
    """

    model: AxisModel
    rate_Hz: float
    voltage_V: Array
    others_V: Mapping[str, Array] = field(default_factory=dict)
    memory_V: Array | None = None
    selected_rows: NDArray[np.int_] | None = None

    @cached_property
    def rows(self) -> NDArray[np.int_]:
        """Return the samples at which columns are computed, (rows,)."""
        if self.selected_rows is not None:
            return self.selected_rows
        return rows_of(len(self.voltage_V), ROWS)

    @cached_property
    def other_drives(self) -> dict[str, Array]:
        """Return the drives of other axes that move, scaled to -1 to 1 over their range."""
        spans = {axis: (float(u.min()), float(u.max())) for axis, u in self.others_V.items()}
        return {
            axis: (2.0 * self.others_V[axis] - low - high) / (high - low)
            for axis, (low, high) in spans.items()
            if high > low
        }

    @property
    def time_s(self) -> Array:
        """Return the time of every sample."""
        return np.arange(len(self.voltage_V)) / self.rate_Hz

    @property
    def half_range_V(self) -> float:
        """Return half the range of the drive in the data of the model."""
        low_V, high_V = self.model.voltage_V
        return 0.5 * (high_V - low_V)

    @cached_property
    def drive_V(self) -> Array:
        """Return the drive behind amplifier and envelope, relative to the offset of the model."""
        forward = replace(self.model.forward, extensions=())
        reached_V = forward.driven_V(self.voltage_V, self.rate_Hz)
        return forward.inner(reached_V - self.model.hysteresis.voltage_offset_V)

    @cached_property
    def initial_memory_V(self) -> Array:
        """Return the play memory before the first sample."""
        return self._memory_after(1.0) if self.memory_V is None else self.memory_V

    @cached_property
    def output_m(self) -> Array:
        """Return the output of the plays, sum_i w_i z_i."""
        return self._play_output(self.drive_V, self.initial_memory_V)

    @cached_property
    def slope(self) -> Array:
        """Return Psi'(h)."""
        return self.model.hysteresis.dead_zones.run_with_slope(self.output_m)[1]

    @cached_property
    def static_m(self) -> Array:
        """Return the static response, with the polarity of the axis."""
        return self.model.polarity * self.model.hysteresis.dead_zones.run(self.output_m)

    @cached_property
    def irreversible_m(self) -> Array:
        """Return the irreversible part: the response without the play of width zero."""
        weight = self.model.hysteresis.plays.weight[0]
        return np.asarray(self.static_m - self.model.polarity * self.slope * weight * self.drive_V)

    @cached_property
    def state(self) -> Array:
        """Return the play states at the rows over half the range, (rows, plays)."""
        return self._states[0] / self.half_range_V

    @cached_property
    def shared(self) -> Array:
        """Return the columns of the model parameters at the rows, (rows, columns)."""
        plays, zones = self.model.hysteresis.plays, self.model.hysteresis.dead_zones
        h, slope = self.output_m[self.rows, None], self.slope[self.rows, None]
        state, by_threshold = self._states
        beyond = np.where(zones.threshold >= 0, h > zones.threshold, h < zones.threshold)
        unit, memory_V, bends = self.drive_V / self.half_range_V, self.initial_memory_V, []
        for power in BEND_POWERS:
            bend_V = BEND * self.half_range_V * unit**power
            change_m = self._play_output(self.drive_V + bend_V, memory_V) - self.output_m
            bends.append((self.slope * change_m / BEND)[self.rows])
        parts = [
            slope * state,
            slope * by_threshold * plays.weight,
            beyond * (h - zones.threshold),
            beyond[:, zones.threshold != 0].astype(float),
            np.column_stack(bends),
        ]
        return np.hstack(parts)

    @cached_property
    def speed(self) -> Array:
        """Return the column of a lag, dy/dt at the rows, (rows, 1)."""
        return np.asarray((np.gradient(self.static_m) * self.rate_Hz)[self.rows, None])

    @cached_property
    def individual(self) -> Array:
        """Return the columns of this drive only: its zero and changes of its initial state."""
        cycled_memories_V = [self._memory_after(side) for side in (-1.0, 1.0)]
        columns = [np.ones(len(self.rows))]
        for memory_V in (*cycled_memories_V, self.model.virgin_memory_V):
            change_m = self._play_output(self.drive_V, memory_V) - self.output_m
            columns.append((self.slope * change_m)[self.rows])
        return np.column_stack(columns)

    @cached_property
    def _states(self) -> tuple[Array, Array]:
        """Return the states z_i at the rows, and dz_i/dr_i, (rows, plays) each.

        A gap between two thresholds shifts all wider plays, so derivatives by single thresholds
        are differences of derivatives by gaps.
        """
        gap = np.diff(self.model.hysteresis.plays.threshold, prepend=0.0)
        per_gap, count = np.append(0.0, 1.0 / gap[1:]), len(gap)
        slope = per_gap * np.diff(self.initial_memory_V, prepend=self.drive_V[:1])
        chain = Chain(gap=gap, weight=np.ones(count + 1), memory_slope=slope, zones=LINEAR)
        rows = np.empty((len(self.rows), count + chain.columns), order="F")
        Following(chain, float(self.drive_V[0])).rows(self.drive_V, self.rows, rows)
        by_gap = rows[:, count : 2 * count] - rows[:, :count] * (slope * per_gap)
        return rows[:, -count - 2 : -2], -np.diff(by_gap, axis=1, append=0.0)

    def _play_output(self, drive_V: Array, memory_V: Array) -> Array:
        return self.model.hysteresis.plays.run(drive_V, memory_V)[0]

    def _memory_after(self, side: float) -> Array:
        """Return the play memory after cycles that end at the upper (1) or lower (-1) end."""
        reach_V, start_V = self.half_range_V, float(self.drive_V[0])
        middle_V = sum(self.model.voltage_V) / 2 - self.model.hysteresis.voltage_offset_V
        reversals = [middle_V - side * reach_V, middle_V + side * reach_V] * HISTORY_CYCLES
        history_V = np.array([*reversals, start_V])
        plays = self.model.hysteresis.plays
        return plays.run(history_V, plays.virgin_memory())[1]


def rows_of(samples: int, count: int) -> NDArray[np.int_]:
    """Return rows spread evenly over a drive on average, at random distances."""
    if samples <= count:
        return np.arange(samples)
    spread = np.random.default_rng(samples).random(count)
    return np.unique(((np.arange(count) + spread) * (samples / count)).astype(int))


def driven_recording(axis: AxisModel, recording: Recording) -> DriveResponse:
    """Return the response to the drive of a recording, with its fitted initial memory."""
    starts = axis.starts_of(recording)
    others_V = {
        channel.axis: channel.values
        for channel in recording.channels
        if channel.quantity is Quantity.VOLTAGE and channel.axis != axis.axis
    }
    return DriveResponse(
        model=axis,
        rate_Hz=recording.sampling_rate_Hz,
        voltage_V=recording.voltage_V(axis.axis),
        others_V=others_V,
        memory_V=starts[0].memory_V if starts else None,
    )


def null_columns(drives: Sequence[DriveResponse], *, lag: bool) -> Array:
    """Return the columns that a refit of the model could absorb, for all drives together.

    lag  whether to include the lag of the model; false for effects that are lags themselves
    """
    shared = [np.hstack([drive.shared, drive.speed]) if lag else drive.shared for drive in drives]
    return np.hstack([np.vstack(shared), block_diag(*(drive.individual for drive in drives))])
