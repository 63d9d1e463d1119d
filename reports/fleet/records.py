"""Records of a stage of a batch and of the batch, as sealed JSON.

A batch may have more stages than fit into memory: ``StagesOnDisk`` reads them one at a time.
"""

import dataclasses
import os
import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import BinaryIO, Self
from zlib import compress, decompress

from msgspec import convert, json, msgpack

from piezoid.digests import seal, seal_stream, unseal
from piezoid.record_json import refusing

STAGE_SCHEMA = "piezoid.batch_stage/1"
FLEET_SCHEMA = "piezoid.batch/1"
STAGES = "stages"  # folder of the stages, next to the page

PASSED, FAILED, REFUSED, CRASHED = "passed", "failed", "refused", "crashed"
STATES = {
    PASSED: "no verdict failed",
    FAILED: "a verdict failed, or the model class does not apply",
    REFUSED: "data or file unusable, or no solution",
    CRASHED: "internal error, or the worker process died; the next run tries it again",
}


@dataclass(frozen=True, kw_only=True)
class FleetAxis:
    """One axis of one stage.

    values      compared quantities by name, in SI units
    parameters  every number of the model by its name in model.json
    errors      standard errors of the values, if known
    """

    axis: str
    applies: bool
    values: Mapping[str, float]
    parameters: Mapping[str, float | list[float]]
    errors: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class FleetStage:
    """Result of one stage.

    name     path of its folder relative to the folder of the batch, with /
    state    ``passed``, ``failed``, ``refused`` or ``crashed``
    reason   why the stage did not pass, or empty
    version  of piezoid
    inputs   digest of every input file by name
    outputs  digest of every sealed output file by name
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
        """Serial number: the last number in the name."""
        numbers = re.findall(r"\d+", self.name)
        return int(numbers[-1]) if numbers else None

    def to_json(self) -> bytes:
        """Return the sealed record, which is saved next to the results of the stage."""
        return seal(STAGE_SCHEMA, dataclasses.asdict(self))

    def packed(self) -> bytes:
        """Return the compressed record that a worker sends: about 1 kB per axis."""
        return compress(msgpack.encode(self), level=1)


class StagesOnDisk:
    """Stages by name, read one at a time from an unnamed temporary file.

    Memory holds the name and the offset of each stage: about 200 bytes. The file is deleted at
    the end of the ``with`` block.
    """

    def __init__(self) -> None:
        """Create an empty collection."""
        self._scratch = tempfile.TemporaryFile()  # noqa: SIM115 -- __exit__ closes it
        self.size = 0  # bytes
        self._extents: dict[str, tuple[int, int]] = {}
        self._decoder = msgpack.Decoder(FleetStage)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Delete the file."""
        self._scratch.close()

    def add(self, name: str, packed: bytes) -> None:
        """Add the result of ``FleetStage.packed``, replacing an earlier result of that name."""
        self._scratch.write(packed)
        self._extents[name] = self.size, len(packed)
        self.size += len(packed)

    def __len__(self) -> int:
        """Return the number of stages."""
        return len(self._extents)

    def __iter__(self) -> Iterator[FleetStage]:
        """Yield the stages in the order of their names."""
        self._scratch.flush()
        for _, (offset, size) in sorted(self._extents.items()):
            content = os.pread(self._scratch.fileno(), size, offset)
            yield self._decoder.decode(decompress(content))


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """Results of a batch; its stages, in the order of their names, may be on disk."""

    name: str
    stages: Sequence[FleetStage] | StagesOnDisk

    @cached_property
    def counts(self) -> Mapping[str, int]:
        """Number of stages by state."""
        return Counter(stage.state for stage in self.stages)

    @property
    def passed(self) -> bool:
        """Whether every stage passed."""
        return self.counts.get(PASSED, 0) == len(self.stages)

    @cached_property
    def without_controller(self) -> int:
        """Number of stages that passed without a controller, because none was requested."""
        return sum(s.state == PASSED and "params.json" not in s.outputs for s in self.stages)

    def write_json(self, stream: BinaryIO) -> None:
        """Write the sealed batch.json, one stage per line; parameters are in the Parquet file.

        stream  readable, writable and seekable
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
    """Read the record of a stage; reject a wrong digest, another schema, or a missing entry."""
    record = unseal(content, STAGE_SCHEMA, source)
    remedy = "Delete the folder of the stage and run the batch again."
    with refusing(STAGE_SCHEMA, source, remedy=remedy):
        return convert(record, FleetStage)
