"""The automatic choice of an observer's poles or noise variances over a plant family."""

from dataclasses import dataclass, replace

import numpy as np

from piezoid.design.chain import Section
from piezoid.design.family_grid import Judgement, family_grid, judge
from piezoid.design.observer import (
    DisturbanceModel,
    DisturbanceObserver,
    ObserverFrame,
    disturbance_model,
    extended,
    feedback_polynomials,
)
from piezoid.design.plant import Plant, PlantFamily
from piezoid.design.rst import (
    LIGHT,
    PoleChoice,
    feedback_poles,
    light_modes,
    observer_poles,
    slowest_damping,
)
from piezoid.design.search import search
from piezoid.design.specification import Specification, slowest_Hz
from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array, freeze

METHODS = ("placed", "kalman")
DAMPED = "damped by state feedback"  # tried where the slowest mode rings, and the others miss
_HOPELESS = (1e3, 1e3)
_DOUBLINGS = 40
_LAST_DIGIT = 1e-15


@dataclass(frozen=True, kw_only=True, eq=False)
class KalmanGain:
    """A stationary Kalman gain in current form.

    gain                 (n + w,)  of plant and disturbance states
    innovation_variance  output unit squared; a recording whose innovations vary otherwise, or
                         are not white, says that a variance or the model is wrong
    """

    gain: Array
    innovation_variance: float

    def __post_init__(self) -> None:
        freeze(self, "gain")


def kalman_gain(
    plant: Plant,
    disturbance: DisturbanceModel,
    *,
    input_variance: float,
    drift_variance: float,
    sensor_variance: float,
) -> KalmanGain:
    """Solve the Riccati equation of the extended state.

        Pm = A_e Pm A_e' - A_e Pm C_e' (C_e Pm C_e' + r)^-1 C_e Pm A_e' + blkdiag(q_x b b', q_d I)
        L = Pm C_e' (C_e Pm C_e' + r)^-1                                 [Kalman 1960]

    q_x  input_variance   V^2 of one sample, white, at the plant's input
    q_d  drift_variance   V^2 of one sample's change of each disturbance state, > 0
    r    sensor_variance  output unit squared, > 0

    q_d is E[(D d)^2], for example of the hysteresis model's remainder along the planned scan.
    """
    if not (drift_variance > 0.0 and sensor_variance > 0.0 and input_variance >= 0.0):
        raise ValueError(
            f"variances are {input_variance}, {drift_variance}, {sensor_variance}; the drift and "
            "the sensor need > 0: an exact constant needs no observer, an exact sensor no filter"
        )
    A_e, C_e = extended(plant, disturbance)
    order, states = len(plant.state_matrix), len(disturbance.output)
    drive = np.concatenate([plant.input_taps.sum(axis=1), np.zeros(states)])
    Q = input_variance * np.outer(drive, drive)
    Q[order:, order:] += drift_variance * np.eye(states)
    try:
        ahead = _doubled(A_e.T, np.outer(C_e, C_e) / sensor_variance, Q)
    except np.linalg.LinAlgError as fault:
        raise DesignError(
            f"the Riccati equation of '{plant.label}' has no stabilising solution: {fault}",
            needed="a drift variance > 0, and a plant that passes a constant",
            remedy="Raise the drift variance, or place the observer's poles.",
        ) from fault
    innovation = float(C_e @ ahead @ C_e + sensor_variance)
    return KalmanGain(gain=ahead @ C_e / innovation, innovation_variance=innovation)


