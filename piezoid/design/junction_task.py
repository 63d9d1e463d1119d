"""Plant family, default specification and design of the tunnelling axis.

    y = ln(i / i_0),    dy/du = K wa/(s + wa) wi/(s + wi) e^(-s tau)

K, the sensor's pole and the delay come from the closed-loop identification with their family;
voltages, set point and the reading's noise are the laboratory's to say.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from piezoid.design.converters import converters_of
from piezoid.design.design import (
    AxisDesign,
    Candidate,
    LoopDesign,
    REPORTED_Hz,
    reached_margins,
    rejections,
)
from piezoid.design.feasibility import refuse, severity, unmet
from piezoid.design.feedforward import fit_reference_path
from piezoid.design.plant import Chain, PlantFamily, Section, family_from_chains
from piezoid.design.shaping import ShapedController, shape
from piezoid.design.specification import Specification, default_specification
from piezoid.design.templates import Template, Violation
from piezoid.design.youla import ConvexController, optimise
from piezoid.errors import DesignError, LabFileError
from piezoid.formatting import with_unit
from piezoid.identification.loop_model import DECLARED_SPREAD
from piezoid.identification.tunnelling.junction_plant import DriveMode, JunctionPlant
from piezoid.identification.tunnelling.loop_model import LoopPlant
from piezoid.identification.tunnelling.loop_noise import CurrentChain
from piezoid.identification.tunnelling.model import TunnellingModel
from piezoid.numerics.frequency import decibel
from piezoid.operators.tunnelling import decay_of_barrier
from piezoid.records.lab import Lab

_ATTEMPTED = 2
_FIGURE = "max over members and f <= bandwidth of |Syp| bandwidth / f"

USUAL_AXIS = "z"
_ROUGHNESS_m = 1e-10  # what a loop meets on an atomically flat terrace with a step or two
MODE_MARGIN = 0.5  # of the small gain, as of the modulus
_LOWEST_SHARE = 0.01  # of the sampling rate: no drive of a tip rings lower
_SLOWEST_SHARE = 5.0  # a pole beyond so many sampling rates is instantaneous


@dataclass(frozen=True, kw_only=True)
class VerticalTask:
    """Inputs of the design of the tunnelling axis.

    axis           its name
    family         the junctions it has to hold, nominal first
    specification  default, to be overruled by what is asked
    """

    axis: str
    family: PlantFamily
    specification: Specification


def vertical_task(tunnelling: TunnellingModel, lab: Lab) -> VerticalTask:
    """Return family and default specification of the tunnelling axis.

    The reading's noise is the least there can be: shot noise at the set point, Johnson noise and
    converter step where resistor and bits are declared, all divided by the set point, in nepers.

    Raises ``DesignError`` where only sweeps were recorded, whose gap law knows no dynamics, and
    ``LabFileError``, with the line to write, where voltage range or set point is not declared.
    """
    loop = loop_plant_of(tunnelling)
    axis = axis_of(tunnelling)
    converters = converters_of(lab, axis)
    if converters.command_V is None or not all(map(math.isfinite, converters.command_V)):
        meaning = "the voltages the height's drive may take"
        raise missing_line(lab, "input_range_V = [-10, 10]", meaning, "[acquisition]")
    low_V, high_V = converters.command_V
    if not low_V < high_V:
        raise LabFileError(
            f"{lab.place}: converter and amplifier have no voltage in common ({low_V:g} V to "
            f"{high_V:g} V)",
            needed="a range of commands that both can take",
            remedy="Correct input_range_V of [acquisition] or the outputs of [amplifier].",
        )
    members = junction_family(loop, lab)
    amplifier_Hz, sensor_Hz = members[0].amplifier_pole_Hz, members[0].sensor_pole_Hz
    rate_Hz = members[0].sampling_rate_Hz
    if min(amplifier_Hz, sensor_Hz) > _SLOWEST_SHARE * rate_Hz:
        raise DesignError(
            f"axis {axis}: amplifier ({amplifier_Hz:.4g} Hz) and current sensor "
            f"({sensor_Hz:.4g} Hz) are instantaneous at {rate_Hz:g} Hz",
            needed="a pole that limits the speed of the loop",
            remedy=f"Declare bandwidth_Hz of [axis.{axis}.amplifier] and fit again.",
        )
    chains = [_chain(member, index) for index, member in enumerate(members)]
    family = family_from_chains(chains[0], chains[1:])
    noise = reading_noise_A(loop.plant, lab, axis) / set_point_A(lab)
    default = default_specification(
        family,
        voltage_min_V=low_V,
        voltage_max_V=high_V,
        sensor_noise_rms=noise,
        disturbance_rms=decay_of_barrier(loop.barrier_eV) * _ROUGHNESS_m,
    )
    return VerticalTask(
        axis=axis,
        family=family,
        specification=replace(
            default,
            voltage_step_V=converters.command_step_V,
            templates=(*default.templates, *_limit_at_modes(loop.modes, loop.plant)),
        ),
    )


def _limit_at_modes(modes: Sequence[DriveMode], plant: JunctionPlant) -> tuple[Template, ...]:
    """Return the limit of Syb that keeps a mode of the drive from oscillating, if there is one.

    Small gain: with the mode the plant is G (1 + D), D = a (M - 1), and |Syb| <= margin / |D|
    holds the loop together whatever the phase. Between the records, and where a mode is off by
    as much as a data sheet is, the largest |D| counts.
    """
    if not modes:
        return ()
    f = np.geomspace(_LOWEST_SHARE * plant.sampling_rate_Hz, 0.5 * plant.sampling_rate_Hz, 200)
    deviations = [
        np.abs(mode.response(f * (1.0 + shift)) - 1.0)
        for mode in modes
        for shift in np.linspace(-DECLARED_SPREAD, DECLARED_SPREAD, 21)
    ]
    largest = np.max(deviations, axis=0)
    limited = largest > MODE_MARGIN
    if not limited.any():
        return ()
    first = int(np.argmax(limited))
    return (
        Template(
            name="mode of the drive",
            function="Syb",
            frequency_Hz=f[first:],
            upper_dB=np.asarray(decibel(MODE_MARGIN / largest[first:])),
        ),
    )


def axis_of(tunnelling: TunnellingModel) -> str:
    """Return the name of the axis that regulates the current; default: z."""
    loop = tunnelling.loop_plant
    return USUAL_AXIS if loop is None or not loop.axis else loop.axis


def loop_plant_of(tunnelling: TunnellingModel) -> LoopPlant:
    """Return the plant found in closed loop, or refuse naming the recording that is missing."""
    if tunnelling.loop_plant is None:
        raise DesignError(
            f"axis {USUAL_AXIS}: sweeps give the barrier, but not how fast the junction answers",
            needed="a recording of the closed loop with a dither that depends on nothing measured",
            remedy="Record drive, current and dither while the tip tunnels, and fit again.",
        )
    return tunnelling.loop_plant


def junction_family(loop: LoopPlant, lab: Lab) -> tuple[JunctionPlant, ...]:
    """Return the junctions a controller has to hold, nominal first.

    The family of the identification, and the nominal junction at both ends of the barriers that
    lab.toml says occur: the gain goes with the root of the barrier.
    """
    declared_eV = lab.tunnelling.barrier_range_eV or ()
    further = [
        replace(
            loop.plant,
            gain_nepers_per_V=loop.plant.gain_nepers_per_V
            * math.sqrt(barrier_eV / loop.barrier_eV),
        )
        for barrier_eV in declared_eV
    ]
    return (*loop.family, *further)


def set_point_A(lab: Lab) -> float:
    """Return the magnitude of the set point, or refuse with the line to write."""
    declared_A = lab.tunnelling.set_point_A
    if declared_A is None:
        raise missing_line(lab, "set_point_A = 1e-9", "the current the loop is to hold")
    return abs(declared_A)


def reading_noise_A(plant: JunctionPlant, lab: Lab, axis: str) -> float:
    """Return the least rms noise of one current reading at the set point.

    sqrt(2 e i B + 4 k T B / R + step^2 / 12),   B = pi f / 2 of a first-order sensor
    """
    converters, resistor_ohm = converters_of(lab, axis), lab.tunnelling.feedback_ohm
    chain = CurrentChain(
        bandwidth_Hz=0.5 * math.pi * plant.sensor_pole_Hz,
        feedback_ohm=resistor_ohm,
        adc_step_A=None if resistor_ohm is None else converters.reading_step_V / resistor_ohm,
    )
    return math.hypot(chain.shot_A(set_point_A(lab)), chain.johnson_A, chain.quantisation_A)


def reading_range_A(lab: Lab, axis: str) -> tuple[float, float] | None:
    """Return the range of currents of resistor and converter, or None if it is unknown.

    ``input_range_V`` is that of both converters; where the set point itself lies at its end or
    beyond it, it can only be that of the drive's.
    """
    reading_V, resistor_ohm = converters_of(lab, axis).reading_V, lab.tunnelling.feedback_ohm
    if reading_V is None or resistor_ohm is None:
        return None
    low_A, high_A = reading_V[0] / resistor_ohm, reading_V[1] / resistor_ohm
    return (low_A, high_A) if max(-low_A, high_A) > set_point_A(lab) else None


def missing_line(lab: Lab, line: str, meaning: str, table: str = "[tunnelling]") -> LabFileError:
    """Return the error of a fact about the tip that lab.toml does not hold."""
    return LabFileError(
        f"{lab.place}: {table} does not say {line.split(' ')[0]}, {meaning}",
        needed="a declaration: what keeps a tip from the surface is never guessed",
        remedy=f"Write, with your own number, `{line}` under {table}.",
    )


def _chain(plant: JunctionPlant, index: int) -> Chain:
    description = (
        f"{plant.gain_nepers_per_V:.4g} nepers/V, sensor {1e-3 * plant.sensor_pole_Hz:.3g} kHz, "
        f"delay {with_unit(plant.delay_s, 's')}"
    )
    return Chain(
        label=description if index else f"nominal: {description}",
        sampling_rate_Hz=plant.sampling_rate_Hz,
        gain=plant.gain_nepers_per_V,
        output_unit="1",
        sections=(
            Section(frequency_Hz=plant.amplifier_pole_Hz),
            Section(frequency_Hz=float(np.minimum(plant.sensor_pole_Hz, 1e9))),
        ),
        delay_s=plant.delay_s,
    )


def design_vertical(
    axis: str, family: PlantFamily, specification: Specification, *, taps: int = 10
) -> AxisDesign:
    """Design R, S, T of the tunnelling axis by band-stops and by convex steps, and choose one.

    family  for example the range of barrier heights: the loop gain goes with their square root
    taps    free coefficients of R' and of S' of the convex problem

    The controller that meets the specification and rejects more over the whole family is chosen.
    Raises ``TemplateError`` where neither meets it.
    """
    shaped = shape(family, specification)
    convex = optimise(family, specification, shaped.controller, taps=taps)
    solutions: dict[str, ShapedController | ConvexController] = {
        "band-stop": shaped,
        "convex": convex,
    }
    missed = {
        name: unmet(family.members, solution.controller.R, solution.controller.S, specification)
        for name, solution in solutions.items()
    }
    feasible = [name for name in solutions if not missed[name]]
    if not feasible:
        least_missed = min(missed.values(), key=severity)
        refuse(axis, specification, least_missed, partial(_attempt, family, taps))
    best_name = min(feasible, key=lambda name: solutions[name].rejection)
    members, best = family.fractions, solutions[best_name].controller
    R, S, T = best.R, best.S, np.array([best.R.sum()])
    loop = LoopDesign(
        method="rst",
        observer=None,
        bandwidth_Hz=specification.bandwidth_Hz,
        R=R,
        S=S,
        T=T,
        A_0=np.ones(1),
        reference=fit_reference_path(members, R, S, T, band_Hz=specification.bandwidth_Hz),
        margins=reached_margins(members, R, S),
        rejections=rejections(members, R, S, (*REPORTED_Hz, specification.bandwidth_Hz)),
        certificate=None,
        candidates=tuple(
            Candidate(
                name=name,
                is_chosen=name == best_name,
                is_feasible=not missed[name],
                figure=solution.rejection,
                figure_name=_FIGURE,
                parameters=solution.parameters,
                R=solution.controller.R,
                S=solution.controller.S,
            )
            for name, solution in solutions.items()
        ),
        members=members,
    )
    return AxisDesign(
        axis=axis,
        output_unit=family.nominal.output_unit,
        specification=specification,
        loops=(loop,),
    )


def _attempt(
    family: PlantFamily, taps: int, specification: Specification
) -> tuple[Violation, ...]:
    """Return the limits that a few convex steps miss; none if band-stops meet them all."""
    start = shape(family, specification).controller
    missed = unmet(family.members, start.R, start.S, specification)
    if not missed:
        return ()
    steps = optimise(family, specification, start, taps=taps, most_iterations=_ATTEMPTED)
    c = steps.controller
    return min(missed, unmet(family.members, c.R, c.S, specification), key=severity)
