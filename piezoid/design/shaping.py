"""Iterative sensitivity shaping: pole placement, with a band-stop at each violated template.

After Landau & Zito 2006: dominant pair, auxiliary poles, then pairs of fixed part and auxiliary
pole around the frequency of the worst violation, and the equation is solved again.
"""

from dataclasses import dataclass

import numpy as np

from piezoid.design.loop_search import FamilyGrid, family_grid, search, worst_excess
from piezoid.design.plant import Plant, PlantFamily, Section
from piezoid.design.rst import (
    INTEGRATOR,
    OPEN_AT_NYQUIST,
    RstController,
    closed_loop_target,
    place_poles,
)
from piezoid.design.specification import Specification
from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import product

_INFEASIBLE = (1e3, 1e3)
_MIN_RATIO, _MAX_RATIO = 0.25, 0.7  # of the dampings of a band-stop
_MIN_TIGHTENING_dB = 0.02
_MIN_IMPROVEMENT = 0.95  # ratio of rejection figures
_DENOMINATOR_DAMPING = 0.8


@dataclass(frozen=True, kw_only=True)
class BandStop:
    """One digital band-stop around a frequency.

    part               ``S`` lowers |Syp| there, ``R`` lowers |Sup|
    frequency_Hz       of the deepest attenuation
    numerator_damping  > 0
    denominator_damping  larger; the ratio is the attenuation, before the equation is re-solved
    """

    part: str
    frequency_Hz: float
    numerator_damping: float
    denominator_damping: float

    def __post_init__(self) -> None:
        if self.part not in ("S", "R"):
            raise ValueError(f"part is {self.part!r}, expected 'S' or 'R'")
        if not 0 < self.numerator_damping < self.denominator_damping:
            raise ValueError(
                f"dampings are {self.numerator_damping} over {self.denominator_damping}, expected "
                "0 < numerator < denominator"
            )


def band_stop_polynomials(filter_: BandStop, sampling_rate_Hz: float) -> tuple[Array, Array]:
    """Return the monic numerator and denominator in q^-1.

        (s^2 + 2 z_n w0 s + w0^2) / (s^2 + 2 z_d w0 s + w0^2),  s = c (1 - q^-1)/(1 + q^-1)

    with c = 2 fs and w0 = c tan(pi f0 / fs): the bilinear map, prewarped so that the attenuation
    is exactly at f0.                                                     [Landau & Zito 2006]
    """
    c = 2.0 * sampling_rate_Hz
    w0 = c * np.tan(np.pi * filter_.frequency_Hz / sampling_rate_Hz)

    def mapped(damping: float) -> Array:
        middle, side = 2.0 * w0**2 - 2.0 * c**2, 2.0 * damping * w0 * c
        raw = np.array([c**2 + side + w0**2, middle, c**2 - side + w0**2])
        return np.asarray(raw / raw[0])

    return mapped(filter_.numerator_damping), mapped(filter_.denominator_damping)


@dataclass(frozen=True, kw_only=True, eq=False)
class ShapedController:
    """A controller by pole placement or by convex optimisation, with its figures.

    controller  R, S, T
    parameters  result of the search, by name
    rejection   max over members and f <= bandwidth of |Syp| bandwidth / f; smaller is better
    excess_dB   <= 0: every member meets every limit on the grid of the search
    band_stops  in the order they were added
    history     (iterations + 1,)  the rejection at the start and after each convex problem
    """

    controller: RstController
    parameters: dict[str, float]
    rejection: float
    excess_dB: float
    band_stops: tuple[BandStop, ...] = ()
    history: tuple[float, ...] = ()


