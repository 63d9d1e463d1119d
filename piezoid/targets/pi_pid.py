"""The target `pi-pid`: settings for a box with PID, notches and a slew limit, and their price."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from piezoid.design.plant import PlantFamily
from piezoid.design.sensitivity import sensitivities
from piezoid.export.c_header import inert
from piezoid.export.parameter_file import AxisParameters
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import decibel
from piezoid.targets.box import run_box
from piezoid.targets.exported import Exported, shipped_position_m, tracked
from piezoid.targets.pid import Pid, PidBox
from piezoid.targets.pid_search import Tuned, tuned_pid
from piezoid.targets.price import (
    FREQUENCIES_Hz,
    felt_family,
    loss,
    rejection_csv,
    shipped_rejection_dB,
)
from piezoid.verification.approach import led_to, room_of
from piezoid.verification.scenarios import constant_angular_velocity
from piezoid.verification.tracking import Tracking

SEED = 0
_SPIRALS_Hz = (10.0, 50.0)
_TURNS = 5.0
_COUNTED = ("no notch", "one notch", "two notches")

_README = """\
# {name}: settings for a box with PID, up to {notches} notches and a slew limit

What the box is taken to compute, sample by sample, T = 1 / sampling rate, e = reference - reading:

    i += integral T e;   d += (1 - exp(-1/2)) ((e - e_before) / T - d)
    v = notches(proportional e + i + derivative d);   output = rest + v
    notch: (s^2 + 2 depth w s + w^2) / (s^2 + 2 width w s + w^2), w = 2 pi frequency,
    by Tustin's transform that keeps the frequency

then the slew limit, the voltage limits and the converter's step; the integral takes up no error
that would drive the output farther beyond a limit. Gains are volts of the command per metre of
displacement: scale them by the sensitivities of your amplifier and sensor. `settings.csv` holds
them, `rejection.csv` the curves of what follows.

{axes}
Tested: the settings in this structure, computed as above in 8-byte reals, against the identified
plant and others that the recordings allow, with hysteresis, creep, noise and converters; margins
of every plant of the family recomputed exactly. Not tested, because no such box was at hand: how
yours names, scales and rounds its settings, how it filters its derivative, where its notches
stand and what delay it adds. The plants have the delay of this stage's own converters. Begin with
a tenth of the integral and without the proportional.
"""

_AXIS = """\
## Axis {axis}

| setting | value |
| --- | --- |
{settings}

{price}.

Worst of {plants} plants: modulus margin {modulus:.2f}, delay margin {delay}.

| spiral | plant | rms error, exported controller | rms error, PID | PID, its best delay apart |
| --- | --- | --- | --- | --- |
{rows}
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Priced:
    """One axis with PID beside its exported controller.

    rejection_dB  (frequencies, 2)  worst |Syp| over the family: exported, PID
    rows          spiral in Hz, label of the plant, what is left with exported controller and PID
    """

    axis: str
    tuned: Tuned
    plants: int
    rejection_dB: Array
    rows: tuple[tuple[float, str, Tracking, Tracking], ...]

    @property
    def price(self) -> str:
        """What the box loses, in one or two sentences."""
        own_dB, pid_dB = self.rejection_dB.T
        slow = [row for row in self.rows if row[0] == _SPIRALS_Hz[0]]
        own = with_unit(max(row[2].rms_m for row in slow), "m")
        pid = with_unit(max(row[3].rms_m for row in slow), "m")
        said = loss(f"PID and {_COUNTED[len(self.tuned.pid.notches)]}", own_dB, pid_dB)
        return f"{said}; a spiral of {_SPIRALS_Hz[0]:g} Hz errs by {pid} rms instead of {own}"


def pi_pid_files(exported: Exported) -> tuple[Mapping[str, bytes], tuple[str, ...]]:
    """Return the folder's files by name, and sentences about what they cost.

    Raises ``DesignError`` where no such box holds the plants of an axis.
    """
    priced = [priced_pid(exported, axis) for axis in exported.lateral]
    notes = [f"axis {one.axis}: {one.price}" for one in priced]
    notes += [
        f"axis {axis.axis} is not in pi-pid/: it regulates a current, and a PID of a displacement "
        "does not; --target library or the bundle holds its controller"
        for axis in exported.file.axes
        if axis.method == "rst"
    ]
    if not priced:
        return {}, tuple(notes)
    readme = _README.format(
        name=inert(exported.file.name),
        notches=exported.box.notches,
        axes="\n".join(_section(one) for one in priced),
    )
    files = {
        "README.md": readme.encode(),
        "settings.csv": _settings_csv(priced).encode(),
        "rejection.csv": rejection_csv(
            ("exported", "pid"), {one.axis: one.rejection_dB for one in priced}
        ).encode(),
    }
    return files, tuple(notes)


