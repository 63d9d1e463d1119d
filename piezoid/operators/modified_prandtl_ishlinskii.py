"""The modified Prandtl-Ishlinskii model: dead zones after plays, with offsets, and its inverse.

With an envelope in front of the plays it is the generalised model with equal envelopes. Both
inverses are exact.
"""

import ctypes
from dataclasses import dataclass, replace

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import LINEAR, DeadZones
from piezoid.operators.library import KERNELS, address, contiguous
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii


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
