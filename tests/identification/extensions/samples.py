"""One extension of every kind with realistic parameters."""

import numpy as np

from piezoid.identification.extensions import (
    AmplifierLimits,
    ConverterHold,
    CreepLadder,
    CrossAxis,
    Delay,
    FirstOrderLag,
    GainChange,
    LinearMode,
    MainsLines,
    PeriodicError,
    RateDependence,
    SlewLimit,
    ThermalDrift,
)
from piezoid.identification.extensions.extension import Extension, Where
from piezoid.identification.extensions.periodic_error import Phase

RATE_Hz = 1000.0


def where(samples: int = 8000, recording: str = "sweep.csv", first: int = 0) -> Where:
    other_V = 5.0 + 4.0 * np.sin(2 * np.pi * 0.5 * np.arange(samples) / RATE_Hz)
    return Where(
        recording=recording, rate_Hz=RATE_Hz, first=first, samples=samples, others_V={"y": other_V}
    )


def one_of_each() -> tuple[Extension, ...]:
    drift, mains = ThermalDrift.of([where()]), MainsLines.of([where()], 50.0)
    rng = np.random.default_rng(0)
    return (
        SlewLimit(limit_V_per_s=123.4),
        AmplifierLimits(low_V=None, high_V=9.5),
        RateDependence(time_s=1e-3, strain_m=2e-7),
        CreepLadder(time_s=(0.1, 1.0, 10.0), share=(0.01, 0.0, 0.02)),
        GainChange(
            recording="sweep.csv", instant_s=4.0, ratio=1.03, offset_m=1e-8, later=("b.csv",)
        ),
        LinearMode(frequency_Hz=80.0, quality=20.0, participation=0.7),
        FirstOrderLag(lag_s=2e-3),
        Delay(delay_s=1.3e-3),
        ConverterHold(hold_s=2.5e-4),
        CrossAxis(
            axis="y",
            centre_V=5.0,
            reach_V=4.0,
            gain_m_per_V=1e-8,
            curvature_m_per_V_per_V=1e-10,
            play_threshold_V=(1.0, 2.0),
            play_weight_m_per_V=(2e-9, 1e-9),
        ),
        drift.moved_to(1e-8 * rng.standard_normal(len(drift.free().value))),
        mains.moved_to(1e-8 * rng.standard_normal(len(mains.free().value))),
        PeriodicError(
            wavelength_m=6e-7,
            cosine_m=(2e-9, 5e-10),
            sine_m=(1e-9, 0.0),
            phases=(Phase(recording="other.csv", angle=0.5),),
        ),
    )
