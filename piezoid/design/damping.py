"""A lightly damped mode that the loop damps, and its effect on the default bandwidth.

State feedback from an observer several times as fast as the mode moves the mode's poles to the
left, where they keep their frequency. Integral resonant control and positive position feedback do
the same with two or three numbers: over a family about a mode at 700 Hz known to 10 % they reach
a fifth of it, the observer 500 Hz. What limits all of them is how far the loop's delay turns the
mode, and how wide its interval is; docs/theory/control.md has the figures.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from piezoid.design.design import AxisDesign, LoopDesign
from piezoid.design.feasibility import rounded_down, unmet
from piezoid.design.observer import linear_controller
from piezoid.design.plant import Fraction, PlantFamily
from piezoid.design.rst import Mode, ringing_mode
from piezoid.design.specification import MODE_SHARE, Specification
from piezoid.design.templates import Template
from piezoid.design.tuning import DAMPED, METHODS, tune_observer
from piezoid.errors import TemplateError
from piezoid.formatting import significant, with_unit
from piezoid.numerics.frequency import decibel

HYSTERESIS = "small gain of the hysteresis"
_RESERVE = 0.95  # of the small gain: what lies between the lines of a search's grid
_BISECTIONS = 5
_WORTH = 1.1  # times the bandwidth: less is not worth a loop at its limits
_STEPS_DOWN, _STEP_DOWN = 4, 0.95
_PAST = 1e-3  # poles below are those of inputs on their way


def must_damp(plant: Fraction, bandwidth_Hz: float) -> bool:
    """Tell whether a bandwidth needs damping of the mode."""
    mode = ringing_mode(plant)
    return mode is not None and bandwidth_Hz > (1.0 + 1e-9) * MODE_SHARE * mode.frequency_Hz


def describe_obstacle(family: PlantFamily, bandwidth_Hz: float) -> str:
    """Describe why a mode is hard to damp; empty if the loop need not damp it."""
    plant = family.nominal
    if not must_damp(plant, bandwidth_Hz):
        return ""
    modes = [mode for mode in map(ringing_mode, family.members) if mode is not None]
    frequencies_Hz = [mode.frequency_Hz for mode in modes]
    return (
        f"To get there the loop must damp the mode at {with_unit(frequencies_Hz[0], 'Hz', 4)}, "
        f"damping ratio {significant(modes[0].damping)}. It lies anywhere from "
        f"{with_unit(min(frequencies_Hz), 'Hz', 4)} to {with_unit(max(frequencies_Hz), 'Hz', 4)}, "
        f"and {describe_delay(plant, modes[0])}, which the feedback must lead"
    )


def describe_delay(plant: Fraction, mode: Mode) -> str:
    """Describe the phase lag of all delays at the mode.

    The phase delay at rest of the whole plant, without the mode's own 2 z / w0.
    """
    late_s = plant.rest_delay_s - mode.damping / (np.pi * mode.frequency_Hz)
    return (
        f"hold, converters and filters, {with_unit(late_s, 's')}, delay it by "
        f"{significant(360.0 * mode.frequency_Hz * late_s)}°"
    )


def describe_mode(loop: LoopDesign) -> str:
    """Describe how a loop treats the slowest resonance; empty without one."""
    nominal = loop.members[0]
    mode, damped = ringing_mode(nominal), damped_mode(loop)
    if mode is None:
        return ""
    if damped is None:
        return (
            f"The loop stays below the mode at {with_unit(mode.frequency_Hz, 'Hz', 4)} and leaves "
            f"it as it is; {describe_delay(nominal, mode)}."
        )
    return (
        f"The mode at {with_unit(mode.frequency_Hz, 'Hz', 4)} is damped by state feedback, from a "
        f"damping ratio of {significant(mode.damping)} to {significant(damped)}; "
        f"{describe_delay(nominal, mode)}."
    )


def damped_mode(loop: LoopDesign) -> float | None:
    """Return the damping of a mode that the loop must damp; None if it need not.

    That of the least damped pole which the nominal state feedback leaves below 1.5 times the
    mode's frequency.
    """
    nominal, gains = loop.members[0], loop.observer
    mode = ringing_mode(nominal)
    if mode is None or gains is None or not must_damp(nominal, loop.bandwidth_Hz):
        return None
    closed = np.linalg.eigvals(gains.A - np.outer(gains.B, gains.feedback_gain))
    s = np.log(closed[np.abs(closed) > _PAST]) * nominal.sampling_rate_Hz
    nearby = s[np.abs(s) <= 1.5 * 2.0 * np.pi * mode.frequency_Hz]
    return float((-nearby.real / np.abs(nearby)).min(initial=1.0))


def raise_bandwidth(
    base: AxisDesign,
    family: PlantFamily,
    default: Specification,
    design: Callable[[Specification], AxisDesign],
    *,
    form: str,
) -> AxisDesign:
    """Return the same axis, its recommended loop with the bandwidth that damping its mode allows.

    At most the mode's frequency; with every margin and template of the default, and with the small
    gain that guarantees the loop in front of the hysteresis:

        |T_v| <= 0.95 / eps                                               (template)

    base     designed for the default
    family   of the recommended loop
    design   of the recommended loop, for a specification
    form     of the recommended loop

    The base is returned where no mode rings, where nothing bounds the hysteresis or eps leaves no
    loop with T_v = 1 at rest, and where damping does not gain a tenth.
    """
    mode, certificate = ringing_mode(family.nominal), base.recommended.certificate
    if mode is None or certificate is None or certificate.increment_gain >= _RESERVE:
        return base
    level_dB = float(decibel(_RESERVE / certificate.increment_gain))
    small_gain = Template(
        name=HYSTERESIS,
        function="Syb",
        frequency_Hz=np.array([1.0, 0.5 * family.nominal.sampling_rate_Hz]),
        upper_dB=np.array([level_dB, level_dB]),
    )
    guarded = replace(default, templates=(*default.templates, small_gain))

    def at_bandwidth(bandwidth_Hz: float) -> Specification:
        return replace(guarded, bandwidth_Hz=bandwidth_Hz, scan_frequency_Hz=bandwidth_Hz / 10.0)

    low_Hz = base.recommended.bandwidth_Hz
    least_Hz = _WORTH * max(low_Hz, MODE_SHARE * mode.frequency_Hz)
    nearest_Hz = _largest_Hz(family, at_bandwidth, least_Hz, mode.frequency_Hz, form)
    for _ in range(_STEPS_DOWN):
        if nearest_Hz is None or nearest_Hz < least_Hz:
            break
        try:
            candidate = design(at_bandwidth(nearest_Hz))
        except TemplateError:
            nearest_Hz *= _STEP_DOWN
            continue
        proven = candidate.recommended.certificate
        if proven is None or not proven.is_guaranteed:
            return base
        return replace(candidate, loops=(candidate.recommended, *base.loops[1:]))
    return base


def _largest_Hz(
    family: PlantFamily,
    at_bandwidth: Callable[[float], Specification],
    least_Hz: float,
    most_Hz: float,
    form: str,
) -> float | None:
    """Return the largest feasible bandwidth of a loop that damps the mode, to three digits."""

    def meets(bandwidth_Hz: float) -> bool:
        specification = at_bandwidth(bandwidth_Hz)
        for method in (DAMPED, *METHODS):
            tuned = tune_observer(family, specification, form=form, method=method, until_met=True)
            controller = linear_controller(tuned.observer)
            if not unmet(family.members, controller.R, controller.S, specification):
                return True
        return False

    if least_Hz >= most_Hz or not meets(least_Hz):
        return None
    low, high = np.log(least_Hz), np.log(most_Hz)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if meets(float(np.exp(middle))) else (low, middle)
    return max(rounded_down(float(np.exp(low))), least_Hz)
