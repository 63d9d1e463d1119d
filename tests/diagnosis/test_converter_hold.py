"""A converter with a declared clock holds the drive, unless the recordings show otherwise."""

from collections.abc import Callable

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.selection import search_all
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import SERIAL
from piezoid.operators.filters import later
from piezoid.records.lab import Lab
from piezoid.records.lab_tables import Acquisition
from tests.diagnosis.bench import single_axis_recording, with_fewer_rows
from tests.laws import LAWS

CLOCK_Hz = 1000.0
STROKE_m = 1e-5
NOISE_m = 2e-9
Drive = Callable[[Array], Array]


def generator(field: Array) -> Array:
    """Return a drive that moves linearly between samples."""
    return field


def converter(field: Array) -> Array:
    """Return a drive that is held for one period, which delays it by half a period."""
    return later(field, 0.5)


def view_of_drive(drive: Drive, *, hum: float = 0.0) -> View:
    """Return the view of loops and a fast sine at the clock of the converter.

    hum  of the reading, over the noise
    """
    time_s = np.arange(6000) / CLOCK_Hz
    envelope = 1.0 - 0.15 * time_s
    fields = {
        "loops": envelope * np.cos(2.0 * np.pi * 1.5 * time_s),
        "sine": 0.4 * np.cos(2.0 * np.pi * 40.0 * time_s) * envelope,
    }
    rng, recordings = np.random.default_rng(7), []
    for name, field in fields.items():
        history = np.tile(np.cos(2.0 * np.pi * time_s[:1000]), 2)
        response = LAWS["plays"](np.concatenate([history, drive(field)]))[len(history) :]
        noise = rng.standard_normal(len(field)) + hum * np.sin(100.0 * np.pi * time_s)
        reading_m = STROKE_m * response + NOISE_m * noise
        recordings.append(single_axis_recording(name, CLOCK_Hz, 5.0 * field, reading_m))
    lab = Lab(acquisition=Acquisition(sampling_rate_Hz=CLOCK_Hz))
    return view_on(recordings, axis="x", lab=lab)


@pytest.mark.parametrize("hum", [0.0, 100.0])
@pytest.mark.parametrize(("drive", "is_held"), [(converter, True), (generator, False)])
def test_a_declared_hold_is_kept_only_if_the_recordings_agree(drive, is_held, hum):
    view = view_of_drive(drive, hum=hum)
    assert bool(view.continuous) is is_held
    if not hum:
        assert view.rms < 1.2 * view.noise


@pytest.mark.parametrize("drive", [converter, generator])
def test_no_effect_is_named_for_the_hold(drive):
    outcome = search_all(with_fewer_rows(view_of_drive(drive), 4), SERIAL).outcome
    assert outcome.causes == ()
    assert dict(outcome.faults) == {}
