"""A recorded 3 x 3 mirror: the modal model beats the measured response, and softens with level."""

from pathlib import Path

import numpy as np

from piezoid.identification.dynamics.fit_dynamics import fit_dynamics
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.modal_basis import Declaration, Structure
from piezoid.identification.dynamics.periodic_estimate import PeriodicData, estimate_response

BAND_HZ = (850.0, 1150.0)  # three modes; the whole band is the benchmark's
STRUCTURE = Structure(modes=4, rate_gains=True, direct=True)


def read(folder: Path, level: str) -> PeriodicData:
    axes = ("1", "2", "3")
    return PeriodicData(
        sampling_rate_Hz=6400.0,
        inputs=axes,
        outputs=axes,
        voltage_V=np.load(folder / "steering_mirror" / f"u_{level}_train.npy"),
        displacement_m=np.load(folder / "steering_mirror" / f"y_{level}_train.npy"),
    )


def fit(data: PeriodicData) -> tuple[LinearDynamics, float, float]:
    """Fit on four realisations; relative rms on the other two, of the model and as measured."""
    measured = estimate_response(data.select([0, 1, 2, 3])).band(*BAND_HZ)
    model = fit_dynamics(measured, STRUCTURE, Declaration(hold="band_limited"))
    f = measured.frequency_Hz
    lines = np.round(f * len(data.voltage_V) / data.sampling_rate_Hz).astype(np.int64)
    drive, moved = (s.mean(axis=3) for s in data.select([4, 5]).spectra(lines))
    smooth, rough = (
        float(np.linalg.norm(moved - response @ drive) / np.linalg.norm(moved))
        for response in (model.response_as_measured(f), measured.response)
    )
    return model, smooth, rough


def test_the_model_beats_the_measured_response_and_the_mode_near_1_kilohertz_softens(
    realdata: Path,
) -> None:
    modes_Hz = []
    for level in ("100mV", "300mV"):
        model, smooth, rough = fit(read(realdata, level))
        assert smooth < 0.8 * rough
        modes_Hz.append(model.mode_frequency_Hz[np.abs(model.mode_frequency_Hz - 997).argmin()])
    np.testing.assert_allclose(modes_Hz, [1002.9, 990.5], atol=1.0)


def test_mains_is_found_at_the_low_level_only(realdata: Path) -> None:
    low = estimate_response(read(realdata, "100mV"))
    high = estimate_response(read(realdata, "300mV"))
    hum_Hz = low.frequency_Hz[low.is_interference.any(axis=1)]
    assert {100.0, 150.0, 200.0, 250.0, 300.0, 400.0} <= set(hum_Hz)
    assert high.is_interference.sum() <= 3
