"""Forward model from a drive to a reading, with its derivatives.

    u -> declared amplifier, drive extensions -> gamma, plays -> irreversible extensions -> Psi
      -> response extensions -> lag -> declared sensor -> + zero + added displacement -> reading

Simulation, prediction, the fit of the hysteresis and the joint fit all use this model, with
different parameters. Its quantities are volts and metres, or scaled as ``Scales`` states. The
derivatives by hysteresis, lag and sensor come from ``operators.chain``.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.extensions.extension import Extension, Where
from piezoid.identification.hysteresis.pieces import Scales, behind_pole
from piezoid.numerics.arrays import Array, Samples
from piezoid.numerics.executor import Once
from piezoid.operators.chain import Chain, Following
from piezoid.operators.dead_zone import LINEAR, DeadZones, from_slopes
from piezoid.operators.filters import FirstOrder, lagged
from piezoid.operators.play import thinned_drive
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii

CHUNK = 1024  # rows written together: about the size of the L2 cache
SPARSE = 3  # samples per row, above which computing from row to row is faster
MAX_DELAY_ERROR = 0.004  # of the motion, of a delay instead of the filters
MAX_ENTRIES = 16_000_000  # of one array of columns
LAG_STEP = 1e-3  # samples


@dataclass(frozen=True, kw_only=True, eq=False)
class Scaled:
    """Operator of a parameter vector of the fit, in scaled units.

    gap, threshold  (plays,)      d and r of the moving plays
    weight          (plays + 1,)  w_0 first
    knot            (zones,)      kinks of Psi with 0 among them, increasing
    slope           (zones + 1,)  slopes below, between and above the kinks
    zero            index of the kink at 0
    lag_s           lag behind the operator
    envelope        gamma, in front of the plays
    """

    gap: Array
    threshold: Array
    weight: Array
    knot: Array
    slope: Array
    zero: int
    lag_s: float
    envelope: DeadZones = LINEAR

    @Once
    def plays(self) -> PrandtlIshlinskii:
        """All plays, beginning with the play of threshold 0."""
        return PrandtlIshlinskii(
            threshold=np.concatenate([[0.0], self.threshold]), weight=self.weight
        )

    @Once
    def dead_zones(self) -> DeadZones:
        """Psi, the memoryless map behind the plays."""
        return from_slopes(self.knot, self.slope)


Operator = Scaled | ModifiedPrandtlIshlinskii
UNSCALED = Scales(voltage_V=1.0, voltage_offset_V=0.0, displacement_m=1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Forward:
    """Forward model without the initial state and the zero of a piece.

    operator      y = Psi(H[gamma(u)]), u and y scaled by ``scales``
    lag           ``none``, ``delay`` or ``first_order``
    lag_s         s, >= 0
    amplifier_Hz  declared pole of the drive; None: no pole, or the drive was measured behind it
    sensor_Hz     declared pole of the reading, or None
    extensions    in the order in which they act
    scales        of drive and displacement; by default 1 V and 1 m
    """

    operator: Operator
    lag: str = "none"
    lag_s: float = 0.0
    amplifier_Hz: float | None = None
    sensor_Hz: float | None = None
    extensions: tuple[Extension, ...] = ()
    scales: Scales = UNSCALED

    def driven_V(self, voltage_V: Array, rate_Hz: float) -> Array:
        """Return the voltage that reaches the ceramic, (samples,)."""
        reached_V = behind_pole(voltage_V, self.amplifier_Hz, rate_Hz)
        for extension in self.extensions:
            reached_V = extension.drive(reached_V, rate_Hz)
        return reached_V

    def inner(self, drive: Array) -> Array:
        """Return gamma(u), the input of the plays, (samples,)."""
        envelope = self.operator.envelope
        return drive if envelope is LINEAR else envelope.run(drive)

    def memory(self, first: float, slope: Array) -> Array:
        """Return the states of all plays before a sample, z_i = gamma(u) + sum_(j<=i) d_j s_j.

        first  u at that sample
        slope  (plays - 1,)  s, -1 to 1: every such memory is admissible
        """
        inner = self.inner(np.array([first]))
        return np.concatenate([inner, inner + np.cumsum(self.operator.gap * slope)])

    def static(self, drive: Array, memory: Array, rate_Hz: float) -> tuple[Array, Array]:
        """Return Psi(H[gamma(u)]), (samples,), and the memory after the last sample, (plays,).

        Extensions may delay the irreversible part.

        memory  (plays,)  before the first sample; for a chunk that of the previous chunk
        """
        operator, inner = self.operator, self.inner(drive)
        h, memory_after = operator.plays.run(inner, memory)
        stroke_m = abs(self.scales.displacement_m)
        for extension in self.extensions:
            reversible = operator.plays.weight[0] * inner
            irreversible_m = (h - reversible) * stroke_m
            delayed_m = extension.irreversible(irreversible_m, rate_Hz)
            h = h if delayed_m is irreversible_m else reversible + delayed_m / stroke_m
        return operator.dead_zones.run(h), memory_after

    def linear_response(
        self, displacement: Array, where: Where, *, fast_only: bool = False
    ) -> Array:
        """Apply the linear part of the model to the output of the hysteresis.

        displacement  (samples,) or (samples, columns)
        fast_only     whether to omit extensions with ``is_fast`` False, such as creep
        """
        displacement = np.asfortranarray(displacement)  # filters run down the columns
        for extension in self.extensions:
            if extension.is_fast or not fast_only:
                displacement = extension.response(displacement, where)
        return self.filtered(displacement, where.rate_Hz)

    def filtered(self, signal: Array, rate_Hz: float) -> Array:
        """Filter a signal, or columns, by the lag of the model and the declared sensor."""
        return behind_pole(lagged(signal, self.lag, self.lag_s, rate_Hz), self.sensor_Hz, rate_Hz)

    def group_delay_s(self, rate_Hz: float) -> float:
        """Return the delay of slow motion by lag, sensor and extensions."""
        sensor_s = 0.0 if self.sensor_Hz is None else 1.0 / (2.0 * np.pi * self.sensor_Hz)
        return sensor_s + self.lag_s + sum(e.group_delay_s(rate_Hz) for e in self.extensions)

    def position(self, static: Array, where: Where, zero_m: Array | float = 0.0) -> Array:
        """Return the position in front of the sensor, (samples,) m, from a static response."""
        position_m = zero_m + self.linear_response(static * self.scales.displacement_m, where)
        for extension in self.extensions:
            position_m = position_m + extension.added(where)
        return np.asarray(position_m)

    def read(self, position_m: Array, where: Where) -> Array:
        """Return the reading of the sensor at a position, (samples,) m."""
        for extension in self.extensions:
            position_m = extension.reading(position_m, where)
        return position_m

    def gain_at(self, sample: Samples, where: Where) -> Array | float:
        """Return the gain of the extensions at samples, (rows, 1), or 1."""
        gain: Array | float = 1.0
        for extension in self.extensions:
            gain = gain * extension.gain(where)
        return gain if isinstance(gain, float) else gain[sample, None]

    def chain(self, memory_slope: Array, rate_Hz: float) -> Chain:
        """Return the hysteresis in the form of the kernel that computes its derivatives."""
        operator = self.operator
        return Chain(
            gap=operator.gap,
            weight=operator.plays.weight,
            memory_slope=memory_slope,
            zones=operator.dead_zones,
            envelope=operator.envelope,
            rate_Hz=rate_Hz,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """Simulation of one piece, with the derivatives of its reading by every parameter.

    command       (samples,)  scaled drive
    memory_slope  (plays - 1,)  of the states before the first sample
    zero_m        m, of the piece
    centre_m      m, subtracted from readings before they are scaled
    where         location of the piece, for extensions
    turns         (samples,)  reversals of the command, if known
    """

    forward: Forward
    command: Array
    memory_slope: Array
    zero_m: float
    centre_m: float
    where: Where
    turns: NDArray[np.bool_] | None = None

    @Once
    def drive(self) -> Array:
        """Scaled drive at the ceramic, (samples,)."""
        if not self.forward.extensions and self.forward.amplifier_Hz is None:
            return self.command
        scales = self.forward.scales
        voltage_V = scales.voltage_offset_V + scales.voltage_V * self.command
        reached_V = self.forward.driven_V(voltage_V, self.where.rate_Hz)
        if reached_V is voltage_V:
            return self.command
        return np.ascontiguousarray((reached_V - scales.voltage_offset_V) / scales.voltage_V)

    @Once
    def static(self) -> Array:
        """Scaled response of the hysteresis, (samples,)."""
        memory = self.forward.memory(self.drive[0], self.memory_slope)
        return self.forward.static(self.drive, memory, self.where.rate_Hz)[0]

    @Once
    def reading(self) -> Array:
        """Scaled reading of the sensor, (samples,)."""
        position_m = self.forward.position(self.static, self.where, self.zero_m)
        relative_m = self.forward.read(position_m, self.where) - self.centre_m
        return np.asarray(relative_m / self.forward.scales.displacement_m)

    def reading_at(self, sample: Samples) -> Array:
        """Return the scaled reading at increasing samples, (rows,).

        Behind a pure delay, the states are computed from row to row if the rows are sparse.
        """
        forward, rate_Hz = self.forward, self.where.rate_Hz
        if forward.extensions:
            return self.reading[sample]
        memory = forward.memory(self.command[0], self.memory_slope)
        is_sparse = SPARSE * len(sample) < len(self.command)
        if forward.lag == "delay" and forward.sensor_Hz is None and is_sparse:
            whole_samples = int(np.floor(forward.lag_s * rate_Hz))
            share = forward.lag_s * rate_Hz - whole_samples
            source = np.maximum(sample - whole_samples, 0)
            drive, nearest = thinned_drive(
                self.command, source, with_previous=True, turns=self.turns
            )
            output, _ = forward.static(drive, memory, rate_Hz)
            previous = output[np.maximum(nearest - 1, 0)]
            output = (1.0 - share) * output[nearest] + share * previous
        else:
            output, _ = forward.static(self.command, memory, rate_Hz)
            output = forward.filtered(output, rate_Hz)[sample]
        return np.asarray(output + (self.zero_m - self.centre_m) / forward.scales.displacement_m)

    def rows(self, sample: Samples, zeros: int) -> Iterator[tuple[Samples, Array]]:
        """Yield samples and the derivatives of the reading by all parameters, in chunks of rows.

        The columns are memory slopes; columns of the zero, which are not written; gaps, weights,
        zones, envelope and lag; numbers of the extensions; and the reading. Without a lag there is
        no column of it.

        sample  (rows,)  increasing
        zeros   number of columns of the zero
        """
        forward, rate_Hz = self.forward, self.where.rate_Hz
        if forward.extensions:
            columns = self.by_hysteresis(sample)
            of_memory, of_operator = np.split(columns, [len(self.memory_slope)], axis=1)
            tables = [of_memory, np.zeros((len(sample), zeros)), of_operator]
            if forward.lag != "none":
                tables.append(self.by_lag(sample)[:, None])
            tables += [self.by_extension(k, sample) for k in range(len(forward.extensions))]
            tables.append(self.reading[sample, None])
            yield sample, np.asfortranarray(np.hstack(tables))
            return
        # Run chunk by chunk, the chain equals ``static`` and ``filtered``, with the derivatives by
        # all of their parameters; only whole samples of a delay are not part of it.
        delay, share = 0, None
        if forward.lag == "delay":
            delay = int(np.floor(forward.lag_s * rate_Hz))
            share = forward.lag_s * rate_Hz - delay
        lag_s = forward.lag_s if forward.lag == "first_order" else None
        pole_s = None if forward.sensor_Hz is None else 1.0 / (2 * np.pi * forward.sensor_Hz)
        lag, sensor = (
            None if time_s is None else FirstOrder(time_s=time_s, rate_Hz=rate_Hz)
            for time_s in (lag_s, pole_s)
        )
        chain = replace(
            forward.chain(self.memory_slope, rate_Hz), share=share, lag=lag, sensor=sensor
        )
        source = np.maximum(sample - delay, 0)
        tangents = Following(chain, float(self.command[0]))
        drive = self.command
        if chain.lag is None and chain.sensor is None and SPARSE * len(sample) < len(drive):
            drive, source = thinned_drive(drive, source, with_previous=True, turns=self.turns)
        constant = (self.zero_m - self.centre_m) / forward.scales.displacement_m
        first = start = 0
        while start < len(sample):
            last_source = source[min(start + CHUNK, len(sample)) - 1]
            end = int(np.searchsorted(source, last_source, side="right"))
            rows = sample[start:end]
            block = np.empty((len(rows), chain.plays + zeros + chain.columns), order="F")
            tangents.rows(drive[first : last_source + 1], source[start:end] - first, block)
            reading = block[:, -1] + constant
            if forward.lag == "none":
                block = block[:, :-1]
            block[:, -1] = reading
            yield rows, block
            first, start = int(last_source) + 1, end

    def by_hysteresis(self, sample: Samples) -> Array:
        """Return d reading / d [memory slopes, gaps, weights, zones, envelope], (rows, numbers).

        For slow motion the filters act as a delay, and two samples are computed for each row.
        Otherwise the columns are simulated at all samples and pass delays, lags and modes exactly.
        Creep is omitted: it changes a column by a hundredth, and the search accepts steps by the
        exact error.
        """
        forward, where = self.forward, self.where
        delay = forward.group_delay_s(where.rate_Hz) * where.rate_Hz
        whole_samples = int(np.floor(delay))
        share = delay - whole_samples
        source = np.maximum(sample - whole_samples, 0)
        newer, older = self.static[source], self.static[np.maximum(source - 1, 0)]
        delayed = (1.0 - share) * newer + share * older
        filtered = forward.linear_response(self.static, where, fast_only=True)[sample]
        chain = forward.chain(self.memory_slope, where.rate_Hz)
        is_too_large = len(self.drive) * (chain.plays + chain.columns - 1) > MAX_ENTRIES
        if is_too_large or np.std(filtered - delayed) < MAX_DELAY_ERROR * np.std(filtered):
            columns = self._columns(replace(chain, share=share), source)
        else:
            columns = self._columns(chain, np.arange(int(sample[-1]) + 1))
            columns = forward.linear_response(columns, where, fast_only=True)[sample]
        gain = forward.gain_at(sample, where)
        return columns if isinstance(gain, float) else columns * gain

    def _columns(self, chain: Chain, source: Samples) -> Array:
        rows = np.empty((len(source), chain.plays + chain.columns), order="F")
        drive = self.drive[: int(source[-1]) + 1]
        Following(chain, float(drive[0])).rows(drive, source, rows)
        return rows[:, :-2]

    def by_lag(self, sample: Samples) -> Array:
        """Return d reading / d lag, (rows,), by a finite difference."""
        forward, step_s = self.forward, LAG_STEP / self.where.rate_Hz
        return self._quotient(replace(forward, lag_s=forward.lag_s + step_s), sample, step_s)

    def by_extension(self, number: int, sample: Samples) -> Array:
        """Return d reading / d numbers of an extension, (rows, numbers).

        Derivatives of added displacement are exact, others are finite differences.
        """
        forward, extension = self.forward, self.forward.extensions[number]
        added = extension.added_by_number(self.where)
        free = extension.free()
        by_number = np.zeros((len(sample), len(free.value)))
        if added is not None:
            first, columns = added
            by_number[:, first : first + columns.shape[1]] = columns[sample]
            return by_number / forward.scales.displacement_m
        for j, step in enumerate(free.step.tolist()):
            # A step beyond the upper bound is taken downwards instead.
            signed = step if free.value[j] + step <= free.upper[j] else -step
            value = free.value.copy()
            value[j] += signed
            extensions = list(forward.extensions)
            extensions[number] = extension.moved_to(value)
            changed = replace(forward, extensions=tuple(extensions))
            by_number[:, j] = self._quotient(changed, sample, signed)
        return by_number

    def _quotient(self, forward: Forward, sample: Samples, step: float) -> Array:
        """Return the change of the reading by a change of the model, over the step."""
        changed = replace(self, forward=forward).reading
        return np.asarray((changed - self.reading)[sample] / step)
