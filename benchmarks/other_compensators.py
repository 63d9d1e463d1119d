"""Compensators of other authors, tuned on the same plants as the controllers that ship.

- ``high_gain``  integral and proportional feedback behind a notch, or behind a low pass if no mode
  is lightly damped; the reference is filtered by the inverse of the closed loop beforehand
  [Leang & Devasia 2007]
- ``inversion``  disturbance observer through inversion of the linear model [Yi, Chang & Shen 2009]

      d_hat = Q (G^-1 y - u),   u = r / G(0) - d_hat

- ``gpi_dob``    inverse of a generalised Prandtl-Ishlinskii model, equal envelopes and no dead
  zones, under the shipped observer [Al Janaideh, Rakheja & Su 2011]

The loops of the first two are searched for with the plant family, the limits and the figure of
merit of ``piezoid design``; the third keeps the gains of ``mpi_dob``. An observer that estimates a
constant disturbance satisfies d_hat = Q d for every d, hence d_hat = Q (G^-1 y - u) with a Q that
follows from its poles; ``inversion`` is therefore built as an observer without state feedback.
"""

import ctypes
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import bilinear, fftconvolve

from piezoid.design.design import AxisDesign
from piezoid.design.feasibility import unmet
from piezoid.design.feedforward import fit_reference_path
from piezoid.design.lateral_task import lateral_task, unseen
from piezoid.design.loop_search import FamilyGrid, evaluate_loop, family_grid
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
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.records.recording import Recording
from piezoid.runtime.controller import Controller

PLAYS, BENDS = 12, 6  # of the generalised model: at least as many plays as the shipped one
_HOPELESS = (1e3, 1e3)
_SLOWER, _SLOWEST = 0.8, 0.02  # of the requested bandwidth, step by step
_INTEGRATES = np.array([1.0, -1.0])
_INVERSE_SAMPLES = 8192  # of the inverse's impulse response
_TRUSTED, _UNTRUSTED = -6.0, 0.0  # log10 of the inverse's effort where the response is known
_STEP = ctypes.CFUNCTYPE(
    ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_double
)
_RESET = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
Polynomials = tuple[Array, Array]
Choices = dict[str, tuple[float, float, tuple[float, ...]]]  # lowest, highest, starts


@dataclass(frozen=True, kw_only=True, eq=False)
class Compensator:
    """A controller of one axis that does not ship.

    bandwidth_Hz  of its loop; None without one
    started       from the whole reference: what has the calls of ``Controller``, and the
                  reference that it is given
    """

    method: str
    bandwidth_Hz: float | None
    started: Callable[[Array], "tuple[Controller | LinearStep, Array]"]


def shipped(axis: AxisParameters) -> Callable[[Array], tuple[Controller, Array]]:
    """Return how the compiled controller is started; with the reference ahead by its preview."""
    preview = int(axis.values["preview_samples"])

    def started(reference: Array) -> tuple[Controller, Array]:
        ahead = np.minimum(np.arange(len(reference)) + preview, len(reference) - 1)
        return Controller(axis.values), reference[ahead]

    return started


