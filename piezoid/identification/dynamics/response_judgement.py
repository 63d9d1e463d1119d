"""Whether a measured response belongs to an axis, and what is said of it.

A response is of one drive, small and quick; the hysteresis is that of large slow ones. Their gains
differ, and neither overrides the other; but a unit, an axis or a sign that is wrong makes them
differ by more than ceramics do.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.formatting import significant, with_unit
from piezoid.identification.dynamics.behind_hysteresis import middle_slope_m_per_V
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.modal_basis import Filter
from piezoid.identification.dynamics.records import ResponseFit
from piezoid.identification.dynamics.response_fit import ResponseFound, fit_response
from piezoid.identification.model import AxisModel
from piezoid.records.frequency_response import FrequencyResponseRecord

# Small drives move soft ceramics by 0.5 to 1 of what large ones do, and the least slope of a large
# loop is about theirs: beyond twice the ends of the slopes there is another reason.
FAR_OFF = 2.0
SAME_MODE = 0.1  # of itself: by so much amplitude and load move a mode between two measurements
BELOW, CLEAR = 1.0 / 3.0, 2.0  # of a mode, and of the lowest line: gains are compared there
HIDDEN = 0.1  # of the gain: a mode with less may be one that a recording does not show


@dataclass(frozen=True, kw_only=True, eq=False)
class ResponseJudged:
    """What a measured response is to an axis.

    dynamics, measured, record  None where it is not used
    remarks   sentences, the first with all that was found or why it is not used
    """

    remarks: tuple[str, ...]
    dynamics: LinearDynamics | None = None
    measured: FrequencyResponse | None = None
    record: ResponseFit | None = None


def judge_response(
    axis: AxisModel,
    response: FrequencyResponseRecord,
    declared: tuple[Filter, ...],
    shown: tuple[LinearDynamics, str] | None,
) -> ResponseJudged:
    """Fit a measured response, and use it where it fits the axis.

    axis      whose hysteresis is known
    declared  poles of the rig
    shown     dynamics that a recording determines, and its name: where modes agree, the gain is
              that of the recording; where they do not, the response is not used
    """
    try:
        found = fit_response(response, axis.axis, declared)
    except (ExcitationError, IdentificationError) as refusal:
        return ResponseJudged(remarks=(f"{response.name} is not used: {refusal}",))
    reason = _reason_against(axis, found, shown)
    if reason:
        return ResponseJudged(remarks=(f"{response.name} is not used: {reason}",))
    at_rest = float(found.dynamics.static_gain_m_per_V[0, 0])
    sign = 1 if at_rest * axis.polarity > 0.0 else -1
    record = _record(axis, response, found, at_rest, sign)
    least, greatest = axis.hysteresis.slope_sector_m_per_V
    gains = (
        f"Small quick drives move it by {with_unit(record.gain_m_per_V, 'm')}/V, "
        f"{significant(record.gain_ratio)} times the middle of the hysteresis' slopes "
        f"({with_unit(least, 'm')}/V to {with_unit(greatest, 'm')}/V): the hysteresis keeps its "
        "own gain, and a controller is designed for both"
    )
    if shown is not None:
        by_recording = _gain_beside(shown[0], found.dynamics)
        record = record.scaled(by_recording)
        gains += (
            f"; {shown[1]} shows the same mode, and the gain is its, "
            f"{significant(by_recording)} times that of the response"
        )
    turned = "; its sign is turned to that of the recordings" if sign < 0 else ""
    text = f"{response.name}, {_words(found, record)}. {gains}{turned}"
    return ResponseJudged(
        remarks=(text,),
        dynamics=_times(found.dynamics, record.factor),
        measured=replace(found.measured, response=sign * found.measured.response),
        record=record,
    )


def _reason_against(
    axis: AxisModel, found: ResponseFound, shown: tuple[LinearDynamics, str] | None
) -> str:
    """Return why a response is not used, empty where it is."""
    if not found.is_determined:
        return (
            f"no few modes follow it: {significant(100.0 * found.left, 2)} % of it are left at "
            f"{with_unit(found.left_Hz, 'Hz')}, or the numbers of a mode are not known. Measure "
            "more finely about each peak, or up to a lower frequency"
        )
    gain = abs(float(found.dynamics.static_gain_m_per_V[0, 0]))
    least, greatest = axis.hysteresis.slope_sector_m_per_V
    if not least / FAR_OFF <= gain <= FAR_OFF * greatest:
        ratio = gain / middle_slope_m_per_V(axis)
        return (
            f"its gain is {with_unit(gain, 'm')}/V, the hysteresis' slopes are "
            f"{with_unit(least, 'm')}/V to {with_unit(greatest, 'm')}/V: {significant(ratio)} "
            "times their middle. Another unit, another axis, or volts in front of the amplifier: "
            "name them in lab.toml, a factor as scale = { response = ... }"
        )
    if shown is None:
        return ""
    dynamics, name = shown
    strongest_Hz = _strongest_Hz(dynamics)
    own_Hz = found.dynamics.mode_frequency_Hz
    near = len(own_Hz) and float(np.abs(np.log(own_Hz / strongest_Hz)).min()) < SAME_MODE
    if strongest_Hz and strongest_Hz < found.dynamics.band_Hz[1] and not near:
        held = ", ".join(with_unit(float(f), "Hz") for f in own_Hz) or "none"
        return (
            f"{name} has a mode at {with_unit(strongest_Hz, 'Hz')}, where the response has none "
            f"(its modes: {held}). Another axis, load or stage"
        )
    return ""


def _gain_beside(shown: LinearDynamics, found: LinearDynamics) -> float:
    """Return the gain of a recording over that of a response, where both were measured.

    Not at rest: that lies below the band of a recording, where a lag may make anything of it.
    """
    low_Hz = max(BELOW * _strongest_Hz(shown), CLEAR * shown.band_Hz[0], found.band_Hz[0])
    one, other = (np.abs(dynamics.response([low_Hz])[0, 0, 0]) for dynamics in (shown, found))
    return float(one / other)


def _strongest_Hz(dynamics: LinearDynamics) -> float:
    """Return the mode with the largest share of the gain; 0 where there is none."""
    share = np.abs(dynamics.mode_gain_m_per_V[:, 0, 0])
    if not len(share) or share.max() < HIDDEN * abs(float(dynamics.static_gain_m_per_V[0, 0])):
        return 0.0
    return float(dynamics.mode_frequency_Hz[int(np.argmax(share))])


def _times(dynamics: LinearDynamics, factor: float) -> LinearDynamics:
    return replace(
        dynamics,
        mode_gain_m_per_V=factor * dynamics.mode_gain_m_per_V,
        mode_rate_gain_m_s_per_V=factor * dynamics.mode_rate_gain_m_s_per_V,
        lag_gain_m_per_V=factor * dynamics.lag_gain_m_per_V,
        direct_gain_m_per_V=factor * dynamics.direct_gain_m_per_V,
        static_gain_std_m_per_V=abs(factor) * dynamics.static_gain_std_m_per_V,
    )


def _record(
    axis: AxisModel,
    response: FrequencyResponseRecord,
    found: ResponseFound,
    at_rest: float,
    sign: int,
) -> ResponseFit:
    alone = found.measured.is_interference[:, 0]
    return ResponseFit(
        name=response.name,
        lines=len(alone),
        used=int((~found.measured.is_rejected[:, 0]).sum()),
        left_out_Hz=tuple(response.frequency_Hz[alone].tolist()),
        gain_m_per_V=abs(at_rest),
        gain_ratio=abs(at_rest) / middle_slope_m_per_V(axis),
        factor=float(sign),
        noise_relative=found.noise,
        left_relative=found.left,
        left_Hz=found.left_Hz,
        slow=found.slow,
    )


def _words(found: ResponseFound, record: ResponseFit) -> str:
    """Return band, modes, delay and slope, with their 95 % intervals."""
    dynamics = found.dynamics
    low_Hz, high_Hz = dynamics.band_Hz
    rest = float(dynamics.static_gain_m_per_V[0, 0])
    quality = 0.5 / dynamics.mode_damping_interval()[:, ::-1]
    modes = [
        f"a mode at {with_unit(f, 'Hz', 4)} ({_ends(ends, 'Hz', 5)}), quality "
        f"{significant(0.5 / damping)} ({_ends(between, '')}), residue {with_unit(share, 'm')}/V "
        f"({significant(100.0 * share / rest)} % of the gain at rest)"
        for f, ends, damping, between, share in zip(
            dynamics.mode_frequency_Hz.tolist(),
            dynamics.mode_frequency_interval_Hz().tolist(),
            dynamics.mode_damping.tolist(),
            quality.tolist(),
            dynamics.mode_gain_m_per_V[:, 0, 0].tolist(),
            strict=True,
        )
    ]
    lags = [
        f"a pole at {with_unit(f, 'Hz')} ({_ends(ends, 'Hz')})"
        for f, ends in zip(
            dynamics.lag_frequency_Hz.tolist(),
            dynamics.lag_frequency_interval_Hz().tolist(),
            strict=True,
        )
    ]
    left_out = f"{record.used} of {record.lines} lines used"
    if record.left_out_Hz:
        left_out += f", {len(record.left_out_Hz)} that stand alone among those left out"
    return (
        f"{with_unit(low_Hz, 'Hz')} to {with_unit(high_Hz, 'Hz')} ({left_out}): "
        f"{', '.join(modes + lags)}; delay {with_unit(dynamics.delay_s, 's')} "
        f"({_ends(dynamics.delay_interval_s(), 's')}); {slope_words(found)}"
    )


def slope_words(found: ResponseFound) -> str:
    """Return what is said of the response far below the first mode."""
    slow = found.slow
    if slow is None:
        return "too few lines lie far below the first mode to tell creep"
    low, high = slow.slope_ci95
    below = f"below {with_unit(slow.high_Hz, 'Hz')}"
    if slow.falls:
        return (
            f"{below} the gain falls by {significant(-slow.slope_dB, 2)} dB per decade "
            f"({_ends((-high, -low), '', 2)}), as of creep"
        )
    slope = f"{significant(slow.slope_dB, 2)} dB per decade ({_ends((low, high), '', 2)}) {below}"
    if low <= 0.0 <= high:
        return f"no creep is seen, {slope}"
    return f"the gain changes by {slope}, which is no creep and was not taken out"


def _ends(interval: Iterable[float], unit: str, digits: int = 3) -> str:
    low, high = (with_unit(float(end), unit, digits) for end in interval)
    return f"{low} to {high}"
