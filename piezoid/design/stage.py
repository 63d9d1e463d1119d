"""design_stage: a model in, the controllers of its axes out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from piezoid.design.design import AxisDesign, Design
from piezoid.design.feasibility import at_feasible_bandwidth
from piezoid.design.from_model import FORMS, LateralTask, lateral_task
from piezoid.design.lateral import design_lateral
from piezoid.design.specification import Specification, specifications_from_toml
from piezoid.errors import DesignError
from piezoid.identification.model import ActuatorModel


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What somebody asks for, over the defaults; the text and the name of ``design.toml``."""

    text: str = ""
    place: str = "design.toml"


def design_stage(
    model: ActuatorModel,
    *,
    model_digest: str,
    sampling_rate_Hz: float | None = None,
    asked: Asked | None = None,
    forms: Sequence[str] = FORMS,
    progress: Callable[[str], None] = lambda _: None,
) -> Design:
    """Design every lateral axis to which the model class applies.

    model_digest      of the model's file
    sampling_rate_Hz  of the controller; by default what the model says the laboratory declared
    asked             specifications; an axis without gets its default, or the nearest bandwidth
                      below it that can be met
    forms             of the observer; the inverse one is recommended, the affine one is there to
                      be compared and takes longer

    The tunnelling axis is not among them: a model knows the family of its loop, yet neither the
    voltages it may use nor its noise. ``design_vertical`` takes them with the family.

    Raises ``DesignError`` where no axis can be designed, the rate is not known, or what limits an
    axis is not; ``TemplateError`` where what is asked for cannot be met.
    """
    rate_Hz = _rate_Hz(model, sampling_rate_Hz)
    axes = [axis for axis in model.axes.values() if axis.verdict.applies]
    if not axes:
        raise DesignError(
            f"{model.stage}: the model class applies to none of its {len(model.axes)} axes",
            needed="an axis whose hysteresis is known",
            remedy="Read in the report why it does not apply, and record again.",
        )
    tasks = {axis.axis: lateral_task(axis, rate_Hz, forms=forms) for axis in axes}
    defaults = {name: task.specification for name, task in tasks.items()}
    wanted = asked or Asked()
    specifications = specifications_from_toml(wanted.text, defaults, place=wanted.place)
    designed = []
    for name, task in tasks.items():
        progress(f"axis {name}: designing")
        is_default = specifications[name] is defaults[name]
        designed.append(_designed(name, task, specifications[name], is_default=is_default))
    return Design(axes=tuple(designed), model_digest=model_digest)


def _rate_Hz(model: ActuatorModel, asked_Hz: float | None) -> float:
    rate_Hz = model.controller_rate_Hz if asked_Hz is None else asked_Hz
    if rate_Hz is None:
        raise DesignError(
            f"{model.stage}: the controller's sampling rate is not known",
            needed="the rate at which the controller will run",
            remedy="Write sampling_rate_Hz under [acquisition] in lab.toml and fit again, or give "
            "the rate to the design.",
        )
    return rate_Hz


def _designed(
    name: str, task: LateralTask, specification: Specification, *, is_default: bool
) -> AxisDesign:
    design = partial(_lateral, name, task)
    return at_feasible_bandwidth(design, specification) if is_default else design(specification)


def _lateral(name: str, task: LateralTask, specification: Specification) -> AxisDesign:
    return design_lateral(name, task.families, specification, bounds=task.bounds)
