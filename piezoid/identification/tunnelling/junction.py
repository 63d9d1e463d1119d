"""Fit the tunnelling junction: gap law from Z spectroscopies, plant from closed loops."""

from collections.abc import Sequence
from dataclasses import replace

from piezoid.errors import ExcitationError
from piezoid.identification.tunnelling.approach import (
    ApproachCurve,
    Direction,
    read_z_spectroscopy,
)
from piezoid.identification.tunnelling.barrier_fit import fit_barrier
from piezoid.identification.tunnelling.closed_loop import (
    ClosedLoopFit,
    Offset,
    identify_closed_loop,
)
from piezoid.identification.tunnelling.instrument_fit import ModeEstimate
from piezoid.identification.tunnelling.loop_files import LoopRecord, LoopRig, is_loop, loops_of
from piezoid.identification.tunnelling.loop_model import (
    LoopPlant,
    LoopSummary,
    describe_loop_plant,
)
from piezoid.identification.tunnelling.loop_noise import measure_loop_noise
from piezoid.identification.tunnelling.model import TunnellingModel, join_barriers
from piezoid.identification.tunnelling.sweep_pairs import common_law, compare_directions
from piezoid.operators.tunnelling import decay_of_barrier
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording
from piezoid.records.table import RawTable


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
    model = fit_sweeps_of_tip(sweeps) if sweeps else None
    gap_law = None if model is None else model.gap_law
    if not any(is_loop(recording) for recording in recordings):
        return model
    offset = None
    if gap_law is not None:
        offset = Offset(value_A=gap_law.offset_A, standard_A=gap_law.offset_standard_A)
    loop = fit_loops(*loops_of(recordings, lab or Lab()), offset)
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


def fit_sweeps_of_tip(sweeps: Sequence[RawTable]) -> TunnellingModel:
    """Fit the gap law, with drift, to all sweeps of Z spectroscopies with one tip."""
    curves = curves_of(sweeps)
    fits = {
        direction: fit_barrier(same_direction)
        for direction in Direction
        if (same_direction := [curve for curve in curves if curve.direction is direction])
    }
    gap_law = common_law(curves, fits)
    if len(fits) < len(Direction):
        return TunnellingModel(gap_law=gap_law, loop_plant=None)
    forward, backward = fits.values()
    try:
        shift = compare_directions(forward, backward)
    except ExcitationError:
        shift = None  # no current is above the noise in both directions
    return TunnellingModel(
        gap_law=gap_law,
        loop_plant=None,
        forward=forward.law,
        backward=backward.law,
        shift=shift,
    )


def curves_of(sweeps: Sequence[RawTable]) -> tuple[ApproachCurve, ...]:
    """Return all sweeps of all tables, in their order."""
    return tuple(curve for table in sweeps for curve in read_z_spectroscopy(table))


def fit_loops(
    rig: LoopRig, loops: Sequence[LoopRecord], offset: Offset | None = None
) -> LoopPlant:
    """Identify the plant of every closed-loop record, their mean, and their family.

    offset  of the current, from sweeps; None: unknown
    """

    def identify(loop: LoopRecord, mode: ModeEstimate | None) -> ClosedLoopFit:
        return identify_closed_loop(
            loop,
            amplifier_pole_Hz=rig.amplifier_pole_Hz,
            drive_gain_m_per_V=rig.drive_gain_m_per_V,
            drive_gain_relative_uncertainty=rig.extension_uncertainty,
            sensor_pole_Hz=rig.bandwidth_Hz,
            offset_A=offset,
            known_mode=mode,
        )

    fits = [identify(loop, None) for loop in loops]
    mode = next((fit.mode for fit in fits if fit.mode is not None), None)
    if mode is not None:  # the drive has it in every record, also if noise hides it
        fits = [
            identify(loop, mode) if fit.mode is None else fit
            for loop, fit in zip(loops, fits, strict=True)
        ]
    records = [
        LoopSummary(
            recording=fit.label,
            gain=fit.plant.gain_nepers_per_V,
            gain_interval=fit.gain_interval,
            barrier_eV=fit.barrier_eV,
            barrier_interval_eV=fit.barrier_interval_eV,
            naive_gain=fit.naive_gain,
            naive_reason=fit.naive_reason,
            dither_share=fit.dither_share,
            period_s=loop.period_s,
            unrest=measure_loop_noise(loop, fit.plant, rig),
        )
        for fit, loop in zip(fits, loops, strict=True)
    ]
    return describe_loop_plant(fits, rig, records)


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
