"""Compensators of other authors, tuned on the same plants as the controllers that ship.

- ``high_gain``  integral and proportional feedback behind a notch, or behind a low pass if no mode
  is lightly damped; the reference is filtered by the inverse of the closed loop beforehand
  [Leang & Devasia 2007]
- ``inversion``  disturbance observer through inversion of the linear model [Yi, Chang & Shen 2009]

      d_hat = Q (G^-1 y - u),   u = r / G(0) - d_hat

- ``gpi_dob``    inverse of a generalised Prandtl-Ishlinskii model, equal envelopes and no dead
  zones, under the shipped observer [Al Janaideh, Rakheja & Su 2011]

The loops of the first two are tuned with the plant family, the limits and the figure of merit of
``piezoid design``. The third keeps the gains of ``mpi_dob``. An observer of a constant disturbance
satisfies d_hat = Q d, hence d_hat = Q (G^-1 y - u), where Q follows from its poles. ``inversion``
is therefore an observer without state feedback.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import bilinear, fftconvolve

from benchmarks.outsiders.simulators import PythonController
from piezoid.design.design import AxisDesign
from piezoid.design.feasibility import unmet
from piezoid.design.feedforward import fit_reference_path
from piezoid.design.lateral_task import lateral_task, unseen
from piezoid.design.loop_search import evaluate_loop, family_grid
from piezoid.design.loop_search import search as search_parameters
from piezoid.design.observer import (
    DisturbanceObserver,
    ObserverFrame,
    disturbance_model,
    linear_controller,
)
from piezoid.design.plant import Plant, PlantFamily, Section
from piezoid.design.rst import LIGHT, section_poles
from piezoid.design.sensitivity import closed_loop_polynomial
from piezoid.design.specification import Specification, slowest_Hz
from piezoid.errors import DesignError
from piezoid.export.export_stage import hysteresis_values, observer_values, reference_values
from piezoid.export.parameter_file import AxisParameters
from piezoid.identification.hysteresis.coordinates import Shape, to_si_units
from piezoid.identification.hysteresis.estimate import longest_lag_s
from piezoid.identification.hysteresis.pieces import pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings, search
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import polynomial_response, product, total, unit_circle
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.records.recording import Recording
from piezoid.runtime.controller import Controller

PLAYS, BENDS = 12, 6  # of the generalised model, which has at least the plays of the shipped one
_INFEASIBLE = (1e3, 1e3)
_SLOWER, _SLOWEST = 0.8, 0.02  # factor between trials, and lowest share of the bandwidth
_INTEGRATOR = np.array([1.0, -1.0])
_INVERSE_SAMPLES = 8192  # of the inverse's impulse response
_TRUSTED, _UNTRUSTED = -6.0, 0.0  # log10 of the inverse's effort where the response is known
Polynomials = tuple[Array, Array]
Ranges = dict[str, tuple[float, float, tuple[float, ...]]]  # lowest, highest, starts


@dataclass(frozen=True, kw_only=True, eq=False)
class Compensator:
    """A controller of one axis.

    bandwidth_Hz  of its loop, or None for feedforward
    prepare       reference -> controller with the calls of ``Controller``, and its command
    """

    method: str
    bandwidth_Hz: float | None
    prepare: Callable[[Array], "tuple[Controller | LinearController, Array]"]


def starter_of(axis: AxisParameters) -> Callable[[Array], tuple[Controller, Array]]:
    """Return the ``prepare`` of the compiled controller: the reference, ahead by its preview."""
    preview = int(axis.values["preview_samples"])

    def prepare(reference: Array) -> tuple[Controller, Array]:
        future = np.minimum(np.arange(len(reference)) + preview, len(reference) - 1)
        return Controller(axis.values), reference[future]

    return prepare


def compensators_of(
    axis: AxisParameters, design: AxisDesign, model: AxisModel, recordings: Sequence[Recording]
) -> Iterator[Compensator]:
    """Yield the feasible compensators, tuned for the plant family of this axis.

    recordings  data of the generalised model
    """
    family = lateral_task(model, design.sampling_rate_Hz, forms=("affine",)).families["affine"]
    for method, tune in (("high_gain", high_gain), ("inversion", through_inversion)):
        try:
            loop = tune(family, design.specification)
        except DesignError:
            continue
        if loop.observer is None:
            prepare = _with_inverse_filter(axis, loop, family, unseen(model).from_Hz)
        else:
            prepare = starter_of(_observer_axis(axis, loop, family))
        yield Compensator(method=method, bandwidth_Hz=loop.bandwidth_Hz, prepare=prepare)
    if "mpi_dob" in axis.methods:
        operator = generalised_model(recordings, model)
        values = hysteresis_values(replace(model.without_loop_shape(), hysteresis=operator))
        yield Compensator(
            method="gpi_dob",
            bandwidth_Hz=design.loop("mpi_dob").bandwidth_Hz,
            prepare=starter_of(axis.for_method("mpi_dob").with_values(values)),
        )


def generalised_model(
    recordings: Sequence[Recording], model: AxisModel
) -> ModifiedPrandtlIshlinskii:
    """Fit plays behind an envelope, without dead zones, to recordings of a model's axis."""
    axis, rig = model.axis, model.rig
    scales = scales_of(recordings, axis)
    pieces = pieces_of(recordings, axis, scales, rig)
    settings = Settings(
        longest_lag_s=longest_lag_s(pieces), sensor_pole_Hz=rig.sensor_bandwidth_Hz
    )
    plays = max(len(model.hysteresis.plays.threshold), PLAYS)
    shape = Shape(plays=plays, below=0, above=0, lag="delay", bends=BENDS)
    operator = to_si_units(search(pieces, shape, settings).operator, scales)
    first = recordings[0]
    response_m, _ = operator.run(first.voltage_V(axis), operator.virgin_memory())
    polarity = float(np.sign(scales.displacement_m))
    offset_m = float(np.mean(first.displacement_m(axis) - polarity * response_m))
    return replace(operator, displacement_offset_m=offset_m)


