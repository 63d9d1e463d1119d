"""Records of a stage of a batch and of the whole batch, as sealed JSON.

A batch may have more stages than memory holds: ``StagesOnDisk`` gives them one at a time.
"""

import dataclasses
import os
import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import BinaryIO, Protocol, Self
from zlib import compress, decompress

from msgspec import ValidationError, convert, json, msgpack

from piezoid.digests import seal, seal_stream, unseal
from piezoid.errors import ParameterFileError

STAGE_SCHEMA = "piezoid.batch_stage/1"
FLEET_SCHEMA = "piezoid.batch/1"
STAGES = "stages"  # folder of the stages beside the page

PASSED, FAILED, REFUSED, CRASHED = "passed", "failed", "refused", "crashed"
STATES = {
    PASSED: "no verdict failed",
    FAILED: "a verdict failed, or the model class does not apply",
    REFUSED: "data or file unusable, or no solution",
    CRASHED: "the work failed or its worker died; the next start tries it again",
}


@dataclass(frozen=True, kw_only=True)
class FleetAxis:
    """One axis of one stage.

    values      compared over stages, by the name of the quantity, in its SI unit
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
    """Result of one stage.

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
    def has_controller(self) -> bool:
        """Whether a controller was exported."""
        return "params.json" in self.outputs

    @property
    def serial(self) -> int | None:
        """The last number in the name: stages are numbered as they are made."""
        numbers = re.findall(r"\d+", self.name)
        return int(numbers[-1]) if numbers else None

    def to_json(self) -> bytes:
        """Return the sealed bytes that are kept beside the stage's results."""
        return seal(STAGE_SCHEMA, dataclasses.asdict(self))

    def packed(self) -> bytes:
        """Return the record as it travels from a worker: about 1 kB for an axis."""
        return compress(msgpack.encode(self), level=1)


class Stages(Protocol):
    """Stages in the order of their names, as often as they are asked for."""

    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[FleetStage]: ...


class StagesOnDisk:
    """Stages by name, read back one at a time from an unnamed scratch file.

    Of each, memory holds its name and its place: about 200 bytes. The file is gone at the end of
    the ``with`` block.
    """

    def __init__(self) -> None:
        """Begin with none."""
        self._scratch = tempfile.TemporaryFile()  # noqa: SIM115 -- __exit__ closes it
        self.size = 0  # bytes
        self._places: dict[str, tuple[int, int]] = {}
        self._decoder = msgpack.Decoder(FleetStage)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the file."""
        self._scratch.close()

    def add(self, name: str, packed: bytes) -> None:
        """Add the result of ``FleetStage.packed``; it replaces an earlier one of that name."""
        self._scratch.write(packed)
        self._places[name] = self.size, len(packed)
        self.size += len(packed)

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._places)

    def __iter__(self) -> Iterator[FleetStage]:
        """Yield them in the order of their names."""
        self._scratch.flush()
        for _, (offset, size) in sorted(self._places.items()):
            content = os.pread(self._scratch.fileno(), size, offset)
            yield self._decoder.decode(decompress(content))


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """A whole batch, by name of the stage; its stages may lie on disk."""

    name: str
    stages: Stages

    @cached_property
    def counts(self) -> Mapping[str, int]:
        """How many stages ended in which state."""
        return Counter(stage.state for stage in self.stages)

    @property
    def passed(self) -> bool:
        """Whether every stage passed."""
        return self.counts.get(PASSED, 0) == len(self.stages)

    @cached_property
    def without_controller(self) -> int:
        """How many stages passed although no controller was exported: none was asked for."""
        return sum(s.state == PASSED and not s.has_controller for s in self.stages)

    def write_json(self, stream: BinaryIO) -> None:
        """Write the sealed batch.json, a stage a line; all parameters stand in the Parquet file.

        stream  can be read and written at any place
        """
        head = {"name": self.name, "passed": self.passed, "stages": []}
        fields = [field.name for field in dataclasses.fields(FleetStage)]
        of_axis = ("axis", "applies", "values", "errors")
        lines = (
            json.encode(
                {name: getattr(stage, name) for name in fields}
                | {"axes": [{name: getattr(a, name) for name in of_axis} for a in stage.axes]}
            )
            for stage in self.stages
        )
        seal_stream(FLEET_SCHEMA, head, lines, stream)


def stage_from_json(content: bytes, source: str) -> FleetStage:
    """Read the record of a stage; refuse a changed bit, another schema, a missing entry."""
    record = unseal(content, STAGE_SCHEMA, source)
    try:
        return convert(record, FleetStage)
    except ValidationError as error:
        raise ParameterFileError(
            f"{source}: {type(error).__name__} at {error}",
            needed=f"every entry of schema {STAGE_SCHEMA}, of its own kind",
            remedy="Remove the stage's folder and start the batch again.",
        ) from error
