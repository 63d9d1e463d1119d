"""Loop shape: the part of the hysteresis that plays with dead zones cannot represent.

    static displacement = a Psi(H[u - u_off]) + L[u]

L is a function of the wide class of ``operators.wide_hysteresis``, fitted to the recordings by
``loop_shape_fit`` together with the weight a of the plays. Simulation, prediction, held-out error
and the verification plant include it. A controller inverts only Psi(H); the difference remains as
an error of the controlled displacement.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.identification.hysteresis.pieces import PieceStart
from piezoid.identification.quality import FitQuality
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.fixed_point import damped_iteration
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.preisach_plays import PreisachPlays
from piezoid.operators.wide_hysteresis import (
    CHUNK,
    CYCLES,
    EDGES,
    HysteresisStates,
    States,
    smooth_families,
    smooth_response,
)

History = tuple[float, ...]
"""Turning points of the scaled drive before its first sample, -1 to 1."""

DECAYING: History = tuple(
    float(a) for a in np.linspace(1.0, 0.02, 30) * (-1.0) ** np.arange(1, 31)
)
SETTLING_SPAN = 1.94  # half ranges, of 2: then no play depends on its initial state
SETTLING_TRAVEL = 20.0  # half ranges after that, ten full swings: then no other state does
ROUNDING = 1e-9  # of half the range
# Iterations of the inverse, and the share of the error that the first corrects. On fourteen laws
# the simulated error fell to 0 to 2.7 times the noise; with 0.6 it stopped at twice as much.
INVERSIONS = 20
INVERSION_SHARE = 0.4


@dataclass(frozen=True, kw_only=True, eq=False)
class FitWithoutShape:
    """Lag, errors and starts of the fit without loop shape.

    lag_s           s
    rms_m           residual on the rows to which loop shape was fitted, m
    held_out_rms_m  error on left-out blocks of these rows, m
    quality         of the axis model without loop shape
    starts          of the pieces
    """

    lag_s: float
    rms_m: float
    held_out_rms_m: float
    quality: FitQuality
    starts: tuple[PieceStart, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopShape:
    """A hysteresis of the wide class.

    centre_V, reach_V  middle and half of the range of the recorded drive
    density_m          (widths, cells)  of the plays, m
    smooth_m           (columns,)       coefficients of all other families in their order, m
    plays_weight       weight of the plays with dead zones, which add to it
    plain              the fit without loop shape
    """

    centre_V: float
    reach_V: float
    density_m: Array
    smooth_m: Array
    plays_weight: float
    plain: FitWithoutShape

    def __post_init__(self) -> None:
        freeze(self, "smooth_m")
        freeze(self, "density_m", ndim=2)
        if len(self.smooth_m) != len(smooth_families()):
            raise ValueError(
                f"loop shape has {len(self.smooth_m)} coefficients, expected "
                f"{len(smooth_families())}"
            )

    def scaled(self, voltage_V: Array) -> Array:
        """Scale a drive to half ranges, clipped to the recorded range."""
        return np.clip((voltage_V - self.centre_V) / self.reach_V, -1.0, 1.0)

    def response(self, voltage_V: Array, history: Sequence[float]) -> Array:
        """Simulate L along a drive, (samples,) m.

        voltage_V  (samples,)  V, at the input of the hysteresis
        history    turning points of the scaled drive before the first sample
        """
        drive = self.scaled(voltage_V)
        states = HysteresisStates((*history, float(drive[0])))
        chunks = (drive[first : first + CHUNK] for first in range(0, len(drive), CHUNK))
        return np.concatenate(
            [self.response_to_states(chunk, states.follow(chunk)) for chunk in chunks]
        )

    def response_to_states(self, drive: Array, states: States) -> Array:
        """Compute L from a scaled drive and the states of the wide class, (samples,) m."""
        rises_m = self.density_m * np.diff(EDGES)
        knots_m = np.hstack([np.zeros((len(rises_m), 1)), rises_m.cumsum(axis=1)])
        total_m = -np.interp(drive, EDGES, knots_m.sum(axis=0))
        for play, knot_m in zip(states[0].T, knots_m, strict=True):
            total_m += np.interp(play, EDGES, knot_m)
        return np.asarray(total_m + smooth_response(drive, states, self.smooth_m))

    def inverse_V(
        self,
        reference_m: Array,
        operator: ModifiedPrandtlIshlinskii | PreisachPlays,
        states_V: Array,
        history: Sequence[float],
    ) -> Array:
        """Return the voltage at which plays and loop shape reach a reference, (samples,).

            v <- v + s (y - a H[u] - L[u]),   u = H^-1[v]

        The whole reference is known, so no closed inverse is needed: the output v of the plays is
        corrected until the model reaches the reference (``damped_iteration``). A voltage outside
        the recorded range is not corrected, because loop shape is constant there.

        reference_m  (samples,)  m, without the offset of the operator
        operator     H, plays that have an inverse
        states_V     of the plays before the first sample
        history      turning points of the scaled drive before the first sample
        """
        offset_m = operator.displacement_offset_m

        def voltage_of(output_m: Array) -> Array:
            return np.asarray(operator.inverse_run(output_m + offset_m, states_V)[0])

        def evaluate(output_m: Array) -> tuple[Array, Array]:
            voltage_V = voltage_of(output_m)
            plays_m = operator.run(voltage_V, states_V)[0] - offset_m
            error_m = reference_m - self.plays_weight * plays_m - self.response(voltage_V, history)
            is_recorded = np.abs(voltage_V - self.centre_V) <= self.reach_V
            return error_m, np.where(is_recorded, error_m, 0.0)

        return voltage_of(
            damped_iteration(reference_m, evaluate, share=INVERSION_SHARE, iterations=INVERSIONS)
        )

    def turns_V(self, history: Sequence[float]) -> Array:
        """Return full cycles and a history as turning points of the drive, V."""
        return np.asarray(self.centre_V + self.reach_V * np.array([*CYCLES, *history]))


def histories(first: float) -> tuple[History, ...]:
    """Return candidate histories of a scaled drive before its first sample."""
    return (
        DECAYING,
        (-1.0,),
        (),
        (-0.5,),
        (-1.0, 0.5),
        (-0.5, 0.25),
        (-1.0, 0.5, -0.25),
        (-1.0, 0.0),
        (0.0,),
        (-1.0, min(first + 0.2, 1.0), max(first - 0.1, -1.0)),
        (max(first - 0.2, -1.0), min(first + 0.1, 1.0)),
    )


def settling_samples(drive: Array) -> int:
    """Return the number of samples for which the response depends on the initial state.

    drive  (samples,)  scaled
    """
    span = np.maximum.accumulate(drive) - np.minimum.accumulate(drive)
    covered = int(np.searchsorted(span, SETTLING_SPAN))
    travel = np.cumsum(np.abs(np.diff(drive[covered:], prepend=drive[covered:][:1])))
    return covered + int(np.searchsorted(travel, SETTLING_TRAVEL))


def history_of(
    hysteresis: ModifiedPrandtlIshlinskii, memory_V: Array, shape: LoopShape
) -> History:
    """Return turning points after which the plays of a hysteresis have these states.

    From the widest play to the narrowest, the drive goes to z_i + r_i or z_i - r_i unless play i
    is at z_i already. For an admissible memory that moves no wider play.

    memory_V  (plays,)  states behind the envelope, V
    """
    threshold_V = hysteresis.plays.threshold
    turns_V = []
    top_V = hysteresis.envelope.run(
        np.array([shape.centre_V + shape.reach_V - hysteresis.voltage_offset_V])
    )[0]
    state_V = top_V - threshold_V
    for i in np.argsort(-threshold_V, kind="stable"):
        error_V = memory_V[i] - state_V[i]
        if abs(error_V) > ROUNDING * shape.reach_V:
            turn_V = memory_V[i] + np.copysign(threshold_V[i], error_V)
            state_V = np.clip(state_V, turn_V - threshold_V, turn_V + threshold_V)
            turns_V.append(turn_V)
    drive_V = hysteresis.envelope.inverse().run(np.array(turns_V)) if turns_V else np.zeros(0)
    return tuple(shape.scaled(drive_V + hysteresis.voltage_offset_V).tolist())
