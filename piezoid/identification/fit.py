"""Recordings in, one ActuatorModel of the whole stage out."""

from collections.abc import Callable, Sequence

import numpy as np

from piezoid.errors import ExcitationError
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import ActuatorModel
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording

STILL = 0.01  # of the widest drive: a recording that moves less says nothing of hysteresis


def fit(
    recordings: Sequence[Recording],
    *,
    lab: Lab | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> ActuatorModel:
    """Fit every axis that has a drive and a displacement.

    recordings  of one stage, any number of axes
    lab         what the laboratory declares; its poles are not fitted again
    progress    told what is being done

    Raises ``ExcitationError`` where no recording has both a drive and a displacement.
    """
    axes = axes_of(recordings)
    if not axes:
        held = sorted({c.quantity.name.lower() for r in recordings for c in r.channels})
        raise ExcitationError(
            f"{', '.join(r.name for r in recordings)}: only {', '.join(held)} is recorded",
            needed="a drive voltage and a displacement of the same axis",
            remedy="Record both, or name the columns in lab.toml.",
        )
    declared = lab or Lab()
    return ActuatorModel(
        stage=declared.name or recordings[0].name.partition(".")[0],
        axes={
            axis: estimate_axis(
                moving(recordings, axis),
                axis,
                rig_of(declared, axis),
                progress=lambda text, axis=axis: progress(f"axis {axis}: {text}"),  # type: ignore[misc]
            )
            for axis in axes
        },
        sources={recording.name: recording.digest for recording in recordings},
        lab=declared.digest or None,
    )


def rig_of(lab: Lab, axis: str) -> Rig:
    """Return the declared poles in front of and behind the hysteresis of an axis."""
    return Rig(
        amplifier_bandwidth_Hz=lab.amplifier_of(axis).bandwidth_Hz,
        sensor_bandwidth_Hz=lab.sensor_of(axis).bandwidth_Hz,
    )


def axes_of(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the axes of which some recording has both drive and displacement."""
    return tuple(sorted({axis for r in recordings for axis in r.axes if _has_both(r, axis)}))


def moving(recordings: Sequence[Recording], axis: str) -> tuple[Recording, ...]:
    """Return the recordings in which this axis has both channels and its drive moves."""
    both = [r for r in recordings if _has_both(r, axis)]
    widest = max(float(np.ptp(r.voltage_V(axis))) for r in both)
    return tuple(r for r in both if np.ptp(r.voltage_V(axis)) > STILL * widest) or tuple(both)


def _has_both(recording: Recording, axis: str) -> bool:
    return all(
        recording.find(quantity, axis) is not None
        for quantity in (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
    )
