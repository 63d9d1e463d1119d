"""The tunnelling part of a stage: gap law from Z spectroscopies, plant from closed loops."""

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from piezoid.errors import ExcitationError, RecordingError, UnitError
from piezoid.identification.tunnelling.approach import ApproachCurve, Direction, read_approach
from piezoid.identification.tunnelling.barrier_fit import BarrierFit, fit_barrier
from piezoid.identification.tunnelling.closed_loop import (
    ClosedLoopFit,
    Offset,
    identify_closed_loop,
)
from piezoid.identification.tunnelling.current_noise import CurrentChain
from piezoid.identification.tunnelling.family import spread_family
from piezoid.identification.tunnelling.instrument_fit import ModeEstimate
from piezoid.identification.tunnelling.joint_barrier import join_barriers
from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.identification.tunnelling.loop_files import LoopRecord, LoopRig, is_loop, loops_of
from piezoid.identification.tunnelling.loop_model import (
    LoopPlant,
    describe_loop_plant,
    summarise_record,
)
from piezoid.identification.tunnelling.loop_noise import (
    LoopNoise,
    is_long_enough,
    measure_loop_noise,
)
from piezoid.identification.tunnelling.model import TunnellingModel, common_law, describe_gap_law
from piezoid.identification.tunnelling.sweep_pairs import (
    DirectionShift,
    compare_directions,
    decay_without_drift,
)
from piezoid.operators.tunnelling import decay_of_barrier
from piezoid.records.column_roles import meaning_of
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording
from piezoid.records.sample_statistics import step_size
from piezoid.records.table import Column, RawTable
from piezoid.records.units import Dimension

_SWEEP = re.compile(r"Current(?: \[(?!bwd)(?P<number>[^\]]+)\])?(?P<way> \[bwd\])?")
_AVERAGE = "AVG"
_BIAS_KEY = "Bias>Bias (V)"
_TIMES_OF_A_ROW = ("Settling time (s)", "Integration time (s)")
_MODULES = ("", "Z Spectroscopy>")  # what Nanonis writes in front of its own settings


class _Name(NamedTuple):
    number: str
    way: str


def read_z_spectroscopy(table: RawTable) -> tuple[ApproachCurve, ...]:
    """Return every sweep of a Z spectroscopy file, in the order of its columns.

    The height is the swept column, which must be a displacement that grows when the tip retracts,
    as ``Z rel (m)`` of Nanonis does. Single sweeps are taken; the average only where the file
    holds nothing else, since it would count the same noise twice. The bias is that of the sweep's
    own column or, without one, of the file's head. Where neither states a bias, or it is 0 V and
    was applied elsewhere, the sign of the current stands in. In a table without a column of that
    name, every column that means a current is one, as ``I (pA)``. A head that states settling and
    integration time of a row tells how long a sweep took.
    """
    height_m = table.si(_height(table).number)
    named = [(column, name) for column in table.columns if (name := _named(column)) is not None]
    named = named or [(column, _Name("", "")) for column in table.columns if _is_current(column)]
    single = [pair for pair in named if pair[1].number != _AVERAGE]
    if not named:
        labels = ", ".join(repr(column.label) for column in table.columns[:8])
        raise RecordingError(
            f"{table.name}: no current among {labels}",
            needed="columns named 'Current (A)' or 'Current [00001] (A)', '[bwd]' for backward",
            remedy="Save the sweep with its current, or build the sweep from two arrays.",
        )
    return tuple(
        read_approach(
            height_m,
            column.si_values,
            bias_V=_bias_V(table, name),
            direction=Direction.BACKWARD if name.way else Direction.FORWARD,
            label=f"{table.name}: {column.label}",
            pair=f"{table.name}: {name.number}",
            duration_s=_duration_s(table, len(height_m)),
        )
        for column, name in (single or named)
    )


def _height(table: RawTable) -> Column:
    swept = table.find(table.independent) if table.independent else None
    unit = swept.heading.unit if swept is not None else None
    if swept is None or unit is None or unit.dimension is not Dimension.LENGTH:
        raise UnitError(
            f"{table.name}: the swept column is {table.independent!r}",
            needed="a height with a unit of length, as 'Z rel (m)'",
            remedy="Take a Z spectroscopy; or build the sweep from two arrays.",
        )
    return swept


def _is_current(column: Column) -> bool:
    meaning = meaning_of(column.heading)
    return meaning.quantity is Quantity.CURRENT and meaning.by_name


def _named(column: Column) -> _Name | None:
    match = _SWEEP.fullmatch(column.heading.stem)
    return None if match is None else _Name(match["number"] or "", match["way"] or "")


def _duration_s(table: RawTable, rows: int) -> float | None:
    """How long one way took; None where the head does not say, or says nothing readable."""
    for module in _MODULES:
        try:
            each_s = sum(float(table.metadata[module + key]) for key in _TIMES_OF_A_ROW)
        except (KeyError, ValueError):
            continue
        if math.isfinite(each_s) and each_s > 0.0:
            return rows * each_s
    return None


def _bias_V(table: RawTable, name: _Name) -> float | None:
    number = f" [{name.number}]" if name.number else ""
    column = table.find(f"Bias{number}{name.way}")
    if column is not None:
        return float(np.nanmedian(column.si_values))
    if _BIAS_KEY in table.metadata:
        return float(table.metadata[_BIAS_KEY])
    return None


