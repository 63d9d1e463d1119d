"""X and Y: a disturbance observer in both forms, chosen among its tunings."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import NoReturn

import numpy as np

from piezoid.design.certificate import Certificate, Disturbances, Operation, certify
from piezoid.design.damping import describe_obstacle, must_damp
from piezoid.design.design import (
    AxisDesign,
    Candidate,
    LoopDesign,
    Member,
    REPORTED_Hz,
    members_of,
    reached_margins,
    rejections,
)
from piezoid.design.feasibility import (
    at_feasible_bandwidth,
    nearest_feasible,
    refuse,
    severity,
    unmet,
)
from piezoid.design.feedforward import ReferencePath, fit_reference_path
from piezoid.design.hysteresis_bounds import HysteresisBounds
from piezoid.design.observer import LinearController, linear_controller
from piezoid.design.plant import Plant, PlantFamily
from piezoid.design.specification import Specification
from piezoid.design.templates import Violation
from piezoid.design.tuning import DAMPED, METHODS, TunedObserver, tune_observer
from piezoid.errors import DesignError, TemplateError
from piezoid.runtime.schema import MAX_ORDER

NO_DISTURBANCES = Disturbances()
SLEW_SHARE = 0.5  # of what the amplifier follows: the rest is the feedback's
_LOOP_OF_FORM = {"inverse": "mpi_dob", "affine": "dob"}


def design_lateral(
    axis: str,
    families: Mapping[str, PlantFamily],
    specification: Specification,
    *,
    model: Plant | None = None,
    bounds: Mapping[str, HysteresisBounds] | None = None,
    reference_slew_m_per_s: float | None = None,
    disturbances: Disturbances = NO_DISTURBANCES,
) -> AxisDesign:
    """Design the disturbance observer of one lateral axis, in every form asked for.

    families  by form, ``inverse`` and/or ``affine``: the affine form leaves the slope sector of
              the hysteresis in the loop, so its family has more gain variation; see
              ``with_sector``
    model     what the observer computes with; by default a nominal member, a delay for which the
              runtime has no states as a pole (``Plant.with_late_pole``)
    bounds    by form, for the certificate; a form without has none
    reference_slew_m_per_s  of the fastest reference; by default a sine at the scan frequency
              whose amplitude uses the drive for which the bounds hold, or what the
              amplifier follows, if that is less
    disturbances  what recordings showed beside drive and noise, for the certificate

    Raises ``TemplateError`` where the first form (the inverse one, if asked for) cannot meet the
    specification. A further form that cannot is designed at its nearest feasible bandwidth, for
    comparison, and left out where there is none.
    """
    forms = [form for form in _LOOP_OF_FORM if form in families]
    loops: list[LoopDesign] = []
    for form in forms:
        request = _Request(
            axis=axis,
            form=form,
            family=families[form],
            model=model or _with_room(axis, families[form].nominal, specification),
            bounds=(bounds or {}).get(form),
            reference_slew_m_per_s=reference_slew_m_per_s,
            disturbances=disturbances,
        )
        if not loops:
            loops.append(_lateral_loop(request, specification))
            continue
        try:
            loops.append(at_feasible_bandwidth(partial(_lateral_loop, request), specification))
        except TemplateError:
            continue
    return AxisDesign(
        axis=axis,
        output_unit=next(iter(families.values())).nominal.output_unit,
        specification=specification,
        loops=tuple(loops),
    )


def with_sector(family: PlantFamily, bounds: HysteresisBounds) -> PlantFamily:
    """Return the family with the nominal gain at both ends of the hysteresis' slope sector."""
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


def _with_room(axis: str, plant: Plant, specification: Specification) -> Plant:
    """Return the plant with no more states than the runtime holds beside its oscillators."""
    max_states = MAX_ORDER - 2 * len(specification.oscillation_Hz)
    excess = len(plant.realised()[0]) - max_states
    if excess <= 0:
        return plant
    if excess < plant.delay_samples:
        return plant.with_late_pole(excess + 1)
    raise DesignError(
        f"axis {axis}: at {plant.sampling_rate_Hz:g} Hz the plant has {max_states + excess} "
        f"states, of which {plant.delay_samples} are delay",
        needed=f"at most {max_states}, as many as the controller holds, a delay counted as one",
        remedy="Design with fewer resonant_harmonics, or fit fewer modes.",
    )


@dataclass(frozen=True, kw_only=True)
class _Request:
    axis: str
    form: str
    family: PlantFamily
    model: Plant | None
    bounds: HysteresisBounds | None
    reference_slew_m_per_s: float | None
    disturbances: Disturbances


