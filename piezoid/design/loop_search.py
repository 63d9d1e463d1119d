"""Search a loop over a plant family: its figures on a frequency grid, and the minimisation.

The grid evaluates thousands of candidate loops quickly. The margins of the record are computed by
``sensitivity`` on a finer grid with exact crossings. The minimisation needs no gradients, is
deterministic, and begins from several starts.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.observer import DisturbanceObserver
from piezoid.design.plant import Plant, PlantFamily
from piezoid.design.rst import LIGHT, RstController, damping_ratios
from piezoid.design.sensitivity import FUNCTIONS, Violation, delay_limit
from piezoid.design.specification import Specification
from piezoid.numerics.arrays import Array
from piezoid.numerics.derivative_free import direct_search
from piezoid.numerics.polynomial import (
    Response,
    decibel,
    grid_Hz,
    polynomial_response,
    unit_circle,
)

_UNSTABLE_dB = 60.0
_WIDTHS, _LINES = 4.0, 13  # half widths on either side of a mode, and lines there
_HARMONICS = np.array([1, 3, 5, 7])
_STEP_TOLERANCE = 1e-3
_POLISHING_STEPS = (0.1, 0.05, 0.1, 0.05)
_MAX_RESERVE_dB = 1.0  # beyond which the constraint is constant

Evaluate = Callable[[Array], tuple[float, float]]
"""Function of the parameters; returns (cost to minimise, excess over the limits in dB)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FamilyGrid:
    """Responses of every member's A and B on one grid, and the limits there.

    q               (frequencies,)           values of q^-1
    A, B            (members, frequencies)
    frequency_Hz    (frequencies,)
    limits          (functions, frequencies) magnitudes of Syp, Sup, Syb, Syv; inf: no limit
    weight          (frequencies,)           integrates a density over the grid up to Nyquist
    q_scan          (harmonics,)             q^-1 at odd harmonics of the scan
    A_scan, B_scan  (members, harmonics)
    """

    specification: Specification
    q: Response
    A: Response
    B: Response
    frequency_Hz: Array
    limits: Array
    weight: Array
    q_scan: Response
    A_scan: Response
    B_scan: Response


@dataclass(frozen=True, kw_only=True)
class LoopFigures:
    """Figures of one candidate loop on the grid.

    function         Syp, Sup, Syb or Syv: the one with the largest excess over its limit
    frequency_Hz     of that excess
    excess_dB        largest excess over any limit; <= 0 if all are met
    rejection        max over members and f <= bandwidth of |Syp(f)| bandwidth / f
    predicted_error  rms, output unit, worst member: scan disturbance, sensor noise, converter
    """

    function: str
    frequency_Hz: float
    excess_dB: float
    rejection: float
    predicted_error: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """A loop that one method found for a family.

    name        of the method
    controller  R, S, T
    parameters  result of the search, by name
    figure      that the choice between methods minimises
    violations  of the specification by members of the family, worst first
    observer    gains of a disturbance observer; None: the controller is its polynomials
    """

    name: str
    controller: RstController
    parameters: dict[str, float]
    figure: float
    violations: tuple[Violation, ...]
    observer: DisturbanceObserver | None = None


def family_grid(
    family: PlantFamily, specification: Specification, *, count: int = 300
) -> FamilyGrid:
    """Sample a family for a specification."""
    rate_Hz = family.nominal.sampling_rate_Hz
    lowest_Hz = min(1.0, specification.bandwidth_Hz / 30.0)
    f = grid_Hz(rate_Hz, lowest_Hz=lowest_Hz, count=count)
    knots = [t.frequency_Hz for t in specification.all_templates]
    lines = np.concatenate([*knots, *(mode_lines_Hz(member) for member in family.members)])
    f = np.union1d(f, lines[(lines >= lowest_Hz) & (lines < 0.5 * rate_Hz)])
    # The tightest limit of each function; margins become limits of Syp and Syb.
    limits = np.full((4, len(f)), np.inf)
    limits[0] = 1.0 / specification.modulus_margin
    limits[2] = delay_limit(f, specification.delay_margin_s)
    for template in specification.all_templates:
        row = FUNCTIONS.index(template.function)
        limits[row] = np.minimum(limits[row], 10.0 ** (template.limit_dB(f) / 20.0))
    q = unit_circle(f, rate_Hz)
    q_scan = unit_circle(_HARMONICS * specification.scan_frequency_Hz, rate_Hz)
    return FamilyGrid(
        specification=specification,
        q=q,
        A=np.stack([polynomial_response(m.A, q) for m in family.members]),
        B=np.stack([polynomial_response(m.B, q) for m in family.members]),
        frequency_Hz=f,
        limits=limits,
        weight=np.gradient(f) / (0.5 * rate_Hz),
        q_scan=q_scan,
        A_scan=np.stack([polynomial_response(m.A, q_scan) for m in family.members]),
        B_scan=np.stack([polynomial_response(m.B, q_scan) for m in family.members]),
    )


def light_modes(plant: Plant) -> tuple[Array, Array]:
    """Return natural frequency in Hz and damping ratio of the lightly damped modes of a plant."""
    s, damping = np.log(plant.poles), damping_ratios(plant.poles)
    light = (damping < LIGHT) & (s.imag > 0.0)
    return np.abs(s[light]) * plant.sampling_rate_Hz / (2.0 * np.pi), damping[light]


def mode_lines_Hz(plant: Plant) -> Array:
    """Return lines about the lightly damped modes of a plant, spaced below their width."""
    natural_Hz, damping = light_modes(plant)
    widths = np.linspace(-_WIDTHS, _WIDTHS, _LINES)
    lines = natural_Hz[:, None] * (1.0 + damping[:, None] * widths)
    return np.asarray(lines.ravel())


