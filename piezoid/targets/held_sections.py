"""An axis in a box of second-order sections: searched for, rounded, bounded, and run.

Settings are searched at the controller's rate, as for `pi-pid`, and then rounded to the box's
numbers at the box's rate. What rate and rounding do to the loop is bounded before anything is run:

    |P' C' / (P C) - 1| |P C / (1 + P C)| < 1 at all f, for all plants P

keeps the loop P' C' as stable as P C [Doyle & Stein 1981], because both have the same pole at 1
and no other outside of the circle. A faster box holds its output for a shorter time:

    P'(f) = P(f) Z(f, T') / Z(f, T),   Z(f, T) = (1 - exp(-2 pi j f T)) / (2 pi j f T)
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.design.plant import Fraction
from piezoid.errors import DesignError, ParameterFileError
from piezoid.export.parameter_file import AxisParameters
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import (
    Response,
    decibel,
    grid_Hz,
    polynomial_response,
    unit_circle,
)
from piezoid.targets.box import Box, run_box
from piezoid.targets.exported import Exported, shipped_position_m, tracked
from piezoid.targets.pid import Pid
from piezoid.targets.pid_search import tuned_pid
from piezoid.targets.price import (
    FREQUENCIES_Hz,
    felt_family,
    loss,
    shipped_rejection_dB,
)
from piezoid.targets.section_boxes import BOXES, CASCADE, PARALLEL, Programmed, SectionBox
from piezoid.targets.section_boxes import programmed as held_by
from piezoid.verification.approach import led_to, room_of
from piezoid.verification.plant import AxisPlant
from piezoid.verification.scenarios import constant_angular_velocity

SEED = 0
_SPIRAL_Hz, _TURNS = 10.0, 5.0
_STILL, _SPIRAL = "standing still", f"on a spiral of {_SPIRAL_Hz:g} Hz"
_REST_s = 0.3  # standing still, after the way to the middle
_RIPPLE_dB = 1.0  # by which rounding may change the gain between 1 Hz and where the loop crosses
_SLOWER = 0.97  # a step towards the asked modulus margin
_AWAY = 0.05  # of the way to the limits: a box that stands farther off does not hold the stage


@dataclass(frozen=True, kw_only=True)
class Row:
    """What was asked of a plant, and what is left: rms of exported controller and of the box.

    apart_m  of the box with its best delay apart
    """

    asked: str
    plant: str
    own_m: float
    box_m: float
    apart_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Held:
    """One axis in one box.

    pid      what was rounded;  modulus  the worst margin after it, of ``plants`` plants
    """

    axis: str
    programmed: Programmed
    pid: Pid
    plants: int
    modulus: float
    own_dB: Array
    box_dB: Array
    rows: tuple[Row, ...]

    @property
    def price(self) -> str:
        """What the box loses, in a sentence."""
        sections = len(self.programmed.coefficient)
        many = f"{sections} section{'s' if sections > 1 else ''} of {self.programmed.box.name}"
        runs = []
        for asked in (_STILL, _SPIRAL):
            rows = [row for row in self.rows if row.asked == asked]
            own, box = max(row.own_m for row in rows), max(row.box_m for row in rows)
            runs.append(f"{asked} {with_unit(box, 'm')} rms instead of {with_unit(own, 'm')}")
        return f"{loss(many, self.own_dB, self.box_dB)}; {', '.join(runs)}"


def held_axis(exported: Exported, axis: AxisParameters, box: SectionBox) -> Held:
    """Return an axis in one box, and what it loses there."""
    design, model = exported.designs[axis.axis], exported.models[axis.axis]
    asked, rate_Hz = design.specification, design.sampling_rate_Hz
    family = felt_family(model, rate_Hz)
    plants = exported.family(axis.axis)
    limits_V = (float(axis.values["voltage_minimum_V"]), float(axis.values["voltage_maximum_V"]))
    blank = Pid(
        sampling_rate_Hz=rate_Hz,
        proportional_V_per_m=0.0,
        integral_V_per_m_s=0.0,
        derivative_V_s_per_m=0.0,
        notches=(),
        rest_V=plants[0].rest_voltage_V,
        minimum_V=limits_V[0],
        maximum_V=limits_V[1],
    )
    # PyRPL's sections have no b2, so that a PID takes two; the first of Linien's is of first order
    for_pid = 2 if box.kind == PARALLEL else 1
    count = _sections(exported.box, box)
    pid = tuned_pid(
        axis.axis,
        family,
        blank,
        notches=max(count - for_pid, 0),
        asked=asked,
        derivative=box.kind != CASCADE and count >= for_pid,
    ).pid
    members = tuple(family.members)
    while True:
        chosen = _programmed(exported.box, axis, box, pid, limits_V, room_of(axis).farthest_m)
        found = _rounded(chosen, pid, members)
        # A faster box reads a little less ahead: slower settings of the same kind
        if found.ripple_dB > _RIPPLE_dB or found.modulus >= asked.modulus_margin:
            break
        pid = pid.times(_SLOWER)
    _refuse_rounded(exported.box, axis, chosen, pid, members, asked.modulus_margin, found)
    return Held(
        axis=axis.axis,
        programmed=chosen,
        pid=pid,
        plants=len(members),
        modulus=found.modulus,
        own_dB=shipped_rejection_dB(design),
        box_dB=_rejection_dB(members, chosen),
        rows=tuple(_rows(axis, chosen, plants)),
    )


def _sections(asked: Box, box: SectionBox) -> int:
    if asked.sections is not None and asked.sections > box.sections:
        raise ParameterFileError(
            f"sections of [biquad] is {asked.sections}, and {box.name} has {box.sections}",
            needed=f"at most {box.sections}",
            remedy=f"Write sections = {box.sections} or less, or leave it away.",
        )
    return asked.sections or box.sections


def _programmed(
    asked: Box,
    axis: AxisParameters,
    box: SectionBox,
    pid: Pid,
    limits_V: tuple[float, float],
    farthest_m: float,
) -> Programmed:
    update_Hz = box.usual_Hz
    if asked.update_Hz is not None:
        away = np.abs(np.array(box.rates_Hz) - asked.update_Hz)
        update_Hz = box.rates_Hz[int(np.argmin(away))]
        if away.min() > 1e-3 * asked.update_Hz:
            divisor = "a power of two" if box.doubles else "a whole number"
            raise ParameterFileError(
                f"update_Hz of [biquad] is {asked.update_Hz:g}, and {box.name} has no such rate",
                needed=f"{box.clock_Hz:g} Hz over {divisor}, {box.rates_Hz[-1]:.6g} to "
                f"{box.rates_Hz[0]:.6g} Hz",
                remedy=f"What would fit: update_Hz = {update_Hz:.8g}.",
            )
    output_V = asked.output_V or limits_V
    has_limits = box.kind not in (PARALLEL, CASCADE)
    if not has_limits and (output_V[0] < limits_V[0] or output_V[1] > limits_V[1]):
        raise ParameterFileError(
            f"axis {axis.axis}: output_V of [biquad] reaches from {output_V[0]:g} V to "
            f"{output_V[1]:g} V, the axis from {limits_V[0]:g} V to {limits_V[1]:g} V, and the "
            f"sections of {box.name} have no limits but their full scale",
            needed="a full scale inside the limits of the axis",
            remedy="Leave output_V away, and set the gain behind the box to match.",
        )
    error_m = asked.error_range_m or farthest_m
    return held_by(
        box,
        pid.sections(update_Hz),
        update_Hz=update_Hz,
        input_step_m=error_m / 2 ** (box.bits - 1),
        output_V=output_V,
        limits_V=limits_V,
    )


def _refuse_rounded(
    asked: Box,
    axis: AxisParameters,
    chosen: Programmed,
    pid: Pid,
    members: Sequence[Fraction],
    modulus_margin: float,
    found: "_Rounded",
) -> None:
    """Refuse numbers that do not hold the plants, with what would fit."""
    if found.holds:
        return
    said = (
        "a number that does not fit"
        if np.isnan(found.ripple_dB)
        else f"a gain that is off by {found.ripple_dB:.2g} dB"
    )
    if chosen.box.point is not None:
        last_bit = chosen.update_Hz * chosen.output_step_V / chosen.input_step_m
        last_bit /= 2.0**chosen.box.point
        said += (
            f"; the last bit of its integral is {last_bit:.3g} V/(m s), and "
            f"{abs(pid.integral_V_per_m_s):.3g} V/(m s) is needed"
        )
    fits = "; ".join(_that_hold(asked, axis, pid, members, modulus_margin))
    raise DesignError(
        f"axis {axis.axis}: {chosen.box.name} at {chosen.update_Hz:.6g} Hz rounds its sections to "
        f"{said}",
        needed=f"a gain within {_RIPPLE_dB:g} dB from 1 Hz to where the loop crosses, and a loop "
        f"that stays stable on all {len(members)} plants",
        remedy=f"What would fit, in [biquad] of box.toml: {fits}."
        if fits
        else "Use --target pi-pid or waveform.",
    )


def _that_hold(
    asked: Box,
    axis: AxisParameters,
    pid: Pid,
    members: Sequence[Fraction],
    modulus_margin: float,
) -> Iterator[str]:
    """Yield boxes and rates that hold the same settings."""
    limits_V = (pid.minimum_V, pid.maximum_V)
    for box in BOXES.values():
        is_first_order = box.kind == CASCADE and pid.derivative_V_s_per_m != 0.0
        if is_first_order or len(pid.notches) + 1 > box.sections:
            continue
        for update_Hz in dict.fromkeys((box.rates_Hz[-1], box.usual_Hz)):
            tried = replace(asked, update_Hz=update_Hz, output_V=None)
            chosen = _programmed(tried, axis, box, pid, limits_V, room_of(axis).farthest_m)
            found = _rounded(chosen, pid, members)
            if found.holds and found.modulus >= modulus_margin:
                yield f'format = "{box.name}" with update_Hz = {update_Hz:.8g}'


@dataclass(frozen=True, kw_only=True)
class _Rounded:
    """What rounding does: the worst modulus margin, the largest change of gain, and the bound."""

    modulus: float
    ripple_dB: float
    bound: float

    @property
    def holds(self) -> bool:
        return self.bound < 1.0 and self.ripple_dB <= _RIPPLE_dB


def _rounded(chosen: Programmed, pid: Pid, members: Sequence[Fraction]) -> _Rounded:
    if not np.isfinite(chosen.coefficient).all():
        return _Rounded(modulus=0.0, ripple_dB=np.nan, bound=np.inf)
    grid = grid_Hz(pid.sampling_rate_Hz, lowest_Hz=1.0)
    sections = pid.sections(chosen.update_Hz)
    meant = np.prod([_ratio(b, a, grid, chosen.update_Hz) for b, a in sections], axis=0)
    designed = _ratio(*pid.polynomials(), grid, pid.sampling_rate_Hz)
    held = chosen.response(grid)
    moduli, bounds = [], []
    inside = grid <= 1.0
    for member in members:
        loop = _ratio(member.B, member.A, grid, member.sampling_rate_Hz) * designed
        reached = _quicker(member, grid, chosen.update_Hz) * held
        moduli.append(float(np.abs(1.0 + reached).min()))
        bounds.append(float(np.max(np.abs((reached / loop - 1.0) * loop / (1.0 + loop)))))
        inside |= np.abs(loop) > 1.0
    return _Rounded(
        modulus=min(moduli),
        ripple_dB=float(np.abs(decibel(np.abs(held / meant)))[inside].max()),
        bound=max(bounds),
    )


def _quicker(member: Fraction, frequency_Hz: Array, update_Hz: float) -> Response:
    """Return a plant at the box's rate."""

    def holding(rate_Hz: float) -> Response:
        turn = 2j * np.pi * frequency_Hz / rate_Hz
        return np.asarray((1.0 - np.exp(-turn)) / turn)

    own = _ratio(member.B, member.A, frequency_Hz, member.sampling_rate_Hz)
    return np.asarray(own * holding(update_Hz) / holding(member.sampling_rate_Hz))


