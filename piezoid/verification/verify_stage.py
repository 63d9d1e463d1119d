"""Verify a parameter file against the model of its stage, and release the axes that pass."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from piezoid.design.design import Design
from piezoid.design.hysteresis_bounds import draw_replicates
from piezoid.design.junction_task import current_chain, junction_family, reading_range_A
from piezoid.design.specification import converters_of
from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.model import AxisModel
from piezoid.identification.tunnelling.closed_loop import LoopPlant
from piezoid.identification.tunnelling.junction import TunnellingModel
from piezoid.operators.tunnelling import decay_of_barrier
from piezoid.records.lab import Lab
from piezoid.verification.bounds import error_bounds
from piezoid.verification.criteria import Limits, describe_failure, limits_from
from piezoid.verification.plant import (
    AxisPlant,
    junction_axis_plant,
    lateral_plant,
    varied_plant,
    with_gain,
)
from piezoid.verification.verification import Verification
from piezoid.verification.verify import verify

_ATTEMPTS = 20  # draws per plant, of which those without an inverse are dropped

_DRAWS = 6
_MAX_FAILURES = 3  # failed verdicts of an axis that its reason names


@dataclass(frozen=True, kw_only=True)
class Shipping:
    """Axes of a parameter file that ship, and axes that are refused.

    verification  of the axes that ship; of all axes if none ships
    parameters    of the axes that ship; None: no axis ships
    refused       parameters of the refused axes, for study; None: all ship
    refused_verification   of the whole file; None: all ship
    reasons       for the refusal, by axis
    """

    verification: Verification
    parameters: ParameterFile | None = None
    refused: ParameterFile | None = None
    refused_verification: Verification | None = None
    reasons: Mapping[str, str] = field(default_factory=dict)


def release(
    file: ParameterFile, model: ActuatorModel, *, lab: Lab | None = None, threads: int = 1
) -> Shipping:
    """Verify a parameter file against the identified stage, and release the axes that pass.

    If the file fails, every axis is verified alone. Axes that fail are refused, and the remaining
    axes must pass together.
    """
    verification = verify_stage(file, model, lab=lab, threads=threads)
    if verification.passed:
        return Shipping(verification=verification, parameters=file)
    by_axis = {
        axis.axis: verify_stage(replace(file, axes=(axis,)), model, lab=lab, threads=threads)
        for axis in (file.axes if len(file.axes) > 1 else ())
    }
    passed = tuple(
        axis for axis in file.axes if axis.axis in by_axis and by_axis[axis.axis].passed
    )
    if passed and len(passed) < len(file.axes):
        failed = tuple(axis for axis in file.axes if axis not in passed)
        reasons = {axis.axis: _reason(by_axis[axis.axis]) for axis in failed}
        remaining = replace(file, axes=passed, unshipped={**file.unshipped, **reasons})
        together = verify_stage(remaining, model, lab=lab, threads=threads)
        if together.passed:
            return Shipping(
                verification=together,
                parameters=remaining,
                refused=replace(file, axes=failed),
                refused_verification=verification,
                reasons=reasons,
            )
    return Shipping(
        verification=verification,
        refused=file,
        refused_verification=verification,
        reasons={axis.axis: _reason(by_axis.get(axis.axis, verification)) for axis in file.axes},
    )


def _reason(verification: Verification) -> str:
    failed = [describe_failure(verdict) for verdict in verification.verdicts if not verdict.passed]
    described = "; ".join(failed[:_MAX_FAILURES])
    omitted = f"; and {len(failed) - _MAX_FAILURES} more" if len(failed) > _MAX_FAILURES else ""
    if not failed:
        return "it passes alone, and not together with the other axes"
    return (
        f"its own verification failed, {len(failed)} of {len(verification.verdicts)} checks: "
        f"{described}{omitted}. Figures for study are in refused/; read there which scenario "
        "fails. Record what the model lacks, slow full loops and a chirp or multisine through the "
        "first resonance, sampled at three times its frequency. Then fit again"
    )


def verify_stage(
    file: ParameterFile,
    model: ActuatorModel,
    *,
    lab: Lab | None = None,
    limits: Limits | None = None,
    seed: int = 0,
    threads: int = 1,
    design: Design | None = None,
    bounds: bool = False,
) -> Verification:
    """Verify a parameter file against the identified stage.

    lab      converters, which round the readings, and range of barriers; without it readings are
             not rounded
    limits   by default those of ``[verification]`` in lab.toml, else those of ``Limits``
    threads  axes of a path that run in parallel; the result does not depend on it
    design   from which the file was exported; needed for bounds
    bounds   whether the largest errors are bounded as well

    Raises ``ParameterFileError`` for a tunnelling axis without a plant in the model, and if
    lab.toml declares other guards or another rig than those of the file.
    """
    declared = lab or Lab()
    plants, variations = stage_plants(file, model, declared, seed=seed)
    exported = file.sources.get("control")
    if exported is not None and exported != declared.control_digest:
        raise ParameterFileError(
            f"{declared.place} declares another rig or other guards than params.json was exported "
            "with",
            needed="the declarations of the export; only [verification] and [uncertainty] may "
            "differ",
            remedy="Run `piezoid export` again, then verify.",
        )
    stated_in = f"[verification] of {declared.place}"
    verification = verify(
        file,
        plants,
        variations=list(zip(*variations, strict=False)),  # as many sets as the axis with fewest
        limits=limits or limits_from(declared.verification, stated_in),
        seed=seed,
        threads=threads,
        coupled=model.coupled,
    )
    verification = replace(verification, lab_digest=declared.digest)
    if design is None or not bounds:
        return verification
    largest_errors = error_bounds(
        file, design, model, plants, variations, seed=seed, threads=threads
    )
    return replace(verification, bounds=largest_errors)


def stage_plants(
    file: ParameterFile, model: ActuatorModel, lab: Lab, *, draws: int = _DRAWS, seed: int = 0
) -> tuple[list[AxisPlant], list[tuple[AxisPlant, ...]]]:
    """Return the identified plant of every axis, and plants that the uncertainty allows.

    draws  number of such plants for each axis

    Raises ``ParameterFileError`` for a tunnelling axis without a plant in the model.
    """
    rng = np.random.default_rng([seed, draws])
    plants: list[AxisPlant] = []
    variations: list[tuple[AxisPlant, ...]] = []
    for axis in file.axes:
        plants.append(plant_of(axis, model, lab))
        if axis.is_tip:
            loop = _loop_of(axis, model.tunnelling)
            # the junctions that a controller must stabilise, extreme gains first
            nominal = loop.plant.gain_nepers_per_V
            ratios = [plant.gain_nepers_per_V / nominal for plant in junction_family(loop, lab)]
            extreme = sorted(ratios, key=lambda ratio: -abs(np.log(ratio)))
            repeated = [extreme[k % len(extreme)] for k in range(draws)]
            variations.append(
                tuple(with_gain(plants[-1], ratio, f"gain x{ratio:.3g}") for ratio in repeated)
            )
        else:
            variations.append(varied_plants(plants[-1], model[axis.axis], count=draws, rng=rng))
    return plants, variations


def plant_of(axis: AxisParameters, model: ActuatorModel, lab: Lab) -> AxisPlant:
    """Return the identified plant of one axis between the converters that lab.toml declares.

    A tip is at its set point, in the middle of its voltage range, with the physical minimum of
    noise: i_n^2 = 2 e i B + 4 k T B / R, B = pi f / 2 of a first-order sensor [Schottky 1918];
    resistor and converter if lab.toml declares them.

    Raises ``ParameterFileError`` for a tunnelling axis without a plant in the model.
    """
    converters = converters_of(lab, axis.axis)
    if not axis.is_tip:
        plant = lateral_plant(model[axis.axis], sampling_rate_Hz=axis.sampling_rate_Hz)
        gain_V_per_m = lab.sensor_of(axis.axis).gain_V_per_m
        if gain_V_per_m is None:
            return plant
        return replace(plant, reading_step=converters.reading_step_V / abs(gain_V_per_m))
    loop, set_point_A = _loop_of(axis, model.tunnelling), float(axis.values["current_reference_A"])
    chain = current_chain(loop.plant, lab, axis.axis)
    plant = junction_axis_plant(
        loop.plant,
        axis=axis.axis,
        set_point_A=set_point_A,
        decay_per_m=decay_of_barrier(loop.barrier_eV),
        noise_rms_A=float(np.hypot(chain.shot_A(set_point_A), chain.johnson_A)),
        modes=loop.modes[:1],
    )
    return replace(
        plant,
        rest_voltage_V=0.5 * sum(axis.voltage_range_V),
        reading_step=chain.adc_step_A,
        reading_range=reading_range_A(lab, axis.axis) or plant.reading_range,
    )


def _loop_of(axis: AxisParameters, tunnelling: TunnellingModel | None) -> LoopPlant:
    if tunnelling is None or tunnelling.loop_plant is None:
        raise ParameterFileError(
            f"axis {axis.axis} regulates a current, and model.json has no plant of it",
            needed="a plant identified in closed loop",
            remedy="Call piezoid.verification.verify.verify with junction_axis_plant.",
        )
    return tunnelling.loop_plant


def varied_plants(
    plant: AxisPlant, model: AxisModel, *, count: int, rng: np.random.Generator
) -> tuple[AxisPlant, ...]:
    """Draw plants: operators from the fit's covariance, poles and modes from their intervals.

    plant  identified
    count  number of plants; fewer are returned if too few draws have an inverse
    """
    plants = []
    operators = draw_replicates(model, rng, draws=_ATTEMPTS * count)[:count]
    for number, operator in enumerate(operators, start=1):
        slower, sharper = rng.uniform(-1.0, 1.0, 2).tolist()
        varied = varied_plant(plant, model, operator, slower=slower, sharper=sharper)
        plants.append(replace(varied, label=f"draw {number}"))
    return tuple(plants)
