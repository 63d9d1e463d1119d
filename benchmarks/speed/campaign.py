"""Campaigns to time whole stages on: the bundled axis, or one made of any length and number."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import piezoid_datasets
from piezoid.records.collection import collect
from piezoid.records.lab import Lab, read_lab
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid_datasets.virtual_lab import bundled, drives
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.stage import Run, record

AXIS = "x"
RATE_Hz = 500.0
CYCLES = 8.0
MOVES = 24


@dataclass(frozen=True, kw_only=True, eq=False)
class Campaign:
    """Recordings of one axis, and what its laboratory declares."""

    recordings: Sequence[Recording]
    lab: Lab

    @property
    def samples(self) -> int:
        """Samples of all recordings together."""
        return sum(one.samples for one in self.recordings)


def bundled_axis() -> Campaign:
    """Return the bundled recordings of the first axis."""
    lab = read_lab(piezoid_datasets.LAB)
    files = [place for place in piezoid_datasets.recordings() if place.name.startswith(AXIS)]
    return Campaign(recordings=collect(files, lab).recordings, lab=lab)


def made(samples: int, recordings: int) -> Campaign:
    """Return so many recordings of so many samples of the stage the bundled ones are of.

    The same loops whatever the length: a longer recording is a slower one. Sweeps and random
    levels in turn.
    """
    shapes = (_sweep(samples) if k % 2 == 0 else _levels(samples, k) for k in range(recordings))
    made_ones = tuple(_recording(k, shape[:samples]) for k, shape in enumerate(shapes))
    return Campaign(recordings=made_ones, lab=read_lab(piezoid_datasets.LAB))


def _sweep(samples: int) -> Array:
    frequency_Hz = (CYCLES + 0.5) * RATE_Hz / samples
    return drives.decaying_sweep(RATE_Hz, frequency_Hz, int(CYCLES))


def _levels(samples: int, number: int) -> Array:
    move_s = samples / RATE_Hz / MOVES
    return drives.random_levels(RATE_Hz, move_s, MOVES, np.random.default_rng(number))


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
    read: Mapping[Quantity, Array] = {
        Quantity.VOLTAGE: rows.voltage_V,
        Quantity.DISPLACEMENT: rows.displacement_m,
    }
    return Recording(
        name=run.name,
        digest=run.name,
        axis=AXIS,
        sampling_rate_Hz=RATE_Hz,
        channels=tuple(
            Channel(quantity=quantity, axis=AXIS, values=values, label=quantity.name.lower())
            for quantity, values in read.items()
        ),
    )
