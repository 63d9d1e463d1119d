"""Recordings of a stage whose drives act on all of its axes: its model, and each axis for itself.

    y = G(s) v,   y' = D y = D G v,   D = diag(G_0) G_0^-1

v is the drive behind its hysteresis, G_0 the response well below the first mode. In the
coordinates y' an axis answers to its own drive alone, as far as the coupling is static: there
hysteresis is fitted, causes are named and controllers run. What of the coupling is dynamic is
left.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from piezoid.digests import digest_of_json
from piezoid.errors import ExcitationError, RecordingError
from piezoid.identification.coupled.coupled_stage import LEVEL_TOLERANCE, CoupledStage
from piezoid.identification.coupled.fit_coupled import fit_coupled
from piezoid.identification.dynamics.periodic_estimate import PeriodicData, estimate_response
from piezoid.identification.dynamics.repetition import (
    FEWEST,
    STILL,
    Repetition,
    find_repetition,
)
from piezoid.numerics.arrays import Array
from piezoid.records.frequency_response import FrequencyResponseRecord, ResponsePath
from piezoid.records.lab import Lab
from piezoid.records.lab_tables import Coupled
from piezoid.records.recording import Quantity, Recording


@dataclass(frozen=True, kw_only=True)
class _Periodic:
    """A recording in which all axes are driven at once, and where that repeats."""

    recording: Recording
    repetition: Repetition


def identify_coupled(
    recordings: Sequence[Recording],
    lab: Lab,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> CoupledStage | None:
    """Return the model of the axes that lab.toml says are coupled; None where it names none.

    recordings  any; those count in which a drive of all these axes at once repeats itself
    lab         its table ``[coupled]``

    Raises ``ExcitationError`` where no recording tells the coupling, and as ``fit_coupled``.
    """
    if not lab.coupled.axes:
        return None
    found = [one for r in recordings if (one := _periodic(r, lab.coupled)) is not None]
    axes = ", ".join(lab.coupled.axes)
    if not found:
        raise ExcitationError(
            f"{lab.place} says that the axes {axes} are coupled, and in no recording do their "
            f"drives repeat together, {lab.coupled.settling_periods + FEWEST} periods or more",
            needed="all these drives and displacements in one file, driven at once by a "
            "multisine of random phases that repeats, more realisations than axes at each level",
            remedy="Record that (piezoid plan does not), or take the table [coupled] out: the "
            "axes are then fitted as if each had its own drive alone. Where periods are steady "
            "from the first on, write settling_periods = 0.",
        )
    progress(f"fitting the coupled axes {axes}")
    fitted = fit_coupled(_levels(found, lab.coupled))
    return replace(fitted, recordings=tuple(one.recording.name for one in found))


def own_responses(
    recordings: Sequence[Recording], coupled: CoupledStage, declared: Coupled
) -> tuple[FrequencyResponseRecord, ...]:
    """Return the measured response of each decoupled axis to its own drive, all in one record.

    At the largest level, where the modes are nearest to those of the drives that follow; the best
    linear approximation, with its coherence. None where the realisations are too few for it.
    """
    found = [one for r in recordings if (one := _periodic(r, declared)) is not None]
    data = _levels(found, declared)[-1]
    turned = np.einsum("ij,njrp->nirp", coupled.decoupling, data.displacement_m)
    if data.voltage_V.shape[2] <= len(data.inputs):
        return ()
    measured = estimate_response(replace(data, displacement_m=turned))
    return (
        FrequencyResponseRecord(
            name=f"{', '.join(coupled.outputs)} together",
            digest=digest_of_json([one.recording.digest for one in found]),
            frequency_Hz=measured.frequency_Hz,
            paths=tuple(
                ResponsePath(
                    output=axis,
                    drive=axis,
                    response_m_per_V=measured.response[:, k, k],
                    coherence=measured.coherence[:, k],
                )
                for k, axis in enumerate(coupled.outputs)
            ),
        ),
    )


def decoupled(recordings: Sequence[Recording], coupled: CoupledStage) -> tuple[Recording, ...]:
    """Return recordings with D y for the displacements y of the coupled axes.

    A recording without one of these displacements stays as it is: its drives are then those of
    one axis, the others at rest, and D y differs from y by a constant.

    Raises ``RecordingError`` where several axes are driven and a displacement is missing.
    """
    return tuple(_decoupled(one, coupled) for one in recordings)


def as_single_axes(
    recordings: Sequence[Recording],
    lab: Lab | None,
    known: CoupledStage | None = None,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Recording, ...]:
    """Return recordings as single axes see them, as far as their coupling is known.

    known  of an earlier fit; None: of these recordings, where lab.toml names coupled axes and they
           tell the coupling; else they stay as they are
    """
    coupled = known
    declared = Coupled() if lab is None else lab.coupled
    if coupled is None and lab is not None and declared.axes:
        told = any(_periodic(one, declared) is not None for one in recordings)
        coupled = identify_coupled(recordings, lab, progress=progress) if told else None
    return tuple(recordings) if coupled is None else apart(decoupled(recordings, coupled), coupled)


def apart(recordings: Sequence[Recording], coupled: CoupledStage) -> tuple[Recording, ...]:
    """Return the recordings without those that told the coupling: they are of no single axis."""
    return tuple(one for one in recordings if one.name not in coupled.recordings)


def _decoupled(recording: Recording, coupled: CoupledStage) -> Recording:
    axes = coupled.outputs
    held = [recording.find(Quantity.DISPLACEMENT, axis) for axis in axes]
    moved = [channel for channel in held if channel is not None]
    if len(moved) < len(axes):
        missing = [a for a, channel in zip(axes, held, strict=True) if channel is None]
        moving = driven(recording, axes)
        if moved and len(moving) > 1:
            raise RecordingError(
                f"{recording.name}: the axes {', '.join(moving)} are driven, and the displacement "
                f"of {', '.join(missing)} is not there",
                needed=f"the displacements of all coupled axes, {', '.join(axes)}",
                remedy="Record them together, or drive one axis while the others rest.",
            )
        return recording
    values = coupled.decoupling @ np.stack([channel.values for channel in moved])
    turned = {
        axis: replace(channel, values=row, label=f"{channel.label}, decoupled")
        for axis, channel, row in zip(axes, moved, values, strict=True)
    }
    channels = tuple(
        turned[c.axis] if c.quantity is Quantity.DISPLACEMENT and c.axis in turned else c
        for c in recording.channels
    )
    return replace(recording, channels=channels)


def driven(recording: Recording, axes: Sequence[str]) -> list[str]:
    """Return which of these axes are driven: not those that rest beside a wider drive."""
    found = [(axis, recording.find(Quantity.VOLTAGE, axis)) for axis in axes]
    reach = {axis: float(np.ptp(channel.values)) for axis, channel in found if channel is not None}
    widest = max(reach.values(), default=0.0)
    return [axis for axis, own in reach.items() if own > STILL * widest]


def _periodic(recording: Recording, declared: Coupled) -> _Periodic | None:
    axes, settling = declared.axes, declared.settling_periods
    wanted = (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
    complete = all(
        recording.find(quantity, axis) is not None for quantity in wanted for axis in axes
    )
    if recording.breaks or not complete or len(driven(recording, axes)) < len(axes):
        return None
    found = [find_repetition(recording.voltage_V(a), fewest=settling + FEWEST) for a in axes]
    known = [one for one in found if one is not None]
    if len(known) < len(axes) or len({one.period_samples for one in known}) > 1:
        return None
    first, period = max(one.first for one in known), known[0].period_samples
    end = min(one.first + one.periods * period for one in known)
    periods = (end - first) // period
    if periods < settling + FEWEST:
        return None
    return _Periodic(
        recording=recording,
        repetition=Repetition(first=first, period_samples=period, periods=periods),
    )


def _levels(found: Sequence[_Periodic], declared: Coupled) -> list[PeriodicData]:
    """Return what was recorded at each level, realisations side by side."""
    periods = min(one.repetition.periods for one in found) - declared.settling_periods
    shapes = {(r.recording.sampling_rate_Hz, r.repetition.period_samples) for r in found}
    if len(shapes) > 1:
        told = "; ".join(f"{count} samples at {rate:g} Hz" for rate, count in sorted(shapes))
        raise ExcitationError(
            f"drives of the coupled axes that repeat after {told}",
            needed="one rate and one period for all levels and realisations",
            remedy="Leave out the recordings of another period.",
        )
    cuts = [(_cut(one, declared.axes, periods, "voltage_V"), one) for one in found]
    cuts.sort(key=lambda pair: float(pair[0].std()))
    sizes = [float(drive.std()) for drive, _ in cuts]
    steps = [k for k, (a, b) in enumerate(pairwise(sizes), 1) if b > LEVEL_TOLERANCE * a]
    edges = [0, *steps, len(cuts)]
    return [
        PeriodicData(
            sampling_rate_Hz=found[0].recording.sampling_rate_Hz,
            inputs=declared.axes,
            outputs=declared.axes,
            voltage_V=np.stack([drive for drive, _ in cuts[a:b]], axis=2),
            displacement_m=np.stack(
                [_cut(one, declared.axes, periods, "displacement_m") for _, one in cuts[a:b]],
                axis=2,
            ),
        )
        for a, b in pairwise(edges)
    ]


def _cut(one: _Periodic, axes: Sequence[str], periods: int, quantity: str) -> Array:
    """Return the last periods of every axis, (samples, axes, periods)."""
    P = one.repetition.period_samples
    start = one.repetition.first + (one.repetition.periods - periods) * P
    signals = [getattr(one.recording, quantity)(axis) for axis in axes]
    cut = [signal[start : start + periods * P].reshape(periods, P).T for signal in signals]
    return np.stack(cut, axis=1)