@dataclass(frozen=True, kw_only=True, eq=False)
class TunedLoop:
    """A tuned loop S u = T r - R y with the largest bandwidth that meets all limits."""

    bandwidth_Hz: float
    R: Array
    S: Array
    T: Array
    observer: DisturbanceObserver | None = None


def high_gain(family: PlantFamily, specification: Specification) -> TunedLoop:
    """Tune integral and proportional feedback, with a notch at a lightly damped mode.

    Raises ``DesignError`` if no bandwidth is feasible.
    """
    plant = family.nominal
    mode, fastest = _slowest_mode(plant), 0.4 * plant.sampling_rate_Hz

    def ranges(bandwidth_Hz: float) -> Ranges:
        slowest = 0.01 * bandwidth_Hz
        feedback: Ranges = {
            "integral_Hz": (slowest, fastest, (bandwidth_Hz, 1.5 * bandwidth_Hz)),
            "zero_Hz": (slowest, 1e3 * fastest, (fastest, slowest_Hz(plant))),
        }
        if mode is None:
            return feedback | {"pole_Hz": (slowest, fastest, (0.5 * fastest, slowest_Hz(plant)))}
        f, damping = mode
        return feedback | {
            "notch_Hz": (0.5 * f, 2.0 * f, (f, f)),
            "notch_damping": (1e-3, 1.0, (damping, 0.1)),
            "notch_width": (0.05, 3.0, (0.5, 1.0)),
        }

    return _tune(family, specification, ranges, lambda values: (*_integral(plant, values), None))


