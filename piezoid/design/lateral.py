"""Design X and Y: a disturbance observer in both forms, the best of several tunings.

A loop can raise its bandwidth by damping a lightly damped mode: state feedback from an observer
several times as fast as the mode moves the mode's poles to the left and keeps their frequency.
docs/theory/control.md compares it with other controllers, and says what limits it.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from piezoid.design.certificate import Disturbances, certify
from piezoid.design.design import AxisDesign, LoopDesign, assemble_loop
from piezoid.design.feasibility import at_feasible_bandwidth, refuse, rounded_down, severity
from piezoid.design.hysteresis_bounds import HysteresisBounds
from piezoid.design.plant import Fraction, Plant, PlantFamily
from piezoid.design.rst import Mode, ringing_mode
from piezoid.design.sensitivity import Violation, constant_limit
from piezoid.design.specification import MODE_SHARE, Specification
from piezoid.design.tuning import DAMPED, METHODS, tune_observer
from piezoid.errors import DesignError, TemplateError
from piezoid.formatting import significant, with_unit
from piezoid.numerics.polynomial import decibel
from piezoid.runtime.schema import MAX_ORDER

_NO_DISTURBANCES = Disturbances()
_SLEW_SHARE = 0.5  # of the amplifier's slew rate, for references: feedback needs the rest
_LOOP_OF_FORM = {"inverse": "mpi_dob", "affine": "dob"}
_FIGURE = "predicted tracking error with noise, rms, worst member"

HYSTERESIS = "small gain of the hysteresis"
_RESERVE = 0.95  # of the small gain, for peaks between the lines of a search's grid
_BISECTIONS = 5
_MIN_RATIO = 1.1  # of the bandwidths: a smaller gain does not justify a loop at its limits
_STEPS_DOWN, _STEP_DOWN = 4, 0.95
_DELAY_POLE = 1e-3  # magnitude below which a pole belongs to a past input


def design_lateral(
    axis: str,
    families: Mapping[str, PlantFamily],
    specification: Specification,
    *,
    model: Plant | None = None,
    bounds: Mapping[str, HysteresisBounds] | None = None,
    disturbances: Disturbances = _NO_DISTURBANCES,
) -> AxisDesign:
    """Design the disturbance observer of one lateral axis, in every requested form.

    families  by form, ``inverse`` and/or ``affine``: in the affine form the slope sector of the
              hysteresis is in the loop, so its family has more gain variation; see
              ``with_sector``
    model     design model of the observer; by default the nominal member, with part of its delay
              as a pole if the runtime has too few states (``Plant.with_delay_pole``)
    bounds    by form, for the certificate; a form without bounds has no certificate
    disturbances  from the recordings, for the certificate

    Raises ``TemplateError`` if the first form (the inverse form, if requested) cannot meet the
    specification. Another form is then designed at its nearest feasible bandwidth, for comparison,
    or omitted if no bandwidth is feasible.
    """
    loops: list[LoopDesign] = []
    for form in (form for form in _LOOP_OF_FORM if form in families):
        plant = model or families[form].nominal
        max_states = MAX_ORDER - 2 * len(specification.oscillation_Hz)
        excess = len(plant.realised()[0]) - max_states
        if model is None and excess > 0:
            # Too many states for the runtime besides its oscillators.
            if excess >= plant.delay_samples:
                raise DesignError(
                    f"axis {axis}: at {plant.sampling_rate_Hz:g} Hz the plant has "
                    f"{max_states + excess} states, of which {plant.delay_samples} are delay",
                    needed=f"at most {max_states} states, a delay counted as one",
                    remedy="Design with fewer resonant_harmonics, or fit fewer modes.",
                )
            plant = plant.with_delay_pole(excess + 1)
        design_form = partial(
            _design_loop,
            axis,
            form,
            families[form],
            plant,
            (bounds or {}).get(form),
            disturbances,
        )
        if not loops:
            loops.append(design_form(specification))
            continue
        try:
            loops.append(at_feasible_bandwidth(design_form, specification))
        except TemplateError:
            continue
    return AxisDesign(
        axis=axis,
        output_unit=next(iter(families.values())).nominal.output_unit,
        specification=specification,
        loops=tuple(loops),
    )


def with_sector(family: PlantFamily, bounds: HysteresisBounds) -> PlantFamily:
    """Add the nominal plant with the gains at both ends of the hysteresis' slope sector."""
    nominal = family.nominal
    members = [
        replace(
            nominal,
            label=f"slope x{slope:.3g}",
            input_taps=nominal.input_taps * slope,
            B=nominal.B * slope,
        )
        for slope in (bounds.slope_min, bounds.slope_max)
    ]
    return PlantFamily(members=(*family.members, *members))


