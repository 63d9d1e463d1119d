"""Identify stages whose drives act on all axes, and decouple their recordings.

    y = G(s) v,   y' = D y = D G v,   D = diag(G_0) G_0^-1

v is the drive behind its hysteresis, G_0 the response well below the first mode. In the
coordinates y' an axis responds to its own drive alone, except for dynamic coupling. Hysteresis is
fitted, effects are named and controllers run in these coordinates.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from piezoid.digests import digest_of_json
from piezoid.errors import ExcitationError, RecordingError
from piezoid.identification.coupled.coupled_stage import LEVEL_TOLERANCE, CoupledStage
from piezoid.identification.coupled.fit_coupled import fit_coupled
from piezoid.identification.dynamics.frequency_response import PeriodicData, estimate_response
from piezoid.numerics.repetition import (
    FEWEST,
    STILL,
    Repetition,
    find_repetition,
)
from piezoid.records.frequency_response import FrequencyResponseRecord, ResponsePath
from piezoid.records.lab import Lab
from piezoid.records.lab_tables import Coupled
from piezoid.records.recording import Quantity, Recording


def identify_coupled(
    recordings: Sequence[Recording],
    lab: Lab,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> CoupledStage | None:
    """Identify the coupled axes named in lab.toml; None if it names none.

    recordings  any; those with a periodic drive of all these axes at once are used
    lab         with its table ``[coupled]``

    Raises ``ExcitationError`` if no recording determines the coupling, and as ``fit_coupled``.
    """
    if not lab.coupled.axes:
        return None
    periodic = _periodic_recordings(recordings, lab.coupled)
    axes = ", ".join(lab.coupled.axes)
    if not periodic:
        raise ExcitationError(
            f"{lab.place} says that the axes {axes} are coupled, and no recording has "
            f"{lab.coupled.settling_periods + FEWEST} periods of their drives together "
            f"({lab.coupled.settling_periods} to settle and {FEWEST} steady)",
            needed="all these drives and displacements in one file, driven at once by a "
            "periodic multisine of random phases, more realisations than axes at each level",
            remedy="If all recorded periods are steady, write settling_periods = 0. Else record "
            "more periods, or remove the table [coupled]: each axis is then fitted with its own "
            "drive alone.",
        )
    progress(f"fitting the coupled axes {axes}")
    stage = fit_coupled(_levels_of(periodic, lab.coupled))
    return replace(stage, recordings=tuple(recording.name for recording, _ in periodic))


def decoupled_responses(
    recordings: Sequence[Recording], coupled: CoupledStage, declared: Coupled
) -> FrequencyResponseRecord:
    """Return the measured response of each decoupled axis to its drive.

    The response is the best linear approximation at the largest level, whose modes are closest to
    those of later drives.
    """
    periodic = _periodic_recordings(recordings, declared)
    data = _levels_of(periodic, declared)[-1]
    decoupled_m = np.einsum("ij,njrp->nirp", coupled.decoupling, data.displacement_m)
    responses = estimate_response(replace(data, displacement_m=decoupled_m))
    return FrequencyResponseRecord(
        name=f"{', '.join(coupled.outputs)} together",
        digest=digest_of_json([recording.digest for recording, _ in periodic]),
        frequency_Hz=responses[0].frequency_Hz,
        paths=tuple(
            ResponsePath(
                output=axis,
                drive=axis,
                response_m_per_V=measured.response,
                coherence=measured.coherence,
            )
            for axis, measured in zip(coupled.outputs, responses, strict=True)
        ),
    )


def decoupled(recordings: Sequence[Recording], coupled: CoupledStage) -> tuple[Recording, ...]:
    """Return recordings with D y for the displacements y of the coupled axes.

    A recording in which one of these displacements is missing is returned unchanged: with a single
    driven axis D y differs from y by a constant only.

    Raises ``RecordingError`` if several axes are driven and a displacement is missing.
    """
    axes, results = coupled.outputs, []
    for recording in recordings:
        channels = {axis: recording.find(Quantity.DISPLACEMENT, axis) for axis in axes}
        present = {axis: channel for axis, channel in channels.items() if channel is not None}
        if len(present) < len(axes):
            missing = ", ".join(axis for axis in axes if axis not in present)
            moving = driven_axes(recording, axes)
            if present and len(moving) > 1:
                raise RecordingError(
                    f"{recording.name}: the axes {', '.join(moving)} are driven, and the "
                    f"displacement of {missing} is missing",
                    needed=f"the displacements of all coupled axes, {', '.join(axes)}",
                    remedy="Record them together, or drive one axis while the others rest.",
                )
            results.append(recording)
            continue
        values = coupled.decoupling @ np.stack([channel.values for channel in present.values()])
        decoupled_channel = {
            axis: replace(channel, values=row, label=f"{channel.label}, decoupled")
            for (axis, channel), row in zip(present.items(), values, strict=True)
        }
        channels_of_recording = tuple(
            decoupled_channel.get(c.axis, c) if c.quantity is Quantity.DISPLACEMENT else c
            for c in recording.channels
        )
        results.append(replace(recording, channels=channels_of_recording))
    return tuple(results)


def as_single_axes(
    recordings: Sequence[Recording],
    lab: Lab | None,
    coupled: CoupledStage | None = None,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Recording, ...]:
    """Decouple recordings into single axes, if the coupling is known or can be identified.

    Recordings of the coupling fit, in which all axes are driven, are left out.

    coupled  of an earlier fit; None: identified from these recordings if lab.toml names coupled
             axes. Otherwise the recordings are returned unchanged.
    """
    declared = Coupled() if lab is None else lab.coupled
    if coupled is None and lab is not None and _periodic_recordings(recordings, declared):
        coupled = identify_coupled(recordings, lab, progress=progress)
    if coupled is None:
        return tuple(recordings)
    return tuple(r for r in decoupled(recordings, coupled) if r.name not in coupled.recordings)


def driven_axes(recording: Recording, axes: Sequence[str]) -> list[str]:
    """Return the axes whose drive moves, relative to the widest drive of the recording."""
    drives = [(axis, recording.find(Quantity.VOLTAGE, axis)) for axis in axes]
    reach = {axis: float(np.ptp(drive.values)) for axis, drive in drives if drive is not None}
    widest = max(reach.values(), default=0.0)
    return [axis for axis, reach_V in reach.items() if reach_V > STILL * widest]


def _periodic_recordings(
    recordings: Sequence[Recording], declared: Coupled
) -> list[tuple[Recording, Repetition]]:
    """Return the recordings in which all coupled axes are driven at once, with their period."""
    axes, fewest = declared.axes, declared.settling_periods + FEWEST
    periodic = []
    for recording in recordings if axes else ():
        complete = all(
            recording.find(quantity, axis) is not None
            for quantity in (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
            for axis in axes
        )
        if recording.breaks or not complete or len(driven_axes(recording, axes)) < len(axes):
            continue
        results = [find_repetition(recording.voltage_V(axis), fewest=fewest) for axis in axes]
        repetitions = [repetition for repetition in results if repetition is not None]
        if len(repetitions) < len(axes) or len({r.period_samples for r in repetitions}) > 1:
            continue
        first, period = max(r.first for r in repetitions), repetitions[0].period_samples
        periods = (min(r.first + r.periods * period for r in repetitions) - first) // period
        if periods >= fewest:
            repetition = Repetition(first=first, period_samples=period, periods=periods)
            periodic.append((recording, repetition))
    return periodic


def _levels_of(
    periodic: Sequence[tuple[Recording, Repetition]], declared: Coupled
) -> list[PeriodicData]:
    """Return the periodic data of each level, one realisation for each recording."""
    axes = declared.axes
    periods = min(repetition.periods for _, repetition in periodic) - declared.settling_periods
    shapes = {(r.sampling_rate_Hz, repetition.period_samples) for r, repetition in periodic}
    if len(shapes) > 1:
        listed = "; ".join(f"{count} samples at {rate:g} Hz" for rate, count in sorted(shapes))
        raise ExcitationError(
            f"drives of the coupled axes that repeat after {listed}",
            needed="one rate and one period for all levels and realisations",
            remedy="Leave out the recordings with another period.",
        )
    voltage_V, displacement_m = (
        np.transpose(
            [
                [repetition.last_periods(signal_of(recording, axis), periods) for axis in axes]
                for recording, repetition in periodic
            ],
            (2, 1, 0, 3),
        )
        for signal_of in (Recording.voltage_V, Recording.displacement_m)
    )
    data = PeriodicData(
        sampling_rate_Hz=periodic[0][0].sampling_rate_Hz,
        inputs=axes,
        outputs=axes,
        voltage_V=voltage_V,
        displacement_m=displacement_m,
    )
    sizes = data.voltage_V.std(axis=(0, 1, 3))
    order = np.argsort(sizes, kind="stable")
    steps = [k for k, (a, b) in enumerate(pairwise(sizes[order]), 1) if b > LEVEL_TOLERANCE * a]
    return [data.select(order[a:b].tolist()) for a, b in pairwise([0, *steps, len(order)])]
