"""Effects outside the catalogue of the diagnosis.

Each is one act in the chain, with the coordinate along which it is systematic. They test whether
a diagnosis reports an unexplained residual, and along which coordinate.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid_datasets.virtual_lab.effects.effect import Act, Place, Scene
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.signals import Array, first_order

GRID_Hz = 50.0
AWAY_Hz = 4.0  # minimum distance from every harmonic of the mains


@dataclass(frozen=True, kw_only=True)
class Uncatalogued:
    """One effect outside the catalogue.

    name         of the effect
    coordinates  along which it is systematic, the most accurate first
    act          (size_m, rig, rng) -> act in the chain; the size is its rms or peak
    plans        recordings that show it
    """

    name: str
    coordinates: tuple[str, ...]
    act: Callable[[float, Rig, np.random.Generator], Act]
    plans: tuple[str, ...] = ("sweep", "check", "rates")


def _sensed(name: str, change: Callable[[Array, Scene], Array]) -> Act:
    """Return an act on the reading before the converter."""

    def sensed(reading_m: Array, scene: Scene, _: np.random.Generator) -> Array:
        return np.asarray(change(reading_m, scene))

    return Act(name=name, place=Place.SENSOR, change=sensed)


def _turns(scene: Scene) -> NDArray[np.int_]:
    """Return the sample indices at which the field turns."""
    step = np.sign(np.diff(scene.field))
    moving = np.flatnonzero(step)
    return moving[np.flatnonzero(np.diff(step[moving])) + 1]


def _tone(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A pump, fan or chopper: a line at a fixed frequency away from the mains harmonics; rms."""
    tried = np.exp(rng.uniform(np.log(12.0), np.log(180.0), 50))
    lines = np.array([k * grid for k in range(1, 8) for grid in (50.0, 60.0)])
    far = [f for f in tried.tolist() if np.min(np.abs(lines - f)) > AWAY_Hz]
    frequency_Hz = far[0]

    def hum(reading_m: Array, scene: Scene) -> Array:
        phase = 1.7 * scene.order
        wave = np.sin(2.0 * np.pi * frequency_Hz * scene.time_s + phase)
        return np.asarray(reading_m + np.sqrt(2.0) * size_m * wave)

    return _sensed("tone", hum)