def through_inversion(family: PlantFamily, specification: Specification) -> TunedLoop:
    """Tune a disturbance observer whose Q has all poles about one frequency.

    Raises ``DesignError`` if no bandwidth is feasible.
    """
    plant = family.nominal
    frame = ObserverFrame(
        plant=plant, disturbance=disturbance_model(plant.sampling_rate_Hz), form="affine"
    )

    def ranges(bandwidth_Hz: float) -> Ranges:
        starts = tuple(factor * bandwidth_Hz for factor in (5.0, 3.0, 12.0))
        return {
            "Q_Hz": (bandwidth_Hz, max(0.2 * plant.sampling_rate_Hz, starts[-1]), starts),
            "Q_damping": (0.3, 1.0, (0.9, 0.7, 1.0)),
        }

    def build(values: dict[str, float]) -> tuple[Array, Array, DisturbanceObserver]:
        section = Section(frequency_Hz=values["Q_Hz"], damping=values["Q_damping"])
        poles = _poles_about(section, len(plant.state_matrix) + 1, plant.sampling_rate_Hz)
        placed = frame.placed(feedback_poles=plant.poles, observer_poles=poles)
        static = np.linalg.solve(np.eye(len(placed.A)) - placed.A, placed.B)
        observer = replace(
            placed,
            feedback_gain=np.zeros_like(placed.feedback_gain),
            reference_gain=1.0 / float(placed.C @ static),
        )
        controller = linear_controller(observer)
        return controller.R, controller.S, observer

    return _tune(family, specification, ranges, build)


def _tune(
    family: PlantFamily,
    specification: Specification,
    ranges: Callable[[float], Ranges],
    build: Callable[[dict[str, float]], tuple[Array, Array, DisturbanceObserver | None]],
) -> TunedLoop:
    bandwidth_Hz = specification.bandwidth_Hz
    while bandwidth_Hz > _SLOWEST * specification.bandwidth_Hz:
        loop = _tune_at(family, replace(specification, bandwidth_Hz=bandwidth_Hz), ranges, build)
        if loop is not None:
            return loop
        bandwidth_Hz *= _SLOWER
    raise DesignError(
        f"no bandwidth down to {_SLOWEST:g} of {specification.bandwidth_Hz:.4g} Hz with this "
        "compensator",
        needed="a loop with which every member of the plant family meets every limit",
        remedy="Describe the plant family more narrowly.",
    )


def _tune_at(
    family: PlantFamily,
    specification: Specification,
    ranges: Callable[[float], Ranges],
    build: Callable[[dict[str, float]], tuple[Array, Array, DisturbanceObserver | None]],
) -> TunedLoop | None:
    """Search for the best loop at one bandwidth; return None if none meets the limits."""
    grid = family_grid(family, specification)
    parameters = ranges(specification.bandwidth_Hz)
    lowest, highest, starts = (np.log(row) for row in zip(*parameters.values(), strict=True))

    def values_of(logarithms: Array) -> dict[str, float]:
        return dict(zip(parameters, np.exp(logarithms).tolist(), strict=True))

    def cost(logarithms: Array) -> tuple[float, float]:
        try:
            R, S, _ = build(values_of(logarithms))
        except DesignError:
            return _INFEASIBLE
        evaluation = evaluate_loop(grid, R, S)
        return float(np.log(max(evaluation.predicted_error, 1e-300))), evaluation.excess_dB

    feasible = search_parameters(cost, lowest, highest, list(starts.T), until_met=True)
    if cost(feasible)[1] > 0.0:
        return None
    optimum = search_parameters(cost, lowest, highest, [feasible, *starts.T])
    R, S, observer = build(values_of(optimum))
    if unmet(family.members, R, S, specification):
        return None
    return TunedLoop(
        bandwidth_Hz=specification.bandwidth_Hz,
        R=R,
        S=S,
        T=R if observer is None else linear_controller(observer).T,
        observer=observer,
    )


def _integral(plant: Plant, values: dict[str, float]) -> Polynomials:
    """Return R and S of w_i (1/s + 1/w_z) / gain behind a notch or a low pass."""
    rate_Hz = plant.sampling_rate_Hz
    integral = 2.0 * np.pi * values["integral_Hz"] / rate_Hz
    proportional = values["integral_Hz"] / values["zero_Hz"]
    R = total([integral], proportional * _INTEGRATOR) / plant.gain
    if "pole_Hz" in values:
        w = 2.0 * np.pi * values["pole_Hz"]
        b, a = bilinear([w], [1.0, w], rate_Hz)
    else:
        w = 2.0 * np.pi * values["notch_Hz"]
        shallow, wide = values["notch_damping"], values["notch_width"]
        b, a = bilinear([1.0, 2.0 * shallow * w, w * w], [1.0, 2.0 * wide * w, w * w], rate_Hz)
    return product(R, b / a[0]), product(_INTEGRATOR, a / a[0])


