"""The target `pid`: settings and second-order sections for PID hardware, and its errors."""

from collections.abc import Mapping

import numpy as np

from piezoid.design.hysteresis_bounds import affine_bounds
from piezoid.design.lateral import with_sector
from piezoid.design.lateral_task import plant_family
from piezoid.design.sensitivity import Margins
from piezoid.export.c_header import plain_ascii
from piezoid.export.parameter_file import AxisParameters
from piezoid.formatting import with_unit
from piezoid.targets.pid import Pid, pid_law, tuned_pid
from piezoid.targets.target_inputs import (
    SEED,
    Errors,
    TargetInputs,
    error_rows,
    exported_position_m,
    worst_errors,
)
from piezoid.verification.closed_loop import approach_path, reference_range, run_law
from piezoid.verification.scenarios import constant_angular_velocity

_SPIRAL_Hz, _TURNS = 10.0, 5.0
_NOTCHES = ("no notch", "one notch", "two notches")

_README = """\
# {name}: settings for a PID controller with up to {notches} notches and a slew limit

The controller computes every sample, with T = 1 / sampling rate and e = reference - reading,

    i += integral T e;   d += (1 - exp(-1/2)) ((e - e_previous) / T - d)
    v = notches(proportional e + i + derivative d);   output = rest + v
    notch: (s^2 + 2 depth w s + w^2) / (s^2 + 2 width w s + w^2), w = 2 pi frequency,
    by Tustin's transform that keeps the frequency

then the slew limit, the voltage limits and the converter's step; while a limit is active, the
integral stops. Gains are volts of the command per metre of displacement: scale them by the
sensitivities of your amplifier and sensor. `settings.csv` holds them. `sections.csv` holds the
same controller as second-order sections at {update}, the first in V/m,

    y[k] = b0 x[k] + b1 x[k-1] + b2 x[k-2] - a1 y[k-1] - a2 y[k-2]

{axes}
Tested: these settings, computed as above in double precision at the controller's rate, on the
identified plant and others that the recordings allow, with hysteresis, creep, noise and
converters; the margins of every plant are recomputed exactly. Not tested, because no such device
was at hand: how yours names, scales and rounds its settings, how it filters its derivative, the
order of its notches, its fixed-point arithmetic, and the delay that it adds. The plants have the
delay of this stage's converters. Begin with a tenth of the integral and without the proportional.
"""

_AXIS = """\
## Axis {axis}

| setting | value |
| --- | --- |
{settings}

{loss}.

Worst of {plants} plants: modulus margin {modulus:.2f}, delay margin {delay}.

| plant | spiral of {spiral} Hz, exported controller, rms | PID, rms |
| --- | --- | --- |
{rows}
"""


def pid_files(inputs: TargetInputs) -> tuple[Mapping[str, bytes], tuple[str, ...]]:
    """Return the folder's files by name, and one sentence about the errors of each axis.

    Raises ``DesignError`` if no PID stabilises all plants of an axis.
    """
    notes = [
        f"axis {axis} is not in pid/: it regulates a current; --target library or the bundle has "
        "its controller"
        for axis in inputs.tips
    ]
    if not inputs.lateral:
        return {}, tuple(notes)
    rate_Hz = inputs.designs[inputs.lateral[0].axis].sampling_rate_Hz
    update_Hz = inputs.hardware.update_Hz or rate_Hz
    losses: list[str] = []
    settings, sections = ["axis,setting,value,unit"], ["axis,section,b0,b1,b2,a1,a2"]
    paragraphs = []
    for axis in inputs.lateral:
        pid, margins, errors_m = pid_of(inputs, axis)
        loss = _loss(pid, errors_m)
        losses.append(f"axis {axis.axis}: {loss}")
        settings += [f"{axis.axis},{n},{v!r},{u}" for n, v, u in _settings(pid)]
        for index, (b, a) in enumerate(pid.sections(update_Hz)):
            values = [*np.pad(b, (0, 3 - len(b))), *np.pad(a, (0, 3 - len(a)))[1:]]
            sections.append(",".join([axis.axis, str(index), *(f"{v:.17g}" for v in values)]))
        delays_s = [m.delay_margin_s for m in margins if m.delay_margin_s is not None]
        paragraphs.append(
            _AXIS.format(
                axis=axis.axis,
                settings="\n".join(f"| {n} | {v:.6g} {u} |" for n, v, u in _settings(pid)),
                loss=loss[0].upper() + loss[1:],
                plants=len(margins),
                modulus=min(m.modulus_margin for m in margins),
                delay=with_unit(min(delays_s), "s") if delays_s else "none needed",
                spiral=f"{_SPIRAL_Hz:g}",
                rows=error_rows(errors_m),
            )
        )
    readme = _README.format(
        name=plain_ascii(inputs.file.name),
        notches=inputs.hardware.notches,
        update=with_unit(update_Hz, "Hz", 6),
        axes="\n".join(paragraphs),
    )
    texts = {
        "README.md": readme,
        "settings.csv": "\n".join([*settings, ""]),
        "sections.csv": "\n".join([*sections, ""]),
    }
    return {name: text.encode() for name, text in texts.items()}, (*losses, *notes)


