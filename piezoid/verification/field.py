"""What else the field compares itself with, on the same plants, references and seeds.

The introduction of [Ryba, Voda & Besancon 2015] names four other ways to compensate hysteresis:

- ``high_gain``  high-gain feedback, and the reference put through the inverse of the closed loop
  beforehand, so that vibration does not show [Leang & Devasia 2007]
- ``inversion``  a disturbance observer through inversion of the linear model
  [Yi, Chang & Shen 2009]
- ``gpi_dob``    the inverse of a generalised Prandtl-Ishlinskii model, equal envelopes and no
  dead zones, under our observer [Al Janaideh, Rakheja & Su 2011]
- ``charge``     a charge amplifier and a static gain, no sensor [Fleming & Leang 2014]

They never ship. The first two are tuned by ``design.field_loops`` within the limits of what ships;
the third keeps its gains. The fourth is another amplifier: where the voltage drive moves p and a
drive without hysteresis p_0, it moves p_0 + F (p - p_0), F being 1 far below its corner, where a
charge amplifier drives a voltage, and a fifth far above it.
"""

import ctypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import fftconvolve

from piezoid.design.design import AxisDesign, Design
from piezoid.design.feedforward import fit_reference_path
from piezoid.design.field_loops import FieldLoop, high_gain, through_inversion
from piezoid.design.from_model import lateral_task, unseen
from piezoid.design.plant import PlantFamily
from piezoid.design.sensitivity import closed_loop_polynomial
from piezoid.errors import DesignError
from piezoid.export.from_design import hysteresis_values, observer_values, reference_values
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.estimate import longest_lag_s
from piezoid.identification.hysteresis.physical import physical
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings, search
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Executor
from piezoid.numerics.frequency import polynomial_response, unit_circle
from piezoid.operators.dead_zone import LINEAR
from piezoid.operators.linear import recursive_filter
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.records.frames import from_arrays
from piezoid.records.recording import Recording
from piezoid.verification.bench import Bench, Compensator, Other, bench_of
from piezoid.verification.closed_loop import LoopRecord, Stepped
from piezoid.verification.criteria import Limits
from piezoid.verification.plant import AxisPlant, Hysteresis
from piezoid.verification.scenarios import SCENARIOS, Path, Scenario
from piezoid.verification.tracking import Tracking
from piezoid.verification.verification import FieldRow
from piezoid.verification.verify import all_pasts, lateral_runs, tracked

# Driving charge takes hysteresis off five times [Fleming & Leang 2014, chapter 12]; the corner is
# that of drives whose dc is set by resistors.
CHARGE_LEAVES, CHARGE_CORNER_Hz = 0.2, 0.1
PLAYS, BENDS = 12, 6  # of the generalised model, at least as many plays as ours has
_SWEEPS, _STEPS = 31, 60
_INVERSE_SAMPLES = 8192  # of the inverse's impulse response
_TRUSTED, _UNTRUSTED = -6.0, 0.0  # log10 of the inverse's effort where the response is known
_STEP = ctypes.CFUNCTYPE(
    ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_double
)
_RESET = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rival:
    """Another compensator of one axis.

    bandwidth_Hz    of its loop, as ``FieldLoop`` has it
    modulus_margin  likewise
    """

    method: str
    compensator: Compensator
    bandwidth_Hz: float
    modulus_margin: float


def field_rows(
    file: ParameterFile,
    design: Design,
    model: ActuatorModel,
    plants: Sequence[AxisPlant],
    *,
    scenarios: Sequence[Scenario] = SCENARIOS,
    seed: int = 0,
    threads: int = 1,
) -> tuple[FieldRow, ...]:
    """Return how the others follow the compared spirals; a method that an axis cannot have is left
    out.

    design  that the file was exported from
    plants  of all axes of the file
    seed    as that of ``verify``
    """
    bench = bench_of(file, plants, Limits(), seed, Executor(threads=threads))
    if not bench.lateral:
        return ()
    rivals = [
        {rival.method: rival for rival in rivals_of(file.axis(a), design.axis(a), model[a])}
        for a in bench.lateral
    ]
    common = [name for name in rivals[0] if all(name in one for one in rivals)]
    compared = [scenario for scenario in scenarios if scenario.is_compared]
    rows = []
    for scenario in compared:
        path = scenario.path(bench.rate_Hz)
        for method in common:
            own = {axis: one[method] for axis, one in zip(bench.lateral, rivals, strict=True)}
            used = {axis: rival.compensator for axis, rival in own.items()}
            run = _run_of(used)
            rows.append(_row(method, scenario, _worst(bench, scenario, path, run), own))
        if "none" in bench.methods():
            rows.append(_row("charge", scenario, _worst(bench, scenario, path, _charge), {}))
    return tuple(rows)


