"""Prandtl-Ishlinskii operators: weighted plays, their exact inverse and their differences.

The modified operator has dead zones after the plays, and offsets. With an envelope in front of the
plays it is the generalised operator with equal envelopes. All inverses are exact.
"""

import ctypes
from dataclasses import dataclass, replace

import numpy as np

from piezoid.errors import NotInvertibleError
from piezoid.numerics.arrays import Array, freeze, same_length, strictly_increasing
from piezoid.operators.dead_zone import LINEAR, DeadZones
from piezoid.operators.library import KERNELS, address, contiguous


@dataclass(frozen=True, kw_only=True, eq=False)
class PrandtlIshlinskii:
    """A weighted sum of plays.

        h[k] = sum_i w_i z_i[k],   W_i = w_0 + ... + w_i,   phi(s) = sum_j w_j max(s - r_j, 0)

    r  threshold  (plays,)  unit of the input, r_0 = 0, strictly increasing
    w  weight     (plays,)  output per unit of input

    Has an inverse of the same class if every cumulative slope W_i is positive; single weights may
    be negative.                                                     [Krejci & Kuhnen 2001]
    """

    threshold: Array
    weight: Array

    def __post_init__(self) -> None:
        freeze(self, "threshold", "weight")
        same_length([("threshold", self.threshold), ("weight", self.weight)])
        strictly_increasing(self.threshold, "threshold")
        if self.threshold[0] != 0.0:
            raise ValueError(f"threshold[0] is {self.threshold[0]}, expected 0")

    @property
    def slope(self) -> Array:
        """Cumulative slopes W_i, (plays,)."""
        return np.cumsum(self.weight)

    def virgin_memory(self) -> Array:
        """Return the de-poled state: every play at zero, the input at zero."""
        return np.zeros_like(self.threshold)

    def run(self, values: Array, memory: Array) -> tuple[Array, Array]:
        """Return the output and the memory after the last sample.

        values  (samples,)  input
        memory  (plays,)    admissible states before the first sample
        """
        source = contiguous(values)
        state = np.array(memory, dtype=np.float64)
        output = np.empty_like(source)
        KERNELS.pk_play_sum(
            len(source),
            address(source),
            len(state),
            address(self.threshold),
            address(self.weight),
            address(state),
            address(output),
        )
        return output, state

    def loading_curve(self, s: Array) -> Array:
        """Return phi(s) for s >= 0: the response of the virgin operator to a first rise."""
        reach = np.maximum(np.asarray(s)[:, None] - self.threshold, 0.0)
        return np.asarray(reach @ self.weight)

    def inverse(self) -> "PrandtlIshlinskii":
        """Return the inverse operator.

            r'_i = phi(r_i);  w'_0 = 1 / W_0;  w'_i = 1 / W_i - 1 / W_(i-1)

        Its memory is ``inverse_memory`` of that of this operator. Raises ``NotInvertibleError`` if
        a W_i <= 0.
        """
        slope = self.slope
        if not (slope > 0).all():
            row = int(np.argmin(slope))
            raise NotInvertibleError(
                f"the cumulative slope W_{row} is {slope[row]:.6g}",
                needed="every cumulative slope must be positive for an inverse",
                remedy="Refit with non-negative weights.",
            )
        return PrandtlIshlinskii(
            threshold=self.loading_curve(self.threshold),
            weight=np.diff(1.0 / slope, prepend=0.0),
        )

    def inverse_memory(self, memory: Array) -> Array:
        """Return the memory of the inverse operator for a memory of this one.

        z'_i = W_i z_i + sum_(j>i) w_j z_j
        """
        product = self.weight * memory
        tail = np.cumsum(product[::-1])[::-1] - product
        return np.asarray(self.slope * memory + tail)


def worst_case(
    first: PrandtlIshlinskii, second: PrandtlIshlinskii, reach: float
) -> tuple[float, Array]:
    """Return the exact worst difference over all inputs with |u| <= reach, and such an input.

        B(R) = integral_0^R |W_1(r) - W_2(r)| dr

    Both start in the same admissible memory with |z(r)| <= max(R - r, 0), for example virgin. The
    attaining input has the extrema u = lambda(c) + s c at the corners c of a memory curve of slope
    -sign(W_1 - W_2), from wide plays to narrow ones.

    returned  supremum, in the unit of the output; (count,) alternating extrema of the input
    """
    # Between the edges both slopes are constant: that of the last play whose threshold is below.
    inner = np.concatenate([first.threshold, second.threshold])
    edges = np.unique(np.concatenate([[0.0, reach], inner[inner < reach]]))
    middle = (edges[1:] + edges[:-1]) / 2
    slopes = [
        operator.slope[np.searchsorted(operator.threshold, middle, side="right") - 1]
        for operator in (first, second)
    ]
    difference = slopes[0] - slopes[1]
    bound = float((np.abs(difference) * np.diff(edges)).sum())
    sign = np.sign(difference)
    nonzero = np.flatnonzero(sign)
    if nonzero.size:  # where the operators agree the sign of a neighbour avoids a corner
        nearest = np.searchsorted(nonzero, np.arange(len(sign)))
        sign = sign[nonzero[np.clip(nearest, 0, len(nonzero) - 1)]]
    else:
        sign = np.ones_like(sign)
    extrema: list[float] = []
    corner = 0.0
    upper = len(sign)
    while upper > 0:
        lower = upper - 1
        while lower > 0 and sign[lower - 1] == sign[upper - 1]:
            lower -= 1
        s = sign[upper - 1]
        corner += s * (edges[upper] - edges[lower])
        extrema.append(corner + s * edges[lower])
        upper = lower
    return bound, np.array(extrema)