def priced_pid(exported: Exported, axis: AxisParameters) -> Priced:
    """Return the best settings of one axis, and what they lose."""
    design, model = exported.designs[axis.axis], exported.models[axis.axis]
    box, asked, values = exported.box, design.specification, axis.values
    family = felt_family(model, design.sampling_rate_Hz)
    plants = exported.family(axis.axis)
    blank = Pid(
        sampling_rate_Hz=design.sampling_rate_Hz,
        proportional_V_per_m=0.0,
        integral_V_per_m_s=0.0,
        derivative_V_s_per_m=0.0,
        notches=(),
        rest_V=plants[0].rest_voltage_V,
        minimum_V=float(values["voltage_minimum_V"]),
        maximum_V=float(values["voltage_maximum_V"]),
        lsb_V=float(values["lsb_V"]),
        slew_V_per_s=box.slew_V_per_s or asked.voltage_slew_V_per_s or np.inf,
    )
    tuned = tuned_pid(
        axis.axis,
        family,
        blank,
        notches=box.notches,
        asked=asked,
    )
    return Priced(
        axis=axis.axis,
        tuned=tuned,
        plants=len(family.members),
        rejection_dB=np.stack(
            [shipped_rejection_dB(design), _rejection_dB(family, tuned.pid)], axis=1
        ),
        rows=tuple(
            _row(exported, axis, tuned.pid, frequency_Hz, place)
            for frequency_Hz in _SPIRALS_Hz
            for place in range(len(plants))
        ),
    )


def _rejection_dB(family: PlantFamily, pid: Pid) -> Array:
    R, S = pid.polynomials()
    found = [np.abs(sensitivities(m, R, S, FREQUENCIES_Hz).Syp) for m in family.members]
    return np.asarray(decibel(np.max(found, axis=0)))


def _row(
    exported: Exported, axis: AxisParameters, pid: Pid, frequency_Hz: float, place: int
) -> tuple[float, str, Tracking, Tracking]:
    plants, rate_Hz = exported.family(axis.axis), pid.sampling_rate_Hz
    room = room_of(axis)
    spiral = constant_angular_velocity(rate_Hz, frequency_Hz, _TURNS)
    path_m = room.centre_m + room.radius_m * spiral.x
    plant = plants[place]
    led_m = led_to(plant, float(path_m[0]))
    rng = np.random.default_rng(SEED)
    boxed = run_box(plant, PidBox(pid), np.concatenate([led_m, path_m]), rng=rng)
    boxed_m = boxed.position_m[len(led_m) :]
    shipped_m = shipped_position_m(axis, plant, path_m, SEED)
    return (
        frequency_Hz,
        plant.label,
        tracked(path_m, shipped_m, room, frequency_Hz, rate_Hz),
        tracked(path_m, boxed_m, room, frequency_Hz, rate_Hz),
    )


def _settings(pid: Pid) -> list[tuple[str, float, str]]:
    found = [
        ("sampling rate", pid.sampling_rate_Hz, "Hz"),
        ("proportional", pid.proportional_V_per_m, "V/m"),
        ("integral", pid.integral_V_per_m_s, "V/(m s)"),
        ("derivative", pid.derivative_V_s_per_m, "V s/m"),
    ]
    for number, notch in enumerate(pid.notches, 1):
        found += [
            (f"notch {number} frequency", notch.frequency_Hz, "Hz"),
            (f"notch {number} depth", notch.depth, "1"),
            (f"notch {number} width", notch.width, "1"),
        ]
    found += [
        ("slew limit", pid.slew_V_per_s, "V/s"),
        ("rest", pid.rest_V, "V"),
        ("lowest output", pid.minimum_V, "V"),
        ("highest output", pid.maximum_V, "V"),
    ]
    return [one for one in found if np.isfinite(one[1])]


def _section(one: Priced) -> str:
    late = [m.delay_margin_s for m in one.tuned.margins if m.delay_margin_s is not None]
    return _AXIS.format(
        axis=one.axis,
        settings="\n".join(f"| {n} | {v:.6g} {u} |" for n, v, u in _settings(one.tuned.pid)),
        price=one.price[0].upper() + one.price[1:],
        plants=one.plants,
        modulus=min(m.modulus_margin for m in one.tuned.margins),
        delay=with_unit(min(late), "s") if late else "none needed",
        rows="\n".join(
            f"| {f:g} Hz | {label} | {with_unit(own.rms_m, 'm')} | {with_unit(pid.rms_m, 'm')} "
            f"| {with_unit(pid.aligned_rms_m, 'm')} |"
            for f, label, own, pid in one.rows
        ),
    )


def _settings_csv(priced: list[Priced]) -> str:
    lines = ["axis,setting,value,unit"]
    for one in priced:
        lines += [f"{one.axis},{n},{v!r},{u}" for n, v, u in _settings(one.tuned.pid)]
    return "\n".join([*lines, ""])
