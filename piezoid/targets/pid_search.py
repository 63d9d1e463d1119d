"""The PID with notches that rejects most on every plant of a family, within its limits."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from piezoid.design.plant import Fraction, Plant, PlantFamily
from piezoid.design.rst import LIGHT
from piezoid.design.sensitivity import Margins, closed_loop_polynomial, margins
from piezoid.design.specification import Specification
from piezoid.design.templates import Template, violations
from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import Response, grid_Hz, polynomial_response, unit_circle
from piezoid.numerics.polynomial import spectral_radius
from piezoid.targets.pid import Notch, Pid

# Values tried; the gain of each is as large as the margins allow. Three times as many leads and
# twice as many of the others gained 0.2 and 0.6 dB on the bundled stage, 0.5 dB with a notch and
# 0.8 dB without on a mode at 630 Hz.
_LEADS_samples = (0.0, *np.geomspace(0.7, 90.0, 24).tolist())
_DERIVATIVES = (0.0, 0.06, 0.12, 0.25, 0.5)  # of the lead
_WIDTHS = (0.3, 0.7, 1.4, 2.0)
_DEEPEST = 0.02
_HALVINGS = 16
_SPAN = 1e6  # of the gain that is searched
_LINES = 400
_SPARED = 0.98  # of the modulus: the grid of the search is coarser than that of the check
_USELESS_Hz = 1.0  # a loop that does not reach so far is none


@dataclass(frozen=True, kw_only=True, eq=False)
class Tuned:
    """What was found, and the margins of every member, recomputed exactly."""

    pid: Pid
    margins: tuple[Margins, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Grid:
    members: Sequence[Plant]
    w: Array  # (frequencies,)  rad/s
    q: Response
    loops: Response  # (members, frequencies)  B / A
    efforts: Array  # (frequencies,)  V per output unit, the largest |Sup| that is allowed


def tuned_pid(
    axis: str,
    family: PlantFamily,
    blank: Pid,
    *,
    notches: int,
    asked: Specification,
    derivative: bool = True,
) -> Tuned:
    """Return the settings with the largest integral gain within the limits, on every plant.

    blank    limits and converter of the box; its gains are not looked at
    notches  how many it has;  derivative: False for a box without
    asked    both margins, and every limit of the control effort: what no recording shows of a
             stage limits a PID as it limits the exported controller

    The integral is what rejects slow disturbances, |Syp| = 2 pi f / (gain integral).

    Raises ``DesignError`` where none makes a loop of 1 Hz.
    """
    efforts = tuple(one for one in asked.templates if one.function == "Sup")
    grid = _grid(family, efforts)
    sign = float(np.sign(family.nominal.gain))
    best: Pid | None = None
    for one in _structures(family.nominal, blank, notches, derivative, sign):
        known = 0.0 if best is None else abs(best.integral_V_per_m_s)
        found = _largest(grid, one, known, asked)
        best = found or best
    least = 2.0 * np.pi * _USELESS_Hz / abs(family.nominal.gain)
    while best is not None and abs(best.integral_V_per_m_s) >= least:
        R, S = best.polynomials()
        if not violations(
            family.members,
            *(R, S),
            templates=efforts,
            modulus_margin=asked.modulus_margin,
            delay_margin_s=asked.delay_margin_s,
        ):
            return Tuned(pid=best, margins=tuple(margins(one, R, S) for one in family.members))
        best = best.times(0.93)
    slowest = min(family.members, key=lambda member: member.gain * sign)
    raise DesignError(
        f"axis {axis}: no PID with {notches} notches holds all {len(family.members)} plants that "
        f"the recordings allow with a loop of {_USELESS_Hz:g} Hz; their gains reach from "
        f"{slowest.gain:.3g} to {max(m.gain * sign for m in family.members) * sign:.3g} m/V",
        needed=f"a modulus margin of {asked.modulus_margin:g}, a delay margin of "
        f"{1e6 * asked.delay_margin_s:.3g} us and every limit of the control effort on every one",
        remedy="Use --target waveform, which closes no loop, or record again so that the "
        "intervals are narrower.",
    )


def _grid(family: PlantFamily, efforts: Sequence[Template]) -> _Grid:
    rate_Hz = family.nominal.sampling_rate_Hz
    lines = [grid_Hz(rate_Hz, lowest_Hz=0.1, count=_LINES)]
    lines += [one.frequency_Hz for one in efforts]
    for member in family.members:  # closer where a mode is narrow
        for f, damping in _modes(member):
            lines.append(f * (1.0 + damping * np.linspace(-4.0, 4.0, 13)))
    frequency_Hz = np.unique(np.concatenate(lines))
    frequency_Hz = frequency_Hz[frequency_Hz < 0.5 * rate_Hz]
    q = unit_circle(frequency_Hz, rate_Hz)
    loops = [polynomial_response(m.B, q) / polynomial_response(m.A, q) for m in family.members]
    w = np.asarray(2.0 * np.pi * frequency_Hz)
    allowed_dB = np.min([one.limit_dB(frequency_Hz) for one in efforts], axis=0, initial=np.inf)
    return _Grid(
        members=family.members,
        w=w,
        q=q,
        loops=np.stack(loops),
        efforts=np.broadcast_to(10.0 ** (allowed_dB / 20.0), w.shape),
    )


def _modes(plant: Plant) -> list[tuple[float, float]]:
    """Return frequency and damping of the light modes, the lowest first."""
    s = np.log(plant.poles.astype(np.complex128))
    damping = -s.real / np.abs(s)
    natural_Hz = np.abs(s) * plant.sampling_rate_Hz / (2.0 * np.pi)
    light = (damping < LIGHT) & (s.imag > 0.0)
    return sorted(zip(natural_Hz[light].tolist(), damping[light].tolist(), strict=True))


def _structures(
    nominal: Plant, blank: Pid, notches: int, derivative: bool, sign: float
) -> Iterator[Pid]:
    """Yield settings with an integral gain of 1."""
    period_s = 1.0 / blank.sampling_rate_Hz
    placed = _modes(nominal)[:notches]
    banks = (
        [()]
        if not placed
        else [
            tuple(Notch(frequency_Hz=f, depth=max(z, _DEEPEST), width=w) for f, z in placed)
            for w in _WIDTHS
        ]
    )
    if placed:
        banks.append(())
    shares = _DERIVATIVES if derivative else (0.0,)
    for bank, lead, share in product(banks, _LEADS_samples, shares):
        if lead == 0.0 and share > 0.0:
            continue
        lead_s = lead * period_s
        yield replace(
            blank,
            proportional_V_per_m=sign * lead_s,
            integral_V_per_m_s=sign,
            derivative_V_s_per_m=sign * share * lead_s**2,
            notches=bank,
        )


def _largest(grid: _Grid, one: Pid, known: float, asked: Specification) -> Pid | None:
    """Return the settings at their largest gain, None where that is not above a known one."""
    R, S = one.polynomials()
    controller = polynomial_response(R, grid.q) / polynomial_response(S, grid.q)
    open_loop = grid.loops * controller

    def holds(gain: float) -> bool:
        scaled = gain * open_loop
        returned = np.abs(1.0 + scaled) * _SPARED
        if returned.min() < asked.modulus_margin:
            return False
        if (gain * np.abs(controller) > grid.efforts * returned).any():
            return False
        outside = np.abs(scaled) > 1.0
        crossed = outside[:, :-1] != outside[:, 1:]
        late_s = (np.angle(-scaled) % (2.0 * np.pi) / grid.w)[:, :-1][crossed]
        if late_s.size and late_s.min() * _SPARED < asked.delay_margin_s:
            return False
        return all(_is_stable(member, gain * R, S) for member in grid.members)

    slowest = 2.0 * np.pi * _USELESS_Hz / abs(grid.members[0].gain)
    low, high = max(known * 1.001, slowest), slowest * _SPAN
    if not holds(low):
        return None
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if holds(middle) else (low, middle)
    return one.times(low)


def _is_stable(member: Fraction, R: Array, S: Array) -> bool:
    return spectral_radius(closed_loop_polynomial(member, R, S)) < 1.0
