"""What changed since the last calibration: two stages from their sealed files, side by side.

Compared is what does not depend on how a fit chose its basis: the loading curve, which holds all
weights and thresholds in one line, the opening of the full loop, lag, modes and junction. Single
weights are not: neighbours share theirs, and another fit shares it otherwise.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from piezoid.diagnosis.diagnosis import Diagnosis, Finding
from piezoid.errors import ParameterFileError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import student_quantile
from piezoid.verification.verification import Verification

# Of the range: the opening of a loop grows with the square of its size, so that this moves it by
# 1 %, half of the narrowest interval of the bundled stage (1.8 % of 3.4 um).
SAME_RANGE = 0.005


@dataclass(frozen=True, kw_only=True)
class Known:
    """A number with its 95 % interval; infinite ends where none is known."""

    value: float
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True, kw_only=True)
class Moved:
    """One quantity of then and now.

    axis       or ``tip``
    name       in words
    unit       SI
    then, now  with their 95 % intervals
    """

    axis: str
    name: str
    unit: str
    then: Known
    now: Known

    @property
    def is_known(self) -> bool:
        """Whether both have an interval, so that a difference can be judged."""
        return all(math.isfinite(one.high - one.low) for one in (self.then, self.now))

    @property
    def is_moved(self) -> bool:
        """Whether the two intervals have nothing in common.

        Of two measurements of one thing that happens once in 180 cases: 2.77 standard deviations
        of their difference where both are known equally well.
        """
        return self.is_known and (self.now.low > self.then.high or self.then.low > self.now.high)

    @property
    def ratio(self) -> float:
        """Now over then."""
        return self.now.value / self.then.value if self.then.value else math.nan


@dataclass(frozen=True, kw_only=True)
class Cause:
    """A cause named then, now, or both times.

    then, now  the finding; None where it was not named, or nobody asked
    """

    axis: str
    effect: str
    then: Finding | None
    now: Finding | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Curves:
    """Loading curves of an axis over the rise that both reach.

    rise_V            (points,)
    then_m, now_m     (points,)
    then_half_m, now_half_m  (points,)  half their 95 % intervals
    """

    axis: str
    rise_V: Array
    then_m: Array
    now_m: Array
    then_half_m: Array
    now_half_m: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Since:
    """Two calibrations of one stage.

    then_digest, now_digest  of the two models
    moved       every quantity that both know, by axis
    curves      by axis, where both have a range in common
    causes      by axis; of axes that were diagnosed both times
    notes       what could not be compared, and why, whole sentences
    only_then, only_now  axes that one of them has not
    held        the controller of then against the stage of now; None where it was not run
    unheld      why not, or what was left out of it and why; empty where all of it was run
    """

    then_digest: str
    now_digest: str
    moved: tuple[Moved, ...]
    curves: tuple[Curves, ...]
    causes: tuple[Cause, ...]
    notes: tuple[str, ...] = ()
    only_then: tuple[str, ...] = ()
    only_now: tuple[str, ...] = ()
    held: Verification | None = None
    unheld: str = ""

    @property
    def came(self) -> tuple[Cause, ...]:
        """Causes that are named now and were not then."""
        return tuple(one for one in self.causes if one.then is None)

    @property
    def went(self) -> tuple[Cause, ...]:
        """Causes that were named then and are not now."""
        return tuple(one for one in self.causes if one.now is None)

    @property
    def beyond(self) -> tuple[Moved, ...]:
        """Quantities whose intervals have nothing in common."""
        return tuple(one for one in self.moved if one.is_moved)

    def summary(self) -> dict[str, Any]:
        """Return what a script wants to know."""
        failed = () if self.held is None else tuple(v for v in self.held.verdicts if not v.passed)
        return {
            "then": self.then_digest,
            "now": self.now_digest,
            "moved": [
                {
                    "axis": one.axis,
                    "name": one.name,
                    "unit": one.unit,
                    "then": one.then.value,
                    "now": one.now.value,
                    "beyond_intervals": one.is_moved if one.is_known else None,
                }
                for one in self.moved
            ],
            "came": [{"axis": one.axis, "effect": one.effect} for one in self.came],
            "went": [{"axis": one.axis, "effect": one.effect} for one in self.went],
            "notes": list(self.notes),
            "axes_gone": list(self.only_then),
            "axes_new": list(self.only_now),
            "controller_holds": None if self.held is None else self.held.passed,
            "controller_failed": [f"{v.name} ({v.scenario})" for v in failed],
            "controller_not_run": self.unheld,
        }


def since(
    then: ActuatorModel,
    now: ActuatorModel,
    *,
    then_digest: str,
    now_digest: str,
    diagnoses_then: Sequence[Diagnosis] = (),
    diagnoses_now: Sequence[Diagnosis] = (),
    held: Verification | None = None,
    unheld: str = "",
) -> Since:
    """Compare two calibrations.

    then, now       the stages
    diagnoses_then, diagnoses_now  of their axes
    held            the controller of then, run against the stage of now
    unheld          why it was not, or what was left out

    Raises ``ParameterFileError`` where they have neither an axis nor a tip in common.
    """
    both = [name for name in now.axes if name in then.axes]
    tips = _tip(then, now)
    if not both and not tips:
        raise ParameterFileError(
            f"the older stage has axes {', '.join(then.axes) or 'none'}, this one "
            f"{', '.join(now.axes) or 'none'}",
            needed="two calibrations of one stage, with an axis in common",
            remedy="Name the folder of an earlier calibration of the same stage.",
        )
    if then.counted != now.counted:
        told = [" and ".join(one.counted) or "nothing" for one in (then, now)]
        raise ParameterFileError(
            f"the older stage has {told[0]} in counts of the converter, this one {told[1]}",
            needed="two calibrations in one unit",
            remedy="Fit the recordings of both with the same scale in lab.toml.",
        )
    pairs = [(then.axes[name], now.axes[name]) for name in both]
    curves = tuple(found for a, b in pairs if (found := _curves(a, b)) is not None)
    return Since(
        then_digest=then_digest,
        now_digest=now_digest,
        moved=(*(one for a, b in pairs for one in _axis(a, b)), *tips),
        curves=curves,
        causes=tuple(_causes(diagnoses_then, diagnoses_now)),
        notes=tuple(_note(a, b) for a, b in pairs if not _same_range(a, b)),
        only_then=tuple(name for name in then.axes if name not in now.axes),
        only_now=tuple(name for name in now.axes if name not in then.axes),
        held=held,
        unheld=unheld,
    )


def _same_range(then: AxisModel, now: AxisModel) -> bool:
    """Return whether both were driven over the same range; opening and curve belong to one."""
    span_V = now.voltage_V[1] - now.voltage_V[0]
    apart_V = np.abs(np.subtract(then.voltage_V, now.voltage_V)).max()
    return bool(apart_V <= SAME_RANGE * span_V)


def _note(then: AxisModel, now: AxisModel) -> str:
    was, is_now = (f"{axis.voltage_V[0]:.4g} to {axis.voltage_V[1]:.4g} V" for axis in (then, now))
    return (
        f"Axis {now.axis} was driven over {was} then and {is_now} now: loops and loading curves "
        "of different ranges are not compared."
    )


def _axis(then: AxisModel, now: AxisModel) -> Iterator[Moved]:
    curves = _curves(then, now)
    if curves is not None:
        for share in (0.5, 1.0):
            k = round(share * (len(curves.rise_V) - 1))
            yield Moved(
                axis=now.axis,
                name=f"displacement after a rise of {curves.rise_V[k]:.3g} V",
                unit="m",
                then=_about(curves.then_m[k], curves.then_half_m[k]),
                now=_about(curves.now_m[k], curves.now_half_m[k]),
            )
    rows = (
        ("opening of the full loop", "m", *_widths(then, now)),
        ("lag", "s", _lag(then), _lag(now)),
        *_modes(then, now),
        (
            "sensor noise, rms",
            "m",
            _only(then.quality.noise_rms_m),
            _only(now.quality.noise_rms_m),
        ),
        (
            "error on data left out, rms",
            "m",
            _only(then.quality.held_out_rms_m),
            _only(now.quality.held_out_rms_m),
        ),
    )
    for name, unit, was, is_now in rows:
        if was is not None and is_now is not None:
            yield Moved(axis=now.axis, name=name, unit=unit, then=was, now=is_now)


def _curves(then: AxisModel, now: AxisModel) -> Curves | None:
    """Return both loading curves over the rise that both reach, from the middle of one range."""
    if not _same_range(then, now):
        return None
    a, b = then.uncertainty, now.uncertainty
    end_V = min(a.reach_V[-1], b.reach_V[-1])
    rise_V = np.linspace(0.0, end_V, len(b.reach_V))
    at = [
        np.interp(rise_V, found.reach_V, values)
        for found in (a, b)
        for values in (found.loading_m, found.loading_half_m)
    ]
    return Curves(
        axis=now.axis,
        rise_V=rise_V,
        then_m=then.polarity * at[0],
        then_half_m=at[1],
        now_m=now.polarity * at[2],
        now_half_m=at[3],
    )


def _widths(then: AxisModel, now: AxisModel) -> tuple[Known | None, Known | None]:
    if not _same_range(then, now):
        return None, None
    return _about(*then.uncertainty.loop_width_m), _about(*now.uncertainty.loop_width_m)


def _lag(axis: AxisModel) -> Known | None:
    """Return the lag, None where it cannot be told from a width of the loop."""
    if axis.lag.kind == "none" or axis.quality.lag_is_open:
        return None
    found = axis.uncertainty
    if "lag_s" not in found.names:
        return _only(axis.lag.time_s)
    variance = float(found.covariance.diagonal()[found.names.index("lag_s")])
    quantile = float(student_quantile(0.975, max(found.blocks - 1, 1)))
    return _about(axis.lag.time_s, quantile * math.sqrt(max(variance, 0.0)))


def _modes(
    then: AxisModel, now: AxisModel
) -> Iterator[tuple[str, str, Known | None, Known | None]]:
    """Return frequency and damping of modes, where both fits found as many."""
    if then.dynamics is None or now.dynamics is None:
        return
    a, b = (axis.dynamics.path(axis.axis, axis.axis) for axis in (then, now) if axis.dynamics)
    if len(a.mode_frequency_Hz) != len(b.mode_frequency_Hz):
        return
    count = len(a.mode_frequency_Hz)
    for k in range(count):
        which = "" if count == 1 else f" {k + 1}"
        for name, unit, values, intervals in (
            ("resonance", "Hz", "mode_frequency_Hz", "mode_frequency_interval_Hz"),
            ("damping of resonance", "", "mode_damping", "mode_damping_interval"),
        ):
            was, is_now = (
                Known(
                    value=float(getattr(path, values)[k]),
                    low=float(getattr(path, intervals)()[k][0]),
                    high=float(getattr(path, intervals)()[k][1]),
                )
                for path in (a, b)
            )
            yield f"{name}{which}", unit, was, is_now


def _tip(then: ActuatorModel, now: ActuatorModel) -> tuple[Moved, ...]:
    """Return the barriers that both stages know."""
    a, b = then.tunnelling, now.tunnelling
    if a is None or b is None:
        return ()
    pairs = (
        ("barrier from sweeps", a.gap_law, b.gap_law),
        ("barrier from the closed loop", a.loop_plant, b.loop_plant),
    )
    found = []
    for name, was, is_now in pairs:
        if was is not None and is_now is not None:
            old, new = (
                Known(
                    value=one.barrier_eV,
                    low=one.barrier_interval_eV[0],
                    high=one.barrier_interval_eV[1],
                )
                for one in (was, is_now)
            )
            found.append(Moved(axis="tip", name=name, unit="eV", then=old, now=new))
    return tuple(found)


def _causes(then: Sequence[Diagnosis], now: Sequence[Diagnosis]) -> Iterator[Cause]:
    before = {one.axis: one for one in then}
    for found in now:
        if found.axis not in before:
            continue
        old = {one.effect: one for one in before[found.axis].findings}
        new = {one.effect: one for one in found.findings}
        for effect in dict.fromkeys((*new, *old)):
            yield Cause(axis=found.axis, effect=effect, then=old.get(effect), now=new.get(effect))


def _about(value: float, half: float) -> Known:
    return Known(value=float(value), low=float(value - half), high=float(value + half))


def _only(value: float) -> Known:
    return Known(value=float(value))