def rivals_of(
    axis: AxisParameters,
    design: AxisDesign,
    model: AxisModel,
    recordings: Sequence[Recording] = (),
) -> Iterator[Rival]:
    """Yield the compensators that have a loop, tuned for the plants this axis may have.

    recordings  to which the generalised model is fitted; by default a decaying sweep of the
                identified stage
    """
    family = lateral_task(model, design.sampling_rate_Hz, forms=("affine",)).families["affine"]
    for method, tuned in (("high_gain", high_gain), ("inversion", through_inversion)):
        try:
            loop = tuned(family, design.specification)
        except DesignError:
            continue
        yield Rival(
            method=method,
            compensator=_of_loop(axis, loop, family, unseen(model).from_Hz),
            bandwidth_Hz=loop.bandwidth_Hz,
            modulus_margin=loop.modulus_margin,
        )
    if "mpi_dob" in axis.methods:
        ours = design.loop("mpi_dob")
        shown = recordings or (_decaying_sweep(model),)
        plays, rig = len(model.hysteresis.plays.threshold), model.rig if recordings else Rig()
        other = generalised_model(shown, model.axis, plays=plays, rig=rig)
        values = hysteresis_values(replace(model.without_minor_loops(), hysteresis=other))
        yield Rival(
            method="gpi_dob",
            compensator=Compensator(axis=axis.for_method("mpi_dob").with_values(values)),
            bandwidth_Hz=ours.bandwidth_Hz,
            modulus_margin=ours.worst_modulus_margin,
        )


def generalised_model(
    recordings: Sequence[Recording], axis: str, *, plays: int, rig: Rig
) -> ModifiedPrandtlIshlinskii:
    """Fit plays behind an envelope, without dead zones, to recordings.

    plays  at least ``PLAYS`` are taken
    rig    declared poles
    """
    scales = scales_of(recordings, axis)
    pieces = pieces_of(recordings, axis, scales, rig)
    settings = Settings(
        longest_lag_s=longest_lag_s(pieces), sensor_pole_Hz=rig.sensor_bandwidth_Hz
    )
    shape = Shape(plays=max(plays, PLAYS), below=0, above=0, lag="delay", bends=BENDS)
    operator = physical(search(pieces, shape, settings).operator, scales)
    first = recordings[0]
    moved_m, _ = operator.run(first.voltage_V(axis), operator.virgin_memory())
    polarity = float(np.sign(scales.displacement_m))
    offset_m = float(np.mean(first.displacement_m(axis) - polarity * moved_m))
    return replace(operator, displacement_offset_m=offset_m)


def _decaying_sweep(model: AxisModel) -> Recording:
    """Return what the identified stage, with what its class leaves, shows of a decaying sweep."""
    low_V, high_V = model.voltage_V
    levels = np.linspace(1.0, 0.05, _SWEEPS) * (-1.0) ** np.arange(_SWEEPS)
    ends = np.concatenate([[1.0], -levels])
    steps = np.linspace(0.0, 1.0, _STEPS, endpoint=False)
    turned = (ends[:-1, None] + np.diff(ends)[:, None] * steps).ravel()
    voltage_V = 0.5 * (low_V + high_V) + 0.5 * (high_V - low_V) * turned
    operator = model.hysteresis
    moved_m, _ = operator.run(voltage_V, operator.virgin_memory())
    if model.discrepancy is not None:
        moved_m = moved_m + model.discrepancy.run(voltage_V)
    offset_m = operator.displacement_offset_m
    return from_arrays(
        voltage_V=voltage_V,
        displacement_m=offset_m + model.polarity * (moved_m - offset_m),
        sampling_rate_Hz=100.0,
        axis=model.axis,
    )


