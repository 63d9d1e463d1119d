"""The target `waveform`: one period of a scan, predistorted, for a wave generator or a DAQ.

The table starts as the exact inverse of the hysteresis. It is then corrected, harmonic by
harmonic, until the simulated motion of the identified plant converges to the reference:

    u <- u + IFFT(E / G),   E = FFT(reference - position in the last period), G the linear plant

so that it compensates amplifier, modes, delay, and creep within a period. The plant contains the
loop shape of the model, which no controller inverts.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from piezoid.design.lateral_task import plant_family
from piezoid.errors import ParameterFileError
from piezoid.export.c_header import plain_ascii
from piezoid.export.parameter_file import AxisParameters
from piezoid.formatting import with_unit
from piezoid.identification.extensions.extension import Where
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.fixed_point import damped_iteration
from piezoid.numerics.polynomial import polynomial_response, unit_circle
from piezoid.targets.target_inputs import (
    SEED,
    ControllerHardware,
    TargetInputs,
    error_rows,
    exported_position_m,
    worst_errors,
)
from piezoid.verification.closed_loop import reference_range, run_law
from piezoid.verification.plant import AxisPlant, Hysteresis
from piezoid.verification.scenarios import raster

_PERIODS = 3  # of which the last is used: the loops of the plays are closed after the first
# Rounds of correction. After eight, the identified plants of the bundled stage had errors of 0.21
# and 0.18 nm, after twenty of 0.21 and 0.16 nm; a plant with a mode at 630 Hz converged to 5 %.
_ROUNDS = 8
# Share of the error in the first round: below 1, because slopes may exceed the middle slope.
_SHARE = 0.8
_MIN_POINTS = 32  # of a period: adjacent points are up to a tenth of the scan apart
# Points of the shortest harmonic that is corrected. With 2 the corrections of a Bouc-Wen stage
# with loop shape diverged behind the turning points (40 nm simulated), with 8 to 32 they converged
# (8 to 10 nm); with plays alone the error is 0.2 nm with 2, 0.2 with 8 and 0.4 with 32.
_CORRECTED = 8
# Harmonics with a response below this share of the plant's gain are not corrected. On a plant with
# a mode at 630 Hz, a triangle of 200 Hz had an error of 11 nm with 0.1 and of 27 nm with 0.3; with
# 0 the drive jumped between its limits.
_BAND = 0.1

# Share of the proportional range in the advice: a smaller hysteresis loop needs more V per m.
_FITTING_SHARE = 0.85

_NO_RANGE = (
    "the voltage range of the converter is not known, and codes mean nothing without it; write "
    "range_V = [-10, 10], with your numbers, into [waveform] of a file for --box, or "
    "input_range_V into [acquisition] of lab.toml"
)

_README = """\
# {name}: predistorted drive, {shape} of {frequency}, {points} points at {rate}

| file | what it is |
| --- | --- |
| `AXIS.csv` | point, time, voltage, the displacement that is wanted then, and the code |
| `AXIS_int16.bin` | the codes alone, little-endian signed 16-bit integers |

{converters}

Output the points cyclically at {rate}. Start where `AXIS.csv` does, with the stage at rest:
the first period settles the hysteresis, and later ones repeat. There is no feedback: the middle
drifts with creep and temperature, and what the recordings did not show is not compensated.

{axes}
Errors are rms about the mean of the last of {periods} periods; *straight* is the same scan with a
constant V/m. Tested: the table with its {bits} bits, held from point to point, against the
identified plant and others that the recordings allow. Not tested, because no such box was at
hand: its own filters, delays and clock, and its format of files.
"""

_AXIS = """\
## Axis {axis}: +-{half} about {centre}, {low:.4f} V to {high:.4f} V

| plant | straight | waveform | exported controller | offset of the waveform |
| --- | --- | --- | --- | --- |
{rows}

Expected error of the waveform on the stage: {expected} rms, the worst of the table and the
held-out error of the model together. It holds for scans of the kind that was recorded.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Waveform:
    """One period for one axis.

    rate_Hz      of the points
    hold         samples at the controller's rate for which each point is held
    wanted_m     (points,)  reference
    voltage_V    (points,)  output of the converter, middle + code step
    code         (points,)  of the converter; None if its range is unknown
    """

    axis: str
    rate_Hz: float
    hold: int
    wanted_m: Array
    voltage_V: Array
    code: Array | None = None
    middle_V: float = 0.0
    step_V: float = 0.0


