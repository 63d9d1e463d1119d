"""Z: R, S, T by band-stop shaping and by convex optimisation; the better one is chosen."""

from dataclasses import replace
from typing import NoReturn

import numpy as np

from piezoid.design.design import (
    AxisDesign,
    Candidate,
    LoopDesign,
    REPORTED_Hz,
    members_of,
    reached_margins,
    rejections,
)
from piezoid.design.feasibility import nearest_feasible, refuse, severity, unmet
from piezoid.design.feedforward import fit_reference_path
from piezoid.design.plant import PlantFamily
from piezoid.design.shaping import ShapedController, shape
from piezoid.design.specification import Specification
from piezoid.design.templates import Violation
from piezoid.design.youla import ConvexController, optimise

_ATTEMPTED = 2
_FIGURE = "max over members and f <= bandwidth of |Syp| bandwidth / f"


def design_vertical(
    axis: str, family: PlantFamily, specification: Specification, *, taps: int = 10
) -> AxisDesign:
    """Design R, S, T of the tunnelling axis by both ways and choose the better one.

    family  for example the range of barrier heights: the loop gain goes with their square root
    taps    free coefficients of R' and of S' in the convex way

    Better means: meets the specification, then rejects more over the whole family. Raises
    ``TemplateError`` where neither meets it.
    """
    stopped, convex = _both(family, specification, taps)
    found = _candidates(family, specification, stopped, convex)
    feasible = [candidate for candidate in found if candidate.is_feasible]
    if not feasible:
        _refuse(axis, family, specification, taps, found)
    chosen = min(feasible, key=lambda candidate: candidate.figure)
    members, R, S = members_of(family), chosen.R, chosen.S
    T = np.array([R.sum()])
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
        candidates=_with_choice(found, chosen),
        members=members,
    )
    return AxisDesign(
        axis=axis,
        output_unit=family.nominal.output_unit,
        specification=specification,
        loops=(loop,),
    )


def _both(
    family: PlantFamily, specification: Specification, taps: int
) -> tuple[ShapedController, ConvexController]:
    stopped = shape(family, specification)
    return stopped, optimise(family, specification, stopped.controller, taps=taps)


def _candidates(
    family: PlantFamily,
    specification: Specification,
    stopped: ShapedController,
    convex: ConvexController,
) -> tuple[Candidate, ...]:
    chosen = {
        "band-stop": {
            "dominant_Hz": stopped.dominant.frequency_Hz,
            "dominant_damping": float(stopped.dominant.damping or 0.0),
            "auxiliary_root": stopped.auxiliary_root,
            **{f"stop_{k}_Hz": stop.frequency_Hz for k, stop in enumerate(stopped.band_stops)},
        },
        "convex": {"taps": float(convex.taps), "iterations": float(convex.iterations)},
    }
    ways = (
        ("band-stop", stopped.controller, stopped.rejection),
        ("convex", convex.controller, convex.rejection),
    )
    return tuple(
        Candidate(
            name=name,
            is_chosen=False,
            is_feasible=not unmet(family.members, c.R, c.S, specification),
            figure=figure,
            figure_name=_FIGURE,
            parameters=chosen[name],
            R=c.R,
            S=c.S,
        )
        for name, c, figure in ways
    )


def _with_choice(found: tuple[Candidate, ...], chosen: Candidate) -> tuple[Candidate, ...]:
    return tuple(replace(candidate, is_chosen=candidate is chosen) for candidate in found)


def _refuse(
    axis: str,
    family: PlantFamily,
    specification: Specification,
    taps: int,
    found: tuple[Candidate, ...],
) -> NoReturn:
    """Refuse with the least violated candidate and the nearest bandwidth either way reaches."""

    def attempt(asked: Specification) -> tuple[Violation, ...]:
        start = shape(family, asked).controller
        missed = unmet(family.members, start.R, start.S, asked)
        if not missed:
            return ()
        c = optimise(family, asked, start, taps=taps, most_iterations=_ATTEMPTED).controller
        return min(missed, unmet(family.members, c.R, c.S, asked), key=severity)

    best = min((unmet(family.members, c.R, c.S, specification) for c in found), key=severity)
    refuse(axis, specification, best, nearest_feasible(specification, best, attempt))
