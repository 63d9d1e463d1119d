"""The target `pid`: settings of a PID controller with notches and limits, and their errors.

The search maximises the rejection of slow disturbances over all plants of a family.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product as combinations

import numpy as np

from piezoid.design.feasibility import unmet
from piezoid.design.lateral import with_sector
from piezoid.design.lateral_task import affine_bounds_of, plant_family
from piezoid.design.loop_search import light_modes, mode_lines_Hz
from piezoid.design.plant import Plant, PlantFamily
from piezoid.design.sensitivity import (
    Margins,
    Template,
    closed_loop_polynomial,
    margins,
)
from piezoid.design.specification import Specification
from piezoid.errors import DesignError
from piezoid.export.c_header import plain_ascii
from piezoid.export.parameter_file import AxisParameters
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import (
    grid_Hz,
    polynomial_response,
    product,
    spectral_radius,
    total,
    unit_circle,
)
from piezoid.targets.target_inputs import (
    SEED,
    Errors,
    TargetInputs,
    error_rows,
    exported_position_m,
    worst_errors,
)
from piezoid.verification.closed_loop import approach_path, reference_range, run_law
from piezoid.verification.scenarios import constant_angular_velocity

_FILTER_SAMPLES = 2.0  # time constant of the filter of D
_DECAY = float(np.exp(-1.0 / _FILTER_SAMPLES))
# Ratios of the candidates; the gain of each is as large as the margins allow. Three times as many
# leads and twice as many other ratios improved the rejection by 0.2 and 0.6 dB on the bundled
# stage, by 0.5 dB with a notch and 0.8 dB without on a mode at 630 Hz.
_LEADS_samples = (0.0, *np.geomspace(0.7, 90.0, 24).tolist())  # proportional / integral
_DERIVATIVES = (0.0, 0.06, 0.12, 0.25, 0.5)  # derivative / (integral lead^2)
_WIDTHS = (0.3, 0.7, 1.4, 2.0)
_MIN_DEPTH = 0.02
_BISECTIONS = 16
_GAIN_RANGE = 1e6
_LINES = 400
_GRID_MARGIN = 0.98  # the grid of the search is coarser than that of the final check
_MIN_LOOP_Hz = 1.0


@dataclass(frozen=True, kw_only=True)
class Notch:
    """A band stop, H(s) = (s^2 + 2 z_n w s + w^2) / (s^2 + 2 z_d w s + w^2), w = 2 pi f.

    frequency_Hz  of the centre, preserved by the prewarped Tustin transform
    depth, width  z_n and z_d; the gain at the centre is depth / width
    """

    frequency_Hz: float
    depth: float
    width: float

    def section(self, rate_Hz: float) -> tuple[Array, Array]:
        """Return numerator and monic denominator in q^-1."""
        t = np.tan(np.pi * self.frequency_Hz / rate_Hz)
        top, bottom = (
            np.array([1.0 + 2.0 * z * t + t * t, 2.0 * (t * t - 1.0), 1.0 - 2.0 * z * t + t * t])
            for z in (self.depth, self.width)
        )
        return np.asarray(top / bottom[0]), np.asarray(bottom / bottom[0])


@dataclass(frozen=True, kw_only=True)
class Pid:
    """Settings; every sample, with T = 1 / sampling_rate_Hz and e = reference - reading,

        i += integral T e;   d += (1 - a) ((e - e_previous) / T - d),   a = exp(-1/2)
        v = notches(proportional e + i + derivative d);   u = rest + v

    then u moves by the slew limit at most, stays within the voltages, and is rounded to the
    converter. While a limit is active, i does not integrate an error that would drive u further.
    """

    sampling_rate_Hz: float
    proportional_V_per_m: float = 0.0
    integral_V_per_m_s: float = 0.0
    derivative_V_s_per_m: float = 0.0
    notches: tuple[Notch, ...] = ()
    rest_V: float
    minimum_V: float
    maximum_V: float
    lsb_V: float = 0.0
    slew_V_per_s: float = np.inf

    def scaled(self, factor: float) -> "Pid":
        """Return the settings with all gains multiplied by a factor."""
        return replace(
            self,
            proportional_V_per_m=self.proportional_V_per_m * factor,
            integral_V_per_m_s=self.integral_V_per_m_s * factor,
            derivative_V_s_per_m=self.derivative_V_s_per_m * factor,
        )

    def sections(self, rate_Hz: float) -> tuple[tuple[Array, Array], ...]:
        """Return B and monic A in q^-1 of the PID (V/m) and of each notch at a sampling rate.

        The time constant of the filter of D and the frequencies of the notches do not change.
        """
        period_s = 1.0 / rate_Hz
        difference = np.array([1.0, -1.0])
        P, integral = self.proportional_V_per_m, self.integral_V_per_m_s * period_s
        notches = tuple(notch.section(rate_Hz) for notch in self.notches)
        if self.derivative_V_s_per_m == 0.0:
            return ((np.array([P + integral, -P]), difference), *notches)
        decay = _DECAY ** (self.sampling_rate_Hz / rate_Hz)
        pole = np.array([1.0, -decay])
        top = total(
            P * product(difference, pole),
            integral * pole,
            self.derivative_V_s_per_m / period_s * (1.0 - decay) * product(difference, difference),
        )
        return ((top, product(difference, pole)), *notches)

    def polynomials(self) -> tuple[Array, Array]:
        """Return R and S of S u = R (r - y), coefficients in q^-1, S monic."""
        tops, bottoms = zip(*self.sections(self.sampling_rate_Hz), strict=True)
        return product(*tops), product(*bottoms)


def pid_law(pid: Pid) -> Callable[[float, float], float]:
    """Return the computation of ``Pid``, with its state.

    It is called once for each sample, with reference and reading, m, and returns the output, V.
    """
    sections = [notch.section(pid.sampling_rate_Hz) for notch in pid.notches]
    states = [[0.0, 0.0] for _ in pid.notches]
    integral_V = derivative_m_per_s = 0.0
    previous_m: float | None = None
    voltage_V = pid.rest_V

    def step(reference_m: float, measured_m: float) -> float:
        nonlocal integral_V, derivative_m_per_s, previous_m, voltage_V
        error_m = reference_m - measured_m
        change_m = 0.0 if previous_m is None else error_m - previous_m
        previous_m = error_m
        derivative_m_per_s += (1.0 - _DECAY) * (
            change_m * pid.sampling_rate_Hz - derivative_m_per_s
        )
        increment_V = pid.integral_V_per_m_s * error_m / pid.sampling_rate_Hz
        integral_V += increment_V
        value_V = (
            pid.proportional_V_per_m * error_m
            + integral_V
            + pid.derivative_V_s_per_m * derivative_m_per_s
        )
        # the notches, in transposed direct form II
        for (b, a), state in zip(sections, states, strict=True):
            output_V = float(b[0]) * value_V + state[0]
            state[0] = float(b[1]) * value_V - float(a[1]) * output_V + state[1]
            state[1] = float(b[2]) * value_V - float(a[2]) * output_V
            value_V = output_V
        free_V = pid.rest_V + value_V
        step_V = pid.slew_V_per_s / pid.sampling_rate_Hz
        limited_V = min(max(free_V, voltage_V - step_V), voltage_V + step_V)
        limited_V = min(max(limited_V, pid.minimum_V), pid.maximum_V)
        if (free_V - limited_V) * increment_V > 0.0:
            integral_V -= increment_V
        voltage_V = limited_V
        return pid.lsb_V * round(limited_V / pid.lsb_V) if pid.lsb_V > 0.0 else limited_V

    return step


def tuned_pid(
    axis: str, family: PlantFamily, blank: Pid, *, notches: int, specification: Specification
) -> tuple[Pid, tuple[Margins, ...]]:
    """Return the settings with the largest integral gain within the limits, and their margins.

    The limits hold on every plant of the family, and the margins are exact, one for each plant.
    The integral rejects slow disturbances, |Syp| = 2 pi f / (gain integral).

    Args:
        axis: name, for messages
        family: plants, with the slope sector of the hysteresis
        blank: limits and converter of the controller; its gains are ignored
        notches: largest number of notches
        specification: both margins, and the limits of the control effort, which guard against
            unseen modes as for the exported controller

    Raises:
        DesignError: no settings reach a loop of 1 Hz
    """
    efforts = tuple(template for template in specification.templates if template.function == "Sup")
    limits = replace(specification, noise_limit_rms=None)
    largest_gain = _gain_search(family, efforts, specification)
    sign = float(np.sign(family.nominal.gain))
    best: Pid | None = None
    for candidate in _candidates(family.nominal, blank, notches, sign):
        best_gain = 0.0 if best is None else abs(best.integral_V_per_m_s)
        best = largest_gain(candidate, best_gain) or best
    min_integral = 2.0 * np.pi * _MIN_LOOP_Hz / abs(family.nominal.gain)
    while best is not None and abs(best.integral_V_per_m_s) >= min_integral:
        R, S = best.polynomials()
        if not unmet(family.members, R, S, limits, templates=efforts):
            return best, tuple(margins(member, R, S) for member in family.members)
        best = best.scaled(0.93)
    gains = sorted((member.gain for member in family.members), key=lambda gain: gain * sign)
    raise DesignError(
        f"axis {axis}: no PID with {notches} notches stabilises all {len(family.members)} plants "
        f"that the recordings allow with a loop of {_MIN_LOOP_Hz:g} Hz; their gains range from "
        f"{gains[0]:.3g} to {gains[-1]:.3g} m/V",
        needed=f"a modulus margin of {specification.modulus_margin:g}, a delay margin of "
        f"{with_unit(specification.delay_margin_s, 's')} and every limit of the control effort on "
        "every plant",
        remedy="Use --target waveform, which closes no loop, or record again so that the "
        "intervals are narrower.",
    )


def _gain_search(
    family: PlantFamily, efforts: Sequence[Template], specification: Specification
) -> Callable[[Pid, float], Pid | None]:
    """Return the search of the largest gain of a candidate, on a frequency grid of all plants.

    The search returns the candidate with its largest allowed gain, or None if that does not exceed
    the integral gain of the best candidate so far, its second argument.
    """
    rate_Hz = family.nominal.sampling_rate_Hz
    lines = [grid_Hz(rate_Hz, lowest_Hz=0.1, count=_LINES)]
    lines += [template.frequency_Hz for template in efforts]
    lines += [mode_lines_Hz(member) for member in family.members]
    f = np.unique(np.concatenate(lines))
    f = f[f < 0.5 * rate_Hz]
    q, w = unit_circle(f, rate_Hz), np.asarray(2.0 * np.pi * f)
    plants = np.stack(
        [polynomial_response(m.B, q) / polynomial_response(m.A, q) for m in family.members]
    )
    limit_dB = np.min([template.limit_dB(f) for template in efforts], axis=0, initial=np.inf)
    max_effort = np.broadcast_to(10.0 ** (limit_dB / 20.0), w.shape)  # |Sup|, V per output unit

    def largest_gain(candidate: Pid, best_gain: float) -> Pid | None:
        R, S = candidate.polynomials()
        controller = polynomial_response(R, q) / polynomial_response(S, q)
        open_loop = plants * controller

        def is_allowed(gain: float) -> bool:
            scaled = gain * open_loop
            distance = np.abs(1.0 + scaled) * _GRID_MARGIN
            if distance.min() < specification.modulus_margin:
                return False
            if (gain * np.abs(controller) > max_effort * distance).any():
                return False
            is_above = np.abs(scaled) > 1.0
            is_crossing = is_above[:, :-1] != is_above[:, 1:]
            delay_s = (np.angle(-scaled) % (2.0 * np.pi) / w)[:, :-1][is_crossing]
            if delay_s.size and delay_s.min() * _GRID_MARGIN < specification.delay_margin_s:
                return False
            return all(
                spectral_radius(closed_loop_polynomial(member, gain * R, S)) < 1.0
                for member in family.members
            )

        min_gain = 2.0 * np.pi * _MIN_LOOP_Hz / abs(family.nominal.gain)
        low, high = max(best_gain * 1.001, min_gain), min_gain * _GAIN_RANGE
        if not is_allowed(low):
            return None
        for _ in range(_BISECTIONS):
            middle = float(np.sqrt(low * high))
            low, high = (middle, high) if is_allowed(middle) else (low, middle)
        return candidate.scaled(low)

    return largest_gain


def _candidates(nominal: Plant, blank: Pid, notches: int, sign: float) -> Iterator[Pid]:
    """Yield settings with an integral gain of 1, with notches on the modes and without."""
    modes = sorted(zip(*(values.tolist() for values in light_modes(nominal)), strict=True))[
        :notches
    ]
    banks: list[tuple[Notch, ...]] = [
        tuple(Notch(frequency_Hz=f, depth=max(z, _MIN_DEPTH), width=width) for f, z in modes)
        for width in (_WIDTHS if modes else ())
    ]
    for bank, lead, share in combinations([*banks, ()], _LEADS_samples, _DERIVATIVES):
        if lead == 0.0 and share > 0.0:
            continue
        lead_s = lead / blank.sampling_rate_Hz
        yield replace(
            blank,
            proportional_V_per_m=sign * lead_s,
            integral_V_per_m_s=sign,
            derivative_V_s_per_m=sign * share * lead_s**2,
            notches=bank,
        )


_SPIRAL_Hz, _TURNS = 10.0, 5.0
_NOTCHES = ("no notch", "one notch", "two notches")

_README = """\
# {name}: settings for a PID controller with up to {notches} notches and a slew limit

