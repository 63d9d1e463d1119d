"""A constructed model of a stage and its recordings, so that pages need no fit."""

import numpy as np

from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.hysteresis.pieces import PieceStart, Rig
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.quality import Certificate, FitQuality, Order, Uncertainty, Verdict
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from piezoid.records.recording import Channel, Quantity, Recording

RATE_Hz = 500.0
NOISE_m = 5e-9
BREAK = 1500
ZERO_m = (2e-6, 2.1e-6, 1.9e-6)

HYSTERESIS = ModifiedPrandtlIshlinskii(
    plays=PrandtlIshlinskii(
        threshold=np.array([0.0, 0.8, 2.1]), weight=np.array([2e-6, 4e-7, 5e-7])
    ),
    dead_zones=DeadZones(
        threshold=np.array([-4e-6, 0.0, 5e-6]), weight=np.array([-0.05, 1.0, 0.04])
    ),
    voltage_offset_V=5.0,
    displacement_offset_m=2e-6,
)
NAMES = (
    *(f"play_threshold_V[{i}]" for i in (1, 2)),
    *(f"play_weight_m_per_V[{i}]" for i in (0, 1, 2)),
    *(f"dead_zone_threshold_m[{j}]" for j in range(3)),
    *(f"dead_zone_weight[{j}]" for j in range(3)),
    "lag_s",
)
VALUES = (0.8, 2.1, 2e-6, 4e-7, 5e-7, -4e-6, 0.0, 5e-6, -0.05, 1.0, 0.04, 0.0)


CERTIFICATE = Certificate(
    plays_m=3e-8, dead_zones_m=2e-8, remainder_m=9e-8, found_m=1e-8, reach_V=5.0, slew_V_per_s=40.0
)
QUALITY = FitQuality(
    rms_m=6e-9,
    held_out_rms_m=3e-8,
    held_out_kind="other recordings",
    range_m=2.4e-5,
    noise_rms_m=NOISE_m,
    rows=3000,
    kkt_gap=1e-9,
    gradient=1e-6,
    converged=True,
    orders=(
        Order(plays=1, dead_zones=0, bends=0, lag="delay", held_out_rms_m=9e-8),
        Order(plays=2, dead_zones=2, bends=0, lag="delay", held_out_rms_m=3e-8),
    ),
)


def axis_model(
    axis: str = "x", recordings: tuple[str, ...] = ("sweep.csv",), *, reason: str = ""
) -> AxisModel:
    """Return the axis; each recording has a break and so two starts."""
    return AxisModel(
        axis=axis,
        hysteresis=HYSTERESIS,
        polarity=1,
        lag=Lag(kind="none", time_s=0.0),
        rig=Rig(),
        starts=tuple(start for name in recordings for start in starts(name)),
        voltage_V=(0.0, 10.0),
        verdict=Verdict(applies=not reason, reason=reason, remarks=("A remark of the fit.",)),
        quality=QUALITY,
        uncertainty=_uncertainty(),
        certificate=CERTIFICATE,
    )


def _uncertainty() -> Uncertainty:
    half = np.array([1e-2 * abs(value) for value in VALUES])
    reach_V = np.linspace(0.0, 5.0, 41)
    loading_m = HYSTERESIS.plays.loading_curve(reach_V)
    return Uncertainty(
        blocks=24,
        names=NAMES,
        values=np.array(VALUES),
        covariance=np.diag(half**2),
        upper_limit={"play_weight_m_per_V[2]": 3e-8},
        reach_V=reach_V,
        loading_m=loading_m,
        loading_half_m=0.01 * loading_m,
        loop_width_m=(1.6e-6, 4e-8),
    )


def starts(recording: str) -> tuple[PieceStart, PieceStart]:
    """Return the starts of the two pieces of a recording."""
    return (
        PieceStart(
            recording=recording,
            memory_V=np.array([-5.0, -4.2, -2.9]),
            zero_m=np.array(ZERO_m),
            first=0,
            last=BREAK,
        ),
        PieceStart(
            recording=recording,
            memory_V=HYSTERESIS.virgin_memory(),
            zero_m=np.array([3e-6]),
            first=100,
            last=BREAK,
        ),
    )


def drive_V(samples: int) -> Array:
    """Return a drive of decaying cycles from 0 V, within 0 and 10 V."""
    time_s = np.arange(samples) / RATE_Hz
    return np.asarray(5.0 - 5.0 * np.exp(-0.1 * time_s) * np.cos(2 * np.pi * time_s))


def recording(
    name: str = "sweep.csv", axis: str = "x", *, noise_m: float = NOISE_m, label: str = "U"
) -> Recording:
    """Return a recording of the stage with white sensor noise and a break in the middle."""
    voltage_V = np.concatenate([drive_V(BREAK), 5.0 - (drive_V(BREAK) - 5.0) * 0.6])
    first, second = starts(name)
    zero_m = np.interp(np.arange(BREAK), [0, (BREAK - 1) / 2, BREAK - 1], ZERO_m)
    parts = [
        HYSTERESIS.run(voltage_V[:BREAK], first.memory_V)[0] - 2e-6 + zero_m,
        HYSTERESIS.run(voltage_V[BREAK:], second.memory_V)[0] - 2e-6 + 3e-6,
    ]
    noise = np.random.default_rng(7).normal(scale=noise_m, size=2 * BREAK)
    return Recording(
        name=name,
        digest="sha256:" + "0" * 64,
        axis=axis,
        sampling_rate_Hz=RATE_Hz,
        channels=(
            Channel(quantity=Quantity.VOLTAGE, axis=axis, values=voltage_V, label=label),
            Channel(
                quantity=Quantity.DISPLACEMENT,
                axis=axis,
                values=np.concatenate(parts) + noise,
                label="y",
            ),
        ),
        breaks=(BREAK,),
    )


def stage_model(*axes: AxisModel, stage: str = "bench") -> ActuatorModel:
    """Return a stage of these axes."""
    return ActuatorModel(
        stage=stage,
        axes={axis.axis: axis for axis in axes},
        sources={start.recording: "sha256:" + "0" * 64 for axis in axes for start in axis.starts},
    )
