"""Search for the PID with notches that rejects slow disturbances most on every plant."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from piezoid.design.family_grid import mode_lines_Hz
from piezoid.design.plant import Plant, PlantFamily
from piezoid.design.rst import LIGHT
from piezoid.design.sensitivity import Margins, closed_loop_polynomial, margins
from piezoid.design.specification import Specification
from piezoid.design.templates import Template, violations
from piezoid.errors import DesignError
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import Response, grid_Hz, polynomial_response, unit_circle
from piezoid.numerics.polynomial import spectral_radius
from piezoid.targets.pid import Notch, Pid

# Ratios tried; the gain of each is as large as the margins allow. Three times as many leads and
# twice as many of the others gained 0.2 and 0.6 dB on the bundled stage, 0.5 dB with a notch and
# 0.8 dB without on a mode at 630 Hz.
_LEADS_samples = (0.0, *np.geomspace(0.7, 90.0, 24).tolist())  # proportional / integral
_DERIVATIVES = (0.0, 0.06, 0.12, 0.25, 0.5)  # derivative / (integral lead^2)
_WIDTHS = (0.3, 0.7, 1.4, 2.0)
_MIN_DEPTH = 0.02
_BISECTIONS = 16
_GAIN_RANGE = 1e6
_LINES = 400
_GRID_MARGIN = 0.98  # the grid of the search is coarser than that of the final check
_MIN_LOOP_Hz = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class TunedPid:
    """Settings, and the margins of every member, recomputed exactly."""

    pid: Pid
    margins: tuple[Margins, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Grid:
    """Frequency responses on which the search judges a loop.

    w         (frequencies,)  rad/s
    plants    (members, frequencies)  B / A
    efforts   (frequencies,)  V per output unit, the largest |Sup| allowed
    """

    members: Sequence[Plant]
    w: Array
    q: Response
    plants: Response
    efforts: Array


def tuned_pid(
    axis: str, family: PlantFamily, blank: Pid, *, notches: int, specification: Specification
) -> TunedPid:
    """Return the settings with the largest integral gain within the limits, on every plant.

    The integral rejects slow disturbances, |Syp| = 2 pi f / (gain integral).

    Args:
        axis: name, for messages
        family: plants, the slope sector of the hysteresis included
        blank: limits and converter of the controller; its gains are ignored
        notches: number of notches it may use
        specification: both margins and every limit of the control effort; what no recording
            shows limits a PID as it limits the exported controller

    Raises:
        DesignError: no settings reach a loop of 1 Hz
    """
    efforts = tuple(template for template in specification.templates if template.function == "Sup")
    grid = _grid(family, efforts)
    sign = float(np.sign(family.nominal.gain))
    best: Pid | None = None
    for candidate in _candidates(family.nominal, blank, notches, sign):
        best_gain = 0.0 if best is None else abs(best.integral_V_per_m_s)
        best = _largest_gain(grid, candidate, best_gain, specification) or best
    min_integral = 2.0 * np.pi * _MIN_LOOP_Hz / abs(family.nominal.gain)
    while best is not None and abs(best.integral_V_per_m_s) >= min_integral:
        R, S = best.polynomials()
        if not violations(
            family.members,
            *(R, S),
            templates=efforts,
            modulus_margin=specification.modulus_margin,
            delay_margin_s=specification.delay_margin_s,
        ):
            return TunedPid(
                pid=best, margins=tuple(margins(member, R, S) for member in family.members)
            )
        best = best.scaled(0.93)
    gains = sorted((member.gain for member in family.members), key=lambda gain: gain * sign)
    raise DesignError(
        f"axis {axis}: no PID with {notches} notches stabilises all {len(family.members)} plants "
        f"that the recordings allow with a loop of {_MIN_LOOP_Hz:g} Hz; their gains range from "
        f"{gains[0]:.3g} to {gains[-1]:.3g} m/V",
        needed=f"a modulus margin of {specification.modulus_margin:g}, a delay margin of "
        f"{with_unit(specification.delay_margin_s, 's')} and every limit of the control effort on "
        "every one",
        remedy="Use --target waveform, which closes no loop, or record again so that the "
        "intervals are narrower.",
    )


def _grid(family: PlantFamily, efforts: Sequence[Template]) -> _Grid:
    rate_Hz = family.nominal.sampling_rate_Hz
    lines = [grid_Hz(rate_Hz, lowest_Hz=0.1, count=_LINES)]
    lines += [template.frequency_Hz for template in efforts]
    lines += [mode_lines_Hz(member) for member in family.members]
    frequency_Hz = np.unique(np.concatenate(lines))
    frequency_Hz = frequency_Hz[frequency_Hz < 0.5 * rate_Hz]
    q = unit_circle(frequency_Hz, rate_Hz)
    plants = [polynomial_response(m.B, q) / polynomial_response(m.A, q) for m in family.members]
    w = np.asarray(2.0 * np.pi * frequency_Hz)
    limit_dB = np.min(
        [template.limit_dB(frequency_Hz) for template in efforts], axis=0, initial=np.inf
    )
    return _Grid(
        members=family.members,
        w=w,
        q=q,
        plants=np.stack(plants),
        efforts=np.broadcast_to(10.0 ** (limit_dB / 20.0), w.shape),
    )


def _modes(plant: Plant) -> list[tuple[float, float]]:
    """Return frequency and damping of the lightly damped modes, the lowest first."""
    s = np.log(plant.poles.astype(np.complex128))
    damping = -s.real / np.abs(s)
    natural_Hz = np.abs(s) * plant.sampling_rate_Hz / (2.0 * np.pi)
    light = (damping < LIGHT) & (s.imag > 0.0)
    return sorted(zip(natural_Hz[light].tolist(), damping[light].tolist(), strict=True))


def _candidates(nominal: Plant, blank: Pid, notches: int, sign: float) -> Iterator[Pid]:
    """Yield settings with an integral gain of 1: without notches, and with them on the modes."""
    modes = _modes(nominal)[:notches]
    banks: list[tuple[Notch, ...]] = [
        tuple(Notch(frequency_Hz=f, depth=max(z, _MIN_DEPTH), width=width) for f, z in modes)
        for width in (_WIDTHS if modes else ())
    ]
    for bank, lead, share in product([*banks, ()], _LEADS_samples, _DERIVATIVES):
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


def _largest_gain(
    grid: _Grid, candidate: Pid, best_gain: float, specification: Specification
) -> Pid | None:
    """Return a candidate at its largest gain, None where that is not above a known one."""
    R, S = candidate.polynomials()
    controller = polynomial_response(R, grid.q) / polynomial_response(S, grid.q)
    open_loop = grid.plants * controller

    def is_allowed(gain: float) -> bool:
        scaled = gain * open_loop
        distance = np.abs(1.0 + scaled) * _GRID_MARGIN
        if distance.min() < specification.modulus_margin:
            return False
        if (gain * np.abs(controller) > grid.efforts * distance).any():
            return False
        outside = np.abs(scaled) > 1.0
        crossed = outside[:, :-1] != outside[:, 1:]
        delay_s = (np.angle(-scaled) % (2.0 * np.pi) / grid.w)[:, :-1][crossed]
        if delay_s.size and delay_s.min() * _GRID_MARGIN < specification.delay_margin_s:
            return False
        return all(
            spectral_radius(closed_loop_polynomial(member, gain * R, S)) < 1.0
            for member in grid.members
        )

    slowest = 2.0 * np.pi * _MIN_LOOP_Hz / abs(grid.members[0].gain)
    low, high = max(best_gain * 1.001, slowest), slowest * _GAIN_RANGE
    if not is_allowed(low):
        return None
    for _ in range(_BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if is_allowed(middle) else (low, middle)
    return candidate.scaled(low)
