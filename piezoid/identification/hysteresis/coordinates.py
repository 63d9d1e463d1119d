"""Parameter vector of the hysteresis fit: layout, bounds, conversion to an operator and to SI.

Everything is in scaled units, drive and displacement divided by half their range, so that all
numbers are of order one. The parametrisation makes every constraint a bound on one number:

    play thresholds       r_i = d_1 + ... + d_i,            d_i >= a least gap
    initial memory        z_i(0) = u(0) + sum_(j<=i) d_j s_j,  -1 <= s_j <= 1   (admissible)
    slopes of Psi         free between two limits, the two at the origin fixed to 1
    kinks of Psi          sums of gaps >= a least gap, outwards from 0
    play weights          w_0 >= a least slope, w_i >= 0
    slopes of gamma       free within a factor of two of the middle slope, which is 1

gamma is the envelope in front of the plays: without bends it is the identity and the model is
Kuhnen's; with them it is the generalised Prandtl-Ishlinskii model with equal envelopes.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from piezoid.identification.forward import Scaled
from piezoid.identification.hysteresis.pieces import Scales
from piezoid.numerics.arrays import Array, Samples
from piezoid.operators.dead_zone import LINEAR, DeadZones, from_slopes
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii

MIN_GAP, MAX_GAP = 2e-3, 0.5
MAX_REACH = 0.98  # largest threshold over half the widest swing of the drive
MIN_SLOPE = 1e-3  # at which a first guess still has an inverse
# Slopes are relative to the mean slope. Of 860 simulated stages of nineteen laws none has a branch
# flatter than a quarter of the mean. A fit without these limits alternates steep and flat
# segments, and the inverse of a flat segment makes a loop oscillate.
MIN_SLOPE_AFTER_REVERSAL = 0.4
PSI_SLOPES = (0.4, 2.5)
ENVELOPE_SLOPES = (0.5, 2.0)
MAX_WEIGHT = 4.0  # of a play: Psi behind the plays may be as flat as 0.4


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Numbers of plays, kinks and other parameters.

    plays         moving plays besides the identity r_0 = 0
    below, above  dead zones with negative and positive thresholds besides the one at 0
    lag           ``none``, ``delay`` or ``first_order``
    bends         kinks of the envelope gamma on each side of its middle
    """

    plays: int
    below: int
    above: int
    lag: str = "delay"
    bends: int = 0

    @property
    def parameters(self) -> int:
        """Number of parameters of the operator: thresholds and weights, kinks and slopes."""
        return 2 * self.plays + 1 + 2 * (self.below + self.above) + 2 * self.bends


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Components of the hysteresis that a joint fit uses.

    operator  True: weights, thresholds, lag and previous extensions are fitted; False: only
              memory, zero and new extensions
    lag       whether the model has a lag, which is then fitted
    memory    True: the memory of every piece is fitted; False: it is that after a full cycle
    bends     kinks of the envelope on each side of its middle; None: as in the model
    """

    operator: bool = True
    lag: bool = True
    memory: bool = True
    bends: int | None = None


@dataclass(frozen=True, kw_only=True)
class Coordinates:
    """Layout of the parameter vector for a shape and a number of pieces.

    The first ``shared`` parameters are those of the operator and the lag; behind them each piece
    has offsets and memory slopes; the last are the numbers of the extensions.

    offsets  (pieces,)  knots of each piece's zero: 1 is a constant, more knots follow slow motion
    numbers  (extensions,)  count of the numbers of each extension
    """

    shape: Shape
    offsets: tuple[int, ...]
    numbers: tuple[int, ...] = ()

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Slice of each group of shared parameters, by name, in their order."""
        shape = self.shape
        counts = {
            "gap": shape.plays,
            "weight": shape.plays + 1,
            "below_gap": shape.below,
            "below_slope": shape.below,
            "above_gap": shape.above,
            "above_slope": shape.above,
            "below_envelope": shape.bends,
            "above_envelope": shape.bends,
            "lag": 0 if shape.lag == "none" else 1,
        }
        edges = np.concatenate([[0], np.cumsum(list(counts.values()))])
        return {
            name: slice(int(a), int(b))
            for name, a, b in zip(counts, edges[:-1], edges[1:], strict=True)
        }

    @property
    def shared(self) -> int:
        """Number of parameters that all pieces share."""
        return int(self.slices["lag"].stop)

    @property
    def total(self) -> int:
        """Length of the vector."""
        of_pieces = sum(self.offsets) + len(self.offsets) * self.shape.plays
        return self.shared + of_pieces + sum(self.numbers)

    @cached_property
    def extension_slices(self) -> tuple[slice, ...]:
        """Slice of the numbers of each extension."""
        edges = self.total - sum(self.numbers) + np.cumsum([0, *self.numbers])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(edges))

    @cached_property
    def common(self) -> Samples:
        """Indices of the parameters of all pieces: operator, lag and numbers of extensions."""
        return np.asarray(np.r_[0 : self.shared, self.total - sum(self.numbers) : self.total])

    def offset_slice(self, piece: int) -> slice:
        """Return the slice of the zero knots of a piece."""
        first = self.shared + sum(self.offsets[:piece]) + piece * self.shape.plays
        return slice(first, first + self.offsets[piece])

    def memory_slice(self, piece: int) -> slice:
        """Return the slice of the memory slopes of a piece, after its offsets."""
        first = self.offset_slice(piece).stop
        return slice(first, first + self.shape.plays)

    def bounds(self, longest_lag_s: float) -> tuple[Array, Array]:
        """Return lower and upper bounds, (total,) each; numbers of extensions have none here."""
        lower, upper = np.full(self.total, -np.inf), np.full(self.total, np.inf)
        for name, group in self.slices.items():
            lower[group], upper[group] = {
                "gap": (MIN_GAP, MAX_GAP),
                "weight": (0.0, MAX_WEIGHT),
                "slope": PSI_SLOPES,
                "envelope": ENVELOPE_SLOPES,
                "lag": (0.0, longest_lag_s),
            }[name.rpartition("_")[2]]
        lower[self.slices["weight"].start] = MIN_SLOPE_AFTER_REVERSAL
        for piece in range(len(self.offsets)):
            lower[self.memory_slice(piece)], upper[self.memory_slice(piece)] = -1.0, 1.0
        return lower, upper

    def within_reach(self, theta: Array, swing: tuple[float, float]) -> Array:
        """Scale the thresholds so that the largest stays below half the swing of the drive.

        A play with a larger threshold never moves, so the data say nothing about it.
        """
        widest = float(theta[self.slices["gap"]].sum())
        low, high = operator_of(theta, self).envelope.run(np.array(swing))
        reach = MAX_REACH * (high - low) / 2
        if widest <= reach:
            return theta
        narrowed = theta.copy()
        narrowed[self.slices["gap"]] *= reach / widest
        return narrowed