def _of_loop(
    axis: AxisParameters, loop: FieldLoop, family: PlantFamily, known_Hz: float
) -> Compensator:
    if loop.observer is None:
        return Compensator(axis=axis, other=_prepared(axis, loop, family, known_Hz))
    path = fit_reference_path(family.members, loop.R, loop.S, loop.T, band_Hz=loop.bandwidth_Hz)
    values = {**observer_values(loop.observer), **reference_values(path), "method": "dob"}
    own = AxisParameters(axis=axis.axis, values=axis.values)
    return Compensator(axis=own.with_values({**values, "certified_step_m": 0.0}))


def _prepared(
    axis: AxisParameters, loop: FieldLoop, family: PlantFamily, known_Hz: float
) -> Other:
    """Return what makes a linear controller, and its reference behind the closed loop's inverse.

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

    def make(reference: Array) -> tuple[Stepped, Array]:
        around = np.pad(reference - reference[0], _INVERSE_SAMPLES // 2, mode="edge")
        led = fftconvolve(around, impulse)[_INVERSE_SAMPLES // 2 :]
        given = reference[0] + led[_INVERSE_SAMPLES // 2 :][: len(reference)]
        return _LinearStep(axis, loop), given

    return make


class _LinearStep:
    """S u = R (r - y) behind limits and converter of an axis; S goes on with what the limits left.

    What rounding took away is not fed back: S would integrate it.
    """

    def __init__(self, axis: AxisParameters, loop: FieldLoop) -> None:
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


Runs = Callable[[Bench, Path, Mapping[str, AxisPlant]], Mapping[str, LoopRecord]]


def _run_of(used: Mapping[str, Compensator]) -> Runs:
    return lambda bench, path, plants: lateral_runs(bench, path, plants=plants, compensators=used)


def _charge(bench: Bench, path: Path, plants: Mapping[str, AxisPlant]) -> Mapping[str, LoopRecord]:
    """Return the path with a static gain, as a charge drive would follow it."""
    driven = lateral_runs(bench, path, "none", plants)
    straight = {a: _without_hysteresis(plant, bench.file.axis(a)) for a, plant in plants.items()}
    linear = lateral_runs(bench, path, "none", straight)
    found = {}
    for axis, record in driven.items():
        moved, away = linear[axis].position, record.position
        line = np.stack([moved, np.ones_like(moved)], axis=1)
        hysteresis = away - line @ np.linalg.lstsq(line, away, rcond=None)[0]
        slow = np.exp(-2.0 * np.pi * CHARGE_CORNER_Hz / bench.rate_Hz)
        begun = hysteresis - hysteresis[0]
        below = recursive_filter([1.0 - slow], [1.0, -slow], begun)
        left = hysteresis[0] + CHARGE_LEAVES * begun + (1.0 - CHARGE_LEAVES) * below
        found[axis] = replace(record, position=moved + left - left.mean())
    return found


def _without_hysteresis(plant: AxisPlant, axis: AxisParameters) -> AxisPlant:
    """Return the plant with the static gain of the controller in place of its hysteresis."""
    response = plant.response
    if not isinstance(response, Hysteresis):
        return plant
    gain = float(axis.for_method("none").values["gain_m_per_V"]) / plant.measured_gain
    line = PrandtlIshlinskii(threshold=np.zeros(1), weight=np.array([gain]))
    operator = ModifiedPrandtlIshlinskii(
        plays=line,
        dead_zones=LINEAR,
        voltage_offset_V=response.operator.voltage_offset_V,
        displacement_offset_m=response.operator.displacement_offset_m,
    )
    return replace(
        plant,
        response=replace(response, operator=operator, discrepancy=None, activation_s=0.0),
    )


def _worst(bench: Bench, scenario: Scenario, path: Path, runs: Runs) -> Tracking:
    """Return the worse of the pasts a stage may have had, as ``verify`` does of ours."""
    each = [
        tracked(bench, scenario, path, runs(bench, path, plants)) for plants in all_pasts(bench)
    ]
    return max(each, key=lambda found: found.rms_m)


def _row(
    method: str, scenario: Scenario, found: Tracking, rivals: Mapping[str, Rival]
) -> FieldRow:
    return FieldRow(
        method=method,
        frequency_Hz=scenario.frequency_Hz,
        rms_m=found.rms_m,
        rms_percent=found.rms_percent,
        max_m=found.max_m,
        aligned_rms_m=found.aligned_rms_m,
        delay_s=found.delay_s,
        bandwidth_Hz=min((one.bandwidth_Hz for one in rivals.values()), default=None),
        modulus_margin=min((one.modulus_margin for one in rivals.values()), default=None),
    )
