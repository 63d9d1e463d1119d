"""Bandwidth verdict: a first-order pole, or a resonance."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from piezoid.formatting import with_unit
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.modal_basis import Declaration
from piezoid.numerics.robust import NORMAL_95

Kind = Literal["first_order", "resonance", "undecided"]

FALLEN = 1.0 / np.sqrt(2.0)
IN_A_ROW = 3  # lines below that: one alone may be noise
BETWEEN_deg = -67.5  # half way from -45 (first order) to -90 (resonance)
AT_REST_deg = 22.5  # at rest a stage has turned by less
# Where a slew limit leaves 0.707 of a sine its triangle lags by acos(0.707 pi^2 / 8) = 29 degrees,
# a pole by 45: a gain that falls with less than half way between them is neither's.
PHASELESS_deg = -37.0
AT_THE_END = 0.8  # of the highest line: a gain that peaks above may rise further
CLEAR_PEAK = 1.2  # a first-order pole never rises; noise and distortion do a little
PEAK_SIGMAS = 4.0  # standard deviations: the peak is the largest of many lines
LOW_BAND = 2.0  # the gain at rest is the median up to so many times the lowest line
UNKNOWN_DELAY_s = (0.0, np.inf)

UNDECIDED = "These recordings do not show whether a pole or a resonance limits the stage"
MEANING = {
    "first_order": "A first-order pole limits the stage",
    "resonance": "A resonance limits the stage",
    "undecided": UNDECIDED,
}
ADVICE = {
    "first_order": "",
    "resonance": "",
    "undecided": " Declare amplifier and sensor, and record a small chirp through that frequency, "
    "at the rate of the controller or faster.",
}


@dataclass(frozen=True, kw_only=True)
class BandwidthVerdict:
    """What limits the bandwidth of the stage, with the reason.

    kind                ``first_order``, ``resonance`` or ``undecided``
    stated_Hz           the bandwidth of the data sheet, where the laboratory declared one
    fallen_Hz           where the gain has fallen by 3 dB, or None where the lines end before
    phase_interval_deg  there, against rest, behind the declared chain and the delay; 95 %, with
                        the delay's own interval
    peak_ratio          largest gain up to there over the gain at rest
    peak_Hz             where that is
    highest_Hz          usable lines end here; 0 where there are none
    text                one sentence or two
    """

    kind: Kind
    stated_Hz: float | None
    fallen_Hz: float | None = None
    phase_interval_deg: tuple[float, float] | None = None
    peak_ratio: float | None = None
    peak_Hz: float | None = None
    highest_Hz: float = 0.0
    text: str

    @property
    def resonance_Hz(self) -> float | None:
        """Where the gain peaks, or has fallen by 3 dB without a peak; None for no resonance."""
        if self.kind != "resonance":
            return None
        return self.peak_Hz if (self.peak_ratio or 0.0) > CLEAR_PEAK else self.fallen_Hz


def decide_bandwidth(
    measured: FrequencyResponse,
    declaration: Declaration,
    *,
    delay_s: tuple[float, float] = UNKNOWN_DELAY_s,
    stated_Hz: float | None = None,
) -> BandwidthVerdict:
    """Decide by phase and peak whether a first-order pole or a resonance limits the stage.

        w / (s + w):                       gain falls by 3 dB at w, phase -45 degrees, no peak
        w^2 / (s^2 + 2 zeta w s + w^2):    it does so at w or above, phase -90 degrees or more,
                                           after a peak of 1 / (2 zeta) where zeta is small

    declaration  hold and known poles: taken out
    delay_s      interval of the pure delay; unknown, the phase only bounds the stage's own
    stated_Hz    of the data sheet; it is compared, and does not decide where to look: at 5 % from
                 a sharp resonance its phase is still near zero

    Undecided where the lines end before the gain has fallen, where the phase's interval holds
    both sides, or where phase and gain belong to neither.
    """
    usable = ~measured.is_rejected[:, 0]
    if usable.sum() <= IN_A_ROW:
        return unmeasured(stated_Hz, f"{int(usable.sum())} lines of the response are usable")
    f = measured.frequency_Hz[usable]
    response = measured.response[usable, 0, 0]
    spread = np.sqrt(measured.variance[usable, 0, 0]) / np.abs(response)
    is_low = f <= LOW_BAND * f[0]
    sign = np.sign(np.median(response[is_low].real)) or 1.0
    declared = declaration.response(f, measured.sampling_rate_Hz)
    relative = sign * response / (declared * np.exp(-2j * np.pi * f * delay_s[0]))
    relative /= np.median(np.abs(relative[is_low]))
    gain = np.abs(relative)
    runs = np.convolve(gain < FALLEN, np.ones(IN_A_ROW), "valid") == IN_A_ROW
    fallen = int(np.argmax(runs)) if runs.any() else None
    turned_deg = float(np.degrees(np.abs(np.angle(relative[0]))))
    if turned_deg >= AT_REST_deg or (fallen is not None and f[fallen] <= LOW_BAND * f[0]):
        return unmeasured(
            stated_Hz, f"lines from {with_unit(f[0], 'Hz')} do not show the gain at rest"
        )
    peak = int(np.argmax(gain[: None if fallen is None else fallen + 1]))
    peak_Hz, ratio = float(f[peak]), float(gain[peak])
    is_peak = peak < len(f) - 1 and ratio * (1.0 - PEAK_SIGMAS * spread[peak]) > CLEAR_PEAK
    kind: Kind = "resonance" if is_peak else "undecided"
    interval, fallen_Hz = None, None
    if fallen is not None:
        pair = slice(fallen - 1, fallen + 1)
        fallen_Hz = float(np.interp(-FALLEN, -gain[pair], f[pair]))
        phase_deg = float(np.degrees(np.angle(np.interp(fallen_Hz, f, relative))))
        phase_deg -= 360.0 if phase_deg > 90.0 else 0.0
        half = NORMAL_95 * float(np.degrees(np.interp(fallen_Hz, f, spread) / np.sqrt(2.0)))
        later = 360.0 * fallen_Hz * (delay_s[1] - delay_s[0])
        interval = (phase_deg - half, max(min(phase_deg + later, 0.0), phase_deg) + half)
        kind = _kind(interval, bool(is_peak))
        text = (
            f"{MEANING[kind]}: the largest gain is {ratio:.3g} times the gain at rest, at "
            f"{with_unit(peak_Hz, 'Hz')}; the gain has fallen by 3 dB at "
            f"{with_unit(fallen_Hz, 'Hz')}, with a phase between {interval[0]:.0f}° and "
            f"{interval[1]:.0f}°.{ADVICE[kind]}"
        )
    elif is_peak:
        text = (
            f"{MEANING[kind]}: the largest gain is {ratio:.3g} times the gain at rest, at "
            f"{with_unit(peak_Hz, 'Hz')}.{ADVICE[kind]}"
        )
    else:
        text = (
            f"{UNDECIDED}: they end at {with_unit(f[-1], 'Hz')}, where the gain is still "
            f"{gain[-1]:.2f} times that at rest. {_remedy(stated_Hz)}"
        )
    return BandwidthVerdict(
        kind=kind,
        stated_Hz=stated_Hz,
        fallen_Hz=fallen_Hz,
        phase_interval_deg=interval,
        peak_ratio=ratio,
        peak_Hz=peak_Hz,
        highest_Hz=float(f[-1]),
        text=_stated(stated_Hz) + text,
    )


def unfitted(
    verdict: BandwidthVerdict, recording: str, reason: str, *, has_mode: bool = False
) -> BandwidthVerdict:
    """Return a verdict with the reason why no pole or mode was fitted.

    recording  that shows the response
    reason     why nothing could be fitted to it
    has_mode   whether the model has a mode that a diagnosis added
    """
    stated_Hz = verdict.stated_Hz
    if verdict.kind == "undecided":
        further = verdict.text if verdict.highest_Hz > 0.0 else _remedy(stated_Hz)
        text = f"{recording}: no resonance or pole could be fitted: {reason}. {further}"
        return replace(verdict, text=text)
    shape, at_Hz, size = "a first-order pole", verdict.fallen_Hz, ""
    if verdict.resonance_Hz is not None:
        shape, at_Hz = "a resonance", verdict.resonance_Hz
    if at_Hz == verdict.peak_Hz:
        size = f" ({verdict.peak_ratio:.3g} times the gain at rest)"
    model = "takes the mode from the diagnosis" if has_mode else "keeps a pure lag"
    location, chirp = f"near {with_unit(at_Hz or 0.0, 'Hz')}", "through it"
    peak_Hz = verdict.peak_Hz or 0.0
    if verdict.fallen_Hz is None and peak_Hz > AT_THE_END * verdict.highest_Hz:
        location = f"at {with_unit(at_Hz or 0.0, 'Hz')} or above, where its response ends"
        chirp = f"to at least {2.0 * verdict.highest_Hz:.0f} Hz"
    text = (
        f"{recording} shows {shape} {location}{size}. Its frequency response could not be fitted: "
        f"{reason}. The model {model}. Record a small chirp {chirp}, about 2 % of the range of "
        "the drive, at the rate of the controller or faster."
    )
    return replace(verdict, text=_stated(stated_Hz) + text)


def unmeasured(stated_Hz: float | None, reason: str) -> BandwidthVerdict:
    """Return an undecided verdict and its reason."""
    return BandwidthVerdict(
        kind="undecided",
        stated_Hz=stated_Hz,
        text=f"{_stated(stated_Hz)}{UNDECIDED}: {reason}. {_remedy(stated_Hz)}",
    )


def _kind(interval_deg: tuple[float, float], is_peak: bool) -> Kind:
    low_deg, high_deg = interval_deg
    if low_deg > PHASELESS_deg:
        return "undecided"
    if is_peak or high_deg < BETWEEN_deg:
        return "resonance"
    return "first_order" if low_deg > BETWEEN_deg else "undecided"


def _stated(stated_Hz: float | None) -> str:
    return "" if stated_Hz is None else f"lab.toml states a bandwidth of {stated_Hz:g} Hz. "


def _remedy(stated_Hz: float | None) -> str:
    if stated_Hz is None:
        return "Record a small chirp until the gain has fallen, at the rate of the controller."
    return (
        "Record a small chirp through that frequency, sampled at the rate of the controller or "
        "faster, at least at three times that frequency."
    )