def compensators_of(
    axis: AxisParameters, design: AxisDesign, model: AxisModel, recordings: Sequence[Recording]
) -> Iterator[Compensator]:
    """Yield the compensators that have a loop, tuned for the plants this axis may have.

    recordings  to which the generalised model is fitted
    """
    family = lateral_task(model, design.sampling_rate_Hz, forms=("affine",)).families["affine"]
    for method, tuned in (("high_gain", high_gain), ("inversion", through_inversion)):
        try:
            loop = tuned(family, design.specification)
        except DesignError:
            continue
        if loop.observer is None:
            started = _behind_inverse(axis, loop, family, unseen(model).from_Hz)
        else:
            started = shipped(_observer_axis(axis, loop, family))
        yield Compensator(method=method, bandwidth_Hz=loop.bandwidth_Hz, started=started)
    if "mpi_dob" in axis.methods:
        operator = generalised_model(recordings, model)
        values = hysteresis_values(replace(model.without_loop_shape(), hysteresis=operator))
        yield Compensator(
            method="gpi_dob",
            bandwidth_Hz=design.loop("mpi_dob").bandwidth_Hz,
            started=shipped(axis.for_method("mpi_dob").with_values(values)),
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
    moved_m, _ = operator.run(first.voltage_V(axis), operator.virgin_memory())
    polarity = float(np.sign(scales.displacement_m))
    offset_m = float(np.mean(first.displacement_m(axis) - polarity * moved_m))
    return replace(operator, displacement_offset_m=offset_m)


@dataclass(frozen=True, kw_only=True, eq=False)
class TunedLoop:
    """A tuned loop S u = T r - R y; bandwidth_Hz is the largest with which every limit is met."""

    bandwidth_Hz: float
    R: Array
    S: Array
    T: Array
    observer: DisturbanceObserver | None = None


def high_gain(family: PlantFamily, asked: Specification) -> TunedLoop:
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
) -> TunedLoop:
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
) -> TunedLoop:
    members = family.members
    for bandwidth_Hz in _downwards(asked.bandwidth_Hz):
        specification = replace(asked, bandwidth_Hz=bandwidth_Hz)
        grid, chosen = family_grid(family, specification), choices(bandwidth_Hz)
        rows = zip(*chosen.values(), strict=True)
        lowest, highest, starts = (np.log(row) for row in rows)

        def named(logarithms: Array, names: Choices = chosen) -> dict[str, float]:
            return dict(zip(names, np.exp(logarithms).tolist(), strict=True))

        def cost(
            logarithms: Array,
            grid: FamilyGrid = grid,
            named: Callable[[Array], dict[str, float]] = named,
        ) -> tuple[float, float]:
            try:
                R, S, _ = build(named(logarithms))
            except DesignError:
                return _HOPELESS
            judged = evaluate_loop(grid, R, S)
            return float(np.log(max(judged.predicted_error, 1e-300))), judged.excess_dB

        found = search_parameters(cost, lowest, highest, list(starts.T), until_met=True)
        if found.excess_dB > 0.0:
            continue
        found = search_parameters(cost, lowest, highest, [found.parameters, *starts.T])
        R, S, observer = build(named(found.parameters))
        if unmet(members, R, S, specification):
            continue
        return TunedLoop(
            bandwidth_Hz=bandwidth_Hz,
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


def _observer_axis(axis: AxisParameters, loop: TunedLoop, family: PlantFamily) -> AxisParameters:
    path = fit_reference_path(family.members, loop.R, loop.S, loop.T, band_Hz=loop.bandwidth_Hz)
    assert loop.observer is not None
    values = {**observer_values(loop.observer), **reference_values(path), "method": "dob"}
    bare = AxisParameters(axis=axis.axis, values=axis.values)
    return bare.with_values({**values, "certified_step_m": 0.0})


def _behind_inverse(
    axis: AxisParameters, loop: TunedLoop, family: PlantFamily, known_Hz: float
) -> "Callable[[Array], tuple[LinearStep, Array]]":
    """Return a linear controller, its reference filtered by the closed loop's inverse.

    conj(H) / (|H|^2 + effort), without regard to causality [Dewey, Leang & Devasia 1998]
    """
    plant = family.nominal
    rate_Hz = plant.sampling_rate_Hz
    frequency_Hz = np.fft.rfftfreq(_INVERSE_SAMPLES, 1.0 / rate_Hz)
    q = unit_circle(frequency_Hz, rate_Hz)
    closed = polynomial_response(closed_loop_polynomial(plant, loop.R, loop.S), q)
    H = polynomial_response(loop.T, q) * polynomial_response(plant.B_position, q) / closed
    octaves = np.log2(np.maximum(frequency_Hz, 1e-9) / known_Hz)
    effort = 10.0 ** np.interp(octaves, [-1.0, 1.0], [_TRUSTED, _UNTRUSTED])  # a jump would ring
    inverse = np.conj(H) / (np.abs(H) ** 2 + effort)
    impulse = np.roll(np.fft.irfft(inverse / inverse[0].real), _INVERSE_SAMPLES // 2)

    def started(reference: Array) -> "tuple[LinearStep, Array]":
        around = np.pad(reference - reference[0], _INVERSE_SAMPLES // 2, mode="edge")
        led = fftconvolve(around, impulse)[_INVERSE_SAMPLES // 2 :]
        given = reference[0] + led[_INVERSE_SAMPLES // 2 :][: len(reference)]
        return LinearStep(axis, loop), given

    return started


class LinearStep:
    """S u = R (r - y) behind limits and converter of an axis; S goes on with what the limits left.

    What rounding took away is not fed back: S would integrate it.
    """

    def __init__(self, axis: AxisParameters, loop: TunedLoop) -> None:
        names = ("voltage_minimum_V", "voltage_maximum_V", "voltage_step_V", "lsb_V")
        low, high, most, lsb = (float(axis.values[name]) for name in names)
        R, S = loop.R.tolist(), (loop.S[1:] / loop.S[0]).tolist()
        self._errors = [0.0] * len(R)
        self._limited = [0.0] * len(S)
        self._status = (ctypes.c_uint32 * 2)()

        def step(_state: int, _parameters: int, wanted: float, measured: float) -> float:
            errors, limited = self._errors, self._limited
            errors.insert(0, wanted - measured)
            errors.pop()
            u = sum(map(float.__mul__, R, errors)) - sum(map(float.__mul__, S, limited))
            if most > 0.0:
                u = min(max(u, limited[0] - most), limited[0] + most)
            u = min(max(u, low), high)
            limited.insert(0, u)
            limited.pop()
            return lsb * round(u / lsb) if lsb > 0.0 else u

        self._step, self._reset = _STEP(step), _RESET(lambda _: None)

    @property
    def addresses(self) -> tuple[int, int, int]:
        """Of the step, the state and the parameters, of which there are none."""
        step = ctypes.cast(self._step, ctypes.c_void_p).value
        assert step is not None
        return step, ctypes.addressof(self._status), ctypes.addressof(self._status)

    @property
    def reset_address(self) -> int:
        """Of a reset that does nothing."""
        reset = ctypes.cast(self._reset, ctypes.c_void_p).value
        assert reset is not None
        return reset

    def start(self, voltage_V: float, measured: float) -> None:
        """Go to rest at a voltage; the error is 0 there."""
        del measured
        self._limited = [voltage_V] * len(self._limited)
