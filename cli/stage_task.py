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
    results = []
    for task in tasks:
        record, refusal = _record_of(task), None
        if record is not None and _is_of(record, task, inputs_of(task)):
            results.append(Known(task.name, record.packed(), False))
            continue
        try:
            results_place(task.results, force=task.force).check_stage(task.name)
        except OutputFolderError as error:
            refusal = error
        results.append(Known(task.name, None, record is not None, refusal))
    return results


def work_off(
    tasks: Sequence[StageTask], run: "Run | None" = None, *, spell_s: float = SPELL_s
) -> list[Outcome]:
    """Do stages one after the other, those that are done already left as they are.

    run      what is done of one; ``run_stage`` if not given
    spell_s  after so long, what is not begun is left to others

    Returns the outcomes of the first, and of the second and so on while less than ``spell_s`` have
    passed. Raises what ``run_stage`` raises.
    """
    start_s, outcomes = monotonic(), list[Outcome]()
    for task in tasks:
        store, inputs = results_place(task.results, force=task.force), inputs_of(task)
        store.check_seen()
        stage = _record_of(task)
        if stage is None or not _is_of(stage, task, inputs):
            stage, files = (run or run_stage)(task, inputs)
            store.write(task.name, {**files, RECORD: stage.to_json()})
        outcomes.append(Outcome(task.name, stage.packed()))
        if monotonic() - start_s > spell_s:
            break
    return outcomes


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
    present = [name for name in dict.fromkeys(declared) if (folder / name).is_file()]
    return present or sorted(
        place.name
        for place in folder.iterdir()
        if place.is_file() and place.suffix not in NO_RECORDING and place.name[0] != "."
    )


def _record_of(task: StageTask) -> FleetStage | None:
    """Return the record of a stage; None without a usable one, or if its work broke off."""
    from piezoid.errors import PiezoidError

    try:
        content = results_place(task.results).record_of(task.name)
        stage = stage_from_json(content, f"{task.name}/{RECORD}")
    except (OSError, PiezoidError):
        return None
    return None if stage.state == CRASHED else stage


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
        calibration = calibrate(files, folder / LAB, lambda _: None)
        return _record(task, inputs, calibration), calibration.files
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


def _record(task: StageTask, inputs: Mapping[str, str], calibration: "Calibration") -> FleetStage:
    from json import loads

    sealed = {name: text for name, text in calibration.files.items() if name.endswith(".json")}
    return FleetStage(
        name=task.name,
        state=PASSED if calibration.passed else FAILED,
        reason=_reason(calibration),
        version=task.version,
        inputs=inputs,
        outputs={name: loads(text)["digest"] for name, text in sealed.items()},
        axes=tuple(_axis(axis, calibration) for axis in calibration.model.axes.values()),
    )


def _reason(calibration: "Calibration") -> str:
    """Return everything that failed; empty if nothing did."""
    from piezoid.verification.criteria import describe_failure

    reasons = [
        f"axis {axis.axis}: {axis.verdict.reason}"
        for axis in calibration.model.axes.values()
        if not axis.verdict.applies
    ]
    if calibration.stumbled:
        reasons += calibration.undiagnosed
    controllers = calibration.controllers
    if not controllers.passed:
        unshipped, verification = controllers.unshipped, controllers.verification
        reasons += [controllers.reason] if controllers.reason else []
        reasons += [f"axis {axis} does not ship: {text}" for axis, text in unshipped.items()]
        verdicts = () if verification is None else verification.verdicts
        reasons += [describe_failure(verdict) for verdict in verdicts if not verdict.passed]
    return "; ".join(reasons)


def _axis(axis: "AxisModel", calibration: "Calibration") -> FleetAxis:
    """Return the quantities of an axis in SI units, with the standard errors that are known."""
    from math import isfinite

    from piezoid.raw_counts import in_counts
    from piezoid_reports.fleet.quantities import QUANTITIES

    design = calibration.controllers.design
    designs = {} if design is None else {each.axis: each for each in design.axes}
    # Stages are compared in units: quantities in counts are left out.
    compared = [q for q in QUANTITIES if in_counts(q.unit, axis.counted) == q.unit]
    values = {q.name: q.of(axis, designs.get(axis.axis)) for q in compared}
    errors = {q.name: q.error(axis) for q in compared}
    return FleetAxis(
        axis=axis.axis,
        applies=axis.verdict.applies,
        values={name: value for name, value in values.items() if value is not None},
        parameters={} if axis.counted else _parameters(axis),
        errors={n: error for n, error in errors.items() if error is not None and isfinite(error)},
    )


def _parameters(axis: "AxisModel") -> dict[str, float | list[float]]:
    hysteresis = axis.hysteresis
    return {
        "play_threshold_V": hysteresis.plays.threshold.tolist(),
        "play_weight_m_per_V": hysteresis.plays.weight.tolist(),
        "dead_zone_threshold_m": hysteresis.dead_zones.threshold.tolist(),
        "dead_zone_weight": hysteresis.dead_zones.weight.tolist(),
        "envelope_threshold_V": hysteresis.envelope.threshold.tolist(),
        "envelope_weight": hysteresis.envelope.weight.tolist(),
        "voltage_offset_V": hysteresis.voltage_offset_V,
        "displacement_offset_m": hysteresis.displacement_offset_m,
        "voltage_low_V": axis.voltage_V[0],
        "voltage_high_V": axis.voltage_V[1],
        "polarity": float(axis.polarity),
    }