def _design_loop(
    axis: str,
    form: str,
    family: PlantFamily,
    model: Plant,
    bounds: HysteresisBounds | None,
    disturbances: Disturbances,
    specification: Specification,
) -> LoopDesign:
    """Design the loop of one axis in one form by every method, and choose the smallest error."""
    tune = partial(tune_observer, family, model=model, form=form)

    def smallest_violations(candidate: Specification) -> tuple[Violation, ...]:
        """Return the violations by the best tuning; empty as soon as a tuning has none."""
        violations = []
        for method in reversed(_methods(family, candidate)):
            violations.append(tune(candidate, method=method, until_met=True).violations)
            if not violations[-1]:
                break
        return min(violations, key=severity)

    methods = _methods(family, specification)
    tunings = [tune(specification, method=method) for method in methods]
    smallest = min((tuning.violations for tuning in tunings), key=severity)
    bandwidth_Hz = specification.bandwidth_Hz
    if smallest:
        because, plant = "", family.nominal
        if must_damp(plant, bandwidth_Hz):
            modes = [mode for mode in map(ringing_mode, family.members) if mode is not None]
            frequencies_Hz = [mode.frequency_Hz for mode in modes]
            because = (
                f"To get there the loop must damp the mode at "
                f"{with_unit(frequencies_Hz[0], 'Hz', 4)}, damping ratio "
                f"{significant(modes[0].damping)}. It lies anywhere from "
                f"{with_unit(min(frequencies_Hz), 'Hz', 4)} to "
                f"{with_unit(max(frequencies_Hz), 'Hz', 4)}. "
                f"{_describe_delay(plant, modes[0])}; the feedback must lead this phase"
            )
        refuse(axis, specification, smallest, smallest_violations, because=because)
    loop = assemble_loop(_LOOP_OF_FORM[form], family.fractions, bandwidth_Hz, tunings, _FIGURE)
    if bounds is None:
        return loop
    # References may have the speed of a full-range sine at the scan frequency, up to a share of
    # the amplifier's slew rate.
    gain = abs(family.nominal.gain)
    half_V = 0.5 * (specification.voltage_max_V - specification.voltage_min_V)
    amplitude_m = min(half_V, bounds.reach_V) * gain
    slew_m_per_s = 2.0 * np.pi * specification.scan_frequency_Hz * amplitude_m
    if specification.voltage_slew_V_per_s is not None:
        amplifier_m_per_s = specification.voltage_slew_V_per_s * gain
        slew_m_per_s = min(slew_m_per_s, _SLEW_SHARE * amplifier_m_per_s)
    certificate = certify(
        *(family.members, loop.R, loop.S, loop.T),
        path=loop.reference,
        bounds=bounds,
        reference_slew_m_per_s=float(slew_m_per_s),
        voltage_step_V=specification.voltage_step_V,
        sensor_noise_rms_m=specification.sensor_noise_rms,
        disturbances=disturbances,
    )
    return replace(loop, certificate=certificate)


def _methods(family: PlantFamily, specification: Specification) -> tuple[str, ...]:
    is_damped = must_damp(family.nominal, specification.bandwidth_Hz)
    return (*METHODS, DAMPED) if is_damped else METHODS


def must_damp(plant: Fraction, bandwidth_Hz: float) -> bool:
    """Whether a loop of this bandwidth must damp the plant's lowest resonance."""
    mode = ringing_mode(plant)
    return mode is not None and bandwidth_Hz > (1.0 + 1e-9) * MODE_SHARE * mode.frequency_Hz


def _describe_delay(plant: Fraction, mode: Mode) -> str:
    """Describe the phase lag of all delays at the mode.

    The delay is the phase delay of the plant at rest, less that of the mode, 2 z / w0.
    """
    delay_s = plant.rest_delay_s - mode.damping / (np.pi * mode.frequency_Hz)
    return (
        f"Hold, converters and all other poles delay the loop by {with_unit(delay_s, 's')}, which "
        f"is {significant(360.0 * mode.frequency_Hz * delay_s)}° at this mode"
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
            f"it as it is. {_describe_delay(nominal, mode)}."
        )
    return (
        f"The mode at {with_unit(mode.frequency_Hz, 'Hz', 4)} is damped by state feedback, from a "
        f"damping ratio of {significant(mode.damping)} to {significant(damping)}. "
        f"{_describe_delay(nominal, mode)}."
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
    band_Hz = (1.0, 0.5 * family.nominal.sampling_rate_Hz)
    small_gain = constant_limit(HYSTERESIS, "Syb", band_Hz, level_dB)
    guarded = replace(default, templates=(*default.templates, small_gain))

    def at_bandwidth(bandwidth_Hz: float) -> Specification:
        return replace(guarded, bandwidth_Hz=bandwidth_Hz, scan_frequency_Hz=bandwidth_Hz / 10.0)

    def is_feasible(bandwidth_Hz: float) -> bool:
        specification = at_bandwidth(bandwidth_Hz)
        tuned = (
            tune_observer(family, specification, form=form, method=method, until_met=True)
            for method in (DAMPED, *METHODS)
        )
        return any(not solution.violations for solution in tuned)

    min_Hz = _MIN_RATIO * max(base.recommended.bandwidth_Hz, MODE_SHARE * mode.frequency_Hz)
    if min_Hz >= mode.frequency_Hz or not is_feasible(min_Hz):
        return base
    # Bisect the largest feasible bandwidth to three digits.
    low, high = np.log(min_Hz), np.log(mode.frequency_Hz)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_feasible(float(np.exp(middle))) else (low, middle)
    bandwidth_Hz = max(rounded_down(float(np.exp(low))), min_Hz)
    for _ in range(_STEPS_DOWN):
        if bandwidth_Hz < min_Hz:
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
