"""Performance losses of the targets against the exported controller, for docs/guide/targets.md.

    python -m benchmarks.target_losses DEMO VIRTUAL...

The stages are folders of `piezoid fit` or `piezoid demo`. The losses are those that each target
states in its README: the worst over the plants that the recordings of the stage allow.
"""

import sys
from pathlib import Path

from piezoid.errors import PiezoidError
from piezoid.targets.targets import inputs_of, target_files
from piezoid_cli.stage_files import StageFolder

TARGETS = ("pid", "nanonis", "waveform")


def losses(folder: Path) -> list[tuple[str, str]]:
    """Return target and statement for every axis of a stage."""
    stage = StageFolder(folder)
    inputs = inputs_of(stage.parameters, stage.model, stage.design, stage.lab)
    rows = []
    for target in TARGETS:
        try:
            _, notes = target_files(inputs, [target])
        except PiezoidError as error:
            notes = (f"refused: {error}",)
        rows += [(target, note) for note in notes if note.startswith(("axis", "refused"))]
    return [
        (name, note) for name, note in rows if " is not in " not in note and " has no " not in note
    ]


def main(folders: list[str]) -> None:
    """Print the table."""
    print("| stage | target | beside the exported controller |\n| --- | --- | --- |")
    for folder in folders:
        for name, note in losses(Path(folder)):
            print(f"| {Path(folder).name} | {name} | {note} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
