"""Guards of a tunnelling tip, as runtime parameters: declared in lab.toml or derived from physics.

Without current the position of the surface is unknown, so the tip extends by a step v per sample.
The current grows by exp(2 kappa dz): by K v nepers per sample, K = 2 kappa dz/du. The loop
responds after N samples:

    N = (delay + 1/(2 pi f_amplifier) + 1/(2 pi f_sensor)) f_s + 2

(one sample for the reading, one for the computation). During this time the current may grow by a
quarter of the smallest of three: the distances from the floor to the set point and from the set
point to the ceiling, and a decade:

    K v N = min(ln(i_set / i_floor), ln(i_ceiling / i_set), ln 10) / 4

with the largest gain, the slowest sensor and the longest delay that the identification allows.
"""

import math

from numpy.typing import ArrayLike

from piezoid.design.junction_task import (
    current_chain,
    junction_family,
    missing_line,
    reading_range_A,
    set_point_A,
)
from piezoid.design.specification import Specification, converters_of
from piezoid.errors import LabFileError
from piezoid.identification.tunnelling.closed_loop import LoopPlant
from piezoid.operators.tunnelling import decay_of_barrier
from piezoid.records.lab import Lab

# Nepers: a decade. With ceilings of 26 to 88 times the set point as limits, oscillating loops of
# tips of an independent simulator came 0.41 nm closer than the set point; errors of e^3 are not
# small signals.
_MAX_DISTANCE = math.log(10.0)
_MARGIN = 0.25  # share of the distance by which the current may grow before the loop responds
_CONTACT = 1.0 / 3.0  # share of the distance from the set point within which the loop regulates
_STUCK_s = 1e-3  # duration of equal readings of a stuck sensor, if noise moves every reading
_CHANCE = 1e-12  # probability of a run of equal readings of a sound sensor; 1e9 readings per day
_MAX_STUCK = 200  # samples, beyond which equal readings are not taken for a stuck sensor
_WINDOW_s, _CYCLES = 1.0, 4.0  # at least a second, or the longest wait and four returns
_MAX_DOUBLINGS = 10  # of the runtime
_MAX_SAMPLES = 1_000_000  # of the counters of the runtime


def tip_guards(
    lab: Lab, specification: Specification, rate_Hz: float, loop: LoopPlant
) -> dict[str, ArrayLike | str]:
    """Return the guards of the tunnelling axis under the runtime's names (``runtime/schema.py``).

    specification  its voltage limits
    rate_Hz        of the controller
    loop           identified junction: its gain, poles and delay bound the approach

    Without ``retract_V`` a latched tip goes to the lowest command: a rising drive extends it.

    Raises ``LabFileError`` with the line to write if set point, floor or ceiling is missing, and
    if they are not in order, if the ceiling cannot be measured, or if the tip would retract out of
    range or approach too fast for its loop.
    """
    reference_A, floor_A, ceiling_A = _currents(lab, loop)
    declared = lab.tunnelling
    retract_V = specification.voltage_min_V if declared.retract_V is None else declared.retract_V
    if not specification.voltage_min_V <= retract_V <= specification.voltage_max_V:
        raise _unusable(
            lab,
            f"retract_V is {retract_V:g}",
            f"a voltage from {specification.voltage_min_V:g} to {specification.voltage_max_V:g} V",
        )
    distance = min(
        math.log(reference_A / floor_A), math.log(ceiling_A / reference_A), _MAX_DISTANCE
    )
    largest_gain = max(
        loop.gain_interval[1], *(m.gain_nepers_per_V for m in junction_family(loop, lab))
    )
    m_per_V = extension_m_per_V(loop)
    # N, the largest number of samples before the loop responds to an approach
    sensor_Hz = min(loop.plant.sensor_pole_Hz, loop.sensor_pole_interval_Hz[0])
    delay_s = max(loop.plant.delay_s, loop.delay_interval_s[1])
    poles_s = (1.0 / loop.plant.amplifier_pole_Hz + 1.0 / sensor_Hz) / (2.0 * math.pi)
    reaction_samples = (delay_s + poles_s) * rate_Hz + 2.0
    bound_V = _MARGIN * distance / reaction_samples / largest_gain
    step_V, speed_m_per_s = bound_V, declared.approach_m_per_s
    if speed_m_per_s is not None:
        step_V = speed_m_per_s / (m_per_V * rate_Hz)
        if speed_m_per_s > bound_V * (m_per_V * rate_Hz):
            raise _unusable(
                lab,
                f"approach_m_per_s is {speed_m_per_s:g}",
                f"at most {bound_V * (m_per_V * rate_Hz):.3g} m/s, so that the loop responds in "
                "time",
            )
    longest_s = declared.retract_s * 2.0 ** min(declared.retract_limit, _MAX_DOUBLINGS)
    distance_m = declared.retract_m + declared.search_m
    window_s = max(_WINDOW_s, longest_s + _CYCLES * distance_m / (step_V * m_per_V * rate_Hz))
    contact_A = reference_A * math.exp(-_CONTACT * distance)
    stuck_samples, stuck_current_A = _stuck_sensor(lab, loop, rate_Hz, contact_A)
    bad_samples = max(round(declared.lost_s * rate_Hz), 1)
    return {
        "current_reference_A": reference_A,
        "current_floor_A": floor_A,
        "current_ceiling_A": ceiling_A,
        "retract_voltage_V": retract_V,
        "retract_step_V": declared.retract_m / m_per_V,
        "retract_samples": max(round(declared.retract_s * rate_Hz), 1),
        "bad_samples": bad_samples,
        "contact_samples": bad_samples,
        "approach_step_V": step_V,
        "approach_log_step": step_V * largest_gain,
        "contact_log": _CONTACT * distance,
        "search_voltage_V": declared.search_m / m_per_V,
        "trip_limit": declared.retract_limit,
        "trip_samples": min(round(window_s * rate_Hz), _MAX_SAMPLES),
        "stuck_samples": stuck_samples,
        "stuck_current_A": stuck_current_A,
        "stuck_voltage_V": _CONTACT * distance / loop.plant.gain_nepers_per_V,
    }