def _doubled(A: Array, G: Array, Q: Array) -> Array:
    """Return P = A' P (I + G P)^-1 A + Q, each round doubling the horizon.

    A search asks thousands of times; ``scipy.linalg.solve_discrete_are`` takes four times as long.

    Source: Chu, Fan, Lin & Wang, International Journal of Control 77 (2004).
    """
    P: Array = Q
    for _ in range(_DOUBLINGS):
        inner = np.linalg.solve(np.eye(len(A)) + G @ P, np.hstack([A, G]))
        ahead, across = np.hsplit(inner, 2)
        increment = A.T @ P @ ahead
        G, A, P = G + A @ across @ A.T, A @ ahead, P + increment
        if np.abs(increment).max() <= _LAST_DIGIT * np.abs(P).max():
            return np.asarray(P)
    raise np.linalg.LinAlgError(f"after {_DOUBLINGS} doublings it is still changing")


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One parameter of the search, on a logarithmic scale.

    starts  one value for each start of the search
    """

    name: str
    lowest: float
    highest: float
    starts: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class TunedObserver:
    """An observer, how it was found, and what the search's grid says of it.

    method       ``placed``, ``kalman`` or ``DAMPED``
    observer     the gains
    parameters   what was chosen, by name
    judgement    excess over the limits and predicted error, on the search's grid
    evaluations  how many candidates were judged
    """

    method: str
    observer: DisturbanceObserver
    parameters: dict[str, float]
    judgement: Judgement
    evaluations: int


def tune_observer(
    family: PlantFamily,
    specification: Specification,
    *,
    model: Plant | None = None,
    form: str = "affine",
    method: str = "placed",
    until_met: bool = False,
) -> TunedObserver:
    """Choose feedback and observer so that every member meets every limit, with the least
    predicted error.

        minimise    max over members of rms(scan disturbance left + sensor noise + converter)
        subject to  templates, modulus margin and delay margin of every member

    model   what the observer computes with; the family's nominal member unless it is too large
    method  ``placed`` searches poles; ``kalman`` searches noise variances and feedback poles;
            ``DAMPED`` searches poles as ``placed`` does, from loops that damp the slowest mode
    until_met  take the first choice that meets every limit, to learn whether there is one

    Where no choice meets the limits, the one that misses them least is returned; its judgement
    says by how much.
    """
    plant = model or family.nominal
    grid = family_grid(family, specification)
    choices = _CHOICES[method](plant)
    names = [choice.name for choice in choices]

    disturbance = disturbance_model(plant.sampling_rate_Hz, specification.oscillation_Hz)
    frame = ObserverFrame(plant=plant, disturbance=disturbance, form=form)

    def build(logarithms: Array) -> DisturbanceObserver:
        values = dict(zip(names, np.exp(logarithms).tolist(), strict=True))
        return _observer(frame, specification, values, method)

    def cost(logarithms: Array) -> tuple[float, float]:
        try:
            R, S = feedback_polynomials(build(logarithms))
        except DesignError:
            return _HOPELESS
        judgement = judge(grid, R, S)
        return float(np.log(max(judgement.predicted_error, 1e-300))), judgement.excess_dB

    result = search(
        cost,
        np.log([choice.lowest for choice in choices]),
        np.log([choice.highest for choice in choices]),
        [np.log(start) for start in zip(*(c.starts for c in choices), strict=True)],
        until_met=until_met,
    )
    observer = build(result.parameters)
    R, S = feedback_polynomials(observer)
    return TunedObserver(
        method=method,
        observer=observer,
        parameters=dict(zip(names, np.exp(result.parameters).tolist(), strict=True)),
        judgement=judge(grid, R, S),
        evaluations=result.evaluations,
    )


def _placed_choices(plant: Plant) -> tuple[Choice, ...]:
    """Return the poles to choose, as multiples of the slowest pole of the plant.

    The starts are a quick, a moderate and a slow observer: a slow one is not the most robust
    with a lightly damped mode. With such a mode a fourth leaves it nearly as it is.
    """
    f, highest = slowest_Hz(plant), 0.2 * plant.sampling_rate_Hz
    min_damping = _least_damping(plant)
    gentle = 1 if min_damping < LIGHT else 0
    light = 3.0 * min_damping
    unchanged, none = (1.0,) * gentle, (light,) * gentle
    return (
        _frequency("feedback_Hz", f, 0.5 * highest, (1.0, 1.0, 0.6, *unchanged)),
        _damping("feedback_damping", min_damping, (0.9, 0.9, 1.0, *none)),
        _frequency("observer_Hz", f, highest, (1.9, 1.2, 0.9, *unchanged)),
        _damping("observer_damping", min_damping, (0.8, 0.8, 1.0, *none)),
        _frequency("disturbance_Hz", f, highest, (1.27, 0.5, 0.3, *(0.2,) * gentle)),
        *_mode_choices(plant, ("mode_damping", "mode_observer_damping"), 3 + gentle),
    )


def _damping_choices(plant: Plant) -> tuple[Choice, ...]:
    """Return the same poles, started where a quick observer lets the feedback damp the mode.

    The mode keeps its frequency and gets a sixth of critical damping; observer and disturbance
    estimate are three to five times as fast. Of 30 starts over the whole box these led to the
    quickest loops about a mode at 700 Hz known to 10 %, 504 Hz, where ``placed`` finds 471.
    """
    slowest = slowest_Hz(plant)
    values = {
        "feedback_Hz": (1.03, 1.04, 1.05),
        "feedback_damping": (0.144, 0.15, 0.16),
        "observer_Hz": (4.7, 4.0, 5.7),
        "observer_damping": (0.83, 0.93, 1.1),
        "disturbance_Hz": (3.1, 4.8, 5.7),
    }
    started = []
    for choice in _placed_choices(plant):
        unit = slowest if choice.name.endswith("_Hz") else 1.0
        starts = np.array(values.get(choice.name, choice.starts[:3]))
        starts = starts * (unit if choice.name in values else 1.0)
        within = np.clip(starts, choice.lowest, choice.highest)
        started.append(replace(choice, starts=tuple(within.tolist())))
    return tuple(started)


def _kalman_choices(plant: Plant) -> tuple[Choice, ...]:
    f, highest = slowest_Hz(plant), 0.2 * plant.sampling_rate_Hz
    min_damping = _least_damping(plant)
    gentle = 1 if min_damping < LIGHT else 0
    return (
        _frequency("feedback_Hz", f, 0.5 * highest, (1.0, 0.6, *(1.0,) * gentle)),
        _damping("feedback_damping", min_damping, (0.9, 1.0, *(3.0 * min_damping,) * gentle)),
        _variance("drift_ratio", (0.1, 1e-3, *(1e-4,) * gentle)),
        _variance("input_ratio", (1.0, 0.1, *(1e-3,) * gentle)),
        *_mode_choices(plant, ("mode_damping",), 2 + gentle),
    )


def _mode_choices(plant: Plant, names: tuple[str, ...], starts: int) -> tuple[Choice, ...]:
    """Return the dampings that further modes are given, where the plant has any."""
    if not light_modes(plant).size:
        return ()
    values = tuple(np.geomspace(0.3, 0.02, starts).tolist())
    return tuple(Choice(name=name, lowest=1e-3, highest=1.0, starts=values) for name in names)


def _least_damping(plant: Plant) -> float:
    return min(slowest_damping(plant), LIGHT)


def _damping(name: str, lowest: float, starts: tuple[float, ...]) -> Choice:
    return Choice(name=name, lowest=lowest, highest=1.6, starts=starts)


def _variance(name: str, starts: tuple[float, ...]) -> Choice:
    return Choice(name=name, lowest=1e-8, highest=1e4, starts=starts)


def _frequency(name: str, f: float, highest: float, multiples: tuple[float, ...]) -> Choice:
    lowest = min(0.05 * f, 0.5 * highest)
    starts = tuple(min(max(f * m, lowest), highest) for m in multiples)
    return Choice(name=name, lowest=lowest, highest=highest, starts=starts)


def _observer(
    frame: ObserverFrame, specification: Specification, parameters: dict[str, float], method: str
) -> DisturbanceObserver:
    """Build one candidate from named parameters."""
    plant = frame.plant
    feedback = Section(
        frequency_Hz=parameters["feedback_Hz"], damping=parameters["feedback_damping"]
    )
    choice = PoleChoice(
        feedback=feedback,
        observer=feedback,
        disturbance_Hz=feedback.frequency_Hz,
        mode_damping=parameters.get("mode_damping", 0.0),
    )
    poles = feedback_poles(plant, choice)
    if method != "kalman":
        observer = Section(
            frequency_Hz=parameters["observer_Hz"], damping=parameters["observer_damping"]
        )
        choice = replace(
            choice,
            observer=observer,
            disturbance_Hz=parameters["disturbance_Hz"],
            mode_observer_damping=parameters.get("mode_observer_damping", 0.0),
        )
        poles_of_observer = observer_poles(plant, choice, specification.oscillation_Hz)
        return frame.placed(feedback_poles=poles, observer_poles=poles_of_observer)
    unit = max(specification.sensor_noise_rms, 1e-12 * abs(plant.gain)) ** 2
    gain = kalman_gain(
        plant,
        frame.disturbance,
        input_variance=parameters["input_ratio"] * unit / plant.gain**2,
        drift_variance=parameters["drift_ratio"] * unit / plant.gain**2,
        sensor_variance=unit,
    )
    return frame.with_gain(gain.gain, feedback_poles=poles)


_CHOICES = {"placed": _placed_choices, "kalman": _kalman_choices, DAMPED: _damping_choices}
