"""What each effect becomes in the model: extensions that begin where a search found them.

A search speaks in half ranges of the drive and half strokes; the model's extensions are in SI.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from piezoid.identification.extensions.amplifier_limits import AmplifierLimits
from piezoid.identification.extensions.creep_ladder import CreepLadder
from piezoid.identification.extensions.cross_axis import CrossAxis
from piezoid.identification.extensions.delay import Delay
from piezoid.identification.extensions.extension import Extension, Where
from piezoid.identification.extensions.first_order_lag import FirstOrderLag
from piezoid.identification.extensions.gain_change import GainChange
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.extensions.mains_lines import MainsLines
from piezoid.identification.extensions.periodic_error import PeriodicError
from piezoid.identification.extensions.rate_dependence import RateDependence
from piezoid.identification.extensions.slew_limit import SlewLimit
from piezoid.identification.extensions.thermal_drift import ThermalDrift
from piezoid.identification.joint.parts import parts_of
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

RUNGS = 8  # of a creep ladder: as many as the runtime has
FASTEST_s = 0.01
LONGER = 10.0  # slowest rung over the longest piece
GAPS = (0.2, 0.5, 0.8)  # of another axis' half range: thresholds of its plays
LINEAR_STRAIN = 1.0  # half strokes: from here on the lag of the walls is as good as linear
SHARES = (0.03, 3.0)  # of the walls' lag: what a search may say where it splits them otherwise
Parameters = Mapping[str, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """One effect as a search left it.

    effect       its name
    parameters   nonlinear ones, by name with unit; drives in half ranges
    coefficient  (columns,)  linear ones
    """

    effect: str
    parameters: Parameters = field(default_factory=dict)
    coefficient: Array = field(default_factory=lambda: np.ones(1))

    @property
    def share(self) -> float:
        """Return the first coefficient, 1 where there is none."""
        return float(self.coefficient[0]) if len(self.coefficient) else 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Setting:
    """What the numbers of a search mean, and the pieces they were found on.

    voltage_V         half the range of the drive: what 1 means
    voltage_offset_V  its middle: what 0 means
    stroke_m          half the stroke
    pieces            in the order of the search's tracks
    recordings        names, in the order in which they were made
    """

    voltage_V: float
    voltage_offset_V: float
    stroke_m: float
    pieces: tuple[Where, ...]
    recordings: tuple[str, ...]

    @property
    def longest_s(self) -> float:
        """Return the duration of the longest piece."""
        return max(piece.samples / piece.rate_Hz for piece in self.pieces)


def setting_of(model: AxisModel, recordings: Sequence[Recording], scales: Parameters) -> Setting:
    """Return the setting of a search on these recordings.

    scales  ``voltage_V``, ``voltage_offset_V`` and ``stroke_m`` of the search's view
    """
    return Setting(
        voltage_V=scales["voltage_V"],
        voltage_offset_V=scales["voltage_offset_V"],
        stroke_m=scales["stroke_m"],
        pieces=tuple(part.where for part in parts_of(model, recordings)),
        recordings=tuple(recording.name for recording in recordings),
    )


def _creep(found: Found, setting: Setting) -> tuple[Extension, ...]:
    first_s = max(found.parameters.get("first_s", 0.0), FASTEST_s)
    longest_s = LONGER * setting.longest_s
    last_s = min(found.parameters.get("last_s", longest_s), longest_s)
    count = int(np.clip(np.ceil(2.0 * np.log10(max(last_s / first_s, 1.0))) + 1.0, 2, RUNGS))
    time_s = np.geomspace(first_s, max(last_s, 1.5 * first_s), count)
    share = np.clip(found.share * np.log10(time_s[1] / time_s[0]), 1e-4, 0.1)
    return (CreepLadder(time_s=tuple(time_s.tolist()), share=(float(share),) * count, even=True),)


def _lag(found: Found, _: Setting) -> tuple[Extension, ...]:
    return (FirstOrderLag(lag_s=max(found.parameters["time_s"], 0.0)),)


def _delay(found: Found, _: Setting) -> tuple[Extension, ...]:
    samples = found.parameters.get("delay_samples", 0.0)
    if samples > 0.0:
        return (Delay(delay_samples=samples),)
    return (Delay(delay_s=max(found.parameters.get("delay_s", 0.0), 0.0)),)


def _resonance(found: Found, _: Setting) -> tuple[Extension, ...]:
    return (
        LinearMode(
            frequency_Hz=found.parameters["frequency_Hz"],
            quality=max(found.parameters["quality"], 0.5),
            participation=float(np.clip(found.share, 0.0, 2.0)),
        ),
    )


def _amplifier_saturation(found: Found, setting: Setting) -> tuple[Extension, ...]:
    level_V = {
        f"{side}_V": setting.voltage_offset_V + setting.voltage_V * found.parameters[side]
        for side in ("low", "high")
        if side in found.parameters
    }
    return (AmplifierLimits(**level_V),)


def _slew_limit(found: Found, setting: Setting) -> tuple[Extension, ...]:
    return (SlewLimit(limit_V_per_s=found.parameters["limit_per_s"] * setting.voltage_V),)


def _rate_dependence(found: Found, setting: Setting) -> tuple[Extension, ...]:
    """A share of the lag is a lag of a shorter time and a smaller strain, where motion is slow."""
    strain, share = found.parameters["strain"], float(np.clip(found.share, *SHARES))
    bends = strain < LINEAR_STRAIN
    return (
        RateDependence(
            time_s=share * found.parameters["time_s"],
            strain_m=share * strain * setting.stroke_m if bends else 0.0,
        ),
    )


def _cross_coupling(_: Found, setting: Setting) -> tuple[Extension, ...]:
    axes = sorted({axis for piece in setting.pieces for axis in piece.others_V})
    return tuple(_answer(axis, setting) for axis in axes)


def _answer(axis: str, setting: Setting) -> Extension:
    drives = [piece.others_V[axis] for piece in setting.pieces if axis in piece.others_V]
    low, high = min(float(u.min()) for u in drives), max(float(u.max()) for u in drives)
    return CrossAxis(
        axis=axis,
        centre_V=(high + low) / 2,
        gain_m_per_V=0.0,
        curvature_m_per_V_per_V=0.0,
        play_threshold_V=tuple(gap * (high - low) / 2 for gap in GAPS),
        play_weight_m_per_V=(0.0,) * len(GAPS),
    )


def _thermal_drift(_: Found, setting: Setting) -> tuple[Extension, ...]:
    return (ThermalDrift.of(setting.pieces),)


def _mains_interference(found: Found, setting: Setting) -> tuple[Extension, ...]:
    return (MainsLines.of(setting.pieces, found.parameters["frequency_Hz"]),)


def _sensor_periodic_error(found: Found, setting: Setting) -> tuple[Extension, ...]:
    wavelength_m = 2.0 * setting.stroke_m / found.parameters["periods"]
    return (PeriodicError(wavelength_m=wavelength_m, cosine_m=(0.0, 0.0), sine_m=(0.0, 0.0)),)


def _gain_change(found: Found, setting: Setting) -> tuple[Extension, ...]:
    piece = setting.pieces[int(found.parameters["track"])]
    instant_s = (piece.first + found.parameters["place"] * piece.samples) / piece.rate_Hz
    after = setting.recordings.index(piece.recording) + 1
    return (
        GainChange(
            recording=piece.recording,
            instant_s=instant_s,
            ratio=float(np.clip(1.0 + found.share, 0.5, 2.0)),
            later=setting.recordings[after:],
        ),
    )


EXTENDERS: Mapping[str, Callable[[Found, Setting], tuple[Extension, ...]]] = {
    "creep": _creep,
    "thermal_drift": _thermal_drift,
    "rate_dependence": _rate_dependence,
    "resonance": _resonance,
    "delay": _delay,
    "lag": _lag,
    "cross_coupling": _cross_coupling,
    "mains_interference": _mains_interference,
    "sensor_periodic_error": _sensor_periodic_error,
    "amplifier_saturation": _amplifier_saturation,
    "slew_limit": _slew_limit,
    "gain_change": _gain_change,
}
