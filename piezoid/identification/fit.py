"""Recordings in, one ActuatorModel of the whole stage out."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from piezoid.errors import ExcitationError
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import ActuatorModel
from piezoid.records.recording import Quantity, Recording

STILL = 0.01  # of the widest drive: a recording that moves less says nothing of hysteresis
UNDECLARED = Rig()


def fit(
    recordings: Sequence[Recording],
    *,
    stage: str = "stage",
    rigs: Mapping[str, Rig] | None = None,
    lab: str | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> ActuatorModel:
    """Fit every axis that has a drive and a displacement.

    recordings  of one stage, any number of axes
    stage       name for the report
    rigs        declared poles by axis
    lab         digest of lab.toml, for the chain of provenance
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
    declared = rigs or {}
    return ActuatorModel(
        stage=stage,
        axes={
            axis: estimate_axis(
                moving(recordings, axis),
                axis,
                declared.get(axis, UNDECLARED),
                progress=lambda text, axis=axis: progress(f"axis {axis}: {text}"),  # type: ignore[misc]
            )
            for axis in axes
        },
        sources={recording.name: recording.digest for recording in recordings},
        lab=lab,
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
