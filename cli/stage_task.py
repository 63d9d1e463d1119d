"""One stage of a batch, as it is done on any worker: names in, files written, a record back."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, NamedTuple

from piezoid.errors import OutputFolderError
from piezoid_cli.results_place import RECORD, results_place
from piezoid_reports.fleet.records import (
    CRASHED,
    FAILED,
    PASSED,
    REFUSED,
    FleetAxis,
    FleetStage,
    stage_from_json,
)

if TYPE_CHECKING:
    from piezoid.calibration.calibrate import Calibration
    from piezoid.calibration.controllers import Controllers
    from piezoid.identification.model import AxisModel

LAB = "lab.toml"
NO_RECORDING = {".toml", ".md", ".json", ".html"}
SPELL_s = 20.0  # after which a worker hands back what it has not begun, so that others help


@dataclass(frozen=True, kw_only=True)
class StageTask:
    """What a worker is told.

    name     of the stage
    folder   where its files lie, as every worker sees it
    results  folder or URL of the results, as every worker sees it
    version  of piezoid
    force    replace results of this stage although they were edited
    """

    name: str
    folder: str
    results: str
    version: str
    force: bool = False


class Outcome(NamedTuple):
    """What the client is told: whose it is, and the packed record; the files are written."""

    name: str
    packed: bytes


class Known(NamedTuple):
    """What is kept of a stage before anything is done.

    packed   the record, where it is of the same inputs and version; None: the stage is to be done
    changed  whether results of other inputs or of another version would be replaced
    refusal  why its results may not be written
    """

    name: str
    packed: bytes | None
    changed: bool
    refusal: OutputFolderError | None = None


def known_of(tasks: Sequence[StageTask]) -> list[Known]:
    """Compare what is kept of stages with the files they would be made from."""
    found = []
    for task in tasks:
        kept = _kept(task)
        same = kept is not None and _is_of(kept, task, inputs_of(task))
        if kept is not None and same:
            found.append(Known(task.name, kept.packed(), False))
        else:
            found.append(Known(task.name, None, kept is not None, _refusal_of(task)))
    return found


def _refusal_of(task: StageTask) -> OutputFolderError | None:
    try:
        results_place(task.results, force=task.force).check_stage(task.name)
    except OutputFolderError as refusal:
        return refusal
    return None


def work_off(
    tasks: Sequence[StageTask], run: "Run | None" = None, *, spell_s: float = SPELL_s
) -> list[Outcome]:
    """Do stages one after the other, those that are done already left as they are.

    run      what is done of one; ``run_stage`` if not given
    spell_s  after so long, what is not begun is left to others

    Returns the outcomes of the first, and of the second and so on while less than ``spell_s`` have
    passed. Raises what ``run_stage`` raises.
    """
    begun_s, found = monotonic(), []
    for task in tasks:
        found.append(_worked(task, run or run_stage))
        if monotonic() - begun_s > spell_s:
            break
    return found


def _worked(task: StageTask, run: "Run") -> Outcome:
    place, inputs = results_place(task.results, force=task.force), inputs_of(task)
    place.check_seen()
    kept = _kept(task)
    if kept is not None and _is_of(kept, task, inputs):
        return Outcome(task.name, kept.packed())
    stage, files = run(task, inputs)
    place.write(task.name, {**files, RECORD: stage.to_json()})
    return Outcome(task.name, stage.packed())


def inputs_of(task: StageTask) -> dict[str, str]:
    """Return the digest of every file of a stage by name, ``lab.toml`` among them."""
    from piezoid.digests import digest_of_file

    folder = Path(task.folder)
    return {name: digest_of_file(folder / name) for name in (LAB, *_recordings(folder))}


def _recordings(folder: Path) -> Sequence[str]:
    """Return the files a lab.toml names, or else every file beside it that may be one."""
    from piezoid.errors import PiezoidError
    from piezoid.records.lab import read_lab

    try:
        declared = [entry.file for entry in read_lab(folder / LAB).recordings]
    except PiezoidError:
        declared = []  # it is read again, and its refusal becomes the stage's reason
    there = [name for name in dict.fromkeys(declared) if (folder / name).is_file()]
    return there or sorted(
        place.name
        for place in folder.iterdir()
        if place.is_file() and place.suffix not in NO_RECORDING and place.name[0] != "."
    )


def _kept(task: StageTask) -> FleetStage | None:
    """Return what is kept of a stage; None where nothing usable is, or its work broke off."""
    from piezoid.errors import PiezoidError

    try:
        content = results_place(task.results).record_of(task.name)
        kept = stage_from_json(content, f"{task.name}/{RECORD}")
    except (OSError, PiezoidError):
        return None
    return None if kept.state == CRASHED else kept


def _is_of(stage: FleetStage, task: StageTask, inputs: Mapping[str, str]) -> bool:
    return dict(stage.inputs) == dict(inputs) and stage.version == task.version


def run_stage(
    task: StageTask, inputs: Mapping[str, str]
) -> tuple[FleetStage, Mapping[str, bytes]]:
    """Calibrate one stage; data that cannot be used is an outcome, and so is an internal error.

    Returns the record, and the files of the stage's folder. Raises only what may be gone the next
    time: a file that cannot be read, memory that is full.
    """
    from piezoid.errors import PiezoidError
    from piezoid_cli.calibration import calibrate

    folder = Path(task.folder)
    files = [folder / name for name in inputs if name != LAB]
    try:
        found = calibrate(files, folder / LAB, lambda _: None)
        return _record(task, inputs, found), found.files
    except (OSError, MemoryError):
        raise
    except PiezoidError as error:
        return broken(task, REFUSED, str(error), inputs), {}
    except Exception as error:
        reason = f"internal error ({type(error).__name__}: {error})"
        return broken(task, CRASHED, reason, inputs), {}


Run = Callable[[StageTask, Mapping[str, str]], tuple[FleetStage, Mapping[str, bytes]]]


def broken(
    task: StageTask, state: str, reason: str, inputs: Mapping[str, str] | None = None
) -> FleetStage:
    """Return the record of a stage of which there are no results."""
    return FleetStage(
        name=task.name, state=state, reason=reason, version=task.version, inputs=inputs or {}
    )


def _record(task: StageTask, inputs: Mapping[str, str], found: "Calibration") -> FleetStage:
    from json import loads

    sealed = {name: text for name, text in found.files.items() if name.endswith(".json")}
    return FleetStage(
        name=task.name,
        state=PASSED if found.passed else FAILED,
        reason=_reason(found),
        version=task.version,
        inputs=inputs,
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
    from piezoid.verification.criteria import describe_failure

    if made.passed:
        return []
    wrong = [made.reason] if made.reason else []
    wrong += [f"axis {axis} does not ship: {reason}" for axis, reason in made.unshipped.items()]
    return wrong + [
        describe_failure(verdict)
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
    from piezoid.raw_counts import in_counts

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
