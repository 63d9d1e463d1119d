"""A tunnelling tip over several spots: closed loops with a dither, a Z spectroscopy, the truth.

    recordings/  loop_1.csv ..., spectroscopy.dat, lab.toml
    truth/       truth.json: barriers, electronics and disturbances of every spot

The spots differ in barrier and disturbances, but have the same electronics.
"""

import json
import math
from dataclasses import asdict, dataclass, replace
from zlib import crc32

import numpy as np

from piezoid_datasets.virtual_lab.junction import (
    Junction,
    JunctionRecord,
    multisine,
    simulate_junctions,
)
from piezoid_datasets.virtual_lab.signals import Array

SCHEMA = "piezoid.junction_truth/1"
SPOTS = 3
PERIOD_SAMPLES = 2000
FEWEST_PERIODS = 12  # with fewer periods, the noise hides the dither
MAINS_FREE = [n for n in range(1, 400, 2) if (10 * n) % 50 and (10 * n) % 60]  # of 10 Hz
DITHER_NEPERS = 0.15
AMPLIFIER_GAIN_V_per_V = 15.0
SPREAD = 0.05  # of the barrier from spot to spot
CEILING_SHARE = 0.9  # of the current at which the converter saturates
# Of the spectroscopy:
_POINTS = 200
_TRAVEL_DECAYS = 12.0  # e-folds of the current: from the set point to below the noise
_READING_s = 10e-3
_ELECTRON_C = 1.602176634e-19
_BOLTZMANN_J_PER_K = 1.380649e-23
_ROOM_K = 293.0
_JITTER_m = 0.3e-12  # of the gap, averaged over a reading
_BIAS_V = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Spectroscopy:
    """One sweep of a junction in each direction: current over height.

    height_m     (points,)  increases when the tip retracts
    forward_A    (points,)
    backward_A   (points,)
    offset_A     of the amplifier, in both directions
    shift_m      of the backward curve towards larger heights
    """

    height_m: Array
    forward_A: Array
    backward_A: Array
    offset_A: float
    shift_m: float

    def text(self) -> str:
        """Return the text of a Nanonis file."""
        rows = np.column_stack([self.height_m, self.forward_A, self.backward_A])
        lines = ["\t".join(f"{value:.9e}" for value in row) for row in rows]
        return (
            f"Experiment\tZ spectroscopy\t\nBias>Bias (V)\t{_BIAS_V:g}\t\n\n[DATA]\n"
            "Z rel (m)\tCurrent (A)\tCurrent [bwd] (A)\n" + "\n".join(lines) + "\n"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class JunctionCampaign:
    """Recordings of one tip, with the true parameters of its junctions.

    junctions     (spots)  the truth
    records       (spots)  closed loops
    spectroscopy  over the first spot
    """

    seed: int
    junctions: tuple[Junction, ...]
    records: tuple[JunctionRecord, ...]
    spectroscopy: Spectroscopy


def draw_junction_campaign(seed: int, *, seconds: float) -> JunctionCampaign:
    """Draw a tip and its electronics, and record every spot; same arguments, same bytes.

    seconds  of every closed loop, at least 1.2; rounded down to dither periods of 0.1 s

    Raises ``ValueError`` for less.
    """
    rng = np.random.default_rng([seed, crc32(b"junction")])
    barrier_eV = rng.uniform(1.5, 5.0)
    rig = Junction(
        sensor_pole_Hz=rng.uniform(5000.0, 9000.0),
        latency_s=rng.uniform(15e-6, 45e-6),
        drive_range_V=float(rng.choice([1.0, 10.0])),
        mains_Hz=float(rng.choice([50.0, 60.0])),
    )
    junctions = tuple(
        replace(
            rig,
            barrier_eV=barrier_eV * math.exp(SPREAD * rng.standard_normal()),
            drift_m_per_s=rng.uniform(-50e-12, 50e-12),
            flicker_m=rng.uniform(1e-12, 3e-12),
        )
        for _ in range(SPOTS)
    )
    rate_Hz = junctions[0].sampling_rate_Hz
    periods = math.floor(seconds * rate_Hz / PERIOD_SAMPLES + 1e-9)
    if periods < FEWEST_PERIODS:
        least_s = FEWEST_PERIODS * PERIOD_SAMPLES / rate_Hz
        raise ValueError(f"{seconds:g} s of a closed loop is too short, at least {least_s:g} s")
    # One more sample, because differences need one: all periods remain complete.
    dither = multisine(PERIOD_SAMPLES, periods + 1, lines=MAINS_FREE, rms=DITHER_NEPERS, rng=rng)
    records = simulate_junctions(
        junctions,
        reference_nepers=dither[: periods * PERIOD_SAMPLES + 1],
        seeds=[crc32(f"{seed} spot {n}".encode()) for n in range(SPOTS)],
    )
    return JunctionCampaign(
        seed=seed,
        junctions=junctions,
        records=records,
        spectroscopy=draw_spectroscopy(junctions[0], rng),
    )


def draw_spectroscopy(junction: Junction, rng: np.random.Generator) -> Spectroscopy:
    """Simulate a sweep of a junction from its set point outwards and back, without feedback.

    The currents include shot and Johnson noise averaged over each reading, an offset of the
    amplifier, and a shift of the height.
    """
    height_m = np.linspace(0.0, _TRAVEL_DECAYS / junction.decay_per_m, _POINTS)
    offset_A, shift_m = float(rng.normal(0.0, 2e-14)), float(rng.normal(0.0, 3e-12))
    band_Hz = 0.5 / _READING_s
    thermal = 4.0 * _BOLTZMANN_J_PER_K * _ROOM_K * band_Hz / junction.current_gain_V_per_A
    currents_A = []
    for distance_m in (height_m, height_m - shift_m):
        gap_m = distance_m + _JITTER_m * rng.standard_normal(_POINTS)
        current_A = junction.set_point_A * np.exp(-junction.decay_per_m * gap_m)
        noise_A = np.sqrt(2.0 * _ELECTRON_C * current_A * band_Hz + thermal)
        currents_A.append(current_A + noise_A * rng.standard_normal(_POINTS) + offset_A)
    return Spectroscopy(
        height_m=height_m,
        forward_A=currents_A[0],
        backward_A=currents_A[1],
        offset_A=offset_A,
        shift_m=shift_m,
    )


def junction_files(campaign: JunctionCampaign) -> dict[str, bytes]:
    """Return the contents of the files of a campaign by relative path."""
    files = {}
    for n, record in enumerate(campaign.records):
        columns = (record.drive_V, 1e9 * record.current_A, record.reference_nepers)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        interval_s = 1.0 / record.sampling_rate_Hz
        lines = [  # seven decimals resolve the steps of the drive
            f"{k * interval_s:.5f},{u:.7f},{i:.6f},{r:.7f}" for k, (u, i, r) in enumerate(rows)
        ]
        text = "\n".join(["time [s],drive [V],current [nA],dither of ln set point", *lines])
        files[f"recordings/{name_of(n)}"] = f"{text}\n".encode()
    files["recordings/spectroscopy.dat"] = campaign.spectroscopy.text().encode()
    files["recordings/lab.toml"] = _lab_toml(campaign).encode()
    truth = {
        "schema": SCHEMA,
        "seed": campaign.seed,
        "junctions": {
            name_of(n): {
                **asdict(junction),
                "gain_nepers_per_V": junction.decay_per_m * junction.drive_gain_m_per_V,
            }
            for n, junction in enumerate(campaign.junctions)
        },
        "spectroscopy": {
            "barrier_eV": campaign.junctions[0].barrier_eV,
            "decay_per_m": campaign.junctions[0].decay_per_m,
            "offset_A": campaign.spectroscopy.offset_A,
            "shift_m": campaign.spectroscopy.shift_m,
        },
    }
    files["truth/truth.json"] = f"{json.dumps(truth, indent=1, allow_nan=False)}\n".encode()
    return files


def name_of(spot: int) -> str:
    """Return the file name of the closed loop of a spot, counted from 0."""
    return f"loop_{spot + 1}.csv"


def _lab_toml(campaign: JunctionCampaign) -> str:
    """Return the declarations of the owner, without barrier, disturbances and latency."""
    junction = campaign.junctions[0]
    actuator = junction.drive_gain_m_per_V / AMPLIFIER_GAIN_V_per_V
    ceiling_A = CEILING_SHARE * junction.input_range_V / junction.current_gain_V_per_A
    text = f"""[rig]
name = "virtual tip {campaign.seed}"

[acquisition]
sampling_rate_Hz = {junction.sampling_rate_Hz:g}
dac_bits = 16
adc_bits = 16
input_range_V = [{-junction.drive_range_V:g}, {junction.drive_range_V:g}]

[tunnelling]
set_point_A = {junction.set_point_A:g}
floor_A = {junction.lost_below_A:g}
ceiling_A = {ceiling_A:g}
feedback_ohm = {junction.current_gain_V_per_A:g}

[axis.z.amplifier]
gain_V_per_V = {AMPLIFIER_GAIN_V_per_V:g}
bandwidth_Hz = {junction.amplifier_pole_Hz:g}

[axis.z.actuator]
gain_m_per_V = {actuator:g}
"""
    columns = 'voltage = "drive [V]", current = "current [nA]", reference = 4'
    for spot in range(len(campaign.records)):
        text += f"""
[[recording]]
file = "{name_of(spot)}"
axis = "z"
columns = {{ time = "time [s]", {columns} }}
"""
    return text
