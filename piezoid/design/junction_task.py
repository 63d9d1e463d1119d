"""Plant family, default specification and design of the tunnelling axis.

    y = ln(i / i_0),    dy/du = K wa/(s + wa) wi/(s + wi) e^(-s tau)

K, the sensor's pole and the delay come from the closed-loop identification with their family.
lab.toml declares voltages, set point, and what determines the noise of the reading.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezoid.design.design import AxisDesign, assemble_loop
from piezoid.design.feasibility import refuse, severity
from piezoid.design.plant import Plant, PlantFamily, sampled_plant
from piezoid.design.sensitivity import Template, Violation
from piezoid.design.shaping import optimise, shape
from piezoid.design.specification import Specification, converters_of, default_specification
from piezoid.errors import DesignError, LabFileError
from piezoid.formatting import with_unit
from piezoid.identification.loop_model import DECLARED_SPREAD
from piezoid.identification.tunnelling.closed_loop import LoopPlant
from piezoid.identification.tunnelling.junction import TunnellingModel
from piezoid.identification.tunnelling.junction_plant import DriveMode, JunctionPlant
from piezoid.identification.tunnelling.loop_noise import CurrentChain
from piezoid.numerics.polynomial import decibel
from piezoid.operators.linear import cascade, first_order
from piezoid.operators.tunnelling import decay_of_barrier
from piezoid.records.lab import Lab

_TRIAL_ITERATIONS = 2  # convex problems that decide whether a bandwidth is feasible
_FIGURE = "max over members and f <= bandwidth of |Syp| bandwidth / f"

_DEFAULT_AXIS = "z"
_ROUGHNESS_m = 1e-10  # rms, of an atomically flat terrace with a step or two
_MODE_MARGIN = 0.5  # of the small gain, as of the modulus
_LOWEST_MODE = 0.01  # of the sampling rate: no drive of a tip resonates lower
_INSTANTANEOUS = 5.0  # sampling rates, beyond which a pole is instantaneous
_LAST_DIGIT = 2.0**-52  # smallest sampled pole that has a state: 5.7 sampling rates


def vertical_task(tunnelling: TunnellingModel, lab: Lab) -> tuple[PlantFamily, Specification]:
    """Return family and default specification of the tunnelling axis.

    The family is the junctions that the loop must stabilise, nominal first.

    The noise of the reading is the physical minimum, in nepers: shot noise at the set point, and
    Johnson noise and converter step if resistor and bits are declared, relative to the set point.

    Raises ``DesignError`` if only sweeps were recorded, from which no dynamics can be identified,
    and ``LabFileError``, with the line to write, if voltage range or set point is not declared.
    """
    loop = loop_plant_of(tunnelling)
    axis = axis_of(tunnelling)
    converters = converters_of(lab, axis)
    if converters.command_V is None or not all(map(math.isfinite, converters.command_V)):
        meaning = "the voltage range of the height's drive"
        raise missing_line(lab, "input_range_V = [-10, 10]", meaning, "[acquisition]")
    low_V, high_V = converters.command_V
    if not low_V < high_V:
        raise LabFileError(
            f"{lab.place}: converter and amplifier have no voltage in common ({low_V:g} V to "
            f"{high_V:g} V)",
            needed="overlapping voltage ranges",
            remedy="Correct input_range_V of [acquisition] or the outputs of [amplifier].",
        )
    members = junction_family(loop, lab)
    amplifier_Hz, sensor_Hz = members[0].amplifier_pole_Hz, members[0].sensor_pole_Hz
    rate_Hz = members[0].sampling_rate_Hz
    if min(amplifier_Hz, sensor_Hz) > _INSTANTANEOUS * rate_Hz:
        raise DesignError(
            f"axis {axis}: amplifier ({amplifier_Hz:.4g} Hz) and current sensor "
            f"({sensor_Hz:.4g} Hz) are instantaneous at {rate_Hz:g} Hz",
            needed="a pole that limits the speed of the loop",
            remedy=f"Declare bandwidth_Hz of [axis.{axis}.amplifier] and fit again.",
        )
    family = PlantFamily(members=tuple(_sample(m, index) for index, m in enumerate(members)))
    noise = reading_noise_A(loop.plant, lab, axis) / set_point_A(lab)
    default = default_specification(
        family,
        voltage_min_V=low_V,
        voltage_max_V=high_V,
        sensor_noise_rms=noise,
        disturbance_rms=decay_of_barrier(loop.barrier_eV) * _ROUGHNESS_m,
    )
    return family, replace(
        default,
        voltage_step_V=converters.command_step_V,
        templates=(*default.templates, *_limit_at_modes(loop.modes, loop.plant)),
    )


def _limit_at_modes(modes: Sequence[DriveMode], plant: JunctionPlant) -> tuple[Template, ...]:
    """Return the limit of Syb that keeps modes of the drive from oscillating; empty without modes.

    Small gain: with the mode the plant is G (1 + D), D = a (M - 1), and |Syb| <= margin / |D|
    stabilises the loop for any phase. |D| is the largest of all records and of all shifts of the
    frequency by the uncertainty of a data sheet.
    """
    if not modes:
        return ()
    f = np.geomspace(_LOWEST_MODE * plant.sampling_rate_Hz, 0.5 * plant.sampling_rate_Hz, 200)
    deviations = [
        np.abs(mode.response(f * (1.0 + shift)) - 1.0)
        for mode in modes
        for shift in np.linspace(-DECLARED_SPREAD, DECLARED_SPREAD, 21)
    ]
    largest = np.max(deviations, axis=0)
    is_limited = largest > _MODE_MARGIN
    if not is_limited.any():
        return ()
    first = int(np.argmax(is_limited))
    return (
        Template(
            name="mode of the drive",
            function="Syb",
            frequency_Hz=f[first:],
            upper_dB=np.asarray(decibel(_MODE_MARGIN / largest[first:])),
        ),
    )


def axis_of(tunnelling: TunnellingModel) -> str:
    """Return the name of the axis that regulates the current; default: z."""
    loop = tunnelling.loop_plant
    return _DEFAULT_AXIS if loop is None or not loop.axis else loop.axis


def loop_plant_of(tunnelling: TunnellingModel) -> LoopPlant:
    """Return the plant that was identified in closed loop.

    Raises ``DesignError`` with the recording to make if there is none.
    """
    if tunnelling.loop_plant is None:
        raise DesignError(
            f"axis {_DEFAULT_AXIS}: sweeps determine the barrier, but not the dynamics of the "
            "junction",
            needed="a recording of the closed loop with a dither that is independent of the "
            "current",
            remedy="Record drive, current and dither while the tip tunnels, and fit again.",
        )
    return tunnelling.loop_plant


def junction_family(loop: LoopPlant, lab: Lab) -> tuple[JunctionPlant, ...]:
    """Return the junctions that a controller must stabilise, nominal first.

    These are the family of the identification, and the nominal junction at both ends of the
    barrier range that lab.toml declares: the gain is proportional to the root of the barrier.
    """
    nominal = loop.plant
    extremes = [
        replace(
            nominal,
            gain_nepers_per_V=nominal.gain_nepers_per_V * math.sqrt(barrier_eV / loop.barrier_eV),
        )
        for barrier_eV in lab.tunnelling.barrier_range_eV or ()
    ]
    return (*loop.family, *extremes)


def set_point_A(lab: Lab) -> float:
    """Return the magnitude of the declared set point.

    Raises ``LabFileError`` with the line to write if lab.toml declares none.
    """
    set_point_A = lab.tunnelling.set_point_A
    if set_point_A is None:
        raise missing_line(lab, "set_point_A = 1e-9", "the current that the loop regulates")
    return abs(set_point_A)


def current_chain(plant: JunctionPlant, lab: Lab, axis: str) -> CurrentChain:
    """Return bandwidth, resistor and converter of the current readings, as lab.toml declares them.

    The bandwidth of a first-order sensor is B = pi f / 2.
    """
    resistor_ohm = lab.tunnelling.feedback_ohm
    return CurrentChain(
        bandwidth_Hz=0.5 * math.pi * plant.sensor_pole_Hz,
        feedback_ohm=resistor_ohm,
        adc_step_A=converters_of(lab, axis).reading_step_V / (resistor_ohm or math.inf),
    )


def reading_noise_A(plant: JunctionPlant, lab: Lab, axis: str) -> float:
    """Return the physical minimum of the rms noise of one current reading at the set point.

    sqrt(2 e i B + 4 k T B / R + step^2 / 12)
    """
    chain = current_chain(plant, lab, axis)
    return math.hypot(chain.shot_A(set_point_A(lab)), chain.johnson_A, chain.quantisation_A)


def reading_range_A(lab: Lab, axis: str) -> tuple[float, float] | None:
    """Return the range of currents of resistor and converter, or None if it is unknown.

    ``input_range_V`` is the range of both converters. If the set point lies at or beyond its end,
    it can only be the range of the drive's converter.
    """
    reading_V, resistor_ohm = converters_of(lab, axis).reading_V, lab.tunnelling.feedback_ohm
    if reading_V is None or resistor_ohm is None:
        return None
    low_A, high_A = reading_V[0] / resistor_ohm, reading_V[1] / resistor_ohm
    return (low_A, high_A) if max(-low_A, high_A) > set_point_A(lab) else None


def missing_line(lab: Lab, line: str, meaning: str, table: str = "[tunnelling]") -> LabFileError:
    """Return the error for a missing declaration about the tip, with the line to write."""
    return LabFileError(
        f"{lab.place}: {table} does not declare {line.split(' ')[0]}, {meaning}",
        needed="a declaration: numbers that keep a tip from the surface are never guessed",
        remedy=f"Write, with your own number, `{line}` under {table}.",
    )


def _sample(junction: JunctionPlant, index: int) -> Plant:
    """Sample one member of the family; poles that leave no trace in a sample have no state."""
    description = (
        f"{junction.gain_nepers_per_V:.4g} nepers/V, sensor "
        f"{1e-3 * junction.sensor_pole_Hz:.3g} kHz, delay {with_unit(junction.delay_s, 's')}"
    )
    rate_Hz = junction.sampling_rate_Hz
    poles_Hz = (junction.amplifier_pole_Hz, junction.sensor_pole_Hz)
    poles = [
        first_order(pole_Hz)
        for pole_Hz in poles_Hz
        if math.exp(-2.0 * math.pi * pole_Hz / rate_Hz) >= _LAST_DIGIT
    ]
    chain = cascade(*poles)
    return sampled_plant(
        description if index else f"nominal: {description}",
        replace(chain, B=chain.B * junction.gain_nepers_per_V, delay_s=junction.delay_s),
        rate_Hz,
        output_unit="1",
    )


def design_vertical(axis: str, family: PlantFamily, specification: Specification) -> AxisDesign:
    """Design R, S, T of the tunnelling axis by band-stops and by convex steps, and choose one.

    family  for example over a range of barriers: the loop gain is proportional to their root

    The feasible controller with the better rejection over the whole family is chosen. Raises
    ``TemplateError`` if neither controller meets the specification.
    """

    def attempt(candidate: Specification) -> tuple[Violation, ...]:
        """Return the violations by band-stops or by a few convex steps, whichever are smaller."""
        shaped = shape(family, candidate)
        if not shaped.violations:
            return ()
        start = shaped.controller
        convex = optimise(family, candidate, start, max_iterations=_TRIAL_ITERATIONS)
        return min(shaped.violations, convex.violations, key=severity)

    shaped = shape(family, specification)
    solutions = (shaped, optimise(family, specification, shaped.controller))
    smallest = min((solution.violations for solution in solutions), key=severity)
    if smallest:
        refuse(axis, specification, smallest, attempt)
    bandwidth_Hz = specification.bandwidth_Hz
    loop = assemble_loop("rst", family.fractions, bandwidth_Hz, solutions, _FIGURE)
    return AxisDesign(
        axis=axis,
        output_unit=family.nominal.output_unit,
        specification=specification,
        loops=(loop,),
    )
