"""A sensor held by a feedback: the drive gives way to creep, and shows it directly.

    y = const  =>  -g (u(t) - u(0)) = a ln(1 + t / s) + noise,      g the stage's mean gain

The logarithm, two numbers, is held against a cubic of time, three, on blocks left out, in units
of the drive. It is creep where it goes on in the direction of the move before, and leaves no more
than the cubic; where it leaves hardly less, drift is not told from it. What the small loop of the
drive's own answer takes (its slope after a turn is smaller than the mean gain) is in the size's
interval.

Source: Jung & Gweon (2000) on the logarithm; Fleming & Leang (2014) on holding a position.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import erfc, log, sqrt

import numpy as np

from piezoid.diagnosis.blocked_regression import gain_z
from piezoid.diagnosis.diagnosis import Diagnosis, Finding, Seen, Size, with_finding
from piezoid.diagnosis.effects import effect_named, every_effect
from piezoid.diagnosis.rest_columns import BLOCKS, SLOWS, cubic, held
from piezoid.diagnosis.structure_findings import seen_in_classes
from piezoid.formatting import significant, with_unit
from piezoid.numerics.arrays import Array
from piezoid.records.checks.feedback import held_span, is_held_throughout
from piezoid.records.recording import Recording

NAME = "creep"
SURE = 3.3  # standard errors of blocks: as every effect asks for
WORTH = 0.1  # of what the drive does in the hold: loops under feedback wander by themselves
SCALES = 12  # of the logarithm, from one sample to a third of the hold
# The slope of a small loop is below the mean gain: on six laws sizes came out 1.00 to 1.42 times
# the truth, and the interval reaches from 0.65 of them.
SLOPE = 0.35


@dataclass(frozen=True, kw_only=True, eq=False)
class _Hold:
    """What the drive does while the sensor stands.

    recording  whose it is
    time_s     (rows,)  since the hold began
    drive_V    (rows,)
    step_V     of the drive in the move before, with its sign; 0 where none is known
    """

    recording: str
    time_s: Array
    drive_V: Array
    step_V: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    """The logarithm that leaves least of a hold, V.

    scale_s       s
    per_decade_V  a ln 10
    curve_V       (rows,)  about its mean
    before_V, after_V  (rows,)  left without it and with it, on blocks left out
    cubic_V       rms that a cubic leaves
    """

    scale_s: float
    per_decade_V: float
    curve_V: Array
    before_V: Array
    after_V: Array
    cubic_V: float


def with_creep_of_holds(
    diagnosis: Diagnosis, recordings: Sequence[Recording], gain_m_per_V: float
) -> Diagnosis:
    """Return a diagnosis with the creep that a hold shows, where no other recording showed any.

    recordings    all of the axis, in their order
    gain_m_per_V  mean gain of those in which the sensor moves, with its sign
    """
    if NAME in diagnosis.names:
        return diagnosis
    holds = _holds(recordings, diagnosis.axis)
    found = [one for one in (_finding(hold, diagnosis, gain_m_per_V) for hold in holds) if one]
    if not found:
        return diagnosis
    return with_finding(diagnosis, max(found, key=lambda one: one.share))


def _holds(recordings: Sequence[Recording], axis: str) -> list[_Hold]:
    found = []
    for number, recording in enumerate(recordings):
        stretch = held_span(recording, axis)
        if stretch is None:
            continue
        drive_V = recording.voltage_V(axis)
        if is_held_throughout(recording, axis):  # the move before is another recording's
            first, before = 0, _last_move_V(recordings[:number], axis, float(drive_V[0]))
        else:
            first, before = stretch.start, _span_V(drive_V[: stretch.start])
        rows = np.arange(stretch.start, stretch.stop)
        found.append(
            _Hold(
                recording=recording.name,
                time_s=(rows - first) / recording.sampling_rate_Hz,
                drive_V=drive_V[rows],
                step_V=before,
            )
        )
    return found


def _last_move_V(earlier: Sequence[Recording], axis: str, end_V: float) -> float:
    """Return how far the recording before went, if it ended where the hold begins."""
    if not earlier:
        return 0.0
    drive_V = earlier[-1].voltage_V(axis)
    move_V = _span_V(drive_V)
    return move_V if abs(float(drive_V[-1]) - end_V) < 0.1 * abs(move_V) else 0.0


def _span_V(drive_V: Array) -> float:
    """Return how far the last monotone move went, with its sign."""
    if len(drive_V) < 2:
        return 0.0
    low, high = int(np.argmin(drive_V)), int(np.argmax(drive_V))
    return float(np.ptp(drive_V)) * (1.0 if high > low else -1.0)


def _finding(hold: _Hold, diagnosis: Diagnosis, gain_m_per_V: float) -> Finding | None:
    fit = _fitted(hold)
    before, after = (sqrt(float(np.mean(one**2))) for one in (fit.before_V, fit.after_V))
    gain = 1.0 - after / max(before, 1e-300)
    block = _blocks(hold)
    z = gain_z(
        np.bincount(block, fit.before_V**2 - fit.after_V**2, BLOCKS).astype(np.float64),
        np.bincount(block, (fit.before_V - fit.after_V) ** 2, BLOCKS).astype(np.float64),
        gain,
    )
    # the drive takes back what creeps: it goes against the move before
    goes_on = hold.step_V * fit.per_decade_V < 0.0
    if gain < WORTH or z < SURE or not goes_on or after > SLOWS * fit.cubic_V:
        return None
    effect = effect_named(NAME)
    percent = 100.0 * abs(fit.per_decade_V / hold.step_V)
    curve_m = abs(gain_m_per_V) * float(np.std(fit.curve_V))
    return Finding(
        effect=NAME,
        held_out_gain=float(np.clip(gain, 0.0, 1.0)),
        held_out_rms_before_m=before * abs(gain_m_per_V),
        held_out_rms_after_m=after * abs(gain_m_per_V),
        p_value=min(1.0, max(0.5 * erfc(z / sqrt(2.0)), 1e-12) * len(every_effect())),
        rms_percent=100.0 * curve_m / diagnosis.stroke_m,
        size=Size(value=percent, unit=effect.unit, ci95=((1.0 - SLOPE) * percent, 1.05 * percent)),
        not_separable_from=effect.confounded if after > fit.cubic_V / SLOWS else (),
        explanation=f"{effect.summary} In "
        f"{hold.recording} a feedback holds the sensor, and the drive gives way by "
        f"{with_unit(float(np.ptp(hold.drive_V)), 'V')} as ln(1 + t / "
        f"{with_unit(fit.scale_s, 's', 2)}): {significant(percent, 2)} % of the "
        f"{with_unit(abs(hold.step_V), 'V')} before it in every decade of time. "
        f"{with_unit(after, 'V')} rms of the drive are left, by a cubic of time "
        f"{with_unit(fit.cubic_V, 'V')}.",
        next_experiment=effect.experiment,
        parameters={"scale_s": fit.scale_s},
        coordinate="time_since_turn",
        seen=_seen(hold, fit, -gain_m_per_V),
    )


def _blocks(hold: _Hold) -> "np.ndarray[tuple[int], np.dtype[np.intp]]":
    return np.arange(len(hold.time_s)) * BLOCKS // len(hold.time_s)


def _fitted(hold: _Hold) -> _Fit:
    block, drive_V = _blocks(hold), hold.drive_V - hold.drive_V.mean()
    step_s = float(np.median(np.diff(hold.time_s)))
    tried = []
    for scale_s in np.geomspace(step_s, hold.time_s[-1] / 3.0, SCALES).tolist():
        column = np.log1p(hold.time_s / scale_s)[:, None]
        tried.append((float(np.mean(held(drive_V, [column], block) ** 2)), scale_s))
    scale_s = min(tried)[1]
    column = np.log1p(hold.time_s / scale_s)
    column -= column.mean()
    slope_V = float(column @ drive_V) / float(column @ column)
    return _Fit(
        scale_s=scale_s,
        per_decade_V=slope_V * log(10.0),
        curve_V=slope_V * column,
        before_V=held(drive_V, [], block),
        after_V=held(drive_V, [column[:, None]], block),
        cubic_V=float(np.sqrt(np.mean(held(drive_V, [cubic(hold.time_s)], block) ** 2))),
    )


def _seen(hold: _Hold, fit: _Fit, gain_m_per_V: float) -> Seen:
    """Return the picture: what the stage would have crept, against the time since the move."""
    drive_V = hold.drive_V - hold.drive_V.mean()
    decades = np.log10(np.maximum(hold.time_s, fit.scale_s))
    found = seen_in_classes(
        decades,
        gain_m_per_V * drive_V,
        gain_m_per_V * fit.curve_V,
        unit="s",
        recording=hold.recording,
    )
    return replace(found, place=tuple(10.0**decade for decade in found.place))
