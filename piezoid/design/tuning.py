"""Search an observer's poles or noise variances over a plant family."""

import numpy as np

from piezoid.design.feasibility import unmet
from piezoid.design.loop_search import Solution, evaluate_loop, family_grid, search
from piezoid.design.observer import (
    DisturbanceModel,
    DisturbanceObserver,
    ObserverFrame,
    disturbance_model,
    extended,
    feedback_polynomials,
    linear_controller,
)
from piezoid.design.plant import Plant, PlantFamily, Section
from piezoid.design.rst import (
    LIGHT,
    damping_ratios,
    feedback_poles,
    observer_poles,
    slow_and_fast,
)
from piezoid.design.specification import Specification, slowest_Hz
from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array

METHODS = ("placed", "kalman")
DAMPED = "damped by state feedback"  # tried where the slowest mode rings, and the others miss
_INFEASIBLE = (1e3, 1e3)
_DOUBLINGS = 40
_LAST_DIGIT = 1e-15
# Starts of the search, one column each: frequencies relative to the slowest pole of the plant.
# ``placed`` starts from a fast, a moderate and a slow observer: a slow observer is not the most
# robust with a lightly damped mode. ``DAMPED`` starts with a fast observer, from which the
# feedback damps the mode at its frequency. Of 30 starts over the whole box, these led to the
# highest bandwidth about a mode at 700 Hz known to 10 %: 504 Hz, where ``placed`` reaches 471 Hz.
_STARTS: dict[str, dict[str, tuple[float, ...]]] = {
    "placed": {
        "feedback_Hz": (1.0, 1.0, 0.6),
        "feedback_damping": (0.9, 0.9, 1.0),
        "observer_Hz": (1.9, 1.2, 0.9),
        "observer_damping": (0.8, 0.8, 1.0),
        "disturbance_Hz": (1.27, 0.5, 0.3),
    },
    "kalman": {
        "feedback_Hz": (1.0, 0.6),
        "feedback_damping": (0.9, 1.0),
        "drift_ratio": (0.1, 1e-3),
        "input_ratio": (1.0, 0.1),
    },
    DAMPED: {
        "feedback_Hz": (1.03, 1.04, 1.05),
        "feedback_damping": (0.144, 0.15, 0.16),
        "observer_Hz": (4.7, 4.0, 5.7),
        "observer_damping": (0.83, 0.93, 1.1),
        "disturbance_Hz": (3.1, 4.8, 5.7),
    },
}
# An additional start for a lightly damped slowest mode, which hardly changes the mode: dampings
# are three times that of the mode.
_GENTLE = {
    **{"feedback_Hz": 1.0, "observer_Hz": 1.0, "disturbance_Hz": 0.2},
    **{"drift_ratio": 1e-4, "input_ratio": 1e-3},
}


def kalman_gain(
    plant: Plant,
    disturbance: DisturbanceModel,
    *,
    input_variance: float,
    drift_variance: float,
    sensor_variance: float,
) -> Array:
    """Return the stationary Kalman gain of the extended state, in current form.

        Pm = A_e Pm A_e' - A_e Pm C_e' (C_e Pm C_e' + r)^-1 C_e Pm A_e' + blkdiag(q_x b b', q_d I)
        L = Pm C_e' (C_e Pm C_e' + r)^-1                                 [Kalman 1960]

    q_x  input_variance   V^2 of one sample, white, at the plant's input
    q_d  drift_variance   V^2 of one sample's change of each disturbance state, > 0
    r    sensor_variance  output unit squared, > 0

    q_d is E[(D d)^2], for example of the hysteresis model's remainder along the planned scan.
    Returns (n + w,), of plant and disturbance states.
    """
    A_e, C_e = extended(plant, disturbance)
    order, states = len(plant.state_matrix), len(disturbance.output)
    drive = np.concatenate([plant.input_taps.sum(axis=1), np.zeros(states)])
    Q = input_variance * np.outer(drive, drive)
    Q[order:, order:] += drift_variance * np.eye(states)
    # P = A' P (I + G P)^-1 A + Q by doubling the horizon in each iteration [Chu, Fan, Lin & Wang
    # 2004]. A search solves it thousands of times; scipy's solver takes four times as long.
    A, G, covariance = A_e.T, np.outer(C_e, C_e) / sensor_variance, Q
    try:
        for _ in range(_DOUBLINGS):
            blocks = np.linalg.solve(np.eye(len(A)) + G @ covariance, np.hstack([A, G]))
            inner_a, inner_g = np.hsplit(blocks, 2)
            increment = A.T @ covariance @ inner_a
            G, A, covariance = G + A @ inner_g @ A.T, A @ inner_a, covariance + increment
            if np.abs(increment).max() <= _LAST_DIGIT * np.abs(covariance).max():
                break
        else:
            raise np.linalg.LinAlgError(f"it still changes after {_DOUBLINGS} doublings")
    except np.linalg.LinAlgError as fault:
        raise DesignError(
            f"the Riccati equation of '{plant.label}' has no stabilising solution: {fault}",
            needed="a drift variance > 0, and a plant that passes a constant",
            remedy="Raise the drift variance, or place the observer's poles.",
        ) from fault
    return np.asarray(covariance @ C_e / float(C_e @ covariance @ C_e + sensor_variance))


