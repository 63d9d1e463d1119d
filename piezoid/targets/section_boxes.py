"""Boxes that hold second-order sections: what their published sources say they compute.

`sections.c` computes as they do; this file knows their numbers. Every section is

    y = b0 x + b1 x' + b2 x'' + a1 y' + a2 y'',   a1 and a2 with this sign in all three boxes
"""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.numerics.compiled import opened
from piezoid.numerics.frequency import Response, polynomial_response, unit_circle
from piezoid.targets.box import Compiled

_MOST_SECTIONS = 14
_QUICKEST_Hz = 250e3  # a faster box is given the same reading several times, for up to 4 us
SINGLE, PARALLEL, CASCADE = range(3)

Polynomials = tuple[Array, Array]  # numerator and monic denominator in q^-1


@dataclass(frozen=True, kw_only=True)
class SectionBox:
    """What one box holds.

    kind      how it computes: ``sections.c``
    sections  at most
    clock_Hz  over a whole number from ``ticks[0]`` to ``ticks[1]`` is its rate; powers of two only
              where ``doubles``
    usual     that number as it is published, or the slowest
    bits      of its converters, both ways
    point     bits behind the point of a coefficient; None: single precision
    width     bits of a coefficient
    source    where this is published
    """

    name: str
    kind: int
    sections: int
    clock_Hz: float
    ticks: tuple[int, int]
    usual: int
    bits: int
    source: str
    doubles: bool = False
    point: int | None = None
    width: int = 32

    @property
    def rates_Hz(self) -> tuple[float, ...]:
        """All rates it can have, the fastest first."""
        least, most = self.ticks
        if self.doubles:
            return tuple(self.clock_Hz / 2**n for n in range(least, most + 1))
        return tuple(self.clock_Hz / n for n in range(least, most + 1))

    @property
    def usual_Hz(self) -> float:
        """Its rate where nobody says another."""
        return self.clock_Hz / (2**self.usual if self.doubles else self.usual)

    def held(self, value: float) -> float:
        """Return a coefficient as it is stored, NaN where it does not fit."""
        if self.point is None:
            return float(np.float32(value))
        raw = float(np.round(value * 2.0**self.point))
        most = 2.0 ** (self.width - 1)
        return raw / 2.0**self.point if -most <= raw < most else np.nan


