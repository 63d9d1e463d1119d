"""Campaigns for timing: the bundled axis, or simulated recordings of any length and number."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import piezoid_datasets
from benchmarks.recordings import recording_of
from piezoid.records.collection import collect
from piezoid.records.lab import Lab, read_lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab import bundled, drives
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.stage import Run, record

AXIS = "x"
RATE_Hz = 500.0
CYCLES = 8.0
MOVES = 24


@dataclass(frozen=True, kw_only=True, eq=False)
class Campaign:
    """Recordings of one axis and their lab.toml."""

    recordings: Sequence[Recording]
    lab: Lab

    @property
    def samples(self) -> int:
        """Samples of all recordings."""
        return sum(recording.samples for recording in self.recordings)


def bundled_axis() -> Campaign:
    """Return the bundled recordings of the first axis."""
    lab = read_lab(piezoid_datasets.LAB)
    files = [path for path in piezoid_datasets.recordings() if path.name.startswith(AXIS)]
    return Campaign(recordings=collect(files, lab).recordings, lab=lab)


def make_campaign(samples: int, recordings: int) -> Campaign:
    """Simulate recordings of the bundled stage, alternately sweeps and random levels.

    The loops do not depend on the length, so a longer recording is a slower one.
    """
    shapes = []
    for k in range(recordings):
        if k % 2 == 0:
            frequency_Hz = (CYCLES + 0.5) * RATE_Hz / samples
            shapes.append(drives.decaying_sweep(RATE_Hz, frequency_Hz, int(CYCLES)))
        else:
            move_s, rng = samples / RATE_Hz / MOVES, np.random.default_rng(k)
            shapes.append(drives.random_levels(RATE_Hz, move_s, MOVES, rng))
    return Campaign(
        recordings=tuple(_recording(k, shape[:samples]) for k, shape in enumerate(shapes)),
        lab=read_lab(piezoid_datasets.LAB),
    )


def _recording(number: int, shape: Array) -> Recording:
    rig = bundled.RIG
    volts = rig.drive_min_V + 0.5 * (shape + 1.0) * (rig.drive_max_V - rig.drive_min_V)
    run = Run(
        name=f"made_{number}",
        sampling_rate_Hz=RATE_Hz,
        command_V=volts,
        history_V=np.array([rig.drive_max_V, rig.drive_min_V] * 2),
    )
    rows = record(bundled.stage(), run, number)
    return recording_of(rows.voltage_V, rows.displacement_m, RATE_Hz, run.name)
