"""Effects outside the catalogue of the diagnosis.

Each is one act in the chain, with the coordinate along which it is systematic. They test whether
a diagnosis reports an unexplained residual, and along which coordinate.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

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
    return Act(
        name=name,
        place=Place.SENSOR,
        change=lambda reading_m, scene, _: np.asarray(change(reading_m, scene)),
    )


def _line(name: str, size_m: float, frequency_Hz: float, phase_step: float) -> Act:
    """Return a line of the reading; its phase increases by a step from recording to recording."""

    def change(reading_m: Array, scene: Scene) -> Array:
        wave = np.sin(2.0 * np.pi * frequency_Hz * scene.time_s + phase_step * scene.order)
        return np.asarray(reading_m + np.sqrt(2.0) * size_m * wave)

    return _sensed(name, change)


def _tone(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A pump, fan or chopper: a line at a fixed frequency away from the mains harmonics; rms."""
    candidates_Hz = np.exp(rng.uniform(np.log(12.0), np.log(180.0), 50)).tolist()
    lines_Hz = np.array([k * grid for k in range(1, 8) for grid in (50.0, 60.0)])
    frequency_Hz = next(f for f in candidates_Hz if np.min(np.abs(lines_Hz - f)) > AWAY_Hz)
    return _line("tone", size_m, frequency_Hz, 1.7)


def _slow_tone(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """An air conditioner that switches on and off: a slow line; rms."""
    return _line("slow_tone", size_m, float(rng.uniform(0.21, 0.45)), 0.9)


def _range_end(size_m: float, rig: Rig, _: np.random.Generator) -> Act:
    """A sensor range shorter than the stroke; peak."""
    end_m = rig.stroke_m - size_m
    return _sensed("range_end", lambda reading_m, _: np.minimum(reading_m, end_m))


def _dent(size_m: float, rig: Rig, rng: np.random.Generator) -> Act:
    """A scratch on the scale: an error near one position; peak."""
    middle_m = float(rng.uniform(0.3, 0.7)) * rig.stroke_m
    width_m = 0.03 * rig.stroke_m
    return _sensed(
        "dent",
        lambda reading_m, _: (
            reading_m + size_m * np.exp(-0.5 * ((reading_m - middle_m) / width_m) ** 2)
        ),
    )


def _dead_band(size_m: float, rig: Rig, rng: np.random.Generator) -> Act:
    """A counter that sticks over a range of positions and then catches up; peak."""
    low_m = float(rng.uniform(0.3, 0.6)) * rig.stroke_m
    high_m = low_m + size_m
    return _sensed(
        "dead_band",
        lambda reading_m, _: np.where(
            (reading_m > low_m) & (reading_m < high_m), low_m, reading_m
        ),
    )


def _every_nth(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A converter with a shared reference: an error in every n-th reading; peak."""
    period = int(rng.integers(3, 40))

    def change(reading_m: Array, scene: Scene, _: np.random.Generator) -> Array:  # noqa: ARG001
        out = reading_m.copy()
        out[::period] += size_m
        return out

    return Act(name="every_nth", place=Place.CONVERTER, change=change)


def _knock(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A temporary load on the table; peak."""
    share = float(rng.uniform(0.25, 0.6))

    def change(reading_m: Array, scene: Scene) -> Array:
        span_s = float(scene.time_s[-1])
        begun, ended = share * span_s, (share + 0.17) * span_s
        return reading_m + size_m * ((scene.time_s > begun) & (scene.time_s < ended))

    return _sensed("knock", change)


def _after_turn(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A bearing that snaps: a bump of one sign after every turning point; peak."""
    tau_s = float(rng.uniform(0.02, 0.06))

    def change(reading_m: Array, scene: Scene) -> Array:
        step = np.sign(np.diff(scene.field))
        moving = np.flatnonzero(step)
        turns = moving[np.flatnonzero(np.diff(step[moving])) + 1]
        if not len(turns):
            return reading_m
        sample = np.arange(len(reading_m))
        latest = turns[np.maximum(np.searchsorted(turns, sample, side="right") - 1, 0)]
        since_s = (sample - latest) / scene.rate_Hz
        return reading_m + size_m * np.where(sample >= turns[0], np.exp(-since_s / tau_s), 0.0)

    return _sensed("after_turn", change)


def _speed_bump(size_m: float, rig: Rig, _: np.random.Generator) -> Act:
    """A sensor with an error that rises with the speed up to six strokes per second; peak."""

    def change(reading_m: Array, scene: Scene) -> Array:
        speed = np.abs(np.gradient(reading_m)) * scene.rate_Hz / rig.stroke_m
        fast = np.minimum(speed / 6.0, 1.0)
        return reading_m + size_m * first_order(fast, 1e-3, scene.rate_Hz, 0.0)

    return _sensed("speed_bump", change)


def _travel_wave(size_m: float, rig: Rig, rng: np.random.Generator) -> Act:
    """A ball that is not round: an error periodic in the distance travelled; rms."""
    period_m = float(rng.uniform(0.5, 1.5)) * rig.stroke_m

    def change(reading_m: Array, scene: Scene) -> Array:  # noqa: ARG001
        travelled_m = np.cumsum(np.abs(np.diff(reading_m, prepend=reading_m[0])))
        wave = np.sin(2.0 * np.pi * travelled_m / period_m)
        return np.asarray(reading_m + np.sqrt(2.0) * size_m * wave)

    return _sensed("travel_wave", change)


def _other_axis_hump(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """The other axis touches a cable near one position of its range; peak."""
    middle = float(rng.uniform(0.35, 0.65))

    def change(reading_m: Array, scene: Scene) -> Array:
        out = reading_m
        for other_V in scene.others_V.values():
            place = (other_V - other_V.min()) / max(float(np.ptp(other_V)), 1e-9)
            out = out + size_m * np.exp(-0.5 * ((place - middle) / 0.08) ** 2)
        return out

    return _sensed("other_axis_hump", change)


def _line_spikes(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A phase-fired heater: a short pulse in every mains period; peak."""
    phase = float(rng.uniform(0.0, 1.0))
    return _sensed(
        "line_spikes",
        lambda reading_m, scene: (
            reading_m + size_m * ((GRID_Hz * scene.time_s + phase) % 1.0 < 0.08)
        ),
    )


def _multiplexed(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A range switch that toggles every few seconds; peak to peak."""
    period_s = float(rng.uniform(2.3, 3.7))
    return _sensed(
        "multiplexed",
        lambda reading_m, scene: reading_m + size_m * ((scene.time_s / period_s) % 1.0 < 0.5),
    )


def _drive_step(size_m: float, _: Rig, rng: np.random.Generator) -> Act:
    """A switched divider: a step of the reading at one field."""
    level = float(rng.uniform(-0.4, 0.4))
    return _sensed(
        "drive_step", lambda reading_m, scene: reading_m + size_m * (scene.field > level)
    )


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
