"""The target `waveform`: one period of a scan, predistorted, for a wave generator or a DAQ.

The table begins as the exact inverse of the hysteresis and is then corrected, harmonic by
harmonic, until the identified plant under it moves as wanted:

    u <- u + IFFT(E / G),   E of wanted less position in the last period, G of the linear plant

so amplifier, modes, delay, creep within a period and the converter's steps are in it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from piezoid.design.lateral_task import plant_family
from piezoid.errors import ParameterFileError
from piezoid.export.c_header import plain_ascii
from piezoid.export.parameter_file import AxisParameters
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import polynomial_response, unit_circle
from piezoid.targets.controller_hardware import ControllerHardware
from piezoid.targets.target_inputs import SEED, TargetInputs, exported_position_m
from piezoid.verification.closed_loop import run_law
from piezoid.verification.plant import AxisPlant, Hysteresis
from piezoid.verification.scenarios import raster
from piezoid.verification.start_position import reference_range

_PERIODS = 3  # the last is looked at: plays have closed their loops after the first
# Rounds of correction. After eight the identified plants of the bundled stage erred by 0.21 and
# 0.18 nm, after twenty by 0.21 and 0.16 nm; one with a mode at 630 Hz within 5 % of that as well.
_ROUNDS = 8
_LEARNT = 0.8  # of the error in a round: less than 1, because a slope may be above the middle one
_FEWEST = 32  # points of a period: neighbours are up to a tenth of the scan apart
# Harmonics to which the plant answers with less than this of its gain are left alone. On a plant
# with a mode at 630 Hz a triangle of 200 Hz erred by 11 nm with 0.1, by 27 nm with 0.3; with 0
# the drive jumped from end to end.
_BAND = 0.1

_SPARED = 0.85  # of a scan that would fit: a smaller loop of a hysteresis takes more V per m

_NO_RANGE = (
    "it is not known which voltages the box's converter spans, and integers mean nothing without; "
    "write range_V = [-10, 10], with your numbers, into [waveform] of a file for --box, or "
    "input_range_V into [acquisition] of lab.toml"
)

_README = """\
# {name}: predistorted drive, {shape} of {frequency}, {points} points at {rate}

| file | what it is |
| --- | --- |
| `AXIS.csv` | point, time, voltage, the displacement that is wanted then, and the code |
| `AXIS_int16.bin` | the codes alone, little-endian signed 16-bit integers |

{converters}

