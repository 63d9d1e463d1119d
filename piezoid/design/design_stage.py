"""Design the controllers of all axes of a model."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from piezoid.design.decoupling import decoupling_of
from piezoid.design.design import AxisDesign, Design
from piezoid.design.feasibility import at_feasible_bandwidth
from piezoid.design.junction_task import axis_of, design_vertical, vertical_task
from piezoid.design.lateral import design_lateral, raise_bandwidth
from piezoid.design.lateral_task import FORMS, has_pole, lateral_task
from piezoid.design.plant import PlantFamily
from piezoid.design.specification import Specification, converters_of, specifications_from_toml
from piezoid.errors import DesignError, LabFileError, PiezoidError, TemplateError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid.identification.loop_model import loop_model
from piezoid.raw_counts import refuse_counts
from piezoid.records.checks.command_range import (
    amplifier_scale,
    command_range_V,
    exceeds_range,
)
from piezoid.records.lab import Lab

_SLOWEST_Hz, _FASTEST_Hz = 1.0, 1e7  # of the runtime
_Task = tuple[
    Specification,
    Callable[[Specification], AxisDesign],
    Callable[[AxisDesign, Specification], AxisDesign],
]
"""Default specification of an axis, its design, and the increase of a default's bandwidth.

The increase is as far as damping of a mode allows; none for a tip.
"""


@dataclass(frozen=True, kw_only=True)
class SpecificationText:
    """Text of ``design.toml``, which overrides the default specifications, and its file name."""

    text: str = ""
    source: str = "design.toml"


@dataclass(frozen=True, kw_only=True)
class AxisDesignResult:
    """Result of designing one axis: a design, a refusal or an obstacle.

    design    of the axis
    slower    with the bandwidth before it was raised beyond a mode; None: it was not raised
    refusal   no controller meets the limits
    obstacle  information without which no design can begin is missing
    """

    axis: str
    design: AxisDesign | None = None
    slower: AxisDesign | None = None
    refusal: TemplateError | None = None
    obstacle: PiezoidError | None = None


def design_stage(
    model: ActuatorModel,
    *,
    model_digest: str,
    sampling_rate_Hz: float | None = None,
    lab: Lab | None = None,
    requested: SpecificationText | None = None,
    forms: Sequence[str] = FORMS,
    progress: Callable[[str], None] = lambda _: None,
) -> Design:
    """Design every axis for which the model suffices; the remarks name the other axes.

    model_digest      of the model's file
    sampling_rate_Hz  of the controller; by default the rate that lab.toml declared at the fit.
                      The tunnelling axis keeps the rate at which its loop was identified
    lab               converters of every axis; voltages and set point of the tunnelling axis
    requested         specifications. An axis without one gets its default, at the nearest feasible
                      bandwidth below it, or at a higher bandwidth if a mode can be damped
    forms             of the observers of X and Y; the inverse form is recommended, the affine form
                      is designed for comparison and takes longer

    An axis without a feasible controller does not prevent the design of other axes; the design
    states the reason.

    Raises the first refusal, else the first obstacle, if no axis can be designed.
    """
    outcomes = design_axes(
        model,
        sampling_rate_Hz=sampling_rate_Hz,
        lab=lab,
        requested=requested,
        forms=forms,
        progress=progress,
    )
    if not outcomes:
        raise nothing_to_design(model)
    design = design_of(outcomes, model_digest=model_digest, lab=lab, coupled=model.coupled)
    if (lab or Lab()).digest == (model.lab or ""):
        return design
    difference = (
        "There is no lab.toml" if lab is None else f"{lab.place} differs from that of the fit"
    )
    remark = (
        f"{difference}: converters, limits and guards are now "
        f"{'the defaults' if lab is None else 'those of this file'}; poles, gains and, without "
        "--rate, the sampling rate are those of the fit. If [amplifier], [actuator], [sensor] or "
        "sampling_rate_Hz changed, fit again."
    )
    return replace(design, remarks=(*design.remarks, remark))


def design_axes(
    model: ActuatorModel,
    *,
    sampling_rate_Hz: float | None = None,
    lab: Lab | None = None,
    requested: SpecificationText | None = None,
    forms: Sequence[str] = FORMS,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[AxisDesignResult, ...]:
    """Design every axis independently; return a design, a refusal or an obstacle for each.

    Without ``requested``, a stage may be designed axis by axis and assembled by ``design_of``.
    """
    lab, tasks, obstacles = lab or Lab(), dict[str, _Task](), list[AxisDesignResult]()
    for name in model.axes:
        try:
            tasks[name] = _lateral_task(model, name, lab, sampling_rate_Hz, forms)
        except (DesignError, LabFileError) as obstacle:
            obstacles.append(AxisDesignResult(axis=name, obstacle=obstacle))
    if model.tunnelling is not None and (tip := axis_of(model.tunnelling)) not in model.axes:
        try:
            family, default = vertical_task(model.tunnelling, lab)
            tasks[tip] = default, partial(design_vertical, tip, family), lambda base, _: base
        except (DesignError, LabFileError) as obstacle:
            obstacles.append(AxisDesignResult(axis=tip, obstacle=obstacle))
    if not tasks:
        return tuple(obstacles)
    defaults = {name: default for name, (default, _, _) in tasks.items()}
    request = requested or SpecificationText()
    specifications = specifications_from_toml(request.text, defaults, source=request.source)
    results = []
    for name, (default, design_axis, raise_axis) in tasks.items():
        progress(f"axis {name}: designing")
        specification = specifications[name]
        try:
            if specification is default:
                # The bandwidth of a default is lowered to a feasible one, and raised if damping
                # of a mode allows a higher one.
                base = at_feasible_bandwidth(design_axis, specification)
                design = raise_axis(base, specification)
                slower = None if design is base else base
            else:
                design, slower = design_axis(specification), None
        except TemplateError as refusal:
            results.append(AxisDesignResult(axis=name, refusal=refusal))
        else:
            results.append(AxisDesignResult(axis=name, design=design, slower=slower))
    return (*results, *obstacles)


def design_of(
    outcomes: Sequence[AxisDesignResult],
    *,
    model_digest: str,
    lab: Lab | None = None,
    coupled: CoupledStage | None = None,
) -> Design:
    """Assemble the design of a stage from the results of its axes, at least one.

    lab      with which the axes were designed
    coupled  of the model: coupling of its axes

    Raises as ``design_stage`` does if no axis could be designed.
    """
    lab = lab or Lab()
    obstacles = [outcome.obstacle for outcome in outcomes if outcome.obstacle is not None]
    refused = {o.axis: o.refusal for o in outcomes if o.refusal is not None}
    axes = tuple(outcome.design for outcome in outcomes if outcome.design is not None)
    if not axes:
        raise [*refused.values(), *obstacles][0]
    decoupling = None
    if coupled is not None:
        bandwidths_Hz = [
            axis.recommended.bandwidth_Hz for axis in axes if axis.axis in coupled.outputs
        ]
        decoupling = decoupling_of(coupled, min(bandwidths_Hz, default=coupled.band_Hz[0]))
    remarks = () if decoupling is None else (decoupling.text,)
    names = [outcome.axis for outcome in outcomes]
    unused = [
        f"[axis.{name}] of {lab.place} is about none of the axes {', '.join(names)}."
        for name in sorted(set(lab.axes) - set(names))
    ]
    unused += [
        f"axis {axis}: adc_bits of {lab.place} has no effect, because gain_V_per_m of [sensor] is "
        "not declared: the steps of its readings are not known in metres."
        for axis in names
        if lab.acquisition.adc_bits is not None and lab.sensor_of(axis).gain_V_per_m is None
    ]
    return Design(
        axes=axes,
        model_digest=model_digest,
        lab_digest=lab.digest,
        rig_digest=lab.rig_digest,
        decoupling=decoupling,
        remarks=(*remarks, *map(str, obstacles), *unused),
        refused={name: str(refusal) for name, refusal in refused.items()},
    )


def without_damping(
    outcomes: Sequence[AxisDesignResult], axes: Collection[str]
) -> tuple[AxisDesignResult, ...]:
    """Replace the designs of some axes by those with the bandwidth below their modes.

    A loop that damps a mode depends on the frequency of the mode; a loop below it does not.
    """
    return tuple(
        replace(outcome, design=outcome.slower, slower=None)
        if outcome.axis in axes and outcome.slower is not None
        else outcome
        for outcome in outcomes
    )


def _lateral_task(
    model: ActuatorModel, name: str, lab: Lab, rate_Hz: float | None, forms: Sequence[str]
) -> _Task:
    axis = model.axes[name]
    refuse_counts(name, axis.counted)
    if not axis.verdict.applies:
        raise DesignError(
            f"axis {name}: the model class does not apply, {axis.verdict.reason}",
            needed="an axis whose hysteresis is known",
            remedy="Correct what the reason names, then fit the axis again.",
        )
    if rate_Hz is None and model.controller_rate_Hz is None:
        is_limited = has_pole(loop_model(axis, _FASTEST_Hz), _FASTEST_Hz)
        raise _unknown_rate(model, lab, needs_pole=not is_limited)
    task = lateral_task(axis, controller_rate_Hz(model, rate_Hz), forms=forms)
    recommended = next(form for form in FORMS if form in task.families)

    def design(families: Mapping[str, PlantFamily], specification: Specification) -> AxisDesign:
        return design_lateral(
            name, families, specification, bounds=task.bounds, disturbances=task.disturbances
        )

    def raise_recommended(base: AxisDesign, default: Specification) -> AxisDesign:
        family = task.families[recommended]
        design_recommended = partial(design, {recommended: family})
        return raise_bandwidth(base, family, default, design_recommended, form=recommended)

    # The voltages lie between the converter's codes; the step of the converter rounds them.
    default, converters = task.specification, converters_of(lab, name)
    slews = [v for v in (default.voltage_slew_V_per_s, converters.command_slew_V_per_s) if v]
    default = replace(
        default,
        voltage_step_V=converters.command_step_V,
        voltage_slew_V_per_s=min(slews, default=None),
    )
    range_V = command_range_V(lab, name)
    if range_V is not None and converters.command_V is not None:
        if exceeds_range((default.voltage_min_V, default.voltage_max_V), range_V):
            raise LabFileError(
                f"axis {name}: its drive was recorded from {default.voltage_min_V:.6g} to "
                f"{default.voltage_max_V:.6g} V, converter and amplifier take commands from "
                f"{range_V[0]:.6g} to {range_V[1]:.6g} V",
                needed="recordings of the controller's output, the command at the amplifier's "
                "input, not of the high voltage at the ceramic",
                remedy="If they were taken behind the amplifier, write "
                f"{amplifier_scale(lab, name)} into their [[recording]] and fit again; else "
                f"correct input_range_V or [amplifier] in {lab.place}.",
            )
        low_V, high_V = converters.command_V
        default = replace(
            default,
            voltage_min_V=max(default.voltage_min_V, low_V),
            voltage_max_V=min(default.voltage_max_V, high_V),
        )
    return default, partial(design, task.families), raise_recommended


def nothing_to_design(model: ActuatorModel) -> DesignError:
    """Return the error for a model without any axis."""
    return DesignError(
        f"stage {model.stage}: the model contains no single axis",
        needed="an axis with a slow sweep of its own drive, or a tunnelling loop",
        remedy=" ".join(model.remarks) or "Fit recordings of the stage first.",
    )


def controller_rate_Hz(model: ActuatorModel, requested_Hz: float | None) -> float:
    """Return the requested rate, else the rate that lab.toml declared at the fit.

    Raises ``DesignError`` if neither exists, and for a rate that the runtime does not accept.
    """
    rate_Hz = model.controller_rate_Hz if requested_Hz is None else requested_Hz
    if rate_Hz is None:
        raise _unknown_rate(model, Lab())
    if not _SLOWEST_Hz <= rate_Hz <= _FASTEST_Hz:
        raise DesignError(
            f"stage {model.stage}: the controller is to run at {rate_Hz:g} Hz",
            needed=f"a rate from {_SLOWEST_Hz:.0f} to {_FASTEST_Hz:.0f} Hz",
            remedy="Correct sampling_rate_Hz in lab.toml and fit again, or --rate.",
        )
    return rate_Hz


def _unknown_rate(model: ActuatorModel, lab: Lab, *, needs_pole: bool = False) -> DesignError:
    """Return the error for a model that was fitted without the rate of the controller.

    needs_pole  whether the model has no pole either, which a rate alone does not mend
    """
    problem = f"stage {model.stage}: the fit had no sampling rate of the controller"
    needed = "the rate at which the controller will run"
    rate_Hz = lab.acquisition.sampling_rate_Hz
    if rate_Hz is not None:
        problem += f", which {lab.place} now states as {rate_Hz:g} Hz"
        remedy = f"Fit again with {lab.place}"
    else:
        remedy = "Write sampling_rate_Hz under [acquisition] in lab.toml and fit again"
    if needs_pole:
        problem += ", and no pole of the stage"
        needed += ", and a pole that limits the speed of the stage"
        remedy += (
            ", with bandwidth_Hz of [amplifier] or [sensor] or with a recording that excites the "
            "dynamics (a small chirp)."
        )
    else:
        remedy += ", or run `piezoid design FOLDER --rate HZ`."
    return DesignError(problem, needed=needed, remedy=remedy)
