"""Parameter vector of the fit, with bounds, and its operator.

Everything is in scaled units, drive and displacement divided by half their range, so that all
numbers are of order one. The parametrisation makes every constraint a bound on one number:

    play thresholds       r_i = d_1 + ... + d_i,            d_i >= a least gap
    initial memory        z_i(0) = u(0) + sum_(j<=i) d_j s_j,  -1 <= s_j <= 1   (admissible)
    slopes of Psi         free numbers between two slopes, the two at the origin fixed to 1
    kinks of Psi          sums of gaps >= a least gap, outwards from 0
    play weights          w_0 >= a least slope, w_i >= 0
    slopes of gamma       free numbers within a factor of two of the one in the middle, which is 1

gamma is the envelope in front of the plays: without bends it is the identity and the model is
Kuhnen's; with them it is the generalised Prandtl-Ishlinskii model with equal envelopes.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once
from piezoid.operators.dead_zone import LINEAR, DeadZones, from_slopes
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

LEAST_GAP = 2e-3
GREATEST_GAP = 0.5
GREATEST_REACH = 0.98
LEAST_SLOPE = 1e-3  # at which a first guess still has an inverse
# Slopes are relative to the mean one. Of 860 stages that two strangers drew from nineteen laws
# none has a branch flatter than a quarter of it. A fit without these limits puts a steep piece
# beside a flat one, and the inverse of the flat one makes a loop oscillate.
LEAST_BEHIND_TURN = 0.4
BENT = (0.4, 2.5)
BENT_ENVELOPE = (0.5, 2.0)
GREATEST_SLOPE = 4.0  # of all plays together, in front of a Psi that may be as flat as 0.4


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
    def numbers(self) -> int:
        """How many numbers the operator has: thresholds and weights, kinks and slopes."""
        return 2 * self.plays + 1 + 2 * (self.below + self.above) + 2 * self.bends


@dataclass(frozen=True, kw_only=True)
class Coordinates:
    """Layout of the parameter vector for a shape and a number of pieces.

    The first ``shared`` numbers belong to the operator and the lag; then each piece of recording
    has its own offsets and memory slopes.

    offsets  (pieces,)  knots of each piece's zero: 1 is a constant, more follow slow motion
    """

    shape: Shape
    offsets: tuple[int, ...]

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Return name -> slice of the shared numbers, in their order."""
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
        """How many numbers all pieces share."""
        return int(self.slices["lag"].stop)

    @property
    def total(self) -> int:
        """Length of the vector."""
        return self.shared + sum(self.offsets) + len(self.offsets) * self.shape.plays

    def offset_slice(self, piece: int) -> slice:
        """Return the slice of the zero knots of a piece."""
        first = self.shared + sum(self.offsets[:piece]) + piece * self.shape.plays
        return slice(first, first + self.offsets[piece])

    def memory_slice(self, piece: int) -> slice:
        """Return the slice of the memory slopes of a piece, after its offsets."""
        first = self.offset_slice(piece).stop
        return slice(first, first + self.shape.plays)

    def bounds(self, longest_lag_s: float) -> tuple[Array, Array]:
        """Return lower and upper bounds of every number."""
        lower, upper = np.full(self.total, -np.inf), np.full(self.total, np.inf)
        for name, numbers in self.slices.items():
            lower[numbers], upper[numbers] = {
                "gap": (LEAST_GAP, GREATEST_GAP),
                "weight": (0.0, GREATEST_SLOPE),
                "slope": BENT,
                "envelope": BENT_ENVELOPE,
                "lag": (0.0, longest_lag_s),
            }[name.rpartition("_")[2]]
        lower[self.slices["weight"].start] = LEAST_BEHIND_TURN
        for piece in range(len(self.offsets)):
            lower[self.memory_slice(piece)], upper[self.memory_slice(piece)] = -1.0, 1.0
        return lower, upper

    def kinks(self) -> tuple[Array, Array]:
        """Return M and c such that M theta + c is the change of slope at every kink.

        For the loading curve these are the play weights; for Psi and gamma the differences of
        neighbouring slopes, outwards from the two middle ones, which are 1.

        returned  (kinks, total) and (kinks,)
        """
        rows, constant = [], []
        for name, numbers_of_name in self.slices.items():
            numbers = range(numbers_of_name.start, numbers_of_name.stop)
            if name == "weight":
                numbers = numbers[1:]
            elif not name.endswith(("slope", "envelope")):
                continue
            for number in numbers:
                row = np.zeros(self.total)
                row[number] = 1.0
                is_first = number == numbers_of_name.start
                if name != "weight" and not is_first:
                    row[number - 1] = -1.0
                rows.append(row)
                constant.append(-1.0 if name != "weight" and is_first else 0.0)
        return np.reshape(rows, (-1, self.total)), np.array(constant)

    def within_reach(self, theta: Array, swing: tuple[float, float] = (-1.0, 1.0)) -> Array:
        """Return the vector with its thresholds drawn in below half the widest swing of the drive.

        A play wider than that never moves: nothing is known about it.
        """
        widest = float(theta[self.slices["gap"]].sum())
        low, high = operator_of(theta, self).envelope.run(np.array(swing))
        reach = GREATEST_REACH * (high - low) / 2
        if widest <= reach:
            return theta
        narrowed = theta.copy()
        narrowed[self.slices["gap"]] *= reach / widest
        return narrowed


@dataclass(frozen=True, kw_only=True, eq=False)
class Scaled:
    """Operator of a parameter vector, in scaled units.

    gap, threshold  (plays,)      d and r of the moving plays
    weight          (plays + 1,)  w_0 first
    knot            (zones,)      kinks of Psi with 0 among them, increasing
    slope           (zones + 1,)  slopes below, between and above the kinks
    zero            index of the kink at 0
    lag_s           seconds
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
        """All plays, that of threshold 0 first."""
        return PrandtlIshlinskii(
            threshold=np.concatenate([[0.0], self.threshold]), weight=self.weight
        )

    @Once
    def dead_zones(self) -> DeadZones:
        """Psi."""
        return from_slopes(self.knot, self.slope)

    def shape(self, lag: str) -> Shape:
        """Return the shape whose vector can hold this operator, with a lag of this kind."""
        return Shape(
            plays=len(self.gap),
            below=self.zero,
            above=len(self.knot) - self.zero - 1,
            lag=lag,
            bends=self.envelope.zero,
        )


def operator_of(theta: Array, coordinates: Coordinates) -> Scaled:
    """Read the shared part of the vector as an operator."""
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
    """Return gamma with its kinks at even places of the scaled drive."""
    bends = len(below)
    if not bends:
        return LINEAR
    knots = np.arange(1, bends + 1) / (bends + 1.0)
    return from_slopes(
        np.concatenate([-knots[::-1], [0.0], knots]),
        np.concatenate([below[::-1], [1.0, 1.0], above]),
    )


def vector_of(operator: Scaled, coordinates: Coordinates) -> Array:
    """Write an operator as the vector of a fit whose pieces start at offset 0, memory at rest."""
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


def bent(operator: Scaled, bends: int) -> Scaled:
    """Return the same operator with an envelope that may bend, and does not yet."""
    return replace(operator, envelope=_envelope(np.ones(bends), np.ones(bends)))
