"""Design the controllers of all axes of a model."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from piezoid.design.converters import converters_of
from piezoid.design.damping import raise_bandwidth
from piezoid.design.decoupling import decoupling_of
from piezoid.design.design import AxisDesign, Design
from piezoid.design.feasibility import at_feasible_bandwidth
from piezoid.design.junction_task import axis_of, design_vertical, vertical_task
from piezoid.design.lateral import design_lateral
from piezoid.design.lateral_task import FORMS, has_pole, lateral_task
from piezoid.design.plant import PlantFamily
from piezoid.design.specification import Specification, specifications_from_toml
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
NO_POLE = ", and no pole of it is declared (bandwidth_Hz of [amplifier] or [sensor]) or fitted"


@dataclass(frozen=True, kw_only=True)
class SpecificationText:
    """Requested specifications, over the defaults: the text and the name of ``design.toml``."""

    text: str = ""
    source: str = "design.toml"


@dataclass(frozen=True, kw_only=True)
class AxisDesignResult:
    """Result of designing one axis: a controller, a refusal or an obstacle.

    design    the controller
    slower    the same axis before its bandwidth was raised beyond a mode; None: it was not
    refusal   no controller meets its limits
    obstacle  too little is known to begin
    """

    axis: str
    design: AxisDesign | None = None
    slower: AxisDesign | None = None
    refusal: TemplateError | None = None
    obstacle: PiezoidError | None = None


@dataclass(frozen=True, kw_only=True)
class _Task:
    """Design function of one axis, and its default specification.

    raised  raises the bandwidth of a default where a mode can be damped; not for a tip
    """

    design: Callable[[Specification], AxisDesign]
    specification: Specification
    raised: Callable[[AxisDesign, Specification], AxisDesign] = lambda base, _: base


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
    """Design every axis for which enough is known; the remarks name the other axes.

    model_digest      of the model's file
    sampling_rate_Hz  of the controller; by default what the model says the laboratory declared.
                      The tunnelling axis keeps the rate at which its loop was identified
    lab               converters of every axis; voltages and set point of the tunnelling axis
    requested         specifications; an axis without gets its default, or the nearest bandwidth
                      below it that can be met, or more where a mode can be damped
    forms             of the observers of X and Y; the inverse one is recommended, the affine one
                      is there to be compared and takes longer

    An axis without a feasible controller does not prevent the design of other axes; the design
    states the reason.

    Raises the obstacle of the first axis if no axis can be designed: a ``TemplateError`` before
    missing information.
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
    now = "There is no lab.toml any more" if lab is None else f"{lab.place} is not that of the fit"
    remark = (
        f"{now}: converters, limits and guards are what it says now, poles, gains and, without "
        "--rate, the sampling rate what the fit took from it. Fit again where [amplifier], "
        "[actuator], [sensor] or sampling_rate_Hz changed."
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
    """Design every axis independently; return a design or an obstacle for each.

    Without ``requested``, a stage may be designed axis by axis and assembled by ``design_of``.
    """
    declared, tasks, hindered = lab or Lab(), dict[str, _Task](), list[AxisDesignResult]()
    for name in model.axes:
        try:
            tasks[name] = _lateral_task(model, name, declared, sampling_rate_Hz, forms)
        except (DesignError, LabFileError) as obstacle:
            hindered.append(AxisDesignResult(axis=name, obstacle=obstacle))
    if model.tunnelling is not None and (tip := axis_of(model.tunnelling)) not in model.axes:
        try:
            junction = vertical_task(model.tunnelling, declared)
            design_tip = partial(design_vertical, tip, junction.family)
            tasks[tip] = _Task(design=design_tip, specification=junction.specification)
        except (DesignError, LabFileError) as obstacle:
            hindered.append(AxisDesignResult(axis=tip, obstacle=obstacle))
    if not tasks:
        return tuple(hindered)
    defaults = {name: task.specification for name, task in tasks.items()}
    request = requested or SpecificationText()
    specifications = specifications_from_toml(request.text, defaults, source=request.source)
    designed = []
    for name, task in tasks.items():
        progress(f"axis {name}: designing")
        specification = specifications[name]
        try:
            if specification is task.specification:
                # The bandwidth of a default is adapted: downwards to what is feasible and upwards
                # where damping a mode allows that.
                base = at_feasible_bandwidth(task.design, specification)
                design = task.raised(base, specification)
                slower = None if design is base else base
            else:
                design, slower = task.design(specification), None
        except TemplateError as refusal:
            designed.append(AxisDesignResult(axis=name, refusal=refusal))
        else:
            designed.append(AxisDesignResult(axis=name, design=design, slower=slower))
    return (*designed, *hindered)


def design_of(
    outcomes: Sequence[AxisDesignResult],
    *,
    model_digest: str,
    lab: Lab | None = None,
    coupled: CoupledStage | None = None,
) -> Design:
    """Assemble the designs of the axes of a stage, at least one; ``lab`` as for each of them.

    coupled  of the model: how its axes are coupled

    Raises as ``design_stage`` does where no axis could be designed.
    """
    obstacles = [outcome.obstacle for outcome in outcomes if outcome.obstacle is not None]
    refused = {o.axis: o.refusal for o in outcomes if o.refusal is not None}
    designed = tuple(outcome.design for outcome in outcomes if outcome.design is not None)
    if not designed:
        raise next(iter([*refused.values(), *obstacles]))
    decoupling = None
    if coupled is not None:
        bandwidths_Hz = [
            axis_design.recommended.bandwidth_Hz
            for axis_design in designed
            if axis_design.axis in coupled.outputs
        ]
        decoupling = decoupling_of(coupled, min(bandwidths_Hz, default=coupled.band_Hz[0]))
    remarks = () if decoupling is None else (decoupling.text,)
    unused = _unused(lab or Lab(), [outcome.axis for outcome in outcomes])
    return Design(
        axes=designed,
        model_digest=model_digest,
        lab_digest=(lab or Lab()).digest,
        rig_digest=(lab or Lab()).rig_digest,
        decoupling=decoupling,
        remarks=(*remarks, *map(str, obstacles), *unused),
        refused={name: str(refusal) for name, refusal in refused.items()},
    )


def _unused(lab: Lab, axes: Sequence[str]) -> Iterator[str]:
    """Yield declarations of lab.toml without effect on the controllers, as sentences."""
    for name in sorted(set(lab.axes) - set(axes)):
        yield f"[axis.{name}] of {lab.place} is about none of the axes {', '.join(axes)}."
    for axis in axes if lab.acquisition.adc_bits is not None else ():
        if lab.sensor_of(axis).gain_V_per_m is None:
            yield (
                f"axis {axis}: adc_bits of {lab.place} has no effect, because gain_V_per_m of "
                "[sensor] is not declared: the steps of its readings are not known in metres."
            )


def without_damping(
    outcomes: Sequence[AxisDesignResult], axes: Collection[str]
) -> tuple[AxisDesignResult, ...]:
    """Return the outcomes with the loops of some axes below their modes, as far as they damp any.

    A loop that damps a mode rests on its frequency; one below it does not.
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
            remedy="Read in the report why it does not apply, and record again.",
        )
    if rate_Hz is None and model.controller_rate_Hz is None:
        further = "" if has_pole(loop_model(axis, _FASTEST_Hz), _FASTEST_Hz) else NO_POLE
        raise _unknown_rate(model, further)
    task = lateral_task(axis, controller_rate_Hz(model, rate_Hz), forms=forms)
    recommended = next(form for form in FORMS if form in task.families)

    def design(families: Mapping[str, PlantFamily], specification: Specification) -> AxisDesign:
        return design_lateral(
            name, families, specification, bounds=task.bounds, disturbances=task.disturbances
        )

    def raised(base: AxisDesign, default: Specification) -> AxisDesign:
        """Return the axis with its recommended loop beyond a mode; the loops beside it stay."""
        family = task.families[recommended]
        recommended_only = partial(design, {recommended: family})
        return raise_bandwidth(base, family, default, recommended_only, form=recommended)

    return _Task(
        design=partial(design, task.families),
        specification=_between_converters(name, task.specification, lab),
        raised=raised,
    )


def _between_converters(name: str, default: Specification, lab: Lab) -> Specification:
    """Return the default within the converter's codes, with its step.

    Raises ``LabFileError`` where the recorded drive lies outside that range: its volts are then
    not those at the converter.
    """
    converters = converters_of(lab, name)
    slews = [v for v in (default.voltage_slew_V_per_s, converters.command_slew_V_per_s) if v]
    stepped = replace(
        default,
        voltage_step_V=converters.command_step_V,
        voltage_slew_V_per_s=min(slews, default=None),
    )
    range_V = command_range_V(lab, name)
    if range_V is None or converters.command_V is None:
        return stepped
    if exceeds_range((default.voltage_min_V, default.voltage_max_V), range_V):
        raise LabFileError(
            f"axis {name}: its drive was recorded from {default.voltage_min_V:.6g} to "
            f"{default.voltage_max_V:.6g} V, converter and amplifier take commands from "
            f"{range_V[0]:.6g} to {range_V[1]:.6g} V",
            needed="recordings of the controller's output, the command at the amplifier's input, "
            "not of the high voltage at the ceramic",
            remedy="If they were taken behind the amplifier, write "
            f"{amplifier_scale(lab, name)} into their [[recording]] and fit again; else correct "
            f"input_range_V or [amplifier] in {lab.place}.",
        )
    low_V, high_V = converters.command_V
    return replace(
        stepped,
        voltage_min_V=max(default.voltage_min_V, low_V),
        voltage_max_V=min(default.voltage_max_V, high_V),
    )


def nothing_to_design(model: ActuatorModel) -> DesignError:
    """Return the refusal of a stage without any axis."""
    return DesignError(
        f"stage {model.stage}: the model holds no axis",
        needed="an axis with drive and displacement, or a tunnelling loop",
        remedy=" ".join(model.remarks) or "Fit recordings of the stage first.",
    )


def controller_rate_Hz(model: ActuatorModel, asked_Hz: float | None) -> float:
    """Return the requested rate, else the rate of lab.toml at the fit, or refuse."""
    rate_Hz = model.controller_rate_Hz if asked_Hz is None else asked_Hz
    if rate_Hz is None:
        raise _unknown_rate(model)
    if not _SLOWEST_Hz <= rate_Hz <= _FASTEST_Hz:
        raise DesignError(
            f"stage {model.stage}: the controller is to run at {rate_Hz:g} Hz",
            needed=f"a rate from {_SLOWEST_Hz:.0f} to {_FASTEST_Hz:.0f} Hz, which its code takes",
            remedy="Correct sampling_rate_Hz in lab.toml and fit again, or --rate.",
        )
    return rate_Hz


def _unknown_rate(model: ActuatorModel, further: str = "") -> DesignError:
    """Return the refusal of a stage without a controller rate, with further missing facts."""
    return DesignError(
        f"stage {model.stage}: the sampling rate of the controller is not known{further}",
        needed="the rate at which the controller will run",
        remedy="Write sampling_rate_Hz under [acquisition] in lab.toml and fit again, or run "
        "`piezoid design FOLDER --rate HZ`.",
    )