def _ratio(b: Array, a: Array, frequency_Hz: Array, rate_Hz: float) -> Response:
    q = unit_circle(frequency_Hz, rate_Hz)
    return np.asarray(polynomial_response(b, q) / polynomial_response(a, q))


def _rejection_dB(members: Sequence[Fraction], chosen: Programmed) -> Array:
    held = chosen.response(FREQUENCIES_Hz)
    found = [
        1.0 / np.abs(1.0 + held * _quicker(m, FREQUENCIES_Hz, chosen.update_Hz)) for m in members
    ]
    return np.asarray(decibel(np.max(found, axis=0)))


def _rows(axis: AxisParameters, chosen: Programmed, plants: Sequence[AxisPlant]) -> Iterator[Row]:
    """Yield what is left standing still and on a spiral, on every plant."""
    room, quick_Hz = room_of(axis), chosen.reading_Hz

    def path_m(rate_Hz: float) -> tuple[Array, int]:
        still = np.zeros(round(_REST_s * rate_Hz))
        spiral = constant_angular_velocity(rate_Hz, _SPIRAL_Hz, _TURNS).x
        return room.centre_m + room.radius_m * np.concatenate([still, spiral]), len(still)

    for own in plants:
        plant = replace(
            own, sampling_rate_Hz=quick_Hz, reading_step=0.0, reading_range=(-np.inf, np.inf)
        )
        own_m, own_turn = path_m(own.sampling_rate_Hz)
        quick_m, turn = path_m(quick_Hz)
        led_m = led_to(plant, room.centre_m)
        boxed = run_box(
            plant,
            chosen.compiled(own.rest_voltage_V),
            np.concatenate([led_m, quick_m]),
            rng=np.random.default_rng(SEED),
        )
        boxed_m = boxed.position_m[len(led_m) :]
        shipped_m = shipped_position_m(axis, own, own_m, SEED)
        for asked, own_part, part in (
            (_STILL, slice(own_turn), slice(turn)),
            (_SPIRAL, slice(own_turn, None), slice(turn, None)),
        ):
            one = tracked(
                own_m[own_part], shipped_m[own_part], room, _SPIRAL_Hz, own.sampling_rate_Hz
            )
            box = tracked(quick_m[part], boxed_m[part], room, _SPIRAL_Hz, quick_Hz)
            if asked == _STILL and box.rms_m > _AWAY * room.farthest_m:
                raise DesignError(
                    f"axis {axis.axis}: {chosen.box.name} stands {with_unit(box.rms_m, 'm')} rms "
                    f"away from what is asked on plant {own.label}",
                    needed=f"at most {with_unit(_AWAY * room.farthest_m, 'm')}",
                    remedy="Set error_range_m and output_V of [biquad] so that codes are finer.",
                )
            yield Row(
                asked=asked,
                plant=own.label,
                own_m=one.rms_m,
                box_m=box.rms_m,
                apart_m=box.aligned_rms_m,
            )