def extension_m_per_V(loop: LoopPlant) -> float:
    """Return dz/du, the extension per volt of command: declared, or K / (2 kappa)."""
    if loop.rig is not None:
        return loop.rig.drive_gain_m_per_V
    return loop.plant.gain_nepers_per_V / decay_of_barrier(loop.barrier_eV)


def _currents(lab: Lab, loop: LoopPlant) -> tuple[float, float, float]:
    declared = lab.tunnelling
    reference_A = set_point_A(lab)
    if declared.floor_A is None:
        raise missing_line(lab, "floor_A = 1e-11", "the current below which the tip is lost")
    if declared.ceiling_A is None:
        raise missing_line(lab, "ceiling_A = 1e-8", "the current from which the tip retracts")
    if not declared.floor_A < reference_A < declared.ceiling_A:
        raise _unusable(
            lab,
            f"floor_A, set_point_A and ceiling_A are {declared.floor_A:g}, {reference_A:g} and "
            f"{declared.ceiling_A:g} A",
            "a floor below the set point and a ceiling above it",
        )
    range_A = reading_range_A(lab, loop.axis)
    if range_A is not None and declared.ceiling_A >= max(map(abs, range_A)):
        raise _unusable(
            lab,
            f"ceiling_A is {declared.ceiling_A:g}, and {declared.feedback_ohm:g} ohm and the "
            f"converter read at most {max(map(abs, range_A)):g} A",
            "a ceiling within the range of the reading, or the tip never retracts",
        )
    return reference_A, declared.floor_A, declared.ceiling_A


def _stuck_sensor(
    lab: Lab, loop: LoopPlant, rate_Hz: float, contact_A: float
) -> tuple[int, float]:
    """Return the number of equal readings of a stuck sensor, and the current above which it
    counts.

    A run of n equal readings of a sound sensor has a negligible probability:

        p = erf(step / (2 sqrt(2) s)),   p^n <= chance

    p is the probability that two consecutive readings lie in the same converter step, and s the
    innovation of the Johnson and shot noise behind a first-order sensor. The current is -1 A if
    Johnson noise alone moves the readings of a sensor without current.
    """
    min_samples = max(round(_STUCK_s * rate_Hz), 1)
    step_V, ohm = converters_of(lab, loop.axis).reading_step_V, lab.tunnelling.feedback_ohm
    if ohm is None or step_V == 0.0 or lab.tunnelling.floor_A is None:
        return max(min_samples, _MAX_STUCK), lab.tunnelling.floor_A or 0.0
    chain = current_chain(loop.plant, lab, loop.axis)
    pole = math.exp(-2.0 * math.pi * loop.plant.sensor_pole_Hz / rate_Hz)
    innovation = math.sqrt(1.0 - pole**2)
    samples = []
    for current_A in (0.0, contact_A):
        innovation_A = math.hypot(chain.johnson_A, chain.shot_A(current_A)) * innovation
        p = math.erf(chain.adc_step_A / (2.0 * math.sqrt(2.0) * innovation_A))
        samples.append(_MAX_SAMPLES if p >= 1.0 else math.ceil(math.log(_CHANCE) / math.log(p)))
    without_current, in_contact = samples
    if without_current <= _MAX_STUCK:
        return max(min_samples, without_current), -1.0
    return max(min_samples, min(in_contact, _MAX_STUCK)), lab.tunnelling.floor_A


def _unusable(lab: Lab, fault: str, needed: str) -> LabFileError:
    return LabFileError(
        f"{lab.place}: {fault}",
        needed=needed,
        remedy=f"Correct [tunnelling] in {lab.place} and export again.",
    )