def _slow_tone(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """An air conditioner that switches on and off: a slow line; rms."""
    frequency_Hz = float(rng.uniform(0.21, 0.45))

    def breathe(reading_m: Array, scene: Scene) -> Array:
        turn = 2.0 * np.pi * frequency_Hz * scene.time_s + 0.9 * scene.order
        return np.asarray(reading_m + np.sqrt(2.0) * size_m * np.sin(turn))

    return _sensed("slow_tone", breathe)


def _range_end(size_m: float, rig: Rig, _: np.random.Generator) -> Act:
    """A sensor range shorter than the stroke; peak."""

    def ended(reading_m: Array, scene: Scene) -> Array:  # noqa: ARG001
        return np.minimum(reading_m, rig.stroke_m - size_m)

    return _sensed("range_end", ended)


def _dent(size_m: float, rig: Rig, rng: np.random.Generator) -> Act:
    """A scratch on the scale: an error near one position; peak."""
    middle_m = float(rng.uniform(0.3, 0.7)) * rig.stroke_m

    def dented(reading_m: Array, scene: Scene) -> Array:  # noqa: ARG001
        return reading_m + size_m * np.exp(
            -0.5 * ((reading_m - middle_m) / (0.03 * rig.stroke_m)) ** 2
        )

    return _sensed("dent", dented)


def _dead_band(size_m: float, rig: Rig, rng: np.random.Generator) -> Act:
    """A counter that sticks over a range of positions and then catches up; peak."""
    low_m = float(rng.uniform(0.3, 0.6)) * rig.stroke_m

    def stuck(reading_m: Array, scene: Scene) -> Array:  # noqa: ARG001
        return np.where((reading_m > low_m) & (reading_m < low_m + size_m), low_m, reading_m)

    return _sensed("dead_band", stuck)


def _every_nth(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A converter with a shared reference: an error in every n-th reading; peak."""
    period = int(rng.integers(3, 40))

    def off(reading_m: Array, scene: Scene, _: np.random.Generator) -> Array:  # noqa: ARG001
        out = reading_m.copy()
        out[::period] += size_m
        return out

    return Act(name="every_nth", place=Place.CONVERTER, change=off)


def _knock(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A temporary load on the table; peak."""
    share = float(rng.uniform(0.25, 0.6))

    def leant(reading_m: Array, scene: Scene) -> Array:
        span_s = float(scene.time_s[-1])
        begun, ended = share * span_s, (share + 0.17) * span_s
        return reading_m + size_m * ((scene.time_s > begun) & (scene.time_s < ended))

    return _sensed("knock", leant)


def _after_turn(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A bearing that snaps: a bump of one sign after every turning point; peak."""
    tau_s = float(rng.uniform(0.02, 0.06))

    def snapped(reading_m: Array, scene: Scene) -> Array:
        turns = _turns(scene)
        if not len(turns):
            return reading_m
        place = np.arange(len(reading_m))
        last = turns[np.maximum(np.searchsorted(turns, place, side="right") - 1, 0)]
        since_s = (place - last) / scene.rate_Hz
        return reading_m + size_m * np.where(place >= turns[0], np.exp(-since_s / tau_s), 0.0)

    return _sensed("after_turn", snapped)


def _speed_bump(size_m: float, rig: Rig, _: np.random.Generator) -> Act:
    """A sensor with an error that rises with the speed up to six strokes per second; peak."""

    def moved(reading_m: Array, scene: Scene) -> Array:
        speed = np.abs(np.gradient(reading_m)) * scene.rate_Hz / rig.stroke_m
        fast = np.minimum(speed / 6.0, 1.0)
        return reading_m + size_m * first_order(fast, 1e-3, scene.rate_Hz, 0.0)

    return _sensed("speed_bump", moved)


def _travel_wave(size_m: float, rig: Rig, rng: np.random.Generator) -> Act:
    """A ball that is not round: an error periodic in the distance travelled; rms."""
    period_m = float(rng.uniform(0.5, 1.5)) * rig.stroke_m

    def rolled(reading_m: Array, scene: Scene) -> Array:  # noqa: ARG001
        travelled_m = np.cumsum(np.abs(np.diff(reading_m, prepend=reading_m[0])))
        wave = np.sin(2.0 * np.pi * travelled_m / period_m)
        return np.asarray(reading_m + np.sqrt(2.0) * size_m * wave)

    return _sensed("travel_wave", rolled)


def _other_axis_hump(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """The other axis touches a cable near one position of its range; peak."""
    middle = float(rng.uniform(0.35, 0.65))

    def touched(reading_m: Array, scene: Scene) -> Array:
        out = reading_m
        for other_V in scene.others_V.values():
            place = (other_V - other_V.min()) / max(float(np.ptp(other_V)), 1e-9)
            out = out + size_m * np.exp(-0.5 * ((place - middle) / 0.08) ** 2)
        return out

    return _sensed("other_axis_hump", touched)


def _line_spikes(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A phase-fired heater: a short pulse in every mains period; peak."""
    phase = float(rng.uniform(0.0, 1.0))

    def fired(reading_m: Array, scene: Scene) -> Array:
        turn = (GRID_Hz * scene.time_s + phase) % 1.0
        return reading_m + size_m * (turn < 0.08)

    return _sensed("line_spikes", fired)


def _multiplexed(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A range switch that toggles every few seconds; peak to peak."""
    period_s = float(rng.uniform(2.3, 3.7))

    def switched(reading_m: Array, scene: Scene) -> Array:
        return reading_m + size_m * ((scene.time_s / period_s) % 1.0 < 0.5)

    return _sensed("multiplexed", switched)


def _drive_step(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A switched divider: a step of the reading at one field."""
    level = float(rng.uniform(-0.4, 0.4))

    def stepped(reading_m: Array, scene: Scene) -> Array:
        return reading_m + size_m * (scene.field > level)

    return _sensed("drive_step", stepped)


UNCATALOGUED: tuple[Uncatalogued, ...] = (
    Uncatalogued(name="tone", coordinates=("frequency",), act=_tone),
    Uncatalogued(name="range_end", coordinates=("reading", "displacement"), act=_range_end),
    Uncatalogued(name="dent", coordinates=("reading", "displacement"), act=_dent),
    Uncatalogued(name="every_nth", coordinates=("sample_index",), act=_every_nth),
    Uncatalogued(name="knock", coordinates=("time",), act=_knock),
    Uncatalogued(name="after_turn", coordinates=("time_since_turn",), act=_after_turn),
    Uncatalogued(name="travel_wave", coordinates=("distance_travelled",), act=_travel_wave),
    Uncatalogued(
        name="other_axis_hump",
        coordinates=("other_axis",),
        act=_other_axis_hump,
        plans=("sweep", "check", "other_axis"),
    ),
    Uncatalogued(name="line_spikes", coordinates=("line_phase", "frequency"), act=_line_spikes),
    Uncatalogued(name="speed_bump", coordinates=("speed",), act=_speed_bump),
    Uncatalogued(name="slow_tone", coordinates=("frequency", "time"), act=_slow_tone),
    Uncatalogued(name="dead_band", coordinates=("reading", "displacement"), act=_dead_band),
    Uncatalogued(name="multiplexed", coordinates=("time", "frequency"), act=_multiplexed),
    Uncatalogued(
        name="drive_step", coordinates=("drive", "displacement", "reading"), act=_drive_step
    ),
)