def fit_junction(
    sweeps: Sequence[RawTable], recordings: Sequence[Recording] = (), lab: Lab | None = None
) -> TunnellingModel | None:
    """Fit the gap law to sweeps over height and the plant to closed loops, of one tip.

    sweeps      tables over height; all sweeps of one direction share decay and offset, each keeps
                its own zero of height
    recordings  over time; those with drive, current and reference are closed loops
    lab         what the laboratory declares, which closed loops cannot do without

    None where neither is there. Raises what ``read_z_spectroscopy``, ``fit_barrier``,
    ``loops_of`` and ``identify_closed_loop`` raise.
    """
    law = fit_sweeps_of_tip(sweeps) if sweeps else None
    gap_law = None if law is None else law.gap_law
    if not any(is_loop(recording) for recording in recordings):
        return law
    offset = None
    if gap_law is not None:
        offset = Offset(value_A=gap_law.offset_A, standard_A=gap_law.offset_standard_A)
    loop = fit_loops(*loops_of(recordings, lab or Lab()), offset)
    if law is None or gap_law is None:
        return TunnellingModel(gap_law=None, loop_plant=loop)
    joint = join_barriers(
        [(gap_law.decay_per_m, gap_law.decay_interval_per_m)],
        (
            decay_of_barrier(loop.barrier_eV),
            (
                decay_of_barrier(loop.barrier_interval_eV[0]),
                decay_of_barrier(loop.barrier_interval_eV[1]),
            ),
        ),
    )
    return replace(law, loop_plant=loop, joint=joint)


def fit_sweeps_of_tip(sweeps: Sequence[RawTable]) -> TunnellingModel:
    """Fit the gap law to every sweep of Z spectroscopies taken with one tip, drift allowed for."""
    curves = curves_of(sweeps)
    fits = {
        direction: fit_barrier(held)
        for direction in Direction
        if (held := [curve for curve in curves if curve.direction is direction])
    }
    found = list(fits.values())
    both = len(found) == len(Direction)
    return TunnellingModel(
        gap_law=common_law(fits, decay_without_drift(curves)),
        loop_plant=None,
        forward=describe_gap_law(found[0]) if both else None,
        backward=describe_gap_law(found[1]) if both else None,
        shift=_shift(found[0], found[1]) if both else None,
    )


def fit_loops(
    rig: LoopRig, loops: Sequence[LoopRecord], offset: Offset | None = None
) -> LoopPlant:
    """Identify the plant of every closed-loop record, their mean, and the family around them.

    offset  of the current, where sweeps have shown it
    """

    def identified(loop: LoopRecord, mode: ModeEstimate | None) -> ClosedLoopFit:
        return identify_closed_loop(
            loop,
            amplifier_pole_Hz=rig.amplifier_pole_Hz,
            drive_gain_m_per_V=rig.drive_gain_m_per_V,
            drive_gain_relative_uncertainty=rig.extension_uncertainty,
            sensor_pole_Hz=rig.bandwidth_Hz,
            offset_A=offset,
            known_mode=mode,
        )

    fits = [identified(loop, None) for loop in loops]
    shown = next((fit.mode for fit in fits if fit.mode is not None), None)
    if shown is not None:  # of the drive, hence of every record, also where noise hides it
        fits = [
            identified(loop, shown) if fit.mode is None else fit
            for loop, fit in zip(loops, fits, strict=True)
        ]
    return describe_loop_plant(
        fits,
        spread_family(fits, drive_gain_m_per_V=rig.drive_gain_m_per_V),
        drive_gain_m_per_V=rig.drive_gain_m_per_V,
        drive_gain_relative_uncertainty=rig.extension_uncertainty,
        rig=rig,
        records=[
            summarise_record(fit, noise_of_loop(loop, rig, fit.plant), _period_s(loop))
            for fit, loop in zip(fits, loops, strict=True)
        ],
    )


def noise_of_loop(loop: LoopRecord, rig: LoopRig, plant: JunctionPlant) -> LoopNoise | None:
    """Return what moved the gap during a record; None where it is too short to tell.

    Converter steps are those the columns show; a column without steps counts as none. Without a
    declared bandwidth of the current sensor the plant's pole stands in, half the rate at most.
    """
    if not is_long_enough(loop):
        return None
    pole_Hz = min(plant.sensor_pole_Hz, 0.5 * loop.sampling_rate_Hz)
    return measure_loop_noise(
        loop,
        plant,
        decay_per_m=plant.gain_nepers_per_V / rig.drive_gain_m_per_V,
        drive_step_V=step_size(loop.drive_V),
        chain=CurrentChain(
            bandwidth_Hz=rig.bandwidth_Hz or pole_Hz,
            feedback_ohm=rig.feedback_ohm,
            adc_step_A=step_size(loop.current_A),
        ),
    )


def _period_s(loop: LoopRecord) -> float | None:
    return None if loop.period_samples is None else loop.period_samples / loop.sampling_rate_Hz


def curves_of(sweeps: Sequence[RawTable]) -> tuple[ApproachCurve, ...]:
    """Return every sweep of every table, in their order."""
    return tuple(curve for table in sweeps for curve in read_z_spectroscopy(table))


def remarks_on_currents(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return why currents over time say nothing of the junction's plant, where they do not."""
    return tuple(
        f"{recording.name}: its current over time was not used. The plant between drive and "
        "current needs the external dither beside them: name its column 'reference' in "
        "lab.toml, and declare the loop under [tunnelling]"
        for recording in recordings
        if any(channel.quantity is Quantity.CURRENT for channel in recording.channels)
        and not is_loop(recording)
    )


def _shift(forward: BarrierFit, backward: BarrierFit) -> DirectionShift | None:
    try:
        return compare_directions(forward, backward)
    except ExcitationError:
        return None  # no current that both directions reach clear of their noise
