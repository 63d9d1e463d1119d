"""export_stage: a model and a design in, the parameter file of all axes that can ship out.

What keeps a tip from the surface, as the runtime takes it: declared, or derived from physics.

Without current nothing says where the surface is, so the tip extends by a step v in a sample. The
current grows by exp(2 kappa dz): by K v nepers in a sample, K = 2 kappa dz/du. Until the loop
answers, N samples pass:

    N = (delay + 1/(2 pi f_amplifier) + 1/(2 pi f_sensor)) f_s + 2

(one sample to be read, one to be judged), and in them the current may grow by a quarter of the
smaller of its two ways, from the floor to the set point and from there to the ceiling:

    K v N = min(ln(i_set / i_floor), ln(i_ceiling / i_set), ln 10) / 4

with the largest gain, the slowest sensor and the longest delay that the identification allows.
"""

import math

from piezoid.design.converters import converters_of
from piezoid.design.design import AxisDesign, Design
from piezoid.design.junction_task import (
    junction_family,
    loop_plant_of,
    missing_line,
    reading_range_A,
    set_point_A,
)
from piezoid.design.specification import Specification
from piezoid.errors import LabFileError, ParameterFileError, PiezoidError
from piezoid.export.parameter_file import AxisParameters, Decoupled, ParameterFile
from piezoid.export.runtime_parameters import TunnellingGuards, lateral_axis, tunnelling_axis
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.tunnelling.current_noise import CurrentChain
from piezoid.identification.tunnelling.loop_model import LoopPlant
from piezoid.operators.tunnelling import decay_of_barrier
from piezoid.records.lab import Lab

# Nepers: a decade. With ceilings 26 to 88 times the set point as ways, oscillating loops of an
# independent simulator's tips came 0.41 nm closer than it; errors of e^3 are no small signals.
_MOST_ROOM = math.log(10.0)
_MARGIN = 0.25  # of the smaller way, what an approach may grow by before the loop answers
_CONTACT = 1.0 / 3.0  # of the same: nearer to the set point the loop is trusted with its error
_UNHEARD_s = 1e-3  # equal readings for so long are a stuck sensor, where noise moves every one
_CHANCE = 1e-12  # of one run of equal readings from a sound sensor; a day has 1e9 readings
_LONGEST = 200  # samples: a sensor that rests longer than this is not watched for being stuck
_WINDOW_s, _CYCLES = 1.0, 4.0  # at least a second, or the longest wait and four ways back
_MOST_DOUBLED = 10  # of the runtime
_MOST_SAMPLES = 1_000_000  # what the runtime counts to

# A sensor is stuck if it shows one number for so long while the drive moves by this share of its
# range.
_STUCK_s = 1e-3
_STUCK_SHARE = 0.02
# So long the model may fly on alone: five times the loss of 20 ms that verification runs, and
# before creep, which grows with the logarithm of time, has moved what the observer cannot see.
_BLIND_s = 0.1


def export_stage(
    model: ActuatorModel, design: Design, *, design_digest: str, lab: Lab | None = None
) -> ParameterFile:
    """Return what ships: each designed axis with its recommended loop, the others to compare.

    An axis that cannot ship keeps no other back; the file says which it is and why.

    design_digest  of the design's file, for the chain of digests
    lab            that of the design, but for what guards a tip

    Raises ``ParameterFileError`` where lab.toml declares another rig than the design was made for,
    and what stands in the way of the first axis where none can ship, as ``LabFileError`` with
    the line to write for a tip whose guards are not declared.
    """
    declared = lab or Lab()
    if declared.rig_digest != design.rig_digest:
        raise ParameterFileError(
            f"{declared.place} declares another rig than the design was made for",
            needed="the converters, amplifiers and set point of the design",
            remedy="Run `piezoid design` again, then everything that follows it.",
        )
    shipped: list[AxisParameters] = []
    refused: dict[str, PiezoidError] = {}
    for axis in design.axes:
        try:
            shipped.append(_axis(model, axis, declared))
        except PiezoidError as refusal:
            refused[axis.axis] = refusal
    if not shipped:
        raise next(iter(refused.values()))
    unshipped = {name: str(refusal) for name, refusal in refused.items()}
    decoupling, decoupled = design.decoupling, None
    if decoupling is not None and {axis.axis for axis in shipped} & set(decoupling.axes):
        decoupled = Decoupled(axes=decoupling.axes, matrix=decoupling.matrix)
    return ParameterFile(
        name=model.stage,
        axes=tuple(shipped),
        sources={
            "model": design.model_digest,
            "design": design_digest,
            "lab": declared.digest,
            "control": declared.control_digest,
        },
        unshipped={**design.refused, **unshipped},
        decoupled=decoupled,
    )