BOXES = {
    box.name: box
    for box in (
        SectionBox(
            name="stabilizer",
            kind=SINGLE,
            sections=2,
            clock_Hz=100e6,
            ticks=(7, 15),
            usual=7,
            doubles=True,
            bits=16,
            source="github.com/quartiq/stabilizer, src/bin/dual-iir.rs (f32 IIR math, 1 or 2 "
            "sections a channel, i16 converter codes, 100 MHz / 2^7); github.com/quartiq/idsp, "
            "src/iir/biquad.rs (direct form 1, signs, clamp before feedback)",
        ),
        SectionBox(
            name="pyrpl",
            kind=PARALLEL,
            sections=14,
            clock_Hz=125e6,
            ticks=(14, 1023),
            usual=1023,
            bits=14,
            point=29,
            source="github.com/lneuhaus/pyrpl, pyrpl/fpga/rtl/red_pitaya_iir_block.v (IIRBITS 32, "
            "IIRSHIFT 29, IIRSTAGES 14 in parallel, IIRSIGNALBITS 32, SIGNALBITS 14, SIGNALSHIFT "
            "3, LOOPBITS 10) and red_pitaya_product_sat.v (rounding, saturation)",
        ),
        SectionBox(
            name="linien",
            kind=CASCADE,
            sections=2,
            clock_Hz=125e6,
            ticks=(1, 1),
            usual=1,
            bits=14,
            point=16,
            width=18,
            source="github.com/linien-org/linien, gateware/logic/chains.py (an Iir of order 1, "
            "then one of order 2; coeff_width 18, shift 16, signal_width 25, converters of 14) "
            "and gateware/logic/iir.py (one rounding down, held where it overflows)",
        ),
    )
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Programmed:
    """A box with its numbers.

    coefficient     (sections, 5)  b0 b1 b2 a1 a2 as they are held, codes to codes
    update_Hz       at which it computes;  repeats: computations for each reading of the plant
    input_step_m    of a code of the difference reference - reading
    output_middle_V, output_step_V   volts of code 0, and of one code
    output_codes    ends of its output
    """

    box: SectionBox
    coefficient: Array
    update_Hz: float
    input_step_m: float
    output_middle_V: float
    output_step_V: float
    output_codes: tuple[int, int]

    @property
    def repeats(self) -> int:
        """How often it computes with the same reading in the simulation."""
        return max(1, int(np.ceil(self.update_Hz / _QUICKEST_Hz)))

    @property
    def reading_Hz(self) -> float:
        """At which the simulation gives it readings."""
        return self.update_Hz / self.repeats

    @property
    def raw(self) -> Array:
        """Coefficients as registers hold them: integers where it has a fixed point."""
        return self.coefficient * (1.0 if self.box.point is None else 2.0**self.box.point)

    def response(self, frequency_Hz: Array) -> Response:
        """Return V/m from the difference to the output, (frequencies,)."""
        q = unit_circle(frequency_Hz, self.update_Hz)
        each = [
            polynomial_response(row[:3], q) / polynomial_response(np.r_[1.0, -row[3:]], q)
            for row in self.coefficient
        ]
        whole = np.sum(each, axis=0) if self.box.kind == PARALLEL else np.prod(each, axis=0)
        return np.asarray(whole * (self.output_step_V / self.input_step_m))

    def compiled(self, rest_V: float) -> Compiled:
        """Return the box as the plant's loop calls it, at rest at a voltage."""
        held = _Box(kind=self.box.kind, sections=len(self.coefficient), repeats=self.repeats)
        for place, row in enumerate(self.coefficient if self.box.point is None else self.raw):
            for k, value in enumerate(row):
                held.coefficient[place][k] = value
        held.input_step_m, held.input_most = self.input_step_m, 2.0 ** (self.box.bits - 1) - 1
        held.output_middle_V, held.output_step_V = self.output_middle_V, self.output_step_V
        held.output_least, held.output_most = self.output_codes
        state = _State()
        code = (rest_V - self.output_middle_V) / self.output_step_V
        place = _integrator(self.coefficient)
        finer = {SINGLE: 1.0, PARALLEL: 2.0**17, CASCADE: 2.0**11}[self.box.kind]
        for k in (2, 3):
            state.single[place][k] = code
            state.whole[place][k] = round(finer * code)
        if self.box.kind == CASCADE:  # what follows the integrator passes a constant on
            for after in range(place + 1, len(self.coefficient)):
                for k in range(4):
                    state.whole[after][k] = round(finer * code)
        step = ctypes.cast(section_library().sb_step, ctypes.c_void_p).value
        assert step is not None
        return Compiled(step=step, state=state, parameters=held)


def _integrator(coefficient: Array) -> int:
    """Return which section has a pole at 1."""
    return int(np.argmin(np.abs(1.0 - coefficient[:, 3] - coefficient[:, 4])))


def programmed(
    box: SectionBox,
    cascade: Sequence[Polynomials],
    *,
    update_Hz: float,
    input_step_m: float,
    output_V: tuple[float, float],
    limits_V: tuple[float, float],
) -> Programmed:
    """Return a box that computes a cascade as nearly as it can; NaN where a number does not fit.

    cascade   sections in V/m at ``update_Hz``, numerators and denominators of at most three
              coefficients. The first has the pole at 1: the integrator
    output_V  command at the ends of its output converter
    limits_V  within which the command stays
    """
    half = 2 ** (box.bits - 1)
    step_V = (output_V[1] - output_V[0]) / (2 * half)
    middle_V = 0.5 * (output_V[0] + output_V[1])
    scaled = [
        (b * (input_step_m / step_V if k == 0 else 1.0), a) for k, (b, a) in enumerate(cascade)
    ]
    if box.kind == PARALLEL:
        scaled = _side_by_side(scaled)
    elif box.kind == SINGLE:
        scaled = scaled[::-1]  # the last clamps, so the integrator stands there
    codes = (
        max(-half, int(np.ceil((limits_V[0] - middle_V) / step_V))),
        min(half - 1, int(np.floor((limits_V[1] - middle_V) / step_V))),
    )
    return Programmed(
        box=box,
        coefficient=np.array([_rounded(box, b, a) for b, a in scaled]),
        update_Hz=update_Hz,
        input_step_m=input_step_m,
        output_middle_V=middle_V,
        output_step_V=step_V,
        output_codes=codes if box.kind == SINGLE else (-half, half - 1),
    )


def _rounded(box: SectionBox, b: Array, a: Array) -> list[float]:
    """Return b0 b1 b2 a1 a2 as they are held; a pole at 1 stays there."""
    b, a = (np.pad(p, (0, 3 - len(p))) for p in (b, a))
    found = [box.held(float(value)) for value in (*b, -a[1], -a[2])]
    if abs(np.sum(a)) < 1e-12:
        grid = 2.0**23 if box.point is None else 2.0**box.point
        found[4] = float(np.round(-a[2] * grid) / grid)
        found[3] = 1.0 - found[4]
    return found


def _side_by_side(cascade: Sequence[Polynomials]) -> list[Polynomials]:
    """Return sections whose sum is the product of others: partial fractions, b2 = 0.

    B / A = k + sum of r_i / (1 - p_i q),   k into the first section, conjugate poles in one
    """
    poles = [np.roots(a) for _, a in cascade]
    flat = np.concatenate(poles).astype(np.complex128)
    k = float(np.prod([b[-1] / a[-1] if len(b) == len(a) else 0.0 for b, a in cascade]))

    sections: list[Polynomials] = []
    for place in np.argsort(-flat.real):
        pole = flat[place]
        top = np.prod([np.polyval(b[::-1], 1.0 / pole) for b, _ in cascade])
        r = complex(top / np.prod(1.0 - np.delete(flat, place) / pole))
        if abs(pole.imag) < 1e-12:
            sections.append((np.array([r.real]), np.array([1.0, -pole.real])))
        elif pole.imag > 0.0:
            b = np.array([2.0 * r.real, -2.0 * (r * pole.conjugate()).real])
            sections.append((b, np.array([1.0, -2.0 * pole.real, abs(pole) ** 2])))
    place = int(np.argmin([abs(np.sum(a)) for _, a in sections]))
    b, a = sections.pop(place)
    b = np.pad(b, (0, 2 - len(b))) + k * np.pad(a, (0, 2 - len(a)))
    return [(b, a), *sections]


class _Box(ctypes.Structure):
    """``sb_box``."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("kind", "sections", "repeats")),
        ("coefficient", ctypes.c_double * 5 * _MOST_SECTIONS),
        *(
            (name, ctypes.c_double)
            for name in (
                "input_step_m",
                "input_most",
                "output_middle_V",
                "output_step_V",
                "output_least",
                "output_most",
            )
        ),
    )


class _State(ctypes.Structure):
    """``sb_state``."""

    _fields_ = (
        ("ready", ctypes.c_uint32),
        ("status", ctypes.c_uint32),
        ("single", ctypes.c_float * 4 * _MOST_SECTIONS),
        ("whole", ctypes.c_int64 * 4 * _MOST_SECTIONS),
    )


@cache
def section_library() -> ctypes.CDLL:
    """Open the compiled sections."""
    return opened("piezoid.targets._sections", {"sb_step": (ctypes.c_double, None)})
