"""Damping of a lightly damped mode by the loop, and its effect on the default bandwidth.

State feedback from an observer several times as fast as the mode moves the mode's poles to the
left and keeps their frequency. Integral resonant control and positive position feedback do the
same with two or three parameters. Over a family about a mode at 700 Hz known to 10 % they reach a
bandwidth of a fifth of the mode's frequency, the observer 500 Hz. All of them are limited by the
phase lag of the loop's delay at the mode, and by the width of the mode's interval;
docs/theory/control.md has the figures.
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
from piezoid.numerics.polynomial import decibel

HYSTERESIS = "small gain of the hysteresis"
_RESERVE = 0.95  # of the small gain, for peaks between the lines of a search's grid
_BISECTIONS = 5
_MIN_RATIO = 1.1  # of the bandwidths: a smaller gain does not justify a loop at its limits
_STEPS_DOWN, _STEP_DOWN = 4, 0.95
_DELAY_POLE = 1e-3  # magnitude below which a pole belongs to a past input


def must_damp(plant: Fraction, bandwidth_Hz: float) -> bool:
    """Whether a loop of this bandwidth must damp the plant's lowest resonance."""
    mode = ringing_mode(plant)
    return mode is not None and bandwidth_Hz > (1.0 + 1e-9) * MODE_SHARE * mode.frequency_Hz


def describe_obstacle(family: PlantFamily, bandwidth_Hz: float) -> str:
    """Describe why the resonance is hard to damp; empty if the loop need not damp it."""
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

    The delay is the phase delay of the plant at rest, less that of the mode, 2 z / w0.
    """
    delay_s = plant.rest_delay_s - mode.damping / (np.pi * mode.frequency_Hz)
    return (
        f"hold, converters and filters, {with_unit(delay_s, 's')}, delay it by "
        f"{significant(360.0 * mode.frequency_Hz * delay_s)}°"
    )


def describe_mode(loop: LoopDesign) -> str:
    """Describe how a loop treats the lowest resonance; empty if the plant has none."""
    nominal = loop.members[0]
    mode, damping = ringing_mode(nominal), damped_mode(loop)
    if mode is None:
        return ""
    if damping is None:
        return (
            f"The loop stays below the mode at {with_unit(mode.frequency_Hz, 'Hz', 4)} and leaves "
            f"it as it is; {describe_delay(nominal, mode)}."
        )
    return (
        f"The mode at {with_unit(mode.frequency_Hz, 'Hz', 4)} is damped by state feedback, from a "
        f"damping ratio of {significant(mode.damping)} to {significant(damping)}; "
        f"{describe_delay(nominal, mode)}."
    )


def damped_mode(loop: LoopDesign) -> float | None:
    """Return the damping ratio of the resonance in closed loop; None if the loop need not damp it.

    It is the smallest damping ratio of the nominal state feedback's poles below 1.5 times the
    frequency of the resonance.
    """
    nominal, gains = loop.members[0], loop.observer
    mode = ringing_mode(nominal)
    if mode is None or gains is None or not must_damp(nominal, loop.bandwidth_Hz):
        return None
    poles = np.linalg.eigvals(gains.A - np.outer(gains.B, gains.feedback_gain))
    s = np.log(poles[np.abs(poles) > _DELAY_POLE]) * nominal.sampling_rate_Hz
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
    """Raise the bandwidth of the recommended loop as far as damping of the resonance allows.

    The bandwidth is at most the frequency of the resonance. The loop meets every margin and
    template of the default, and the small gain that guarantees its stability with hysteresis:

        |T_v| <= 0.95 / eps                                               (template)

    base     designed for the default
    family   of the recommended loop
    design   of the recommended loop, for a specification
    form     of the recommended loop

    Returns the base if the plant has no resonance, if the hysteresis has no bound or eps excludes
    every loop with T_v = 1 at rest, and if damping raises the bandwidth by less than a tenth.
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

    min_Hz = _MIN_RATIO * max(base.recommended.bandwidth_Hz, MODE_SHARE * mode.frequency_Hz)
    bandwidth_Hz = _largest_Hz(family, at_bandwidth, min_Hz, mode.frequency_Hz, form)
    for _ in range(_STEPS_DOWN):
        if bandwidth_Hz is None or bandwidth_Hz < min_Hz:
            break
        try:
            candidate = design(at_bandwidth(bandwidth_Hz))
        except TemplateError:
            bandwidth_Hz *= _STEP_DOWN
            continue
        certificate = candidate.recommended.certificate
        if certificate is None or not certificate.is_guaranteed:
            return base
        return replace(candidate, loops=(candidate.recommended, *base.loops[1:]))
    return base


def _largest_Hz(
    family: PlantFamily,
    at_bandwidth: Callable[[float], Specification],
    min_Hz: float,
    max_Hz: float,
    form: str,
) -> float | None:
    """Bisect the largest feasible bandwidth of a loop that damps the mode, to three digits."""

    def meets(bandwidth_Hz: float) -> bool:
        specification = at_bandwidth(bandwidth_Hz)
        for method in (DAMPED, *METHODS):
            tuned = tune_observer(family, specification, form=form, method=method, until_met=True)
            controller = linear_controller(tuned.observer)
            if not unmet(family.members, controller.R, controller.S, specification):
                return True
        return False

    if min_Hz >= max_Hz or not meets(min_Hz):
        return None
    low, high = np.log(min_Hz), np.log(max_Hz)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if meets(float(np.exp(middle))) else (low, middle)
    return max(rounded_down(float(np.exp(low))), min_Hz)