@dataclass(frozen=True, kw_only=True, eq=False)
class ModifiedPrandtlIshlinskii:
    """Modified Prandtl-Ishlinskii model: plays followed by dead zones.

        y = y_off + Psi(H[gamma(u - u_off)])

    plays                  H, thresholds in V, weights in m/V
    dead_zones             Psi, thresholds in m, weights without unit
    voltage_offset_V       u_off; the plays act on gamma(u - u_off)
    displacement_offset_m  y_off
    envelope               gamma, V to V; the identity in Kuhnen's model [Kuhnen 2003], increasing
                           in the generalised one [Al Janaideh, Rakheja & Su 2011]

    Gauge: the dead zone at 0 has weight 1, so that H converts to metres. Models are compared in
    this gauge; ``regauged`` converts to it.
    """

    plays: PrandtlIshlinskii
    dead_zones: DeadZones
    voltage_offset_V: float = 0.0
    displacement_offset_m: float = 0.0
    envelope: DeadZones = LINEAR

    @property
    def gap(self) -> Array:
        """Gaps between the thresholds of the plays, (plays - 1,)."""
        return np.diff(self.plays.threshold)

    @property
    def is_invertible(self) -> bool:
        """Whether all parts have an inverse: all their slopes are positive."""
        parts = (self.plays, self.dead_zones, self.envelope)
        return all(bool((part.slope > 0).all()) for part in parts)

    @property
    def slope_sector_m_per_V(self) -> tuple[float, float]:
        """Smallest and largest incremental gain: m <= dy/du <= M for every step of every input."""
        slopes = (self.envelope.slope, self.plays.slope, self.dead_zones.slope)
        smallest, largest = np.prod([[s.min(), s.max()] for s in slopes], axis=0)
        return float(smallest), float(largest)

    @property
    def middle_slope_m_per_V(self) -> float:
        """Middle of the slope sector, by which a linear model replaces the hysteresis."""
        return 0.5 * sum(self.slope_sector_m_per_V)

    def virgin_memory(self) -> Array:
        """Return the de-poled state."""
        return self.plays.virgin_memory()

    def run(self, voltage_V: Array, memory_V: Array) -> tuple[Array, Array]:
        """Return the displacement and the memory after the last sample.

        voltage_V  (samples,)  V
        memory_V   (plays,)    V, admissible states before the first sample
        returned   (samples,)  m, and (plays,) V
        """
        offsets = self.voltage_offset_V, self.displacement_offset_m
        return _run(voltage_V, memory_V, self.envelope, self.plays, self.dead_zones, offsets)

    def inverse_run(self, displacement_m: Array, memory_V: Array) -> tuple[Array, Array]:
        """Return the voltage for a displacement, and the forward memory after it.

            u = u_off + gamma^-1(H^-1[Psi^-1(y - y_off)])

        displacement_m  (samples,)  m
        memory_V        (plays,)    V, the forward memory before the first sample
        """
        zones, plays = self.dead_zones.inverse(), self.plays.inverse()
        start, offsets = self.plays.inverse_memory(memory_V), (self.displacement_offset_m, 0.0)
        voltage_V, memory_after = _run(displacement_m, start, zones, plays, LINEAR, offsets)
        if self.envelope is not LINEAR:
            voltage_V = self.envelope.inverse().run(voltage_V)
        voltage_V += self.voltage_offset_V
        # The inverse of the inverse plays gives the forward memory.
        return voltage_V, plays.inverse_memory(memory_after)

    def multiplied(self, factor: float) -> "ModifiedPrandtlIshlinskii":
        """Return the operator with the displacement multiplied by a factor."""
        zones = replace(self.dead_zones, weight=self.dead_zones.weight * factor)
        return replace(self, dead_zones=zones)

    def rescaled(self, c: float) -> "ModifiedPrandtlIshlinskii":
        """Return the same operator in another gauge: (w, r_S, w_S) -> (c w, c r_S, w_S / c)."""
        return replace(
            self,
            plays=PrandtlIshlinskii(threshold=self.plays.threshold, weight=self.plays.weight * c),
            dead_zones=DeadZones(
                threshold=self.dead_zones.threshold * c, weight=self.dead_zones.weight / c
            ),
        )

    def regauged(self) -> "ModifiedPrandtlIshlinskii":
        """Return the same operator with weight 1 at the central dead zone."""
        return self.rescaled(float(self.dead_zones.weight[self.dead_zones.zero]))


def _run(
    values: Array,
    memory: Array,
    first_map: DeadZones,
    plays: PrandtlIshlinskii,
    last_map: DeadZones,
    offsets: tuple[float, float],
) -> tuple[Array, Array]:
    """Subtract an offset, apply a map, plays and a second map, and add an offset."""
    source = contiguous(values)
    state = np.array(memory, dtype=np.float64)
    output = np.empty_like(source)
    maps = [
        None if section is LINEAR else section.kernel_map() for section in (first_map, last_map)
    ]
    addresses = [
        None if kernel_map is None else ctypes.addressof(kernel_map) for kernel_map in maps
    ]
    KERNELS.pk_mapped_plays(
        len(source),
        address(source),
        offsets[0],
        addresses[0],
        len(state),
        address(plays.threshold),
        address(plays.weight),
        address(state),
        addresses[1],
        offsets[1],
        address(output),
    )
    return output, state
