"""One stage of a batch, as it is done on any worker: paths in, record and files out."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from piezoid_reports.fleet.records import CRASHED, FAILED, PASSED, REFUSED, FleetAxis, FleetStage

if TYPE_CHECKING:
    from piezoid.calibration.calibrate import Calibration
    from piezoid.calibration.controllers import Controllers
    from piezoid.identification.model import AxisModel

LAB = "lab.toml"


@dataclass(frozen=True, kw_only=True)
class StageTask:
    """What a worker is told.

    name     of the stage
    folder   where its files lie, as every worker sees it
    inputs   digest of every file by name, ``lab.toml`` among them
    version  of piezoid
    """

    name: str
    folder: str
    inputs: Mapping[str, str]
    version: str


@dataclass(frozen=True, kw_only=True)
class StageDone:
    """What comes back: the record, and the files of the stage's folder."""

    stage: FleetStage
    files: Mapping[str, bytes]


def run_stage(task: StageTask) -> StageDone:
    """Calibrate one stage; data that cannot be used is an outcome, and so is a mistake of ours.

    Raises only what may be gone the next time: a file that cannot be read, memory that is full.
    """
    from piezoid.errors import PiezoidError
    from piezoid_cli.calibration import calibrate

    folder = Path(task.folder)
    files = [folder / name for name in task.inputs if name != LAB]
    try:
        found = calibrate(files, folder / LAB, lambda _: None)
    except (OSError, MemoryError):
        raise
    except PiezoidError as error:
        return StageDone(stage=broken(task, REFUSED, str(error)), files={})
    except Exception as error:
        reason = f"a mistake of ours, {type(error).__name__}: {error}"
        return StageDone(stage=broken(task, CRASHED, reason), files={})
    return StageDone(stage=_record(task, found), files=found.files)


def broken(task: StageTask, state: str, reason: str) -> FleetStage:
    """Return the record of a stage of which there are no results."""
    return FleetStage(
        name=task.name, state=state, reason=reason, version=task.version, inputs=task.inputs
    )


def _record(task: StageTask, found: "Calibration") -> FleetStage:
    from json import loads

    sealed = {name: text for name, text in found.files.items() if name.endswith(".json")}
    return FleetStage(
        name=task.name,
        state=PASSED if found.passed else FAILED,
        reason=_reason(found),
        version=task.version,
        inputs=task.inputs,
        outputs={name: loads(text)["digest"] for name, text in sealed.items()},
        axes=tuple(_axis(axis, found) for axis in found.model.axes.values()),
    )


def _reason(found: "Calibration") -> str:
    wrong = [
        f"axis {axis.axis}: {axis.verdict.reason}"
        for axis in found.model.axes.values()
        if not axis.verdict.applies
    ]
    if found.stumbled:
        wrong += found.undiagnosed
    return "; ".join([*wrong, *_wrong_controllers(found.controllers)])


def _wrong_controllers(made: "Controllers") -> list[str]:
    from piezoid.verification.criteria import failure_of

    if made.passed:
        return []
    wrong = [made.reason] if made.reason else []
    wrong += [f"axis {axis} does not ship: {reason}" for axis, reason in made.unshipped.items()]
    return wrong + [
        failure_of(verdict)
        for verdict in (() if made.verification is None else made.verification.verdicts)
        if not verdict.passed
    ]


def _axis(axis: "AxisModel", found: "Calibration") -> FleetAxis:
    from piezoid_reports.fleet.quantities import QUANTITIES

    design = found.controllers.design
    designs = {} if design is None else {one.axis: one for one in design.axes}
    values = {
        quantity.name: quantity.of(axis, designs.get(axis.axis))
        for quantity in QUANTITIES
        if not _is_counted(quantity.unit, axis)
    }
    return FleetAxis(
        axis=axis.axis,
        applies=axis.verdict.applies,
        values={name: value for name, value in values.items() if value is not None},
        parameters={} if axis.counted else _parameters(axis),
        errors=_errors(axis),
    )


def _is_counted(unit: str, axis: "AxisModel") -> bool:
    """Tell whether a quantity of this axis is in counts: stages are compared in units."""
    from piezoid.counts import in_counts

    return in_counts(unit, axis.counted) != unit


def _errors(axis: "AxisModel") -> dict[str, float]:
    """Return the standard errors that the fit knows, by quantity."""
    from math import isfinite

    from piezoid_reports.fleet.quantities import QUANTITIES

    found = {
        quantity.name: quantity.error(axis)
        for quantity in QUANTITIES
        if not _is_counted(quantity.unit, axis)
    }
    return {name: error for name, error in found.items() if error is not None and isfinite(error)}


def _parameters(axis: "AxisModel") -> dict[str, float | list[float]]:
    held = axis.hysteresis
    return {
        "play_threshold_V": held.plays.threshold.tolist(),
        "play_weight_m_per_V": held.plays.weight.tolist(),
        "dead_zone_threshold_m": held.dead_zones.threshold.tolist(),
        "dead_zone_weight": held.dead_zones.weight.tolist(),
        "envelope_threshold_V": held.envelope.threshold.tolist(),
        "envelope_weight": held.envelope.weight.tolist(),
        "voltage_offset_V": held.voltage_offset_V,
        "displacement_offset_m": held.displacement_offset_m,
        "voltage_low_V": axis.voltage_V[0],
        "voltage_high_V": axis.voltage_V[1],
        "polarity": float(axis.polarity),
    }
