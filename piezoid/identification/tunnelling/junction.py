"""Fit the tunnelling junction: gap law from Z spectroscopies, plant from closed loops.

Sweeps measure k relative to the recorded height, the loop relative to the declared extension per
volt. Their ratio does not depend on the barrier:

    k_loop / k_sweep = (true extension per volt) / (declared)    if the height of the sweep is true

so that a disagreement shows that one of the two calibrations is wrong, or that the spots differ.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from piezoid.errors import ExcitationError
from piezoid.identification.tunnelling.approach import (
    ApproachCurve,
    Direction,
    read_z_spectroscopy,
)
from piezoid.identification.tunnelling.barrier_fit import GapLaw, fit_barrier
from piezoid.identification.tunnelling.closed_loop import (
    LoopPlant,
    describe_loop_plant,
    identify_closed_loop,
)
from piezoid.identification.tunnelling.loop_files import is_loop, loops_of
from piezoid.identification.tunnelling.sweep_pairs import (
    DirectionShift,
    common_law,
    compare_directions,
)
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.tunnelling import barrier_of_decay, decay_of_barrier
from piezoid.record_json import Interval
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording
from piezoid.records.table import RawTable


@dataclass(frozen=True, kw_only=True)
class JointBarrier:
    """Decay and barrier of sweeps and loop together.

    ratio           k of the loop over k of the sweeps, and its 95 % interval
    agree           whether that interval contains 1
    decay_per_m     weighted mean of both; None if they disagree
    decay_interval_per_m  95 % interval of the mean; if they disagree, the range of both intervals
    barrier_eV, barrier_interval_eV  of the decay
    """

    ratio: float
    ratio_interval: Interval
    agree: bool
    decay_per_m: float | None
    decay_interval_per_m: Interval
    barrier_eV: float | None
    barrier_interval_eV: Interval


def join_barriers(sweeps: tuple[float, Interval], loop: tuple[float, Interval]) -> JointBarrier:
    """Combine two decays with their 95 % intervals, in the logarithm, by inverse variance.

    sweeps, loop  decay and interval, 1/m; an unbounded interval carries no information

    If the decays differ by more than their standard deviations, the interval of the mean is
    widened by that ratio (Birge).
    """
    variances = [
        (math.log(high / low) / (2.0 * NORMAL_95)) ** 2
        if low > 0.0 and math.isfinite(high)
        else math.inf
        for _, (low, high) in (sweeps, loop)
    ]

    def around(center: float, half: float) -> Interval:
        if not math.isfinite(half):
            return 0.0, math.inf
        return math.exp(center - half), math.exp(center + half)

    log_ratio = math.log(loop[0]) - math.log(sweeps[0])
    half = NORMAL_95 * math.sqrt(sum(variances))
    agree = abs(log_ratio) <= half
    decay = None
    interval = min(sweeps[1][0], loop[1][0]), max(sweeps[1][1], loop[1][1])
    if agree:
        weights = [1.0 / max(variance, 1e-30) for variance in variances]
        total = sum(weights)
        share = weights[1] / total if total > 0.0 else 0.5
        mean = math.log(sweeps[0]) + share * log_ratio
        excess = weights[0] * share * log_ratio**2 if total > 0.0 else 0.0
        spread = math.sqrt(max(excess, 1.0) / total) if total > 0.0 else math.inf
        decay, interval = math.exp(mean), around(mean, NORMAL_95 * spread)
    return JointBarrier(
        ratio=math.exp(log_ratio),
        ratio_interval=around(log_ratio, half),
        agree=agree,
        decay_per_m=decay,
        decay_interval_per_m=interval,
        barrier_eV=None if decay is None else barrier_of_decay(decay),
        barrier_interval_eV=(barrier_of_decay(interval[0]), barrier_of_decay(interval[1])),
    )


@dataclass(frozen=True, kw_only=True)
class TunnellingModel:
    """Model of the tunnelling junction, from sweeps, closed loops, or both.

    gap_law            of all sweeps together, corrected for drift; None: no sweeps
    loop_plant         None: no closed loops
    forward, backward  of the sweeps of one direction, not corrected for drift; None unless there
                       are both directions
    shift              between both directions; None also if no current is above the noise in both
    joint              of sweeps and loops together; None unless there are both
    """

    gap_law: GapLaw | None
    loop_plant: LoopPlant | None
    forward: GapLaw | None = None
    backward: GapLaw | None = None
    shift: DirectionShift | None = None
    joint: JointBarrier | None = None


def fit_junction(
    sweeps: Sequence[RawTable], recordings: Sequence[Recording] = (), lab: Lab | None = None
) -> TunnellingModel | None:
    """Fit the gap law to sweeps over height and the plant to closed loops, of one tip.

    sweeps      tables over height; all sweeps of one direction share decay and offset, each has a
                zero of height
    recordings  over time; recordings with drive, current and reference are closed loops
    lab         declarations of the laboratory, required for closed loops

    Returns None if there are neither sweeps nor closed loops. Raises as ``read_z_spectroscopy``,
    ``fit_barrier``, ``loops_of`` and ``identify_closed_loop``.
    """
    model = gap_law = offset = None
    if sweeps:
        curves = curves_of(sweeps)
        fits = {
            direction: fit_barrier(same_direction)
            for direction in Direction
            if (same_direction := [curve for curve in curves if curve.direction is direction])
        }
        gap_law = common_law(curves, fits)
        model = TunnellingModel(gap_law=gap_law, loop_plant=None)
        if len(fits) == len(Direction):
            forward, backward = fits.values()
            try:
                shift = compare_directions(forward, backward)
            except ExcitationError:
                shift = None  # no current is above the noise in both directions
            model = replace(model, forward=forward.law, backward=backward.law, shift=shift)
    if not any(is_loop(recording) for recording in recordings):
        return model
    if gap_law is not None:
        offset = (gap_law.offset_A, gap_law.offset_standard_A)
    rig, records = loops_of(recordings, lab or Lab())
    fits_of_loops = [identify_closed_loop(record, rig, offset_A=offset) for record in records]
    loop = describe_loop_plant(fits_of_loops, rig)
    if model is None or gap_law is None:
        return TunnellingModel(gap_law=None, loop_plant=loop)
    low_eV, high_eV = loop.barrier_interval_eV
    joint = join_barriers(
        (gap_law.decay_per_m, gap_law.decay_interval_per_m),
        (
            decay_of_barrier(loop.barrier_eV),
            (decay_of_barrier(low_eV), decay_of_barrier(high_eV)),
        ),
    )
    return replace(model, loop_plant=loop, joint=joint)


def curves_of(sweeps: Sequence[RawTable]) -> tuple[ApproachCurve, ...]:
    """Return all sweeps of all tables, in their order."""
    return tuple(curve for table in sweeps for curve in read_z_spectroscopy(table))


def remarks_on_currents(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return a remark for each recording whose current over time could not be used."""
    return tuple(
        f"{recording.name}: its current over time was not used. The plant between drive and "
        "current needs the external dither beside them: name its column 'reference' in "
        "lab.toml, and declare the loop under [tunnelling]"
        for recording in recordings
        if any(channel.quantity is Quantity.CURRENT for channel in recording.channels)
        and not is_loop(recording)
    )
