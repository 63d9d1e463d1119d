"""Stages whose displacements several drives move by comparable amounts."""

import numpy as np
import pytest

import piezoid
from piezoid.identification.fit import unfitted_stage
from piezoid.numerics.arrays import Array
from piezoid.records.checks.coupled_drives import check_coupled_drives
from piezoid.records.lab import Coupled, Lab
from piezoid.records.recording import Recording
from tests.laws import LAWS
from tests.records.tables import quantities_of, statements_of

RATE_Hz = 2000.0
TIME_s = np.arange(16_000) / RATE_Hz
PERIODS_s = {"x": 1.0, "y": 1.37, "z": 0.71}


def triangle_V(period_s: float) -> Array:
    return np.asarray(5.0 * np.abs((2.0 * TIME_s / period_s) % 2.0 - 1.0))


def ringing(signal: Array, frequency_Hz: float, damping: float) -> Array:
    """Filter a signal by a mode of unit static gain."""
    s = 2j * np.pi * np.fft.rfftfreq(len(signal), 1.0 / RATE_Hz)
    w = 2.0 * np.pi * frequency_Hz
    response = w**2 / (s**2 + 2.0 * damping * w * s + w**2)
    return np.asarray(np.fft.irfft(np.fft.rfft(signal) * response, len(signal)))


def stage(gains: Array, law: str, *, drives_V: dict[str, Array] | None = None) -> Recording:
    """Return a recording of three axes; row i of the gains moves displacement i, in um."""
    rng = np.random.default_rng(4)
    drives_V = drives_V or {axis: triangle_V(period_s) for axis, period_s in PERIODS_s.items()}
    strokes = np.stack([LAWS[law](v / 2.5 - 1.0) for v in drives_V.values()])
    displacement_um = gains @ strokes + 0.005 * rng.standard_normal(strokes.shape)
    return piezoid.from_arrays(
        voltage_V=drives_V,
        displacement_m=dict(zip(drives_V, 1e-6 * displacement_um, strict=True)),
        sampling_rate_Hz=RATE_Hz,
    )


COUPLED = "coupled_drives"


@pytest.mark.parametrize("law", ["preisach", "dahl", "plays"])
def test_only_comparable_gains_are_reported_with_the_line_to_write(law):
    gains = np.array([[8.0, 4.0, -5.0], [4.0, 8.0, 5.0], [4.0, -4.0, 8.0]])
    (statement,) = statements_of(stage(gains, law), COUPLED)
    assert statement.text.endswith('[coupled] axes = ["x", "y", "z"]')
    assert "x by the drive of y 50 %" in statement.text
    assert COUPLED not in quantities_of(stage(8.0 * np.eye(3) + 0.5, law))


def test_a_coupled_pair_is_reported_unless_lab_toml_declares_it():
    gains = np.array([[8.0, 5.0, 0.0], [5.0, 8.0, 0.0], [0.0, 0.0, 8.0]])
    recording = stage(gains, "duhem")
    (statement,) = statements_of(recording, COUPLED)
    assert statement.text.endswith('[coupled] axes = ["x", "y"]')
    assert f"{recording.name}: {statement.text}" in unfitted_stage([recording], Lab()).remarks
    declared = Lab(coupled=Coupled(axes=("x", "y")))
    assert not check_coupled_drives(recording, declared)
    assert not any("[coupled]" in text for text in unfitted_stage([recording], declared).remarks)


def test_proportional_drives_are_not_reported():
    drives_V = {axis: triangle_V(1.0) * gain for axis, gain in (("x", 1.0), ("y", 0.7))}
    recording = stage(np.full((2, 2), 4.0), "plays", drives_V=drives_V)
    assert COUPLED not in quantities_of(recording)


def test_coupling_is_detected_with_modes_and_multisines():
    rng = np.random.default_rng(8)
    drives_V = {axis: np.tile(rng.standard_normal(8000), 2) for axis in "xyz"}
    ringing_V = np.stack([ringing(v, 300.0, 0.02) for v in drives_V.values()])
    for gain, is_coupled in ((0.6, True), (0.05, False)):
        displacement_m = 1e-7 * (np.eye(3) + gain * (1.0 - np.eye(3))) @ ringing_V
        displacement_m += 1e-9 * rng.standard_normal(displacement_m.shape)
        recording = piezoid.from_arrays(
            voltage_V=drives_V,
            displacement_m=dict(zip(drives_V, displacement_m, strict=True)),
            sampling_rate_Hz=RATE_Hz,
        )
        assert (COUPLED in quantities_of(recording)) is is_coupled
