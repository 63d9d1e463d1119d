"""The Preisach operator in play form: a sum of rising functions of the states of plays."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from piezoid.numerics.arrays import Array, freeze
from piezoid.operators.library import KERNELS, address, contiguous
from piezoid.operators.play import play_columns

UNEVEN = 1e-9  # of a step: rounding of numbers read from a file


@dataclass(frozen=True, kw_only=True, eq=False)
class PreisachPlays:
    """A sum of rising functions of plays, which represents all closed minor loops.

        y = y_off + sum_i phi_i(z_i[u - u_off]),   phi_i linear between edges        [Krejci 1996]

    step_V      r_i = i step_V are the half-widths of the plays
    edge_V      (edges,)        V, evenly spaced by whole steps, ascending
    value_m     (plays, edges)  m, phi_i at the edges: nondecreasing, and increasing for i = 0;
                extrapolated linearly beyond the outermost edges
    voltage_offset_V, displacement_offset_m  u_off and y_off

    The density in the Preisach plane is constant in cells bounded by rising and falling branches;
    linear functions give a Prandtl-Ishlinskii operator. A branch changes its slope only at points
    ``step_V`` apart or where a play begins to move, so that their number is known for the inverse.
    """

    step_V: float
    edge_V: Array
    value_m: Array
    voltage_offset_V: float = 0.0
    displacement_offset_m: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, "edge_V")
        freeze(self, "value_m", ndim=2)
        plays, edges = self.value_m.shape
        steps = np.diff(self.edge_V) / self.step_V
        if plays < 2 or edges < 2 or edges != len(self.edge_V) or not self.step_V > 0.0:
            raise ValueError(
                f"{plays} plays {self.step_V} V apart with {edges} values at {len(self.edge_V)} "
                "edges, expected two or more of each"
            )
        if np.abs(steps - max(round(steps[0]), 1)).max() > UNEVEN * steps[0]:
            raise ValueError(f"edges are {steps} steps apart, expected the same whole number")
        if self.rise_m.min() < 0.0 or self.rise_m[0].min() <= 0.0:
            raise ValueError(f"a function falls by {-self.rise_m.min():.3g} m between edges")

    def multiplied(self, factor: float) -> "PreisachPlays":
        """Return the operator with the displacement multiplied by a factor."""
        return replace(self, value_m=factor * self.value_m)

    def with_rises(self, rise_m: Array) -> "PreisachPlays":
        """Return the operator with other rises of its functions, each 0 at the middle edge.

        rise_m  (plays, edges - 1)  m
        """
        value_m = np.pad(np.cumsum(rise_m, axis=1), ((0, 0), (1, 0)))
        return replace(self, value_m=value_m - value_m[:, len(self.edge_V) // 2, None])

    @cached_property
    def rise_m(self) -> Array:
        """Rises of the functions between edges, (plays, edges - 1)."""
        return np.asarray(np.diff(self.value_m, axis=1))

    @property
    def threshold_V(self) -> Array:
        """Half-widths of the plays, (plays,)."""
        return np.asarray(self.step_V * np.arange(len(self.value_m)))

    @property
    def slope_sector_m_per_V(self) -> tuple[float, float]:
        """Smallest and largest incremental gain: m <= dy/du <= M for every step of every input.

        After a reversal only phi_0 changes, and further along the branch the plays up to some i
        move, with the states u -+ r_i. The largest sums occur on the lattice of the breakpoints.
        """
        width = self.edge_V[1] - self.edge_V[0]
        reach = self.threshold_V[-1]
        middle = np.arange(self.edge_V[0] - reach, self.edge_V[-1] + reach, self.step_V)
        middle += 0.5 * self.step_V
        largest = 0.0
        for side in (-1.0, 1.0):
            position = (middle[:, None] + side * self.threshold_V - self.edge_V[0]) / width
            k = np.clip(position.astype(int), 0, len(self.edge_V) - 2)
            slopes = self.rise_m[np.arange(len(self.value_m)), k].sum(axis=1) / width
            largest = max(largest, float(slopes.max()))
        return float(self.rise_m[0].min() / width), largest

    def virgin_memory(self) -> Array:
        """Return the memory of a de-poled stage, (plays,) of u - u_off."""
        return np.zeros(len(self.value_m))

    def at_rest(self, voltage_V: float) -> Array:
        """Return the memory of a de-poled stage after a ramp to a voltage, of u - u_off."""
        u, r = voltage_V - self.voltage_offset_V, self.threshold_V
        return np.clip(self.virgin_memory(), u - r, u + r)

    def run(self, voltage_V: Array, memory_V: Array) -> tuple[Array, Array]:
        """Return the displacement and the memory after the last sample.

        voltage_V  (samples,)  V
        memory_V   (plays,)    V, admissible states before the first sample
        """
        u = contiguous(voltage_V - self.voltage_offset_V)
        states, memory_after = play_columns(u, self.threshold_V, memory_V)
        displacement = np.full(len(u), self.displacement_offset_m)
        for state, value in zip(states.T, self.value_m, strict=True):
            displacement += straight_between(state, self.edge_V, value)
        return displacement, memory_after

    def inverse_run(self, displacement_m: Array, memory_V: Array) -> tuple[Array, Array]:
        """Return the voltage for a displacement, and the memory after it.

        displacement_m  (samples,)  m
        memory_V        (plays,)    V, before the first sample

        Solved by bisection to the last bit, because every branch rises.
        """
        desired = contiguous(displacement_m - self.displacement_offset_m)
        state = np.array(memory_V, dtype=np.float64)
        voltage = np.empty_like(desired)
        plays, edges = self.value_m.shape
        KERNELS.pk_valued_inverse(
            len(desired),
            address(desired),
            plays,
            self.step_V,
            edges,
            address(self.edge_V),
            address(contiguous(self.value_m)),
            address(state),
            address(voltage),
        )
        return voltage + self.voltage_offset_V, state


def straight_between(x: Array, edge: Array, value: Array) -> Array:
    """Interpolate linearly between edges, and extrapolate the outermost pieces."""
    result = np.interp(x, edge, value)
    for beyond, end, inner in ((x < edge[0], 0, 1), (x > edge[-1], -1, -2)):
        if beyond.any():
            slope = (value[end] - value[inner]) / (edge[end] - edge[inner])
            result[beyond] = value[end] + slope * (x[beyond] - edge[end])
    return result
