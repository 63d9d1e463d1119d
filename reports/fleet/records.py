"""What is kept of each stage of a batch, and the batch as a whole; both as sealed JSON."""

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from msgspec import ValidationError, convert

from piezoid.errors import ParameterFileError
from piezoid.provenance import seal, unseal

STAGE_SCHEMA = "piezoid.batch_stage/1"
FLEET_SCHEMA = "piezoid.batch/1"

PASSED, FAILED, REFUSED, CRASHED = "passed", "failed", "refused", "crashed"
STATES = {
    PASSED: "every verdict passed",
    FAILED: "a verdict failed, or the model class does not apply",
    REFUSED: "data or file unusable, or no solution",
    CRASHED: "the work broke off; it is tried again at the next start",
}


@dataclass(frozen=True, kw_only=True)
class FleetAxis:
    """One axis of one stage.

    values      what is compared over stages, by the name of the quantity, in its SI unit
    parameters  every number of the model by its name in model.json
    errors      standard errors of values, where the fit knows them
    """

    axis: str
    applies: bool
    values: Mapping[str, float]
    parameters: Mapping[str, float | list[float]]
    errors: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class FleetStage:
    """What became of one stage.

    name     of its folder, from the batch's folder, with /
    state    ``passed``, ``failed``, ``refused`` or ``crashed``
    reason   why it did not pass; empty where it did
    version  of piezoid
    inputs   digest of every file it was made from, by name
    outputs  digest of every sealed file that was written, by name
    """

    name: str
    state: str
    reason: str = ""
    version: str = ""
    inputs: Mapping[str, str] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    axes: tuple[FleetAxis, ...] = ()

    def __post_init__(self) -> None:
        if self.state not in STATES:
            raise ValueError(f"{self.name}: state is {self.state!r}")

    @property
    def serial(self) -> int | None:
        """The last number in the name: stages are numbered as they are made."""
        numbers = re.findall(r"\d+", self.name)
        return int(numbers[-1]) if numbers else None

    def to_json(self) -> bytes:
        """Return the sealed bytes that are kept beside the stage's results."""
        return seal(STAGE_SCHEMA, dataclasses.asdict(self))


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """A whole batch, by name of the stage."""

    name: str
    stages: tuple[FleetStage, ...]

    def of_state(self, state: str) -> tuple[FleetStage, ...]:
        """Return the stages that ended this way."""
        return tuple(stage for stage in self.stages if stage.state == state)

    @property
    def passed(self) -> bool:
        """Whether every stage passed."""
        return len(self.of_state(PASSED)) == len(self.stages)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of all axes of all stages, sorted."""
        return tuple(sorted({axis.axis for stage in self.stages for axis in stage.axes}))

    def to_json(self) -> bytes:
        """Return the sealed bytes of batch.json; all parameters stand in the Parquet file."""
        stages = [_without_parameters(stage) for stage in self.stages]
        return seal(FLEET_SCHEMA, {"name": self.name, "passed": self.passed, "stages": stages})


def _without_parameters(stage: FleetStage) -> dict[str, Any]:
    """Return a stage as a mapping, of which the parameters are never copied."""
    bare = tuple(dataclasses.replace(axis, parameters={}) for axis in stage.axes)
    record = dataclasses.asdict(dataclasses.replace(stage, axes=bare))
    for axis in record["axes"]:
        del axis["parameters"]
    return record


def stage_from_json(content: bytes, place: str) -> FleetStage:
    """Read what is kept of a stage; refuse a changed bit, another schema, a missing entry."""
    record = unseal(content, STAGE_SCHEMA, place)
    try:
        return convert(record, FleetStage)
    except ValidationError as error:
        raise ParameterFileError(
            f"{place}: {type(error).__name__} at {error}",
            needed=f"every entry of schema {STAGE_SCHEMA}, of its own kind",
            remedy="Remove the stage's folder and start the batch again.",
        ) from error
