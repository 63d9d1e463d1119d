"""Compare the demo and twenty virtual stages with frozen results, to see what a change changed.

    python -m benchmarks.goldens FOLDER            compare; FOLDER is what `make demo` wrote
    python -m benchmarks.goldens FOLDER --freeze   write benchmarks/goldens.json again

Two readings of each artefact. The digest of its bytes says whether anything at all moved, and
holds on one machine with one set of versions only. The main numbers say what moved and by how
much: they are compared within TOLERANCE, which also absorbs another processor's last digits. Exit
status 1 means that a number moved by more than that, 2 that only bytes did.
"""

import hashlib
import json
import math
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid.identification.fit import fit
from piezoid.identification.store import write_model
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab
from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign
from piezoid_datasets.virtual_lab.effects import EFFECTS
from piezoid_datasets.virtual_lab.truths import ZOO
from piezoid_datasets.virtual_lab.write import campaign_files

FROZEN = Path(__file__).with_suffix(".json")
TOLERANCE = 1e-6  # relative; last digits of another processor moved these numbers by 1e-9 at most
ROWS = 1000  # of each recording, thinned: a stage then takes 3 to 12 s instead of a minute
SKIPPED = ("report.html",)  # words and figures: their own tests
Stage = tuple[int, str | None, str]  # seed, hidden effect, kind of ceramic
PLANS = ("sweep", "check")
FURTHER = {"cross_coupling": "other_axis", "rate_dependence": "rates", "slew_limit": "rates"}
# Every effect of the laboratory and two healthy stages, over the laws in turn.
STAGES: tuple[Stage, ...] = tuple(
    (number, hidden, ZOO[number % len(ZOO)].name)
    for number, hidden in enumerate((None, *(effect.name for effect in EFFECTS), None), start=1)
)
Numbers = dict[str, float | str]
AXIS_NUMBERS = {
    "quality": ("rms_m", "held_out_rms_m", "noise_rms_m"),
    "lag": ("time_s",),
    "certificate": ("remainder_m",),
    "baseline": ("held_out_rms_m",),
    "final": ("held_out_rms_m",),
}


def frozen_of(folder: Path) -> dict[str, dict[str, Any]]:
    """Return digests and main numbers of the demo's folder and of the virtual stages."""
    files = {
        f"demo/{path.relative_to(folder)}": path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in SKIPPED
    }
    for stage in STAGES:
        files |= artefacts_of(stage)
    numbers: Numbers = {}
    for name, content in files.items():
        if name.endswith(".json"):
            numbers |= {
                f"{name}: {key}": value for key, value in main_numbers(json.loads(content))
            }
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    return {"digests": digests, "numbers": numbers}


def artefacts_of(stage: Stage) -> dict[str, bytes]:
    """Fit and diagnose a virtual stage."""
    seed, hidden, truth = stage
    effects = () if hidden is None else (hidden,)
    plans = (*PLANS, *(FURTHER[effect] for effect in effects if effect in FURTHER))
    campaign = draw_campaign(seed, effects=effects, truth=truth, plans=plans)
    with tempfile.TemporaryDirectory() as folder:
        files = write_thinned(campaign, Path(folder))
        lab = read_lab(Path(folder) / "lab.toml")
        recordings = collect(files, lab).recordings
        model = fit(recordings, lab=lab)
        diagnosis = diagnose(recordings, lab=lab, model=next(iter(model.axes.values())))
    return {
        f"stage {seed}/model.json": write_model(model),
        f"stage {seed}/diagnosis.json": write_diagnosis(diagnosis),
    }


def write_thinned(campaign: Campaign, folder: Path) -> list[Path]:
    """Write what the laboratory hands over with about ROWS rows a recording."""
    recordings = []
    for name, content in campaign_files(campaign).items():
        path = folder / Path(name).name
        if path.suffix == ".csv":
            header, *rows = content.splitlines(keepends=True)
            content = header + b"".join(rows[:: max(len(rows) // ROWS, 1)])
            recordings.append(path)
        path.write_bytes(content)
    return recordings


def main_numbers(record: Mapping[str, Any]) -> Iterator[tuple[str, float | str]]:
    """Give what a reader of an artefact looks at first."""
    for axis in axes_in(record):
        name = axis["axis"]
        for group, keys in AXIS_NUMBERS.items():
            yield from (
                (f"{name}.{group}.{key}", axis[group][key]) for key in keys if group in axis
            )
        for finding in axis.get("findings", ()):
            yield f"{name}.{finding['effect']}", finding["size"]["value"]
        for loop in axis.get("loops", ()):
            label = f"{name}.{loop['method']}"
            yield f"{label}.bandwidth_Hz", loop["bandwidth_Hz"]
            yield f"{label}.chosen", next(c["name"] for c in loop["candidates"] if c["is_chosen"])
    for index, verdict in enumerate(record.get("verdicts", ())):
        label = f"verdict {index}, {verdict['name']}, {verdict['scenario']}"
        yield label, str(verdict["passed"])


def axes_in(record: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Give what an artefact says of each axis."""
    if "findings" in record:
        yield record
    axes = record.get("axes", {})
    yield from axes.values() if isinstance(axes, Mapping) else axes


def is_changed(old: float | str | None, new: float | str | None) -> bool:
    """Return whether a number changed by more than the tolerance, or a word at all."""
    if isinstance(old, float) and isinstance(new, float):
        return not math.isclose(old, new, rel_tol=TOLERANCE)
    return old != new


def main(arguments: list[str]) -> int:
    """Compare, or freeze."""
    new = frozen_of(Path(arguments[0]))
    if "--freeze" in arguments:
        FROZEN.write_text(json.dumps(new, indent=1, sort_keys=True) + "\n")
        return 0
    old = json.loads(FROZEN.read_text())
    changes = {
        kind: [name for name in sorted({*old[kind], *new[kind]}) if differ(kind, name, old, new)]
        for kind in ("numbers", "digests")
    }
    for name in changes["numbers"]:
        print(f"{name}: {old['numbers'].get(name)} -> {new['numbers'].get(name)}")
    for name in changes["digests"]:
        print(f"other bytes: {name}")
    print(f"{len(changes['numbers'])} of {len(old['numbers'])} numbers changed,", end=" ")
    print(f"{len(changes['digests'])} of {len(old['digests'])} files have other bytes")
    return 1 if changes["numbers"] else 2 * bool(changes["digests"])


def differ(kind: str, name: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> bool:
    """Return whether an entry differs."""
    return is_changed(old[kind].get(name), new[kind].get(name))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