The controller computes every sample, with T = 1 / sampling rate and e = reference - reading,

    i += integral T e;   d += (1 - exp(-1/2)) ((e - e_previous) / T - d)
    v = notches(proportional e + i + derivative d);   output = rest + v
    notch: (s^2 + 2 depth w s + w^2) / (s^2 + 2 width w s + w^2), w = 2 pi frequency,
    by Tustin's transform that keeps the frequency

then the slew limit, the voltage limits and the converter's step; while a limit is active, the
integral stops. Gains are volts of the command per metre of displacement: scale them by the
sensitivities of your amplifier and sensor. `settings.csv` holds them. `sections.csv` holds the
same controller as second-order sections at {update}, the first in V/m,

    y[k] = b0 x[k] + b1 x[k-1] + b2 x[k-2] - a1 y[k-1] - a2 y[k-2]

{axes}
Tested: these settings, computed as above in double precision at the controller's rate, on the
identified plant and others that the recordings allow, with hysteresis, creep, noise and
converters; the margins of every plant are recomputed exactly. Not tested, because no such device
was at hand: how yours names, scales and rounds its settings, how it filters its derivative, the
order of its notches, its fixed-point arithmetic, and the delay that it adds. The plants have the
delay of this stage's converters. Begin with a tenth of the integral and without the proportional.
"""

_AXIS = """\
## Axis {axis}