def waveform_files(inputs: TargetInputs) -> tuple[Mapping[str, bytes], tuple[str, ...]]:
    """Return the folder's files by name, and one sentence about the error of each axis.

    Raises ``ParameterFileError`` for a scan that exceeds the memory or the range of the hardware.
    """
    files: dict[str, bytes] = {}
    notes = [f"axis {axis} is not in waveform/: it follows a surface" for axis in inputs.tips]
    sections, converters = [], []
    waveforms = [waveform_of(inputs, axis) for axis in inputs.lateral]
    for axis, waveform in zip(inputs.lateral, waveforms, strict=True):
        files[f"{axis.axis}.csv"] = waveform_csv(waveform).encode()
        if waveform.code is None:
            notes.append(f"waveform/{axis.axis}_int16.bin is not written: {_NO_RANGE}")
            converter = f"voltages alone, not rounded. {_NO_RANGE[0].upper()}{_NO_RANGE[1:]}."
        else:
            files[f"{axis.axis}_int16.bin"] = waveform.code.astype("<i2").tobytes()
            converter = f"voltage = {waveform.middle_V!r} V + code x {waveform.step_V!r} V."
        converters.append(f"Axis {axis.axis}: {converter}")
        errors_m = scan_errors_m(inputs, axis, waveform)
        worst = worst_errors(errors_m)
        nominal = with_unit(next(iter(errors_m.values()))["waveform"], "m")
        expected = with_unit(expected_error_m(inputs.models[axis.axis], errors_m), "m")
        wanted_m, shape = waveform.wanted_m, inputs.hardware.shape
        frequency_Hz = waveform.rate_Hz / len(wanted_m)
        notes.append(
            f"axis {axis.axis}: {shape} of {with_unit(frequency_Hz, 'Hz')}, "
            f"{with_unit(float(np.ptp(wanted_m)), 'm')} wide, rms error in simulation: with the "
            f"drive of waveform/ {worst['waveform']} (identified stage: {nominal}), with a plain "
            f"{shape} {worst['straight']}, with the exported controller {worst['exported']} "
            f"(worst of {len(errors_m)} plants); "
            f"expected on the stage, with the error of the model: {expected}"
        )
        sections.append(
            _AXIS.format(
                axis=waveform.axis,
                half=with_unit(0.5 * float(np.ptp(wanted_m)), "m"),
                centre=with_unit(0.5 * float(wanted_m.max() + wanted_m.min()), "m"),
                low=float(waveform.voltage_V.min()),
                high=float(waveform.voltage_V.max()),
                rows=error_rows(errors_m),
                expected=expected,
            )
        )
    if waveforms:
        first = waveforms[0]
        files["README.md"] = _README.format(
            name=plain_ascii(inputs.file.name),
            shape=inputs.hardware.shape,
            frequency=with_unit(first.rate_Hz / len(first.wanted_m), "Hz"),
            points=len(first.wanted_m),
            rate=with_unit(first.rate_Hz, "Hz", 6),
            converters="\n".join(converters),
            axes="\n".join(sections),
            periods=_PERIODS,
            bits=inputs.hardware.bits,
        ).encode()
    return files, tuple(notes)