def _axis(model: ActuatorModel, design: AxisDesign, lab: Lab) -> AxisParameters:
    specification = design.specification
    rate_Hz = design.recommended.members[0].sampling_rate_Hz
    if design.output_unit != "m":
        if model.tunnelling is None:
            raise ParameterFileError(
                f"axis {design.axis} regulates a current, and model.json has no junction",
                needed="the junction this controller was designed for",
                remedy="Fit again with the recordings of the tip.",
            )
        loop = loop_plant_of(model.tunnelling)
        return tunnelling_axis(design, tip_guards(lab, specification, rate_Hz, loop))
    watch = {
        "blind_samples": max(round(_BLIND_s * rate_Hz), 1),
        "stuck_samples": max(round(_STUCK_s * rate_Hz), 1),
        "stuck_voltage_V": _STUCK_SHARE
        * (specification.voltage_max_V - specification.voltage_min_V),
    }
    return lateral_axis(model[design.axis], design, watch)


def tip_guards(
    lab: Lab, specification: Specification, rate_Hz: float, loop: LoopPlant
) -> TunnellingGuards:
    """Return the guards of the tunnelling axis.

    specification    its voltage limits
    rate_Hz  of the controller
    loop     the junction as it was identified: its gain, poles and delay bound the approach

    Without ``retract_V`` a latched tip goes to the lowest command: a rising drive extends it.

    Raises ``LabFileError`` with the line to write where set point, floor or ceiling is missing,
    and where they do not follow each other, the ceiling cannot be read, the tip would retract out
    of range or approach faster than its loop can answer.
    """
    reference_A, floor_A, ceiling_A = _currents(lab, loop)
    declared = lab.tunnelling
    retract_V = specification.voltage_min_V if declared.retract_V is None else declared.retract_V
    if not specification.voltage_min_V <= retract_V <= specification.voltage_max_V:
        raise _useless(
            lab,
            f"retract_V is {retract_V:g}",
            f"a voltage from {specification.voltage_min_V:g} to {specification.voltage_max_V:g} V",
        )
    room = min(math.log(reference_A / floor_A), math.log(ceiling_A / reference_A), _MOST_ROOM)
    bound = _MARGIN * room / reaction_samples(loop, rate_Hz)
    steepest = max(
        loop.gain_interval[1], *(m.gain_nepers_per_V for m in junction_family(loop, lab))
    )
    m_per_V = extension_m_per_V(loop)
    step_V = _step_V(lab, bound / steepest, m_per_V * rate_Hz)
    longest_s = declared.retract_s * 2.0 ** min(declared.retract_limit, _MOST_DOUBLED)
    way_m, speed_m_per_s = (
        declared.retract_m + declared.search_m,
        step_V * m_per_V * rate_Hz,
    )
    window_s = max(_WINDOW_s, longest_s + _CYCLES * way_m / speed_m_per_s)
    contact_A = reference_A * math.exp(-_CONTACT * room)
    stuck_samples, stuck_current_A = _watch(lab, loop, rate_Hz, contact_A)
    bad_samples = max(round(declared.lost_s * rate_Hz), 1)
    return TunnellingGuards(
        reference_A=reference_A,
        floor_A=floor_A,
        ceiling_A=ceiling_A,
        retract_voltage_V=retract_V,
        retract_step_V=declared.retract_m / m_per_V,
        retract_samples=max(round(declared.retract_s * rate_Hz), 1),
        bad_samples=bad_samples,
        contact_samples=bad_samples,
        approach_step_V=step_V,
        approach_log_step=step_V * steepest,
        contact_log=_CONTACT * room,
        search_voltage_V=declared.search_m / m_per_V,
        trip_limit=declared.retract_limit,
        trip_samples=min(round(window_s * rate_Hz), _MOST_SAMPLES),
        stuck_samples=stuck_samples,
        stuck_current_A=stuck_current_A,
        stuck_voltage_V=_CONTACT * room / loop.plant.gain_nepers_per_V,
    )