def _loss(pid: Pid, errors_m: Errors) -> str:
    """Return the errors of the PID and of the exported controller, as a sentence."""
    worst = worst_errors(errors_m)
    is_integral = pid.proportional_V_per_m == pid.derivative_V_s_per_m == 0.0
    controller = "an integral controller" if is_integral else "a PID"
    return (
        f"with {controller} and {_NOTCHES[len(pid.notches)]}, a spiral of {_SPIRAL_Hz:g} Hz errs "
        f"by {worst['pid']} rms instead of {worst['exported']} (worst of {len(errors_m)} plants)"
    )


def pid_of(inputs: TargetInputs, axis: AxisParameters) -> tuple[Pid, tuple[Margins, ...], Errors]:
    """Search the settings of one axis, and simulate them and the exported controller.

    returned  settings, margins on every plant of the family, and rms errors on a spiral by plant
    """
    design, model, hardware = inputs.designs[axis.axis], inputs.models[axis.axis], inputs.hardware
    specification, rate_Hz = design.specification, design.sampling_rate_Hz
    bounds = affine_bounds(
        model.operator, model.certificate.reach_V, remainder_m=model.certificate.bound_m
    )
    plants = inputs.family(axis.axis)
    pid, margins = tuned_pid(
        axis.axis,
        with_sector(plant_family(model, rate_Hz), bounds),
        Pid(
            sampling_rate_Hz=rate_Hz,
            rest_V=plants[0].rest_voltage_V,
            minimum_V=float(axis.values["voltage_minimum_V"]),
            maximum_V=float(axis.values["voltage_maximum_V"]),
            lsb_V=float(axis.values["lsb_V"]),
            slew_V_per_s=hardware.slew_V_per_s or specification.voltage_slew_V_per_s or np.inf,
        ),
        notches=hardware.notches,
        specification=specification,
    )
    span = reference_range(axis)
    spiral = constant_angular_velocity(rate_Hz, _SPIRAL_Hz, _TURNS)
    path_m = span.centre_m + span.radius_m * spiral.x
    errors_m = {}
    for plant in plants:
        approach_m = approach_path(plant, float(path_m[0]))
        reference_m = np.concatenate([approach_m, path_m])
        rng = np.random.default_rng(SEED)
        record = run_law(plant, pid_law(pid), reference_m, rng=rng)
        positions_m = {
            "exported": exported_position_m(axis, plant, path_m),
            "pid": record.position[len(approach_m) :],
        }
        errors_m[plant.label] = {
            name: float(np.sqrt(np.mean((position_m - path_m) ** 2)))
            for name, position_m in positions_m.items()
        }
    return pid, margins, errors_m


def _settings(pid: Pid) -> list[tuple[str, float, str]]:
    settings = [
        ("sampling rate", pid.sampling_rate_Hz, "Hz"),
        ("proportional", pid.proportional_V_per_m, "V/m"),
        ("integral", pid.integral_V_per_m_s, "V/(m s)"),
        ("derivative", pid.derivative_V_s_per_m, "V s/m"),
    ]
    for number, notch in enumerate(pid.notches, 1):
        settings += [
            (f"notch {number} frequency", notch.frequency_Hz, "Hz"),
            (f"notch {number} depth", notch.depth, "1"),
            (f"notch {number} width", notch.width, "1"),
        ]
    settings += [
        ("slew limit", pid.slew_V_per_s, "V/s"),
        ("rest", pid.rest_V, "V"),
        ("lowest output", pid.minimum_V, "V"),
        ("highest output", pid.maximum_V, "V"),
    ]
    return [setting for setting in settings if np.isfinite(setting[1])]