def _slowest_mode(plant: Plant) -> tuple[float, float] | None:
    """Return frequency and damping of the lowest lightly damped mode, or None."""
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


def _observer_axis(axis: AxisParameters, loop: TunedLoop, family: PlantFamily) -> AxisParameters:
    path = fit_reference_path(family.members, loop.R, loop.S, loop.T, band_Hz=loop.bandwidth_Hz)
    assert loop.observer is not None
    values = {**observer_values(loop.observer), **reference_values(path), "method": "dob"}
    without_alternatives = AxisParameters(axis=axis.axis, values=axis.values)
    return without_alternatives.with_values({**values, "certified_step_m": 0.0})


def _with_inverse_filter(
    axis: AxisParameters, loop: TunedLoop, family: PlantFamily, known_Hz: float
) -> "Callable[[Array], tuple[LinearController, Array]]":
    """Return the ``prepare`` of a linear controller behind the inverse of its closed loop.

    The filter conj(H) / (|H|^2 + effort) is not causal [Dewey, Leang & Devasia 1998].

    known_Hz  highest frequency at which the response is known
    """
    plant = family.nominal
    rate_Hz = plant.sampling_rate_Hz
    frequency_Hz = np.fft.rfftfreq(_INVERSE_SAMPLES, 1.0 / rate_Hz)
    q = unit_circle(frequency_Hz, rate_Hz)
    denominator = polynomial_response(closed_loop_polynomial(plant, loop.R, loop.S), q)
    H = polynomial_response(loop.T, q) * polynomial_response(plant.B_position, q) / denominator
    octaves = np.log2(np.maximum(frequency_Hz, 1e-9) / known_Hz)
    effort = 10.0 ** np.interp(octaves, [-1.0, 1.0], [_TRUSTED, _UNTRUSTED])  # a jump would ring
    inverse = np.conj(H) / (np.abs(H) ** 2 + effort)
    impulse = np.roll(np.fft.irfft(inverse / inverse[0].real), _INVERSE_SAMPLES // 2)

    def prepare(reference: Array) -> "tuple[LinearController, Array]":
        padded = np.pad(reference - reference[0], _INVERSE_SAMPLES // 2, mode="edge")
        filtered = fftconvolve(padded, impulse)[_INVERSE_SAMPLES // 2 :]
        command = reference[0] + filtered[_INVERSE_SAMPLES // 2 :][: len(reference)]
        return LinearController(axis, loop), command

    return prepare


class LinearController(PythonController):
    """S u = R (r - y) with the limits and the converter of an axis.

    The limited drive enters S. The rounding error of the converter does not, as S would
    integrate it.
    """

    def __init__(self, axis: AxisParameters, loop: TunedLoop) -> None:
        names = ("voltage_minimum_V", "voltage_maximum_V", "voltage_step_V", "lsb_V")
        low, high, max_step, lsb = (float(axis.values[name]) for name in names)
        R, S = loop.R.tolist(), (loop.S[1:] / loop.S[0]).tolist()
        self._errors = [0.0] * len(R)
        self._limited = [0.0] * len(S)

        def step(reference: float, measured: float) -> float:
            errors, limited = self._errors, self._limited
            errors.insert(0, reference - measured)
            errors.pop()
            u = sum(map(float.__mul__, R, errors)) - sum(map(float.__mul__, S, limited))
            if max_step > 0.0:
                u = min(max(u, limited[0] - max_step), limited[0] + max_step)
            u = min(max(u, low), high)
            limited.insert(0, u)
            limited.pop()
            return lsb * round(u / lsb) if lsb > 0.0 else u

        super().__init__(step)

    def start(self, voltage_V: float, measured: float) -> None:
        """Start at a drive with an error of 0."""
        del measured
        self._limited = [voltage_V] * len(self._limited)
