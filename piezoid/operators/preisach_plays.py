"""The Preisach operator in play form, and the largest difference of two over all histories.

With plays and edges on one lattice two operators have the same states:

    y_t - y_m = sum_i g_i(z_i),   g_i = phi_i of one - phi_i of the other
    |z_i - z_(i-1)| <= r_1,   |z_i| <= max(R - r_i, 0)

for every drive within R that began de-poled or at an end of it. The g_i are linear between lattice
points, and all constraints are differences of whole steps. The extremes lie on the lattice: states
with the same fraction of a step can move together, and the sum changes linearly until they meet
other states. Dynamic programming from the widest play to the narrowest finds the extremes.

Along a branch on which the plays up to some j move, both operators have slopes, and the
incremental gain of one behind the inverse of the other is their ratio. There is one ratio for each
j and each lattice point.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array, freeze
from piezoid.operators.library import KERNELS, address, contiguous
from piezoid.operators.play import play_columns

Mask = NDArray[np.bool_]
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

    @property
    def middle_slope_m_per_V(self) -> float:
        """Middle of the slope sector, by which a linear model replaces the hysteresis."""
        return 0.5 * sum(self.slope_sector_m_per_V)

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


def farthest_from_line_m(operator: PreisachPlays, slope_m_per_V: float, reach_V: float) -> float:
    """Return sup |y - slope u - c| over all drives within a reach of u_off, for the best c.

    >>> straight = PreisachPlays(
    ...     step_V=1.0,
    ...     edge_V=np.array([-2.0, 2.0]),
    ...     value_m=np.array([[-2.0, 2.0], [-1.0, 1.0]]),
    ... )
    >>> farthest_from_line_m(straight, 1.0, 2.0)  # one play of half-width 1, of slope 1/2
    0.5
    """
    level_V, allowed = _lattice(operator, reach_V)
    value_m = _values(operator, level_V)
    value_m[0] -= slope_m_per_V * level_V
    return float(_half_range(value_m[None], allowed)[0])


def farthest_apart_m(
    model: PreisachPlays, alternatives: Sequence[PreisachPlays], reach_V: float
) -> Array:
    """Return sup |y - y_model - c| over drives within a reach, for the best c, (alternatives,).

    Raises ``ValueError`` unless all operators have the same lattice.

    >>> straight = PreisachPlays(
    ...     step_V=1.0,
    ...     edge_V=np.array([-2.0, 2.0]),
    ...     value_m=np.array([[-2.0, 2.0], [-1.0, 1.0]]),
    ... )
    >>> farthest_apart_m(straight, [straight], 2.0)
    array([0.])
    """
    level_V, allowed = _lattice(model, reach_V, alternatives)
    model_m = _values(model, level_V)
    difference_m = np.array(
        [_values(alternative, level_V) - model_m for alternative in alternatives]
    )
    return _half_range(difference_m, allowed)


def slope_ratios(
    model: PreisachPlays, alternatives: Sequence[PreisachPlays], reach_V: float
) -> Array:
    """Return the smallest and largest incremental gain of alternatives behind the inverse model.

    returned  (alternatives, 2)

    >>> straight = PreisachPlays(
    ...     step_V=1.0,
    ...     edge_V=np.array([-2.0, 2.0]),
    ...     value_m=np.array([[-2.0, 2.0], [-1.0, 1.0]]),
    ... )
    >>> slope_ratios(straight, [straight], 2.0)
    array([[1., 1.]])
    """
    level_V, allowed = _lattice(model, reach_V, alternatives)
    slope = _branch_slopes(_values(model, level_V), allowed)
    ratios = []
    for alternative in alternatives:
        ratio = _branch_slopes(_values(alternative, level_V), allowed) / slope
        ratios.append((np.nanmin(ratio), np.nanmax(ratio)))
    return np.array(ratios)


def _lattice(
    operator: PreisachPlays, reach_V: float, alternatives: Sequence[PreisachPlays] = ()
) -> tuple[Array, Mask]:
    """Return the drive levels of the lattice, and which of them the state of each play can reach.

    alternatives  operators that must have the same lattice
    returned      (levels,) V, and (plays, levels); the reach is rounded up to the lattice
    """
    for alternative in alternatives:
        if (
            alternative.value_m.shape != operator.value_m.shape
            or alternative.step_V != operator.step_V
            or not np.array_equal(alternative.edge_V, operator.edge_V)
        ):
            raise ValueError("plays or edges of two operators differ, expected one lattice")
    first_V, step_V = operator.edge_V[0], operator.step_V
    slack = 1e-9
    low = np.floor((-reach_V - first_V) / step_V + slack)
    high = np.ceil((reach_V - first_V) / step_V - slack)
    index = np.arange(low, high + 1)
    inward = np.arange(len(operator.value_m))
    inward = np.minimum(inward, (len(index) - 1) // 2)[:, None]
    return first_V + step_V * index, (index >= low + inward) & (index <= high - inward)


def _values(operator: PreisachPlays, level_V: Array) -> Array:
    """Return the values of all functions at all levels, (plays, levels) m."""
    return np.array([straight_between(level_V, operator.edge_V, v) for v in operator.value_m])


def _half_range(value_m: Array, allowed: Mask) -> Array:
    """Return half the range of sums over admissible states, by dynamic programming, (sums,).

    value_m  (sums, plays, levels)
    """
    extremes = []
    for signed_m in (value_m, -value_m):
        best_m = np.where(allowed[-1], signed_m[:, -1], -np.inf)
        for play in range(value_m.shape[1] - 2, -1, -1):
            padded_m = np.pad(best_m, ((0, 0), (1, 1)), constant_values=-np.inf)
            best_m = np.maximum(np.maximum(padded_m[:, :-2], padded_m[:, 2:]), best_m)
            best_m = np.where(allowed[play], signed_m[:, play] + best_m, -np.inf)
        extremes.append(best_m.max(axis=1))
    return np.asarray(0.5 * (extremes[0] + extremes[1]))


def _branch_slopes(value_m: Array, allowed: Mask) -> Array:
    """Return the rise per step of all branches, (2, plays, levels - 1); NaN where undefined.

    On a rising branch at level k play i has the state k - i, on a falling branch k + i. The sums
    are over the moving plays, beginning with the narrowest.
    """
    slopes = []
    for direction in (1, -1):  # a falling branch is a rising one on the reversed lattice
        rise_m = np.diff(value_m[:, ::direction], axis=1) * direction
        is_allowed = (allowed[:, 1:] & allowed[:, :-1])[:, ::direction]
        plays, steps = rise_m.shape
        summed = np.full((plays, steps), np.nan)
        sum_m = np.zeros(steps)
        for play in range(plays):
            shifted_m = np.full(steps, np.nan)
            shifted_m[play:] = np.where(is_allowed[play], rise_m[play], np.nan)[: steps - play]
            sum_m = sum_m + shifted_m
            summed[play] = sum_m
        slopes.append(summed)
    return np.array(slopes)