def _search_box(plant: Plant, method: str) -> tuple[tuple[str, ...], Array, list[Array]]:
    """Return the parameters that a method chooses for a plant, their bounds, and its starts.

    returned  names; (2, parameters) lower and upper bounds; starts, (parameters,) each, within the
              bounds
    """
    slowest, fastest_Hz = slowest_Hz(plant), 0.2 * plant.sampling_rate_Hz
    slow, fast = slow_and_fast(plant)
    damping = min(float(damping_ratios(slow).min()), LIGHT)
    is_gentle = damping < LIGHT
    starts = dict(_STARTS[method])
    count = len(starts["feedback_Hz"])
    if is_gentle and method != DAMPED:
        for name, multiples in starts.items():
            starts[name] = (*multiples, _GENTLE.get(name, 3.0 * damping))
    if (damping_ratios(fast) < LIGHT).any():
        mode_damping = tuple(np.geomspace(0.3, 0.02, count + is_gentle).tolist())
        starts["mode_damping"] = mode_damping[: len(starts["feedback_Hz"])]
        if method != "kalman":
            starts["mode_observer_damping"] = starts["mode_damping"]
    rows = []
    for name, multiples in starts.items():
        unit, lowest, highest = 1.0, damping, 1.6
        if name.endswith("_Hz"):
            highest = 0.5 * fastest_Hz if name == "feedback_Hz" else fastest_Hz
            unit, lowest = slowest, min(0.05 * slowest, 0.5 * highest)
        elif name.endswith("_ratio"):
            lowest, highest = 1e-8, 1e4
        elif name.startswith("mode_"):
            lowest, highest = 1e-3, 1.0
        rows.append([lowest, highest, *np.clip(unit * np.array(multiples), lowest, highest)])
    columns = np.array(rows).T
    return tuple(starts), columns[:2], list(columns[2:])


def tune_observer(
    family: PlantFamily,
    specification: Specification,
    *,
    model: Plant | None = None,
    form: str = "affine",
    method: str = "placed",
    until_met: bool = False,
) -> Solution:
    """Search the observer and feedback with the smallest predicted error that meet every limit.

        minimise    max over members of rms(scan disturbance + sensor noise + converter)
        subject to  templates, modulus margin and delay margin of every member

    model   design model of the observer; the family's nominal member unless it is too large
    method  ``placed`` searches poles; ``kalman`` searches noise variances and feedback poles;
            ``DAMPED`` searches poles as ``placed`` does, from loops that damp the slowest mode
    until_met  stop at the first point that meets every limit, to decide feasibility

    If no point meets every limit, the point with the smallest excess is returned.
    """
    plant = model or family.nominal
    grid, (names, bounds, starts) = family_grid(family, specification), _search_box(plant, method)
    disturbance = disturbance_model(plant.sampling_rate_Hz, specification.oscillation_Hz)
    frame = ObserverFrame(plant=plant, disturbance=disturbance, form=form)

    def parameters_of(logarithms: Array) -> dict[str, float]:
        return dict(zip(names, np.exp(logarithms).tolist(), strict=True))

    def cost(logarithms: Array) -> tuple[float, float]:
        try:
            observer = _observer(frame, specification, parameters_of(logarithms), method)
            R, S = feedback_polynomials(observer)
        except DesignError:
            return _INFEASIBLE
        figures = evaluate_loop(grid, R, S)
        return float(np.log(max(figures.predicted_error, 1e-300))), figures.excess_dB

    logarithms = [np.log(start) for start in starts]
    lower, upper = np.log(bounds)
    result = search(cost, lower, upper, logarithms, until_met=until_met)
    parameters = parameters_of(result)
    observer = _observer(frame, specification, parameters, method)
    controller = linear_controller(observer)
    return Solution(
        name=method,
        controller=controller,
        parameters=parameters,
        figure=evaluate_loop(grid, controller.R, controller.S).predicted_error,
        violations=unmet(family.members, controller.R, controller.S, specification),
        observer=observer,
    )


def _observer(
    frame: ObserverFrame, specification: Specification, parameters: dict[str, float], method: str
) -> DisturbanceObserver:
    """Build the observer of one candidate."""
    plant = frame.plant
    feedback = Section(
        frequency_Hz=parameters["feedback_Hz"], damping=parameters["feedback_damping"]
    )
    poles = feedback_poles(plant, feedback, mode_damping=parameters.get("mode_damping", 0.0))
    if method == "kalman":
        unit = max(specification.sensor_noise_rms, 1e-12 * abs(plant.gain)) ** 2
        gain = kalman_gain(
            plant,
            frame.disturbance,
            input_variance=parameters["input_ratio"] * unit / plant.gain**2,
            drift_variance=parameters["drift_ratio"] * unit / plant.gain**2,
            sensor_variance=unit,
        )
        return frame.with_gain(gain, feedback_poles=poles)
    error_poles = observer_poles(
        plant,
        Section(frequency_Hz=parameters["observer_Hz"], damping=parameters["observer_damping"]),
        parameters["disturbance_Hz"],
        specification.oscillation_Hz,
        mode_damping=parameters.get("mode_observer_damping", 0.0),
    )
    return frame.placed(feedback_poles=poles, observer_poles=error_poles)
