"""A recorded 3 x 3 mirror: mains interference is visible at small drives."""

from pathlib import Path

import numpy as np

from piezoid.identification.dynamics.frequency_response import PeriodicData, estimate_response


def read(folder: Path, level: str) -> PeriodicData:
    axes = ("1", "2", "3")
    return PeriodicData(
        sampling_rate_Hz=6400.0,
        inputs=axes,
        outputs=axes,
        voltage_V=np.load(folder / "steering_mirror" / f"u_{level}_train.npy"),
        displacement_m=np.load(folder / "steering_mirror" / f"y_{level}_train.npy"),
    )


def test_mains_interference_is_found_at_the_low_level_only(realdata):
    low = estimate_response(read(realdata, "100mV"))
    high = estimate_response(read(realdata, "300mV"))
    hum_Hz = low[0].frequency_Hz[np.any([path.is_interference for path in low], axis=0)]
    assert {100.0, 150.0, 200.0, 250.0, 300.0, 400.0} <= set(hum_Hz)
    assert sum(path.is_interference.sum() for path in high) <= 3
