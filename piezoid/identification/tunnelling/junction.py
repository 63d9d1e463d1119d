"""The tunnelling part of a stage: gap law from Z spectroscopies, forward and backward apart."""

from collections.abc import Sequence

from piezoid.errors import ExcitationError
from piezoid.identification.tunnelling.approach import ApproachCurve, Direction
from piezoid.identification.tunnelling.barrier_fit import BarrierFit, fit_barrier
from piezoid.identification.tunnelling.directions import DirectionShift, compare_directions
from piezoid.identification.tunnelling.model import TunnellingModel, describe_gap_law
from piezoid.identification.tunnelling.z_spectroscopy import read_z_spectroscopy
from piezoid.records.recording import Quantity, Recording
from piezoid.records.table import RawTable


def fit_junction(sweeps: Sequence[RawTable]) -> TunnellingModel:
    """Fit the gap law to every sweep of Z spectroscopies taken with one tip.

    sweeps  at least one table over height; all sweeps of one direction share decay and offset,
            each keeps its own zero of height

    Raises what ``read_z_spectroscopy`` and ``fit_barrier`` raise.
    """
    curves = curves_of(sweeps)
    fits = {
        direction: fit_barrier(held)
        for direction in Direction
        if (held := [curve for curve in curves if curve.direction is direction])
    }
    found = list(fits.values())
    both = len(found) == len(Direction)
    return TunnellingModel(
        gap_law=describe_gap_law(found[0]),
        loop_plant=None,
        backward=describe_gap_law(found[1]) if both else None,
        shift=_shift(found[0], found[1]) if both else None,
    )


def curves_of(sweeps: Sequence[RawTable]) -> tuple[ApproachCurve, ...]:
    """Return every sweep of every table, in their order."""
    return tuple(curve for table in sweeps for curve in read_z_spectroscopy(table))


def remarks_on_currents(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return why the currents of recordings over time say nothing of the junction's plant."""
    return tuple(
        f"{recording.name}: its current over time was not used. The plant between drive and "
        "current needs set point, floor and an external dither beside drive and current, which "
        "a recording cannot hold: build a LoopRecord of the arrays and pass it to "
        "identify_closed_loop"
        for recording in recordings
        if any(channel.quantity is Quantity.CURRENT for channel in recording.channels)
    )


def _shift(forward: BarrierFit, backward: BarrierFit) -> DirectionShift | None:
    try:
        return compare_directions(forward, backward)
    except ExcitationError:
        return None  # no current that both directions reach clear of their noise
