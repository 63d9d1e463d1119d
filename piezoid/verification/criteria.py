"""Acceptance criteria: verdicts on measured figures and their limits."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np

from piezoid.errors import LabFileError
from piezoid.formatting import significant, with_unit
from piezoid.numerics.arrays import Array
from piezoid.runtime.controller import Status
from piezoid.toml_files import read_toml
from piezoid.verification.tracking import LoopRecord, Tracking

SHAPE_ERROR = "shape error of the controller"
HOLD_TIME = "time without sensor until the output is held"
SHAPE_RATIO = "shape error, ratio to no compensation"
_Positive = Annotated[float, msgspec.Meta(gt=0.0, le=sys.float_info.max)]
_Limit = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
_SETTLED = 0.02  # of the largest step
_BEFORE_NEXT_s = 5e-3  # a loop with preview moves before the next step
_AFTERWARDS = 0.25  # share of a record, at its end, in which a fault must have no effect


class Limits(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Acceptance limits; every number may be replaced for an application.

    aligned_percent     of the diameter, shape error of the controller, up to judged_Hz
    judged_Hz           frequency above which spirals are compared with no compensation only
    settling_s          after the largest step, to 2 % of it
    overshoot_percent   of the largest step
    varied_percent      of the diameter, shape error with any plant the uncertainty allows
    fault_percent       of the diameter, largest distance from the path with a failed sensor
    coupling_percent    of the motion of a coupled axis, amplitude of another axis, at judged_Hz
    ln_current          standard deviation of ln i, up to judged_Hz
    blind_s             after which a stage without a sensor is held at constant voltage
    closest_m           largest approach of a tip to the surface beyond its set point and the step
                        of the surface; a gap is 0.4 to 1 nm wide
    recovery_s          time until the current recovers after the end of a fault
    approach_s          time until the current recovers from 200 nm away, or after a reset
    """

    aligned_percent: _Positive = 1.0
    judged_Hz: _Positive = 10.0
    settling_s: _Positive = 0.05
    overshoot_percent: _Positive = 40.0
    varied_percent: _Positive = 1.0
    fault_percent: _Positive = 15.0
    coupling_percent: _Positive = 1.0
    ln_current: _Positive = 0.5
    blind_s: _Positive = 0.15
    closest_m: _Positive = 4e-10
    recovery_s: _Positive = 1.0
    approach_s: _Positive = 10.0


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A figure and its limit.

    name      of the figure
    scenario  name of the scenario, or ``all``
    value     measured
    limit     largest allowed value
    unit      of value and limit
    """

    name: str
    scenario: str
    value: float
    limit: _Limit
    unit: str

    @property
    def passed(self) -> bool:
        """Whether the value is within its limit."""
        return self.value <= self.limit


def worst_by_name(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """Return the verdict with the largest value of each name, in order of first appearance."""
    worst: dict[str, Verdict] = {}
    for verdict in verdicts:
        if verdict.name not in worst or verdict.value > worst[verdict.name].value:
            worst[verdict.name] = verdict
    return list(worst.values())


def describe_failure(verdict: Verdict) -> str:
    """Describe the measured value and the limit in convenient units."""

    def formatted(number: float) -> str:
        if verdict.unit in ("s", "m"):
            return with_unit(number, verdict.unit)
        if verdict.unit == "1":
            return f"{number:.0f}" if number.is_integer() else significant(number)
        return f"{significant(number)} {verdict.unit}"

    value, limit = formatted(verdict.value), formatted(verdict.limit)
    return f"{verdict.name} ({verdict.scenario}): {value}, allowed {limit}"


def judge(name: str, scenario: str, value: float, limit: float, unit: str) -> Verdict:
    """Compare a measured value with its limit; the arguments are those of ``Verdict``."""
    return Verdict(name=name, scenario=scenario, value=value, limit=limit, unit=unit)


def none_of(name: str, scenario: str, count: int) -> Verdict:
    """Return the verdict on a number of events that must be zero."""
    return judge(name, scenario, float(count), 0.0, "1")


def shape_verdict(
    scenario: str, tracking: Tracking, radius_m: float, limit_percent: float
) -> Verdict:
    """Compare the shape error of a path, in percent of its diameter, with its limit."""
    error_percent = 100.0 * tracking.aligned_rms_m / (2.0 * radius_m)
    return judge(SHAPE_ERROR, scenario, error_percent, limit_percent, "% of the diameter")


def step_verdicts(scenario: str, record: LoopRecord, limits: Limits) -> tuple[Verdict, Verdict]:
    """Compare overshoot and settling time of one axis after its largest step with their limits.

    The last 5 ms before the next step are ignored.
    """
    jumps = np.diff(record.reference)
    start = int(np.abs(jumps).argmax()) + 1
    size = float(jumps[start - 1])
    next_jumps = np.flatnonzero(jumps[start:])
    end = start + int(next_jumps[0]) + 1 if len(next_jumps) else len(jumps) + 1
    end -= int(_BEFORE_NEXT_s * record.sampling_rate_Hz)
    progress = 1.0 + (record.position[start:end] - record.reference[start:end]) / size
    outside = np.flatnonzero(np.abs(progress - 1.0) > _SETTLED)
    settled_s = (int(outside[-1]) + 1 if len(outside) else 0) / record.sampling_rate_Hz
    overshoot = max(100.0 * (float(progress.max()) - 1.0), 0.0)
    names = f"overshoot of axis {record.axis}", f"settling of axis {record.axis} to 2 %"
    return (
        judge(names[0], scenario, overshoot, limits.overshoot_percent, "% of the step"),
        judge(names[1], scenario, settled_s, limits.settling_s, "s"),
    )


def fault_verdicts(
    scenario: str, error_m: Array, healthy: Tracking, radius_m: float, limits: Limits
) -> tuple[Verdict, Verdict]:
    """Compare the error during and after the failure of a sensor with its limits.

    error_m  (samples,)  distance from the path
    healthy  the same path without a fault. The error after the fault is relative to its largest
             error, or to the allowed shape error if that is larger
    """
    baseline_m = max(healthy.max_m, limits.aligned_percent / 100.0 * 2.0 * radius_m)
    largest_percent = 100.0 * float(error_m.max()) / (2.0 * radius_m)
    ratio = float(error_m[-int(_AFTERWARDS * len(error_m)) :].max()) / baseline_m
    name, unit = "largest distance from the path", "% of the diameter"
    return (
        judge(name, scenario, largest_percent, limits.fault_percent, unit),
        judge("error after the fault, ratio to no fault", scenario, ratio, 1.5, "1"),
    )


def current_verdicts(scenario: str, record: LoopRecord, limits: Limits) -> tuple[Verdict, Verdict]:
    """Compare the deviation of ln i of a tunnelling axis, and its retracts, with their limits."""
    deviation = float(np.std(np.log(record.position)))
    retracted = int(np.sum((record.status & Status.RETRACTED) != 0))
    return (
        judge("standard deviation of ln i", scenario, deviation, limits.ln_current, "1"),
        none_of("samples with the tip retracted", scenario, retracted),
    )


def hold_verdicts(
    scenario: str, record: LoopRecord, lost_at: int, limits: Limits
) -> tuple[Verdict, ...]:
    """Compare the time until a stage without a sensor is held, and its motion then, with limits.

    lost_at  sample from which the sensor fails
    """
    is_held = (record.status & np.uint32(Status.BLIND | Status.LATCHED)) > Status.LATCHED
    start = int(np.argmax(is_held)) if is_held.any() else len(is_held)
    changes = int(
        np.count_nonzero(np.diff(record.voltage_V[start:])) + np.count_nonzero(~is_held[start:])
    )
    blind_s = (start - lost_at) / record.sampling_rate_Hz
    return (
        judge(HOLD_TIME, scenario, blind_s, limits.blind_s, "s"),
        none_of("samples that moved while the output was held", scenario, changes),
    )


def limits_from_toml(text: str, source: str = "limits.toml") -> Limits:
    """Return the default limits with replacements from a TOML text.

        aligned_percent = 0.5
        judged_Hz = 20

    Raises ``LabFileError`` as ``limits_from`` does, and for text that is not TOML.
    """
    try:
        table = read_toml(text)
    except ValueError as fault:
        raise _unusable(source, f"not TOML: {fault}", "correct TOML") from fault
    return limits_from(table, source)


def limits_from(table: Mapping[str, object], source: str) -> Limits:
    """Return the default limits with replacements from a table.

    table   values by the names of ``Limits``
    source  name of the table, for the message

    Raises ``LabFileError`` for an unknown name and for a value that is not a positive number.
    """
    try:
        return msgspec.convert(dict(table), Limits)
    except msgspec.ValidationError as fault:
        needed = f"numbers above zero for {', '.join(Limits.__struct_fields__)}"
        raise _unusable(source, str(fault)[:200], needed) from fault


def _unusable(source: str, fault: str, needed: str) -> LabFileError:
    return LabFileError(
        f"{source}: {fault}", needed=needed, remedy=f"Correct {source} and verify again."
    )
