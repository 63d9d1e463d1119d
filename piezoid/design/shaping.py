"""Iterative sensitivity shaping: pole placement, with a band-stop at each violated template.

After Landau & Zito 2006: dominant pair, auxiliary poles, then pairs of fixed part and auxiliary
pole around the frequency of the worst violation, and the equation is solved again.
"""

import numpy as np

from piezoid.design.feasibility import unmet
from piezoid.design.loop_search import (
    FamilyGrid,
    LoopFigures,
    Solution,
    evaluate_loop,
    family_grid,
    search,
)
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
_DENOMINATOR_DAMPING = 0.8  # of a band-stop

BandStop = tuple[str, float, float]
"""``S`` to lower |Syp| or ``R`` to lower |Sup|; frequency in Hz; damping of the numerator."""


def band_stop_polynomials(
    frequency_Hz: float, damping: float, sampling_rate_Hz: float
) -> tuple[Array, Array]:
    """Return the monic numerator and denominator of a band-stop in q^-1.

        (s^2 + 2 z_n w0 s + w0^2) / (s^2 + 2 z_d w0 s + w0^2),  s = c (1 - q^-1)/(1 + q^-1)

    with c = 2 fs and w0 = c tan(pi f0 / fs): the bilinear map, prewarped so that the attenuation
    z_n / z_d is exactly at f0; z_d is 0.8.                               [Landau & Zito 2006]

    damping  z_n of the numerator
    """
    c = 2.0 * sampling_rate_Hz
    w0 = c * np.tan(np.pi * frequency_Hz / sampling_rate_Hz)

    def mapped(damping: float) -> Array:
        middle, side = 2.0 * w0**2 - 2.0 * c**2, 2.0 * damping * w0 * c
        raw = np.array([c**2 + side + w0**2, middle, c**2 - side + w0**2])
        return np.asarray(raw / raw[0])

    return mapped(damping), mapped(_DENOMINATOR_DAMPING)


def shape(
    family: PlantFamily, specification: Specification, *, max_band_stops: int = 3
) -> Solution:
    """Search P_D and P_F for the smallest rejection figure under all limits, and add band-stops.

    A band-stop is tried at the frequency that is worst relative to its limit. Its attenuation is
    the excess there, from 3 to 12 dB. It is kept if it reduces the excess, or the rejection by 5 %
    at the same excess; the first band-stop that is not kept ends the search.
    """
    grid = family_grid(family, specification)
    stops: tuple[BandStop, ...] = ()
    controller, parameters, figures = _best_placement(family.nominal, grid, stops)
    for _ in range(max_band_stops):
        ratio = 10.0 ** (-max(figures.excess_dB, 3.0) / 20.0)
        damping = float(np.clip(ratio, _MIN_RATIO, _MAX_RATIO)) * _DENOMINATOR_DAMPING
        part = "R" if figures.function == "Sup" else "S"
        more_stops = (*stops, (part, figures.frequency_Hz, damping))
        candidate = _best_placement(family.nominal, grid, more_stops)
        tightened = candidate[-1]
        # The band-stop must justify two more coefficients in R, S and P.
        tightened_dB = max(figures.excess_dB, 0.0) - max(tightened.excess_dB, 0.0)
        is_better = tightened_dB > 0.0
        if abs(tightened_dB) <= _MIN_TIGHTENING_dB:
            is_better = tightened.rejection < _MIN_IMPROVEMENT * figures.rejection
        if not is_better:
            break
        stops, (controller, parameters, figures) = more_stops, candidate
    return Solution(
        name="band-stop",
        controller=controller,
        parameters=parameters,
        figure=figures.rejection,
        violations=unmet(family.members, controller.R, controller.S, specification),
    )


def _best_placement(
    plant: Plant, grid: FamilyGrid, band_stops: tuple[BandStop, ...]
) -> tuple[RstController, dict[str, float], LoopFigures]:
    """Search log f0 and zeta of the dominant pair and the auxiliary root for fixed band-stops.

        P = P_D P_F,   P_F = (1 - alpha q^-1)^n,   R and S contain 1 + q^-1, 1 - q^-1 and the stops

    The range of f0 follows from the plant's delay.
    """
    rate_Hz = plant.sampling_rate_Hz
    fixed_r, fixed_s, denominators = OPEN_AT_NYQUIST, INTEGRATOR, np.ones(1)
    for part, frequency_Hz, damping in band_stops:
        numerator, denominator = band_stop_polynomials(frequency_Hz, damping, rate_Hz)
        denominators = product(denominators, denominator)
        if part == "S":
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

    def place(x: Array) -> RstController:
        dominant = Section(frequency_Hz=float(np.exp(x[0])), damping=float(x[1]))
        target = closed_loop_target(
            dominant, rate_Hz, auxiliary_root=float(x[2]), auxiliary_count=free
        )
        return place_poles(plant, product(target, denominators), H_R=fixed_r, H_S=fixed_s)

    def cost(x: Array) -> tuple[float, float]:
        try:
            controller = place(x)
        except DesignError:
            return _INFEASIBLE
        figures = evaluate_loop(grid, controller.R, controller.S)
        return float(np.log(figures.rejection)), figures.excess_dB

    x = search(cost, lower, upper, starts)
    controller = place(x)
    parameters = {
        "dominant_Hz": float(np.exp(x[0])),
        "dominant_damping": float(x[1]),
        "auxiliary_root": float(x[2]),
        **{f"stop_{k}_Hz": frequency_Hz for k, (_, frequency_Hz, _) in enumerate(band_stops)},
    }
    return controller, parameters, evaluate_loop(grid, controller.R, controller.S)
