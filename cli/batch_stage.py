"""One stage of a batch: its input files, its earlier result, and its calibration on a worker."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from piezoid_cli.result_store import RECORD, result_store
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
OTHER_SUFFIXES = {".toml", ".md", ".json", ".html"}  # never recordings


@dataclass(frozen=True, kw_only=True)
class StageTask:
    """A stage to calibrate.

    name     of the stage
    folder   of its files, as every worker sees it
    results  folder or URL of the results, as every worker sees it
    version  of piezoid
    force    replace edited results of this stage
    """

    name: str
    folder: str
    results: str
    version: str
    force: bool = False


Calibrate = Callable[[StageTask, Mapping[str, str]], tuple[FleetStage, Mapping[str, bytes]]]


def earlier_result(task: StageTask) -> tuple[FleetStage | None, bool]:
    """Return the record of an earlier run, and whether its files and version are unchanged.

    Raises ``OutputFolderError`` if the stage is unfinished and its results may not be written.
    """
    record = _read_record(task)
    try:
        is_current = record is not None and _is_current(record, task, inputs_of(task))
    except OSError:  # a recording cannot be read: the worker records that as the reason
        record, is_current = None, False
    if not is_current:
        result_store(task.results, force=task.force).check_stage(task.name)
    return record, is_current


def run_task(task: StageTask, calibrate: Calibrate | None = None) -> bytes:
    """Calibrate a stage, write its files, and return its packed record.

    calibrate  default: ``calibrate_stage``

    A stage that another worker has finished in the meantime is not calibrated again.
    """
    store, inputs = result_store(task.results, force=task.force), inputs_of(task)
    store.check_visible()
    record = _read_record(task)
    if record is None or not _is_current(record, task, inputs):
        record, files = (calibrate or calibrate_stage)(task, inputs)
        store.write_stage(task.name, {**files, RECORD: record.to_json()})
    return record.packed()


def inputs_of(task: StageTask) -> dict[str, str]:
    """Return the digest of every file of a stage by name, including ``lab.toml``."""
    from piezoid.digests import digest_of_file
    from piezoid.errors import PiezoidError
    from piezoid.records.lab import read_lab

    folder = Path(task.folder)
    try:
        declared = [entry.file for entry in read_lab(folder / LAB).recordings]
    except PiezoidError:
        declared = []  # the calibration raises the same error, which becomes the reason
    recordings = [name for name in dict.fromkeys(declared) if (folder / name).is_file()]
    # Without entries in lab.toml, any file of the folder may be a recording.
    recordings = recordings or sorted(
        file.name
        for file in folder.iterdir()
        if file.is_file() and file.suffix not in OTHER_SUFFIXES and file.name[0] != "."
    )
    return {name: digest_of_file(folder / name) for name in (LAB, *recordings)}


def _read_record(task: StageTask) -> FleetStage | None:
    """Return the record of a stage; None without a valid record, or if the stage crashed."""
    from piezoid.errors import PiezoidError

    try:
        content = result_store(task.results).read_record(task.name)
        stage = stage_from_json(content, f"{task.name}/{RECORD}")
    except (OSError, PiezoidError):
        return None
    return None if stage.state == CRASHED else stage


def _is_current(record: FleetStage, task: StageTask, inputs: Mapping[str, str]) -> bool:
    return dict(record.inputs) == dict(inputs) and record.version == task.version


def calibrate_stage(
    task: StageTask, inputs: Mapping[str, str]
) -> tuple[FleetStage, Mapping[str, bytes]]:
    """Return the record of a stage and its files; unusable data and internal errors are recorded.

    Raises ``OSError`` and ``MemoryError``, which may not recur when the stage is repeated.
    """
    from piezoid.errors import PiezoidError
    from piezoid_cli.calibration import calibrate

    folder = Path(task.folder)
    files = [folder / name for name in inputs if name != LAB]
    without_results = partial(FleetStage, name=task.name, version=task.version, inputs=inputs)
    try:
        calibration = calibrate(files, folder / LAB, lambda _: None)
        return _record(task, inputs, calibration), calibration.files
    except (OSError, MemoryError):
        raise
    except PiezoidError as error:
        return without_results(state=REFUSED, reason=str(error)), {}
    except Exception as error:
        reason = f"internal error ({type(error).__name__}: {error})"
        return without_results(state=CRASHED, reason=reason), {}


def _record(task: StageTask, inputs: Mapping[str, str], calibration: "Calibration") -> FleetStage:
    """Return the record of a calibrated stage; its reason lists everything that failed."""
    from piezoid.digests import digest_in
    from piezoid.verification.criteria import describe_failure

    reasons = [
        f"axis {axis.axis}: {axis.verdict.reason}"
        for axis in calibration.model.axes.values()
        if not axis.verdict.applies
    ]
    if calibration.has_crashed:
        reasons += calibration.undiagnosed
    controllers = calibration.controllers
    if not controllers.passed:
        unshipped, verification = controllers.unshipped, controllers.verification
        reasons += [controllers.reason] if controllers.reason else []
        reasons += [f"axis {axis} does not ship: {text}" for axis, text in unshipped.items()]
        verdicts = () if verification is None else verification.verdicts
        reasons += [describe_failure(verdict) for verdict in verdicts if not verdict.passed]
    sealed = {name: text for name, text in calibration.files.items() if name.endswith(".json")}
    return FleetStage(
        name=task.name,
        state=PASSED if calibration.passed else FAILED,
        reason="; ".join(reasons),
        version=task.version,
        inputs=inputs,
        outputs={name: digest_in(text) for name, text in sealed.items()},
        axes=tuple(_axis(axis, calibration) for axis in calibration.model.axes.values()),
    )


def _axis(axis: "AxisModel", calibration: "Calibration") -> FleetAxis:
    from math import isfinite

    from piezoid.raw_counts import in_counts
    from piezoid_reports.fleet.statistics import QUANTITIES

    design = calibration.controllers.design
    designs = {} if design is None else {each.axis: each for each in design.axes}
    # Stages are compared in SI units; quantities in counts are left out.
    compared = [q for q in QUANTITIES if in_counts(q.unit, axis.counted) == q.unit]
    values = {q.name: q.of(axis, designs.get(axis.axis)) for q in compared}
    errors = {q.name: q.error(axis) for q in compared}
    hysteresis = axis.hysteresis
    parameters: dict[str, float | list[float]] = {
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
    return FleetAxis(
        axis=axis.axis,
        applies=axis.verdict.applies,
        values={name: value for name, value in values.items() if value is not None},
        parameters={} if axis.counted else parameters,
        errors={n: error for n, error in errors.items() if error is not None and isfinite(error)},
    )