def waveform_of(inputs: TargetInputs, axis: AxisParameters) -> Waveform:
    """Return one period of one axis, quantised if the range of the converter is known."""
    hardware, plant = inputs.hardware, inputs.family(axis.axis)[0]
    rate_Hz = hardware.rate_Hz or plant.sampling_rate_Hz
    hold, points = _hold_and_points(axis.axis, hardware, plant.sampling_rate_Hz, rate_Hz)
    centre_m, half_m = half_range(axis, hardware.half_range_m, "half_range_m of [waveform]")
    unit = raster(rate_Hz, rate_Hz / points, 1.0).x
    if hardware.shape == "sine":
        unit = np.asarray(np.sin(2.0 * np.pi * np.arange(points) / points))
    wanted_m = centre_m + half_m * unit
    nominal = plant_family(inputs.models[axis.axis], plant.sampling_rate_Hz).nominal
    q = unit_circle(np.fft.rfftfreq(points, 1.0 / rate_Hz), plant.sampling_rate_Hz)
    response = polynomial_response(nominal.B_position, q) / polynomial_response(nominal.A, q)
    response[np.abs(response) < _BAND * abs(response[0])] = np.inf
    noiseless, model = replace(plant, noise_rms=0.0, hums=()), inputs.models[axis.axis]

    def evaluate(voltage_V: Array) -> tuple[Array, Array]:
        error_m = wanted_m - last_period(noiseless, voltage_V, hold, model)
        error = np.fft.rfft(error_m)
        error[max(points // _CORRECTED, _MIN_POINTS // 2) :] = 0.0
        return error_m, np.fft.irfft(error / response, points)

    first_V = inverse_V(plant, wanted_m, model)
    voltage_V = damped_iteration(first_V, evaluate, share=_SHARE, iterations=_ROUNDS)
    limits_V = axis.voltage_range_V
    range_V = hardware.range_V or inputs.converter_V
    waveform = Waveform(
        axis=axis.axis, rate_Hz=rate_Hz, hold=hold, wanted_m=wanted_m, voltage_V=voltage_V
    )
    if range_V is not None:
        waveform = quantise(waveform, range_V, hardware.bits)
        limits_V = (
            max(range_V[0], limits_V[0]),
            min(range_V[1] - waveform.step_V, limits_V[1]),
        )
    check_range(axis.axis, waveform.voltage_V, limits_V, half_m, "half_range_m", "[waveform]")
    return waveform


def quantise(waveform: Waveform, range_V: tuple[float, float], bits: int) -> Waveform:
    """Return the waveform rounded to the codes of a converter, with the codes."""
    step_V = (range_V[1] - range_V[0]) / 2.0**bits
    middle_V = 0.5 * (range_V[0] + range_V[1])
    code = np.asarray(np.round((waveform.voltage_V - middle_V) / step_V))
    return replace(
        waveform, voltage_V=middle_V + step_V * code, code=code, middle_V=middle_V, step_V=step_V
    )


def scan_errors_m(
    inputs: TargetInputs, axis: AxisParameters, waveform: Waveform
) -> dict[str, dict[str, float]]:
    """Return errors by plant and column, m.

    The columns are the rms errors of a drive with constant V/m, of the waveform and of the
    exported controller, each about its mean, and the mean error of the waveform.
    """
    plants, wanted_m, hold = inputs.family(axis.axis), waveform.wanted_m, waveform.hold
    model = inputs.models[axis.axis]
    gain = plant_family(model, plants[0].sampling_rate_Hz).nominal.gain
    middle_V = 0.5 * float(waveform.voltage_V.max() + waveform.voltage_V.min())
    straight_V = middle_V + (wanted_m - reference_range(axis).centre_m) / gain
    path_m = np.tile(np.repeat(wanted_m, hold), _PERIODS)
    errors_m = {}
    for plant in plants:
        waveform_m = last_period(plant, waveform.voltage_V, hold, model) - wanted_m
        straight_m = last_period(plant, straight_V, hold, model) - wanted_m
        exported_m = exported_position_m(axis, plant, path_m)[::hold][-len(wanted_m) :] - wanted_m
        errors_m[plant.label] = {
            "straight": float(np.std(straight_m)),
            "waveform": float(np.std(waveform_m)),
            "exported": float(np.std(exported_m)),
            "offset": float(np.mean(waveform_m)),
        }
    return errors_m


def expected_error_m(model: AxisModel, errors_m: Mapping[str, Mapping[str, float]]) -> float:
    """Return the error of the waveform on the stage, rms m, from plants and held-out error.

    sqrt(worst^2 + held_out^2 - noise^2)
    """
    worst_m, quality = max(row["waveform"] for row in errors_m.values()), model.quality
    model_power = max(quality.held_out_rms_m**2 - quality.noise_rms_m**2, 0.0)
    return float(np.sqrt(worst_m**2 + model_power))


def half_range(axis: AxisParameters, requested_m: float | None, key: str) -> tuple[float, float]:
    """Return centre and half range of a scan, m; the default is 0.7 of the largest half range.

    Raises ``ParameterFileError`` for a half range beyond the limits, with the key in box.toml.
    """
    span = reference_range(axis)
    half_m = requested_m or span.radius_m
    if half_m > span.farthest_m:
        raise ParameterFileError(
            f"axis {axis.axis}: {key} is {half_m:g} m",
            needed=f"at most {span.farthest_m:.4g} m, the distance from the centre to the limits",
            remedy="Reduce it in box.toml.",
        )
    return span.centre_m, half_m


def _hold_and_points(
    axis: str, hardware: ControllerHardware, plant_Hz: float, rate_Hz: float
) -> tuple[int, int]:
    """Return the samples of the controller for which a point is held, and the points of a period.

    Raises ``ParameterFileError`` for a rate that does not divide that of the controller, and for
    more points than the memory has, or too few.
    """
    hold = max(round(plant_Hz / rate_Hz), 1)
    if abs(hold * rate_Hz - plant_Hz) > 1e-9 * plant_Hz:
        rates = ", ".join(f"{plant_Hz / n:g}" for n in (1, 2, 4, 5, 10))
        raise ParameterFileError(
            f"axis {axis}: a generator of {rate_Hz:g} points a second, and a plant sampled at "
            f"{plant_Hz:g} Hz",
            needed=f"a rate that divides {plant_Hz:g} Hz",
            remedy=f"Set rate_Hz of [waveform] to {rates} Hz or the like.",
        )
    points = round(rate_Hz / hardware.frequency_Hz)
    period = f"a period of {hardware.frequency_Hz:g} Hz has {points} points at {rate_Hz:g} Hz"
    if points > hardware.points:
        raise ParameterFileError(
            f"{period}, and the table holds {hardware.points}",
            needed=f"{points} points",
            remedy=f"Set frequency_Hz to {rate_Hz / hardware.points:.4g} or more, or "
            f"rate_Hz to {hardware.points * hardware.frequency_Hz:.4g} or less, in [waveform] of "
            "box.toml.",
        )
    if points < _MIN_POINTS:
        raise ParameterFileError(
            period,
            needed=f"at least {_MIN_POINTS}",
            remedy=f"Set frequency_Hz to {rate_Hz / _MIN_POINTS:.4g} or less in [waveform] of "
            "box.toml.",
        )
    return hold, points


def check_range(
    axis: str,
    voltage_V: Array,
    range_V: tuple[float, float],
    half_m: float,
    key: str,
    table: str,
) -> None:
    """Refuse a scan whose voltages exceed a range, with the key and table of its half range."""
    low_V, high_V = float(voltage_V.min()), float(voltage_V.max())
    if range_V[0] <= low_V and high_V <= range_V[1]:
        return
    middle_V, half_V = 0.5 * (low_V + high_V), 0.5 * (high_V - low_V)
    share = min(range_V[1] - middle_V, middle_V - range_V[0]) / half_V
    remedy = (
        f"Set {key} to {_FITTING_SHARE * share * half_m:.3g} or less in {table} of box.toml."
        if share > 0.0
        else f"Use hardware whose range includes {middle_V:.4g} V, the middle of the scan."
    )
    raise ParameterFileError(
        f"axis {axis}: +-{with_unit(half_m, 'm')} takes {low_V:.4g} V to {high_V:.4g} V, and "
        f"hardware and stage allow {range_V[0]:.6g} V to {range_V[1]:.6g} V",
        needed="the whole period within this range",
        remedy=remedy,
    )


def inverse_V(plant: AxisPlant, wanted_m: Array, model: AxisModel | None = None) -> Array:
    """Return the periodic voltage for which the hysteresis alone follows a periodic reference.

    model  whose loop shape is part of the hysteresis
    """
    response = plant.response
    assert isinstance(response, Hysteresis)
    operator = response.operator
    offset_m = operator.displacement_offset_m
    inner_m = np.tile((wanted_m - offset_m) / plant.measured_gain, 2)
    if model is None or model.loop_shape is None:
        output_m = response.polarity * inner_m + offset_m
        voltage_V, _ = operator.inverse_run(output_m, operator.virgin_memory())
    else:
        voltage_V = model.inverse(inner_m + model.zero_m)
    return np.asarray(voltage_V[len(wanted_m) :])


def last_period(
    plant: AxisPlant, voltage_V: Array, hold: int = 1, model: AxisModel | None = None
) -> Array:
    """Simulate a plant with a periodic voltage; return its position in the last period, (points,).

    model  whose loop shape replaces the discrepancy of the plant, which estimates it
    """
    table_V = np.tile(np.repeat(voltage_V, hold), _PERIODS)
    of_shape_m = np.zeros(len(table_V))
    if model is not None and model.loop_shape is not None:
        assert isinstance(plant.response, Hysteresis)
        plant = replace(plant, response=replace(plant.response, discrepancy=None))
        where = Where(recording="", rate_Hz=plant.sampling_rate_Hz, samples=len(table_V))
        forward, memory_V = model.forward, model.virgin_memory_V
        driven_V = forward.driven_V(table_V, where.rate_Hz)
        static_m = model.static_m(driven_V, memory_V, where.rate_Hz)
        static_m = static_m - model.invertible_m(driven_V, memory_V, where.rate_Hz)
        of_shape_m = forward.linear_response(model.polarity * static_m, where)
    drive_V = iter(table_V.tolist())
    record = run_law(
        plant,
        lambda _reference, _measured: next(drive_V),
        np.zeros(len(table_V)),
        rng=np.random.default_rng(SEED),
    )
    return np.asarray((record.position + of_shape_m)[::hold][-len(voltage_V) :])


def waveform_csv(waveform: Waveform) -> str:
    """Return the text of `AXIS.csv`."""
    lines = ["point,time_s,voltage_V,wanted_m" + ("" if waveform.code is None else ",code")]
    rows = zip(waveform.voltage_V.tolist(), waveform.wanted_m.tolist(), strict=True)
    for k, (voltage_V, wanted_m) in enumerate(rows):
        code = "" if waveform.code is None else f",{int(waveform.code[k])}"
        lines.append(f"{k},{k / waveform.rate_Hz!r},{voltage_V!r},{wanted_m:.6e}{code}")
    return "\n".join([*lines, ""])