def shape_of(operator: Scaled, lag: str) -> Shape:
    """Return the shape of an operator with a lag of the given type."""
    return Shape(
        plays=len(operator.gap),
        below=operator.zero,
        above=len(operator.knot) - operator.zero - 1,
        lag=lag,
        bends=operator.envelope.zero,
    )


def operator_of(theta: Array, coordinates: Coordinates) -> Scaled:
    """Return the operator of a parameter vector."""
    slices = coordinates.slices
    gap = theta[slices["gap"]]
    below = -np.cumsum(theta[slices["below_gap"]])[::-1]
    above = np.cumsum(theta[slices["above_gap"]])
    lag = theta[slices["lag"]]
    return Scaled(
        gap=gap,
        threshold=np.cumsum(gap),
        weight=theta[slices["weight"]],
        knot=np.concatenate([below, [0.0], above]),
        slope=np.concatenate(
            [theta[slices["below_slope"]][::-1], [1.0, 1.0], theta[slices["above_slope"]]]
        ),
        zero=len(below),
        lag_s=float(lag[0]) if lag.size else 0.0,
        envelope=_envelope(theta[slices["below_envelope"]], theta[slices["above_envelope"]]),
    )


def _envelope(below: Array, above: Array) -> DeadZones:
    """Return gamma with its kinks spread evenly over the scaled drive."""
    bends = len(below)
    if not bends:
        return LINEAR
    knots = np.arange(1, bends + 1) / (bends + 1.0)
    return from_slopes(
        np.concatenate([-knots[::-1], [0.0], knots]),
        np.concatenate([below[::-1], [1.0, 1.0], above]),
    )