| setting | value |
| --- | --- |
{settings}

{loss}.

Worst of {plants} plants: modulus margin {modulus:.2f}, delay margin {delay}.

| plant | spiral of {spiral} Hz, exported controller, rms | PID, rms |
| --- | --- | --- |
{rows}
"""


def pid_files(inputs: TargetInputs) -> tuple[Mapping[str, bytes], tuple[str, ...]]:
    """Return the folder's files by name, and one sentence about the errors of each axis.

    Raises ``DesignError`` if no PID stabilises all plants of an axis.
    """
    notes = [
        f"axis {axis} is not in pid/: it regulates a current; --target library or the bundle has "
        "its controller"
        for axis in inputs.tips
    ]
    if not inputs.lateral:
        return {}, tuple(notes)
    rate_Hz = inputs.designs[inputs.lateral[0].axis].sampling_rate_Hz
    update_Hz = inputs.hardware.update_Hz or rate_Hz
    losses: list[str] = []
    settings, sections = ["axis,setting,value,unit"], ["axis,section,b0,b1,b2,a1,a2"]
    paragraphs = []
    for axis in inputs.lateral:
        pid, margins, errors_m = pid_of(inputs, axis)
        worst = worst_errors(errors_m)
        is_integral = pid.proportional_V_per_m == pid.derivative_V_s_per_m == 0.0
        controller = "an integral controller" if is_integral else "a PID"
        loss = (
            f"with {controller} and {_NOTCHES[len(pid.notches)]}, a spiral of {_SPIRAL_Hz:g} Hz "
            f"errs by {worst['pid']} rms instead of {worst['exported']} (worst of "
            f"{len(errors_m)} plants)"
        )
        losses.append(f"axis {axis.axis}: {loss}")
        settings += [f"{axis.axis},{n},{v!r},{u}" for n, v, u in _settings(pid)]
        for index, (b, a) in enumerate(pid.sections(update_Hz)):
            values = [*np.pad(b, (0, 3 - len(b))), *np.pad(a, (0, 3 - len(a)))[1:]]
            sections.append(",".join([axis.axis, str(index), *(f"{v:.17g}" for v in values)]))
        delays_s = [m.delay_margin_s for m in margins if m.delay_margin_s is not None]
        paragraphs.append(
            _AXIS.format(
                axis=axis.axis,
                settings="\n".join(f"| {n} | {v:.6g} {u} |" for n, v, u in _settings(pid)),
                loss=loss[0].upper() + loss[1:],
                plants=len(margins),
                modulus=min(m.modulus_margin for m in margins),
                delay=with_unit(min(delays_s), "s") if delays_s else "none needed",
                spiral=f"{_SPIRAL_Hz:g}",
                rows=error_rows(errors_m),
            )
        )
    readme = _README.format(
        name=plain_ascii(inputs.file.name),
        notches=inputs.hardware.notches,
        update=with_unit(update_Hz, "Hz", 6),
        axes="\n".join(paragraphs),
    )
    texts = {
        "README.md": readme,
        "settings.csv": "\n".join([*settings, ""]),
        "sections.csv": "\n".join([*sections, ""]),
    }
    return {name: text.encode() for name, text in texts.items()}, (*losses, *notes)


def pid_of(inputs: TargetInputs, axis: AxisParameters) -> tuple[Pid, tuple[Margins, ...], Errors]:
    """Search the settings of one axis, and simulate them and the exported controller.

    returned  settings, margins on every plant of the family, and rms errors on a spiral by plant
    """
    design, model, hardware = inputs.designs[axis.axis], inputs.models[axis.axis], inputs.hardware
    specification, rate_Hz = design.specification, design.sampling_rate_Hz
    plants = inputs.family(axis.axis)
    pid, margins = tuned_pid(
        axis.axis,
        with_sector(plant_family(model, rate_Hz), affine_bounds_of(model)),
        Pid(
            sampling_rate_Hz=rate_Hz,
            rest_V=plants[0].rest_voltage_V,
            minimum_V=axis.voltage_range_V[0],
            maximum_V=axis.voltage_range_V[1],
            lsb_V=float(axis.values["lsb_V"]),
            slew_V_per_s=hardware.slew_V_per_s or specification.voltage_slew_V_per_s or np.inf,
        ),
        notches=hardware.notches,
        specification=specification,
    )
    span = reference_range(axis)
    spiral = constant_angular_velocity(rate_Hz, _SPIRAL_Hz, _TURNS)
    path_m = span.centre_m + span.radius_m * spiral.x
    errors_m = {}
    for plant in plants:
        approach_m = approach_path(plant, float(path_m[0]))
        reference_m = np.concatenate([approach_m, path_m])
        rng = np.random.default_rng(SEED)
        record = run_law(plant, pid_law(pid), reference_m, rng=rng).after(len(approach_m))
        exported_error_m = exported_position_m(axis, plant, path_m) - path_m
        errors_m[plant.label] = {
            "exported": float(np.sqrt(np.mean(exported_error_m**2))),
            "pid": record.rms_error,
        }
    return pid, margins, errors_m


def _settings(pid: Pid) -> list[tuple[str, float, str]]:
    settings = [
        ("sampling rate", pid.sampling_rate_Hz, "Hz"),
        ("proportional", pid.proportional_V_per_m, "V/m"),
        ("integral", pid.integral_V_per_m_s, "V/(m s)"),
        ("derivative", pid.derivative_V_s_per_m, "V s/m"),
    ]
    for number, notch in enumerate(pid.notches, 1):
        settings += [
            (f"notch {number} frequency", notch.frequency_Hz, "Hz"),
            (f"notch {number} depth", notch.depth, "1"),
            (f"notch {number} width", notch.width, "1"),
        ]
    settings += [
        ("slew limit", pid.slew_V_per_s, "V/s"),
        ("rest", pid.rest_V, "V"),
        ("lowest output", pid.minimum_V, "V"),
        ("highest output", pid.maximum_V, "V"),
    ]
    return [setting for setting in settings if np.isfinite(setting[1])]