def evaluate_loop(grid: FamilyGrid, R: ArrayLike, S: ArrayLike) -> LoopFigures:
    """Return excess over the limits, rejection and predicted error of one loop over the family."""
    functions, unstable_poles = magnitudes(grid, R, S)
    ratio = (functions / grid.limits[:, None, :]).max(axis=1)
    row, column = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    excess_dB = float(decibel(ratio[row, column]))
    if unstable_poles:
        excess_dB = _UNSTABLE_dB * unstable_poles + max(excess_dB, 0.0)
    specification = grid.specification
    band = grid.frequency_Hz <= specification.bandwidth_Hz * (1.0 + 1e-12)
    scale = specification.bandwidth_Hz / grid.frequency_Hz[band]
    r, s = polynomial_response(R, grid.q_scan), polynomial_response(S, grid.q_scan)
    sensitivity = np.abs(grid.A_scan * s / (grid.A_scan * s + grid.B_scan * r))
    harmonics = sensitivity * specification.disturbance_rms / _HARMONICS
    disturbance = np.sqrt((harmonics**2).sum(axis=1))  # of the scan, by member
    sensor = (functions[2] ** 2 @ grid.weight) * specification.sensor_noise_rms**2
    converter = (functions[3] ** 2 @ grid.weight) * specification.voltage_step_V**2 / 12.0
    noise = np.sqrt(sensor + converter)
    if specification.noise_limit_rms is not None:
        excess_dB = max(excess_dB, float(decibel(noise.max() / specification.noise_limit_rms)))
    return LoopFigures(
        function=FUNCTIONS[row],
        frequency_Hz=float(grid.frequency_Hz[column]),
        excess_dB=excess_dB,
        rejection=float((functions[0][:, band].max(axis=0) * scale).max()),
        predicted_error=float(np.hypot(disturbance, noise).max()),
    )


def magnitudes(grid: FamilyGrid, R: ArrayLike, S: ArrayLike) -> tuple[Array, int]:
    """Return |Syp|, |Sup|, |Syb|, |Syv|, and the largest number of unstable poles of a member.

    The magnitudes are (functions, members, frequencies). Unstable poles are counted by the winding
    of P(e^jw): a polynomial in q^-1 that starts with 1 winds once around zero for each root
    outside the unit circle.
    """
    r, s = polynomial_response(R, grid.q), polynomial_response(S, grid.q)
    p = grid.A * s + grid.B * r
    functions = np.stack(
        [np.abs(grid.A * s), np.abs(grid.A * r), np.abs(grid.B * r), np.abs(grid.B * s)]
    ) / np.abs(p)
    # The unwrapped angle from the first line to the last. A search evaluates it thousands of
    # times; np.unwrap takes eight times as long.
    angle = np.angle(p)
    turns = np.round(np.diff(angle) / (2.0 * np.pi)).sum(axis=1)
    winding = angle[:, -1] - angle[:, 0] - 2.0 * np.pi * turns
    return functions, int(np.round(np.abs(winding) / np.pi).max())


class _LimitsMetError(Exception):
    """Stops the optimiser at the first feasible point; caught in this module."""


def search(
    evaluate: Evaluate,
    lower: Array,
    upper: Array,
    starts: Sequence[Array],
    *,
    evaluations: int = 250,
    reserve_dB: float = 0.1,
    until_met: bool = False,
) -> Array:
    """Minimise the cost where the excess is at most -reserve_dB; else minimise the excess.

    From each start COBYLA [Powell 1994] descends in the unit cube for at most ``evaluations``
    calls. It is restarted from the best point with smaller steps, because it can stop at an edge
    of the maximum over members. The best of all evaluated points is returned.

    reserve_dB  allowance for peaks between the points of the search's grid
    until_met   stop at the first point that meets every limit, to decide feasibility
    """
    evaluated: list[tuple[bool, float, Array]] = []
    span = upper - lower

    def evaluate_unit(unit: Array) -> tuple[float, float]:
        parameters = lower + np.clip(unit, 0.0, 1.0) * span
        cost, excess_dB = evaluate(parameters)
        is_feasible = excess_dB <= -reserve_dB
        evaluated.append((not is_feasible, cost if is_feasible else excess_dB, parameters))
        if is_feasible and until_met:
            raise _LimitsMetError
        return cost, excess_dB

    def descend(start: Array, step: float) -> None:
        cache: dict[bytes, tuple[float, float]] = {}

        def cached(unit: Array) -> tuple[float, float]:
            """Evaluate cost and constraint of one point together."""
            key = unit.tobytes()
            if key not in cache:
                cache.clear()
                cache[key] = evaluate_unit(unit)
            return cache[key]

        direct_search(
            lambda unit: cached(unit)[0],
            np.clip((start - lower) / span, 0.0, 1.0),
            (np.zeros(len(start)), np.ones(len(start))),
            initial_step=step,
            max_evaluations=evaluations,
            constraint=lambda unit: max(cached(unit)[1], -_MAX_RESERVE_dB) + reserve_dB,
            step_tolerance=_STEP_TOLERANCE,
        )

    with contextlib.suppress(_LimitsMetError):
        for start in starts:
            descend(start, 0.15)
        polished = set()
        for step in _POLISHING_STEPS:
            best = min(evaluated, key=lambda item: item[:2])
            if (id(best), step) not in polished:  # else the same evaluations would repeat
                polished.add((id(best), step))
                descend(best[2], step)
    return min(evaluated, key=lambda item: item[:2])[2]