def vector_of(operator: Scaled, coordinates: Coordinates) -> Array:
    """Return the parameter vector of an operator, with zero offsets and memory slopes."""
    theta = np.zeros(coordinates.total)
    slices, zero = coordinates.slices, operator.zero
    theta[slices["gap"]] = operator.gap
    theta[slices["weight"]] = operator.weight
    theta[slices["below_gap"]] = np.diff(-operator.knot[: zero + 1][::-1])
    theta[slices["above_gap"]] = np.diff(operator.knot[zero:])
    theta[slices["below_slope"]] = operator.slope[:zero][::-1]
    theta[slices["above_slope"]] = operator.slope[zero + 2 :]
    theta[slices["lag"]] = operator.lag_s
    theta[slices["below_envelope"]] = operator.envelope.slope[: operator.envelope.zero][::-1]
    theta[slices["above_envelope"]] = operator.envelope.slope[operator.envelope.zero + 2 :]
    return theta


def with_flat_envelope(operator: Scaled, bends: int) -> Scaled:
    """Return the operator with an identity envelope of ``bends`` kinks on each side."""
    return replace(operator, envelope=_envelope(np.ones(bends), np.ones(bends)))


def to_si_units(
    operator: Scaled, scales: Scales, offset_m: float = 0.0
) -> ModifiedPrandtlIshlinskii:
    """Return the operator in SI units, rising with the drive for either polarity of the sensor.

    The envelope is normalised to the range of the drive: gamma(R) - gamma(-R) = 2 R.
    """
    stroke_m = abs(scales.displacement_m)
    stretch = envelope_stretch(operator)
    return ModifiedPrandtlIshlinskii(
        plays=PrandtlIshlinskii(
            threshold=np.concatenate([[0.0], operator.threshold]) * (stretch * scales.voltage_V),
            weight=operator.weight * (stroke_m / (stretch * scales.voltage_V)),
        ),
        dead_zones=from_slopes(operator.knot * stroke_m, operator.slope),
        voltage_offset_V=scales.voltage_offset_V,
        displacement_offset_m=offset_m,
        envelope=from_slopes(
            operator.envelope.threshold * scales.voltage_V, operator.envelope.slope * stretch
        ),
    )


def to_scaled_units(model: ModifiedPrandtlIshlinskii, scales: Scales, lag_s: float) -> Scaled:
    """Return the scaled operator of a model in SI units: the inverse of ``to_si_units``."""
    envelope, zones, stroke_m = model.envelope, model.dead_zones, abs(scales.displacement_m)
    stretch = float(envelope.slope[envelope.zero])
    centre = float(zones.slope[zones.zero])
    threshold = model.plays.threshold / (stretch * scales.voltage_V)
    return Scaled(
        gap=np.diff(threshold),
        threshold=threshold[1:],
        weight=model.plays.weight * (centre * stretch * scales.voltage_V / stroke_m),
        knot=zones.threshold * (centre / stroke_m),
        slope=zones.slope / centre,
        zero=zones.zero,
        lag_s=lag_s,
        envelope=from_slopes(envelope.threshold / scales.voltage_V, envelope.slope / stretch)
        if envelope.zero > 0
        else LINEAR,
    )


def envelope_stretch(operator: Scaled) -> float:
    """Return the factor that normalises the envelope to the range of the drive."""
    low, high = operator.envelope.run(np.array([-1.0, 1.0]))
    return float(2.0 / (high - low))


def parameters_of(theta: Array, coordinates: Coordinates, scales: Scales) -> dict[str, float]:
    """Return the shared parameters of a vector in SI units, by name."""
    operator = operator_of(theta, coordinates)
    model = to_si_units(operator, scales)
    numbered = {
        "play_threshold_V": model.plays.threshold,
        "play_weight_m_per_V": model.plays.weight,
        "dead_zone_threshold_m": model.dead_zones.threshold,
        "dead_zone_weight": model.dead_zones.weight,
        "envelope_weight": model.envelope.weight,
    }
    parameters = {
        f"{name}[{number}]": float(value)
        for name, values in numbered.items()
        for number, value in enumerate(values)
    }
    del parameters["play_threshold_V[0]"]  # the identity
    return {**parameters, "lag_s": operator.lag_s}