Put the points out again and again at {rate}. Start where `AXIS.csv` does, with the stage at rest:
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
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Waveform:
    """One period for one axis.

    rate_Hz      of its points;  hold: samples of the controller's rate that each is held
    wanted_m     (points,)
    voltage_V    (points,)  what the converter puts out: middle + code step
    code         (points,)  of the converter; None where its ends are not known
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
    """Return the folder's files by name, and sentences about what the table is worth.

    Raises ``ParameterFileError`` for a scan that the box cannot hold or put out.
    """
    files: dict[str, bytes] = {}
    sections: list[str] = []
    converters: list[str] = []
    notes = [
        f"axis {axis} is not in waveform/: it follows a surface, not a path"
        for axis in inputs.tips
    ]
    made = [waveform_of(inputs, axis) for axis in inputs.lateral]
    for axis, one in zip(inputs.lateral, made, strict=True):
        files[f"{one.axis}.csv"] = waveform_csv(one).encode()
        if one.code is None:
            notes.append(f"waveform/{one.axis}_int16.bin is not written: {_NO_RANGE}")
        else:
            files[f"{one.axis}_int16.bin"] = one.code.astype("<i2").tobytes()
        rows = scan_errors_m(inputs, axis, one)
        sections.append(_section(one, rows))
        converters.append(f"Axis {one.axis}: {_converter(one)}")
        worst = {name: max(row[name] for row in rows.values()) for name in _COLUMNS[:3]}
        notes.append(
            f"axis {one.axis}: the waveform errs by {with_unit(worst['waveform'], 'm')} rms, "
            f"straight by {with_unit(worst['straight'], 'm')}, the exported controller by "
            f"{with_unit(worst['exported'], 'm')}; worst of {len(rows)} plants"
        )
    if made:
        files["README.md"] = _README.format(
            name=plain_ascii(inputs.file.name),
            shape=inputs.hardware.shape,
            frequency=with_unit(made[0].rate_Hz / len(made[0].wanted_m), "Hz"),
            points=len(made[0].wanted_m),
            rate=with_unit(made[0].rate_Hz, "Hz", 6),
            converters="\n".join(converters),
            axes="\n".join(sections),
            periods=_PERIODS,
            bits=inputs.hardware.bits,
        ).encode()
    return files, tuple(notes)


def waveform_of(inputs: TargetInputs, axis: AxisParameters) -> Waveform:
    """Return the table of one axis."""
    hardware, plant = inputs.hardware, inputs.family(axis.axis)[0]
    rate_Hz = hardware.rate_Hz or plant.sampling_rate_Hz
    hold = _hold(axis.axis, plant.sampling_rate_Hz, rate_Hz)
    points = _points(hardware, rate_Hz)
    room = reference_range(axis)
    radius_m = hardware.half_range_m or room.radius_m
    if radius_m > room.farthest_m:
        raise ParameterFileError(
            f"axis {axis.axis}: half_range_m of [waveform] is {radius_m:g} m",
            needed=f"at most {room.farthest_m:.4g} m: from the middle to its limits",
            remedy="Set it to that or less.",
        )
    unit = raster(rate_Hz, rate_Hz / points, 1.0).x
    if hardware.shape == "sine":
        unit = np.asarray(np.sin(2.0 * np.pi * np.arange(points) / points))
    wanted_m = room.centre_m + radius_m * unit
    nominal = plant_family(inputs.models[axis.axis], plant.sampling_rate_Hz).nominal
    harmonic_Hz = np.fft.rfftfreq(points, 1.0 / rate_Hz)
    q = unit_circle(harmonic_Hz, plant.sampling_rate_Hz)
    response = polynomial_response(nominal.B_position, q) / polynomial_response(nominal.A, q)
    response[np.abs(response) < _BAND * abs(response[0])] = np.inf
    voltage_V = inverse_V(plant, wanted_m)
    noiseless = replace(plant, noise_rms=0.0, hums=())
    for _ in range(_ROUNDS):
        position_m = last_period(noiseless, voltage_V, hold)
        missing = np.fft.rfft(wanted_m - position_m)
        voltage_V = voltage_V + _LEARNT * np.fft.irfft(missing / response, points)
    own_V = (float(axis.values["voltage_minimum_V"]), float(axis.values["voltage_maximum_V"]))
    range_V = hardware.range_V or inputs.converter_V
    table = Waveform(
        axis=axis.axis, rate_Hz=rate_Hz, hold=hold, wanted_m=wanted_m, voltage_V=voltage_V
    )
    if range_V is None:
        check_range(axis.axis, voltage_V, own_V, radius_m)
        return table
    rounded = quantise(table, range_V, hardware.bits)
    allowed_V = (max(range_V[0], own_V[0]), min(range_V[1] - rounded.step_V, own_V[1]))
    check_range(axis.axis, voltage_V, allowed_V, radius_m)
    return rounded


def quantise(table: Waveform, range_V: tuple[float, float], bits: int) -> Waveform:
    """Return the table as a converter with these ends puts it out, with its codes."""
    step_V = (range_V[1] - range_V[0]) / 2.0**bits
    middle_V = 0.5 * (range_V[0] + range_V[1])
    code = np.asarray(np.round((table.voltage_V - middle_V) / step_V))
    rounded_V = middle_V + step_V * code
    return replace(table, voltage_V=rounded_V, code=code, middle_V=middle_V, step_V=step_V)


_COLUMNS = ("straight", "waveform", "exported", "offset")


def scan_errors_m(
    inputs: TargetInputs, axis: AxisParameters, waveform: Waveform
) -> dict[str, dict[str, float]]:
    """Return by plant what is left: rms in m of a straight drive, the waveform, the controller."""
    errors_m = {}
    plants = inputs.family(axis.axis)
    gain = plant_family(inputs.models[axis.axis], plants[0].sampling_rate_Hz).nominal.gain
    middle_V = 0.5 * float(waveform.voltage_V.max() + waveform.voltage_V.min())
    straight_V = middle_V + (waveform.wanted_m - reference_range(axis).centre_m) / gain
    path_m = np.tile(np.repeat(waveform.wanted_m, waveform.hold), _PERIODS)
    for plant in plants:
        waveform_m = last_period(plant, waveform.voltage_V, waveform.hold) - waveform.wanted_m
        straight_m = last_period(plant, straight_V, waveform.hold) - waveform.wanted_m
        moved_m = exported_position_m(axis, plant, path_m)
        shipped_m = moved_m[:: waveform.hold][-len(waveform.wanted_m) :] - waveform.wanted_m
        spreads = (float(np.std(error)) for error in (straight_m, waveform_m, shipped_m))
        values = (*spreads, float(np.mean(waveform_m)))
        errors_m[plant.label] = dict(zip(_COLUMNS, values, strict=True))
    return errors_m


def _hold(axis: str, own_Hz: float, rate_Hz: float) -> int:
    hold = max(round(own_Hz / rate_Hz), 1)
    if abs(hold * rate_Hz - own_Hz) > 1e-9 * own_Hz:
        fits = ", ".join(f"{own_Hz / n:g}" for n in (1, 2, 4, 5, 10))
        raise ParameterFileError(
            f"axis {axis}: a box of {rate_Hz:g} points a second, and a plant sampled at "
            f"{own_Hz:g} Hz",
            needed="a rate by which that can be divided",
            remedy=f"Set rate_Hz of [waveform] to {fits} Hz or the like.",
        )
    return hold


def _points(hardware: ControllerHardware, rate_Hz: float) -> int:
    points = round(rate_Hz / hardware.frequency_Hz)
    if points > hardware.points:
        raise ParameterFileError(
            f"a period of {hardware.frequency_Hz:g} Hz has {points} points at {rate_Hz:g} Hz, and "
            f"the table holds {hardware.points}",
            needed=f"{points} points",
            remedy=f"What would fit: frequency_Hz of {rate_Hz / hardware.points:.4g} or more, or "
            f"rate_Hz of {hardware.points * hardware.frequency_Hz:.4g} or less, in [waveform] of "
            "box.toml.",
        )
    if points < _FEWEST:
        raise ParameterFileError(
            f"a period of {hardware.frequency_Hz:g} Hz has {points} points at {rate_Hz:g} Hz",
            needed=f"at least {_FEWEST}",
            remedy=f"What would fit: frequency_Hz of {rate_Hz / _FEWEST:.4g} or less, in "
            "[waveform] of box.toml.",
        )
    return points


def _converter(waveform: Waveform) -> str:
    if waveform.code is None:
        return f"voltages alone, not rounded. {_NO_RANGE[0].upper()}{_NO_RANGE[1:]}."
    return f"voltage = {waveform.middle_V!r} V + code x {waveform.step_V!r} V."


def check_range(
    axis: str,
    voltage_V: Array,
    range_V: tuple[float, float],
    radius_m: float,
    key: str = "half_range_m",
    table: str = "[waveform]",
) -> None:
    """Refuse voltages of a scan of this half range, a key of a table, outside of a range."""
    low_V, high_V = float(voltage_V.min()), float(voltage_V.max())
    if range_V[0] <= low_V and high_V <= range_V[1]:
        return
    middle_V, half_V = 0.5 * (low_V + high_V), 0.5 * (high_V - low_V)
    share = min(range_V[1] - middle_V, middle_V - range_V[0]) / half_V
    fits = (
        f"{key} of {_SPARED * share * radius_m:.3g} or less"
        if share > 0.0
        else f"a box that puts out {middle_V:.4g} V, about which the scan lies"
    )
    raise ParameterFileError(
        f"axis {axis}: +-{with_unit(radius_m, 'm')} takes {low_V:.4g} V to {high_V:.4g} V, and "
        f"box and stage allow {range_V[0]:.6g} V to {range_V[1]:.6g} V",
        needed="all of the period within them",
        remedy=f"What would fit: {fits}, in {table} of box.toml.",
    )


def inverse_V(plant: AxisPlant, wanted_m: Array) -> Array:
    """Return the voltage that makes the hysteresis alone move so, its loop closed."""
    response = plant.response
    assert isinstance(response, Hysteresis)
    operator = response.operator
    offset_m = operator.displacement_offset_m
    inner_m = response.polarity * (wanted_m - offset_m) / plant.measured_gain + offset_m
    twice_V, _ = operator.inverse_run(np.tile(inner_m, 2), operator.virgin_memory())
    return np.asarray(twice_V[len(wanted_m) :])


def last_period(plant: AxisPlant, voltage_V: Array, hold: int = 1) -> Array:
    """Return where a plant is at each point of the last period, (points,)."""
    table_V = iter(np.tile(np.repeat(voltage_V, hold), _PERIODS).tolist())
    samples = _PERIODS * hold * len(voltage_V)
    record = run_law(
        plant,
        lambda _reference, _measured: next(table_V),
        np.zeros(samples),
        rng=np.random.default_rng(SEED),
    )
    return np.asarray(record.position[::hold][-len(voltage_V) :])


def waveform_csv(waveform: Waveform) -> str:
    """Return the text of `AXIS.csv`."""
    lines = ["point,time_s,voltage_V,wanted_m" + ("" if waveform.code is None else ",code")]
    codes = (
        [""] * len(waveform.wanted_m)
        if waveform.code is None
        else [f",{int(c)}" for c in waveform.code]
    )
    rows = zip(waveform.voltage_V.tolist(), waveform.wanted_m.tolist(), codes, strict=True)
    for k, (voltage_V, wanted_m, code) in enumerate(rows):
        lines.append(f"{k},{k / waveform.rate_Hz!r},{voltage_V!r},{wanted_m:.6e}{code}")
    return "\n".join([*lines, ""])


def _section(waveform: Waveform, rows: Mapping[str, Mapping[str, float]]) -> str:
    return _AXIS.format(
        axis=waveform.axis,
        half=with_unit(0.5 * float(np.ptp(waveform.wanted_m)), "m"),
        centre=with_unit(0.5 * float(waveform.wanted_m.max() + waveform.wanted_m.min()), "m"),
        low=float(waveform.voltage_V.min()),
        high=float(waveform.voltage_V.max()),
        rows="\n".join(
            f"| {label} | {' | '.join(with_unit(row[name], 'm') for name in _COLUMNS)} |"
            for label, row in rows.items()
        ),
    )