def shape(
    family: PlantFamily, specification: Specification, *, max_band_stops: int = 3
) -> ShapedController:
    """Search P_D and P_F for the smallest rejection figure under all limits, and add band-stops.

    A band-stop is tried at the frequency that is worst relative to its limit. Its attenuation is
    the excess there, from 3 to 12 dB. It is kept if it reduces the excess, or the rejection by 5 %
    at the same excess; the first band-stop that is not kept ends the search.
    """
    grid = family_grid(family, specification)
    best = _best_placement(family.nominal, grid, ())
    for _ in range(max_band_stops):
        worst = worst_excess(grid, best.controller.R, best.controller.S)
        ratio = 10.0 ** (-max(worst.excess_dB, 3.0) / 20.0)
        stop = BandStop(
            part="R" if worst.function == "Sup" else "S",
            frequency_Hz=worst.frequency_Hz,
            numerator_damping=float(np.clip(ratio, _MIN_RATIO, _MAX_RATIO)) * _DENOMINATOR_DAMPING,
            denominator_damping=_DENOMINATOR_DAMPING,
        )
        placement = _best_placement(family.nominal, grid, (*best.band_stops, stop))
        # The band-stop must justify two more coefficients in R, S and P.
        tightened_dB = max(best.excess_dB, 0.0) - max(placement.excess_dB, 0.0)
        is_better = tightened_dB > 0.0
        if abs(tightened_dB) <= _MIN_TIGHTENING_dB:
            is_better = placement.rejection < _MIN_IMPROVEMENT * best.rejection
        if not is_better:
            break
        best = placement
    return best


def _best_placement(
    plant: Plant, grid: FamilyGrid, band_stops: tuple[BandStop, ...]
) -> ShapedController:
    """Search log f0 and zeta of the dominant pair and the auxiliary root for fixed band-stops.

        P = P_D P_F,   P_F = (1 - alpha q^-1)^n,   R and S contain 1 + q^-1, 1 - q^-1 and the stops

    The range of f0 follows from the plant's delay.
    """
    rate_Hz = plant.sampling_rate_Hz
    fixed_r, fixed_s, denominators = OPEN_AT_NYQUIST, INTEGRATOR, np.ones(1)
    for stop in band_stops:
        numerator, denominator = band_stop_polynomials(stop, rate_Hz)
        denominators = product(denominators, denominator)
        if stop.part == "S":
            fixed_s = product(fixed_s, numerator)
        else:
            fixed_r = product(fixed_r, numerator)
    free = len(plant.A) + len(plant.B) - 3
    reach_Hz = min(0.1 / plant.rest_delay_s, 0.2 * rate_Hz)
    lower = np.array([np.log(0.02 * reach_Hz), 0.5, 0.02])
    upper = np.array([np.log(min(5.0 * reach_Hz, 0.3 * rate_Hz)), 1.5, 0.8])
    starts = [
        np.array([np.log(share * reach_Hz), 0.9, root])
        for share, root in ((1.0, 0.2), (0.3, 0.2), (0.1, 0.4))
    ]

    def build(x: Array) -> ShapedController:
        frequency_Hz, damping, root = float(np.exp(x[0])), float(x[1]), float(x[2])
        dominant = Section(frequency_Hz=frequency_Hz, damping=damping)
        target = closed_loop_target(dominant, rate_Hz, auxiliary_root=root, auxiliary_count=free)
        P = product(target, denominators)
        controller = place_poles(plant, P, H_R=fixed_r, H_S=fixed_s)
        worst = worst_excess(grid, controller.R, controller.S)
        return ShapedController(
            controller=controller,
            parameters={
                "dominant_Hz": frequency_Hz,
                "dominant_damping": damping,
                "auxiliary_root": root,
                **{f"stop_{k}_Hz": stop.frequency_Hz for k, stop in enumerate(band_stops)},
            },
            rejection=worst.rejection,
            excess_dB=worst.excess_dB,
            band_stops=band_stops,
        )

    def cost(x: Array) -> tuple[float, float]:
        try:
            shaped = build(x)
        except DesignError:
            return _INFEASIBLE
        return float(np.log(shaped.rejection)), shaped.excess_dB

    return build(search(cost, lower, upper, starts))