def reaction_samples(loop: LoopPlant, rate_Hz: float) -> float:
    """Return N, how many samples an approach goes on before its loop answers, at the most."""
    sensor_Hz = min(loop.plant.sensor_pole_Hz, loop.sensor_pole_interval_Hz[0])
    delay_s = max(loop.plant.delay_s, loop.delay_interval_s[1])
    poles_s = (1.0 / loop.plant.amplifier_pole_Hz + 1.0 / sensor_Hz) / (2.0 * math.pi)
    return (delay_s + poles_s) * rate_Hz + 2.0


def extension_m_per_V(loop: LoopPlant) -> float:
    """Return dz/du, metres of extension per volt of command: declared, or K / (2 kappa)."""
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
        raise _useless(
            lab,
            f"floor_A, set_point_A and ceiling_A are {declared.floor_A:g}, {reference_A:g} and "
            f"{declared.ceiling_A:g} A",
            "a floor below the set point and a ceiling above it",
        )
    readable_A = reading_range_A(lab, loop.axis)
    if readable_A is not None and declared.ceiling_A >= max(map(abs, readable_A)):
        raise _useless(
            lab,
            f"ceiling_A is {declared.ceiling_A:g}, and {declared.feedback_ohm:g} ohm and the "
            f"converter read at most {max(map(abs, readable_A)):g} A",
            "a ceiling that can be read, or the tip never retracts",
        )
    return reference_A, declared.floor_A, declared.ceiling_A


def _step_V(lab: Lab, bound_V: float, speed_of_V: float) -> float:
    """Return the approach's step, declared or the largest; ``speed_of_V`` is m/s per volt."""
    declared_m_per_s = lab.tunnelling.approach_m_per_s
    if declared_m_per_s is None:
        return bound_V
    if declared_m_per_s > bound_V * speed_of_V:
        raise _useless(
            lab,
            f"approach_m_per_s is {declared_m_per_s:g}",
            f"at most {bound_V * speed_of_V:.3g} m/s, where this loop still answers in time",
        )
    return declared_m_per_s / speed_of_V


def _watch(lab: Lab, loop: LoopPlant, rate_Hz: float, contact_A: float) -> tuple[int, float]:
    """Return after how many equal readings a sensor is stuck, and below which current it may rest.

    A dark sensor is watched too, where its Johnson noise alone moves its readings.
    """
    usual = max(round(_UNHEARD_s * rate_Hz), 1)
    step_V, ohm = converters_of(lab, loop.axis).reading_step_V, lab.tunnelling.feedback_ohm
    if ohm is None or step_V == 0.0 or lab.tunnelling.floor_A is None:
        return max(usual, _LONGEST), lab.tunnelling.floor_A or 0.0
    dark, lit = (
        _equal_readings(loop, rate_Hz, ohm, step_V / ohm, current_A)
        for current_A in (0.0, contact_A)
    )
    if dark <= _LONGEST:
        return max(usual, dark), -1.0
    return max(usual, min(lit, _LONGEST)), lab.tunnelling.floor_A


def _equal_readings(
    loop: LoopPlant, rate_Hz: float, ohm: float, step_A: float, current_A: float
) -> int:
    """Return the shortest run of equal readings that a sound sensor never shows.

        p = erf(step / (2 sqrt(2) s)),   p^n <= chance

    p  two readings in a row are in one converter step; s  the Johnson and shot noise that came
    between them, all of it but what a first-order sensor carries over
    """
    pole_Hz = loop.plant.sensor_pole_Hz
    carried = math.exp(-2.0 * math.pi * pole_Hz / rate_Hz)
    chain = CurrentChain(bandwidth_Hz=0.5 * math.pi * pole_Hz, feedback_ohm=ohm)
    fresh_A = math.hypot(chain.johnson_A, chain.shot_A(current_A)) * math.sqrt(1.0 - carried**2)
    equal = math.erf(step_A / (2.0 * math.sqrt(2.0) * fresh_A))
    return _MOST_SAMPLES if equal >= 1.0 else math.ceil(math.log(_CHANCE) / math.log(equal))


def _useless(lab: Lab, fault: str, needed: str) -> LabFileError:
    return LabFileError(
        f"{lab.place}: {fault}",
        needed=needed,
        remedy=f"Correct [tunnelling] in {lab.place} and export again.",
    )
