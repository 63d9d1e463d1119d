"""The verb ``simulate``: recordings of a virtual stage with known effects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from json import loads
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from piezoid.errors import RecordingError
from piezoid.records import lab as laboratory
from piezoid.records.collection import Collection, collect
from piezoid.records.lab import Lab


@dataclass(frozen=True, kw_only=True, eq=False)
class VirtualStage:
    """Recordings of a virtual stage with known effects.

    recordings  of the stage
    lab         declarations of its laboratory
    truth       ``effects`` with their sizes, the noise, and the ceramic
    files       names and contents of the files that ``piezoid simulate`` writes
    """

    recordings: Collection
    lab: Lab
    truth: Mapping[str, Any]
    files: Mapping[str, bytes]


def simulate(
    seed: int = 0,
    *,
    effects: Mapping[str, float | None] | Sequence[str] = (),
    truth: str | None = None,
    drives: Sequence[str] | None = None,
    careless: bool = False,
) -> VirtualStage:
    """Simulate recordings of a virtual stage, which shares no code with the model.

    seed      random seed
    effects   names of effects to add; a mapping gives sizes in percent of the stroke
    truth     type of ceramic; default: random
    drives    names of the drives to record; default: chosen for the effects
    careless  do not cycle the drive before recording, so that the initial state is unknown

    Raises ``RecordingError`` for an unknown name, with the available names.

    >>> stage = simulate(7, effects={"creep": 0.8})
    >>> [effect["effect"] for effect in stage.truth["effects"]]
    ['creep']
    >>> stage.recordings[0].axes
    ('x',)
    """
    sizes = dict(effects) if isinstance(effects, Mapping) else dict.fromkeys(effects)
    campaigns, written = (import_module(f"piezoid_datasets.virtual_lab.{n}") for n in _LABORATORY)
    try:
        campaign = campaigns.draw_campaign(
            seed,
            effects=sizes,
            truth=truth,
            plans=None if drives is None else list(drives),
            careless=careless,
        )
    except ValueError as error:
        raise RecordingError(
            str(error),
            needed="names and sizes of the virtual laboratory",
            remedy="Choose from the names in this message.",
        ) from error
    files: dict[str, bytes] = written.campaign_files(campaign)
    with TemporaryDirectory(prefix="piezoid-") as name:
        paths = {file: Path(name) / Path(file).name for file in files}
        for file, path in paths.items():
            path.write_bytes(files[file])
        lab = laboratory.read_lab(Path(name) / "lab.toml")
        recordings = collect([path for path in paths.values() if path.suffix == ".csv"], lab)
    truth_file = loads(files["truth/truth.json"])
    return VirtualStage(recordings=recordings, lab=lab, truth=truth_file, files=files)


_LABORATORY = ("campaign", "write")