def _lateral_loop(request: _Request, specification: Specification) -> LoopDesign:
    members = members_of(request.family)
    tuned = [_tuned(request, specification, method) for method in _methods(request, specification)]
    missed = [_missed(members, t, specification) for t in tuned]
    if all(missed):
        _refuse(request, members, specification, min(missed, key=severity))
    best = min(
        (k for k in range(len(tuned)) if not missed[k]),
        key=lambda k: tuned[k].judgement.predicted_error,
    )
    controller = linear_controller(tuned[best].observer)
    R, S, T = controller.R, controller.S, controller.T
    path = fit_reference_path(members, R, S, T, band_Hz=specification.bandwidth_Hz)
    return LoopDesign(
        method=_LOOP_OF_FORM[request.form],
        observer=tuned[best].observer,
        bandwidth_Hz=specification.bandwidth_Hz,
        R=R,
        S=S,
        T=T,
        A_0=np.ones(1),
        reference=path,
        margins=reached_margins(members, R, S),
        rejections=rejections(members, R, S, (*REPORTED_Hz, specification.bandwidth_Hz)),
        certificate=_certified(request, controller, path, specification),
        candidates=tuple(
            _candidate(t, is_chosen=k == best, is_feasible=not missed[k])
            for k, t in enumerate(tuned)
        ),
        members=members,
    )


def _methods(request: _Request, specification: Specification) -> tuple[str, ...]:
    if must_damp(request.family.nominal, specification.bandwidth_Hz):
        return (*METHODS, DAMPED)
    return METHODS


def _tuned(
    request: _Request, specification: Specification, method: str, *, until_met: bool = False
) -> TunedObserver:
    return tune_observer(
        request.family,
        specification,
        model=request.model,
        form=request.form,
        method=method,
        until_met=until_met,
    )


def _refuse(
    request: _Request,
    members: tuple[Member, ...],
    specification: Specification,
    best: tuple[Violation, ...],
) -> NoReturn:
    def attempt(asked: Specification) -> tuple[Violation, ...]:
        tries = (
            _missed(members, _tuned(request, asked, method, until_met=True), asked)
            for method in reversed(_methods(request, asked))
        )
        return min(_until_empty(tries), key=severity)

    refuse(
        request.axis,
        specification,
        best,
        nearest_feasible(specification, best, attempt),
        because=describe_obstacle(request.family, specification.bandwidth_Hz),
    )


def _until_empty(
    tries: Iterable[tuple[Violation, ...]],
) -> Iterator[tuple[Violation, ...]]:
    """Yield tries up to and including the first that misses nothing."""
    for missed in tries:
        yield missed
        if not missed:
            return


def _missed(
    members: tuple[Member, ...], tuned: TunedObserver, specification: Specification
) -> tuple[Violation, ...]:
    controller = linear_controller(tuned.observer)
    return unmet(members, controller.R, controller.S, specification)


def _candidate(tuned: TunedObserver, *, is_chosen: bool, is_feasible: bool) -> Candidate:
    controller = linear_controller(tuned.observer)
    return Candidate(
        name=tuned.method,
        is_chosen=is_chosen,
        is_feasible=is_feasible,
        figure=tuned.judgement.predicted_error,
        figure_name="predicted tracking error with noise, rms, worst member",
        parameters=tuned.parameters,
        R=controller.R,
        S=controller.S,
    )


def _certified(
    request: _Request,
    controller: LinearController,
    path: ReferencePath,
    specification: Specification,
) -> Certificate | None:
    if request.bounds is None:
        return None
    half_V = 0.5 * (specification.voltage_max_V - specification.voltage_min_V)
    span_V = min(half_V, request.bounds.reach_V)
    amplitude_m = span_V * abs(request.family.nominal.gain)
    fastest_m_per_s = 2.0 * np.pi * specification.scan_frequency_Hz * amplitude_m
    if specification.voltage_slew_V_per_s is not None:
        followed_m_per_s = specification.voltage_slew_V_per_s * abs(request.family.nominal.gain)
        fastest_m_per_s = min(fastest_m_per_s, SLEW_SHARE * followed_m_per_s)
    return certify(
        request.family.members,
        controller.R,
        controller.S,
        controller.T,
        path=path,
        bounds=request.bounds,
        operation=Operation(
            reference_slew_m_per_s=request.reference_slew_m_per_s or float(fastest_m_per_s),
            voltage_step_V=specification.voltage_step_V,
            sensor_noise_rms_m=specification.sensor_noise_rms,
            disturbances=request.disturbances,
        ),
    )
