"""Loops of other compensators, tuned as ours are: same plants, limits, search and figure of merit.

High-gain feedback is an integrator with a proportional part behind a notch, or behind a low pass
where no mode rings [Leang & Devasia 2007]. A disturbance observer through inversion takes

    d_hat = Q (G^-1 y - u),   u = r / G(0) - d_hat                  [Yi, Chang & Shen 2009]

An observer that estimates a constant disturbance is the same thing: d_hat = Q d whatever d is, so
that d_hat = Q (G^-1 y - u) for every pair of signals, and Q follows from the observer's poles. So
it is built as one, without feedback of the states.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import bilinear

from piezoid.design.chain import Section
from piezoid.design.design import members_of
from piezoid.design.family_grid import FamilyGrid, family_grid, judge
from piezoid.design.feasibility import unmet
from piezoid.design.observer import (
    DisturbanceObserver,
    ObserverFrame,
    disturbance_model,
    linear_controller,
)
from piezoid.design.plant import Plant, PlantFamily
from piezoid.design.rst import LIGHT, section_poles
from piezoid.design.search import search
from piezoid.design.sensitivity import margins
from piezoid.design.specification import Specification, slowest_Hz
from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import product, total

_HOPELESS = (1e3, 1e3)
_SLOWER, _SLOWEST = 0.8, 0.02  # of the asked bandwidth, step by step
_INTEGRATES = np.array([1.0, -1.0])
Polynomials = tuple[Array, Array]
Named = Callable[[Array], dict[str, float]]
Choices = dict[str, tuple[float, float, tuple[float, ...]]]  # lowest, highest, starts


@dataclass(frozen=True, kw_only=True, eq=False)
class FieldLoop:
    """A tuned loop S u = T r - R y of another compensator.

    bandwidth_Hz     the largest, up to the asked one, with which every member meets every limit
    modulus_margin   the least of the family
    parameters       what the search chose
    observer         of a compensator that has one
    """

    bandwidth_Hz: float
    modulus_margin: float
    parameters: dict[str, float]
    R: Array
    S: Array
    T: Array
    observer: DisturbanceObserver | None = None


def high_gain(family: PlantFamily, asked: Specification) -> FieldLoop:
    """Return integral and proportional feedback of the error, with a notch where a mode rings.

    Raises ``DesignError`` where no bandwidth is feasible.
    """
    plant = family.nominal
    mode, fastest = _slowest_mode(plant), 0.4 * plant.sampling_rate_Hz

    def choices(bandwidth_Hz: float) -> Choices:
        slowest = 0.01 * bandwidth_Hz
        found: Choices = {
            "integral_Hz": (slowest, fastest, (bandwidth_Hz, 1.5 * bandwidth_Hz)),
            "zero_Hz": (slowest, 1e3 * fastest, (fastest, slowest_Hz(plant))),
        }
        if mode is None:
            return found | {"pole_Hz": (slowest, fastest, (0.5 * fastest, slowest_Hz(plant)))}
        f, damping = mode
        return found | {
            "notch_Hz": (0.5 * f, 2.0 * f, (f, f)),
            "notch_damping": (1e-3, 1.0, (damping, 0.1)),
            "notch_width": (0.05, 3.0, (0.5, 1.0)),
        }

    return _tuned(family, asked, choices, lambda chosen: (*_integral(plant, chosen), None))


def through_inversion(
    family: PlantFamily, asked: Specification, model: Plant | None = None
) -> FieldLoop:
    """Return a disturbance observer whose Q has all poles about one frequency.

    model  that is inverted; the family's nominal member by default

    Raises ``DesignError`` where no bandwidth is feasible.
    """
    plant = model or family.nominal
    frame = ObserverFrame(
        plant=plant, disturbance=disturbance_model(plant.sampling_rate_Hz), form="affine"
    )

    def choices(bandwidth_Hz: float) -> Choices:
        starts = tuple(factor * bandwidth_Hz for factor in (5.0, 3.0, 12.0))
        return {
            "Q_Hz": (bandwidth_Hz, max(0.2 * plant.sampling_rate_Hz, starts[-1]), starts),
            "Q_damping": (0.3, 1.0, (0.9, 0.7, 1.0)),
        }

    def build(chosen: dict[str, float]) -> tuple[Array, Array, DisturbanceObserver]:
        section = Section(frequency_Hz=chosen["Q_Hz"], damping=chosen["Q_damping"])
        poles = _poles_about(section, len(plant.state_matrix) + 1, plant.sampling_rate_Hz)
        placed = frame.placed(feedback_poles=plant.poles, observer_poles=poles)
        still = np.linalg.solve(np.eye(len(placed.A)) - placed.A, placed.B)
        observer = replace(
            placed,
            feedback_gain=np.zeros_like(placed.feedback_gain),
            reference_gain=1.0 / float(placed.C @ still),
        )
        controller = linear_controller(observer)
        return controller.R, controller.S, observer

    return _tuned(family, asked, choices, build)


def _tuned(
    family: PlantFamily,
    asked: Specification,
    choices: Callable[[float], Choices],
    build: Callable[[dict[str, float]], tuple[Array, Array, DisturbanceObserver | None]],
) -> FieldLoop:
    members = members_of(family)
    for bandwidth_Hz in _downwards(asked.bandwidth_Hz):
        specification = replace(asked, bandwidth_Hz=bandwidth_Hz)
        grid, chosen = family_grid(family, specification), choices(bandwidth_Hz)
        rows = zip(*chosen.values(), strict=True)
        lowest, highest, starts = (np.log(row) for row in rows)

        def named(logarithms: Array, names: Choices = chosen) -> dict[str, float]:
            return dict(zip(names, np.exp(logarithms).tolist(), strict=True))

        def cost(
            logarithms: Array, grid: FamilyGrid = grid, named: Named = named
        ) -> tuple[float, float]:
            try:
                R, S, _ = build(named(logarithms))
            except DesignError:
                return _HOPELESS
            judged = judge(grid, R, S)
            return float(np.log(max(judged.predicted_error, 1e-300))), judged.excess_dB

        found = search(cost, lowest, highest, list(starts.T), until_met=True)
        if found.excess_dB > 0.0:
            continue
        found = search(cost, lowest, highest, [found.parameters, *starts.T])
        R, S, observer = build(named(found.parameters))
        if unmet(members, R, S, specification):
            continue
        return FieldLoop(
            bandwidth_Hz=bandwidth_Hz,
            modulus_margin=min(margins(member, R, S).modulus_margin for member in members),
            parameters=named(found.parameters),
            R=R,
            S=S,
            T=R if observer is None else linear_controller(observer).T,
            observer=observer,
        )
    raise DesignError(
        f"no bandwidth down to {_SLOWEST:g} of {asked.bandwidth_Hz:.4g} Hz with this compensator",
        needed="a loop with which every member of the plant family meets every limit",
        remedy="Describe the plant family more narrowly.",
    )


def _downwards(asked_Hz: float) -> Iterator[float]:
    bandwidth_Hz = asked_Hz
    while bandwidth_Hz > _SLOWEST * asked_Hz:
        yield bandwidth_Hz
        bandwidth_Hz *= _SLOWER


def _integral(plant: Plant, chosen: dict[str, float]) -> Polynomials:
    """Return R and S of w_i (1/s + 1/w_z) / gain behind a notch or a low pass."""
    rate_Hz = plant.sampling_rate_Hz
    integral = 2.0 * np.pi * chosen["integral_Hz"] / rate_Hz
    proportional = chosen["integral_Hz"] / chosen["zero_Hz"]
    R = total([integral], proportional * _INTEGRATES) / plant.gain
    if "pole_Hz" in chosen:
        w = 2.0 * np.pi * chosen["pole_Hz"]
        b, a = bilinear([w], [1.0, w], rate_Hz)
    else:
        w = 2.0 * np.pi * chosen["notch_Hz"]
        shallow, wide = chosen["notch_damping"], chosen["notch_width"]
        b, a = bilinear([1.0, 2.0 * shallow * w, w * w], [1.0, 2.0 * wide * w, w * w], rate_Hz)
    return product(R, b / a[0]), product(_INTEGRATES, a / a[0])


def _slowest_mode(plant: Plant) -> tuple[float, float] | None:
    """Return frequency and damping of the slowest mode that rings, if one does."""
    s = np.log(plant.poles) * plant.sampling_rate_Hz
    light = s[(-s.real < LIGHT * np.abs(s)) & (s.imag > 0.0)]
    if not light.size:
        return None
    slowest = light[np.argmin(np.abs(light))]
    return float(np.abs(slowest) / (2.0 * np.pi)), float(-slowest.real / np.abs(slowest))


def _poles_about(section: Section, count: int, rate_Hz: float) -> Array:
    pair = section_poles(section, rate_Hz)
    single = section_poles(Section(frequency_Hz=section.frequency_Hz), rate_Hz)
    return np.concatenate([*[pair] * (count // 2), *[single] * (count % 2)])
