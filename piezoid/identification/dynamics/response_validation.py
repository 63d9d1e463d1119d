"""Validate a measured response against an axis, and scale its dynamics to the gain of the axis.

A response is measured with small fast drives, the hysteresis with large slow drives. Their gains
differ in any ceramic; a larger difference is due to a wrong unit, axis or sign.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.formatting import significant, with_unit
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.modal import Filter, LinearDynamics, ResponseFit
from piezoid.identification.dynamics.response_fit import FittedResponse, fit_response
from piezoid.identification.model import AxisModel
from piezoid.records.frequency_response import FrequencyResponseRecord

# The gain of soft ceramics for small drives is 0.5 to 1 times that for large drives, about the
# least slope of a large loop: a gain beyond twice the limits of the slopes has another cause.
MAX_GAIN_RATIO = 2.0
SAME_MODE = 0.1  # relative change of a mode with amplitude and load between two measurements
# Gains are compared at a third of a mode, and at least at twice the lowest line.
BELOW_MODE, ABOVE_BAND = 1.0 / 3.0, 2.0
MIN_MODE_SHARE = 0.1  # of the gain: a recording may not show a mode with a smaller share


def validate_response(
    axis: AxisModel,
    response: FrequencyResponseRecord,
    declared: tuple[Filter, ...],
    recorded: tuple[LinearDynamics, str] | None,
) -> tuple[str, LinearDynamics, FrequencyResponse, ResponseFit] | str:
    """Fit a measured response, and reject it if it contradicts the axis.

    axis      with its hysteresis
    declared  poles of the rig
    recorded  dynamics determined by a recording, and its name: if the modes agree, the gain is
              that of the recording; if not, the response is rejected

    Returns:
        The result in a sentence, the dynamics, the fitted lines and the record of the fit; or the
        reason for the rejection.
    """
    try:
        fit = fit_response(response, axis.axis, declared)
    except (ExcitationError, IdentificationError) as refusal:
        return f"{response.name} is not used: {refusal}"
    reason = _contradiction(axis, fit, recorded)
    if reason:
        return f"{response.name} is not used: {reason}"
    d, sector = fit.dynamics, axis.hysteresis.slope_sector_m_per_V
    gain_m_per_V = abs(d.static_gain_m_per_V)
    gain_ratio = gain_m_per_V / axis.hysteresis.middle_slope_m_per_V
    sign = 1 if d.static_gain_m_per_V * axis.polarity > 0.0 else -1
    factor = 1.0 if recorded is None else _gain_ratio(recorded[0], d)
    is_outlier = fit.measured.is_interference
    record = ResponseFit(
        name=response.name,
        lines=len(is_outlier),
        used=int((~fit.measured.is_rejected).sum()),
        left_out_Hz=tuple(response.frequency_Hz[is_outlier].tolist()),
        gain_m_per_V=gain_m_per_V * factor,
        gain_ratio=gain_ratio * factor,
        factor=sign * factor,
        noise_relative=fit.noise,
        left_relative=fit.residual,
        left_Hz=fit.residual_Hz,
        slow=fit.slow,
    )
    gains = (
        f"For small fast drives the gain is {with_unit(gain_m_per_V, 'm')}/V, "
        f"{significant(gain_ratio)} times the middle of the hysteresis' slopes "
        f"({with_unit(sector[0], 'm')}/V to {with_unit(sector[1], 'm')}/V): the hysteresis keeps "
        "its own gain, and a controller is designed for both"
    )
    if recorded is not None:
        gains += (
            f"; {recorded[1]} shows the same mode and determines the gain, "
            f"{significant(factor)} times that of the response"
        )
    sign_change = "; its sign is inverted to that of the recordings" if sign < 0 else ""
    dynamics = replace(
        d,
        mode_gain_m_per_V=record.factor * d.mode_gain_m_per_V,
        lag_gain_m_per_V=record.factor * d.lag_gain_m_per_V,
        direct_gain_m_per_V=record.factor * d.direct_gain_m_per_V,
        static_gain_std_m_per_V=abs(record.factor) * d.static_gain_std_m_per_V,
    )
    measured = replace(fit.measured, response=sign * fit.measured.response)
    text = f"{response.name}, {_describe(fit, record)}. {gains}{sign_change}"
    return text, dynamics, measured, record


def _contradiction(
    axis: AxisModel, fit: FittedResponse, recorded: tuple[LinearDynamics, str] | None
) -> str:
    """Return why a response is rejected, or ''."""
    if not fit.is_determined:
        return (
            "no model of few modes fits it: the residual is "
            f"{significant(100.0 * fit.residual, 2)} % at {with_unit(fit.residual_Hz, 'Hz')}, or "
            "frequency or damping of a mode is not determined. Measure more finely about each "
            "peak, or up to a lower frequency"
        )
    gain, middle = abs(fit.dynamics.static_gain_m_per_V), axis.hysteresis.middle_slope_m_per_V
    flattest, greatest = axis.hysteresis.slope_sector_m_per_V
    if not flattest / MAX_GAIN_RATIO <= gain <= MAX_GAIN_RATIO * greatest:
        return (
            f"its gain is {with_unit(gain, 'm')}/V, the hysteresis' slopes are "
            f"{with_unit(flattest, 'm')}/V to {with_unit(greatest, 'm')}/V: "
            f"{significant(gain / middle)} times their middle. Another unit, another axis, "
            "or volts at the amplifier's input: name them in lab.toml, a factor as "
            "scale = { response = ... }"
        )
    if recorded is None:
        return ""
    mode_Hz, modes_Hz = _strongest_Hz(recorded[0]), fit.dynamics.mode_frequency_Hz
    is_same = len(modes_Hz) and float(np.abs(np.log(modes_Hz / mode_Hz)).min()) < SAME_MODE
    if mode_Hz and mode_Hz < fit.dynamics.band_Hz[1] and not is_same:
        listed = ", ".join(with_unit(float(f), "Hz") for f in modes_Hz) or "none"
        return (
            f"{recorded[1]} has a mode at {with_unit(mode_Hz, 'Hz')}, where the response has none "
            f"(its modes: {listed}). Another axis, load or stage"
        )
    return ""


def _gain_ratio(recorded: LinearDynamics, measured: LinearDynamics) -> float:
    """Return the gain of a recording over that of a response, at a frequency measured in both.

    The gain at rest lies below the band of a recording, where a fitted lag makes it meaningless.
    """
    low_Hz = max(
        BELOW_MODE * _strongest_Hz(recorded),
        ABOVE_BAND * recorded.band_Hz[0],
        measured.band_Hz[0],
    )
    gains = [np.abs(dynamics.response([low_Hz])[0]) for dynamics in (recorded, measured)]
    return float(gains[0] / gains[1])


def _strongest_Hz(dynamics: LinearDynamics) -> float:
    """Return the frequency of the mode with the largest share of the gain; 0 without a mode."""
    share = np.abs(dynamics.mode_gain_m_per_V)
    gain = abs(dynamics.static_gain_m_per_V)
    if not len(share) or share.max() < MIN_MODE_SHARE * gain:
        return 0.0
    return float(dynamics.mode_frequency_Hz[int(np.argmax(share))])


def _describe(fit: FittedResponse, record: ResponseFit) -> str:
    """Describe band, modes, delay and slope far below the modes, with their 95 % intervals."""
    dynamics = fit.dynamics
    low_Hz, high_Hz = dynamics.band_Hz
    gain = dynamics.static_gain_m_per_V
    quality = 0.5 / dynamics.mode_damping_interval()[:, ::-1]
    residues: list[float] = dynamics.mode_gain_m_per_V.tolist()
    modes_Hz = dynamics.mode_frequency_interval_Hz()
    lags_Hz = dynamics.lag_frequency_interval_Hz()
    modes = [
        f"a mode at {with_unit(float(f), 'Hz', 4)} ({_interval(modes_Hz[m], 'Hz', 5)}), quality "
        f"{significant(0.5 / float(dynamics.mode_damping[m]))} ({_interval(quality[m], '')}), "
        f"residue {with_unit(residues[m], 'm')}/V ({significant(100.0 * residues[m] / gain)} % of "
        "the static gain)"
        for m, f in enumerate(dynamics.mode_frequency_Hz)
    ]
    lags = [
        f"a pole at {with_unit(float(f), 'Hz')} ({_interval(lags_Hz[k], 'Hz')})"
        for k, f in enumerate(dynamics.lag_frequency_Hz)
    ]
    lines = f"{record.used} of {record.lines} lines used"
    if record.left_out_Hz:
        lines += f", {len(record.left_out_Hz)} left out as interference"
    slope = "too few lines lie far below the first mode to show creep"
    if (slow := fit.slow) is not None:
        low, high = slow.slope_ci95
        below = f"below {with_unit(slow.high_Hz, 'Hz')}"
        change = (
            f"{significant(slow.slope_dB, 2)} dB per decade ({_interval((low, high), '', 2)}) "
            f"{below}"
        )
        slope = f"the gain changes by {change}, which is no creep and was not removed"
        if slow.falls:
            slope = (
                f"{below} the gain falls by {significant(-slow.slope_dB, 2)} dB per decade "
                f"({_interval((-high, -low), '', 2)}), like creep"
            )
        elif low <= 0.0 <= high:
            slope = f"no creep was detected, {change}"
    return (
        f"{with_unit(low_Hz, 'Hz')} to {with_unit(high_Hz, 'Hz')} ({lines}): "
        f"{', '.join(modes + lags)}; delay {with_unit(dynamics.delay_s, 's')} "
        f"({_interval(dynamics.delay_interval_s(), 's')}); {slope}"
    )


def _interval(bounds: Iterable[float], unit: str, digits: int = 3) -> str:
    low, high = (with_unit(float(bound), unit, digits) for bound in bounds)
    return f"{low} to {high}"
