"""Bandwidth verdict: whether a first-order pole or a resonance limits the stage."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from piezoid.formatting import with_unit
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.modal import Declaration
from piezoid.numerics.robust import NORMAL_95

Kind = Literal["first_order", "resonance", "undecided"]

MINUS_3_dB = 1.0 / np.sqrt(2.0)
IN_A_ROW = 3  # lines below that gain: a single line may be noise
BETWEEN_deg = -67.5  # half way from -45 (first order) to -90 (resonance)
STATIC_deg = 22.5  # largest phase of the lowest line, which shows the static gain
# At 0.707 of the amplitude of a sine the triangle of a slew limit lags by
# acos(0.707 pi^2 / 8) = 29 degrees, a pole by 45: a gain that falls with a lag of less than half
# way between them has another cause than a pole.
MIN_LAG_deg = -37.0
BAND_END = 0.8  # of the highest line: a gain that peaks above may rise further
CLEAR_PEAK = 1.2  # a first-order pole never rises; noise and distortion do a little
PEAK_SIGMAS = 4.0  # standard deviations: the peak is the largest of many lines
LOW_BAND = 2.0  # times the lowest line: up to there the median gain is the static gain
UNKNOWN_DELAY_s = (0.0, np.inf)
CHIRP_SAMPLES = 3.0  # in a period of its highest frequency
CHIRP_AMPLITUDE = 0.02  # of the range of the drive

UNDECIDED = "These recordings do not show whether a pole or a resonance limits the stage"
MEANING = {
    "first_order": "A first-order pole limits the stage",
    "resonance": "A resonance limits the stage",
    "undecided": UNDECIDED,
}
ADVICE = (
    "Declare amplifier and sensor, and record a small chirp through that frequency, sampled at "
    "three times that frequency or faster."
)


@dataclass(frozen=True, kw_only=True)
class BandwidthVerdict:
    """Verdict on what limits the bandwidth of a stage.

    kind                ``first_order``, ``resonance`` or ``undecided``
    stated_Hz           bandwidth of the data sheet; None: not declared
    fallen_Hz           frequency at which the gain has fallen by 3 dB; None: above the lines
    phase_interval_deg  95 % interval of the phase at ``fallen_Hz`` relative to that at rest,
                        declared chain and delay removed, with the interval of the delay
    peak_ratio          largest gain up to ``fallen_Hz`` over the gain at rest
    peak_Hz             frequency of the largest gain
    highest_Hz          highest usable line; 0 if there is none
    text                one or two sentences
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
        """Frequency of the peak, or of -3 dB if there is no peak; None if no resonance limits."""
        if self.kind != "resonance":
            return None
        return self.peak_Hz if (self.peak_ratio or 0.0) > CLEAR_PEAK else self.fallen_Hz


def decide_bandwidth(
    measured: FrequencyResponse,
    declaration: Declaration,
    *,
    delay_s: Sequence[float] = UNKNOWN_DELAY_s,
    stated_Hz: float | None = None,
) -> BandwidthVerdict:
    """Decide by phase and peak whether a first-order pole or a resonance limits the stage.

        w / (s + w):                       gain falls by 3 dB at w, phase -45 degrees, no peak
        w^2 / (s^2 + 2 zeta w s + w^2):    it does so at w or above, phase -90 degrees or more,
                                           after a peak of 1 / (2 zeta) where zeta is small

    declaration  hold and declared filters, which are removed from the response
    delay_s      interval of the pure delay; if unknown, the measured phase is only a bound
    stated_Hz    of the data sheet, for comparison only: the phase at 5 % below a sharp resonance
                 is still near zero

    Undecided if the lines end before the gain has fallen, if the phase interval contains both
    sides, or if phase and gain agree with neither.
    """
    usable = ~measured.is_rejected
    if usable.sum() <= IN_A_ROW:
        return unmeasured(stated_Hz, f"{int(usable.sum())} lines of the response are usable")
    f = measured.frequency_Hz[usable]
    response = measured.response[usable]
    spread = np.sqrt(measured.variance[usable]) / np.abs(response)
    is_low = f <= LOW_BAND * f[0]
    sign = np.sign(np.median(response[is_low].real)) or 1.0
    declared = declaration.response(f, measured.sampling_rate_Hz)
    relative = sign * response / (declared * np.exp(-2j * np.pi * f * delay_s[0]))
    relative /= np.median(np.abs(relative[is_low]))
    gain = np.abs(relative)
    runs = np.convolve(gain < MINUS_3_dB, np.ones(IN_A_ROW), "valid") == IN_A_ROW
    fallen = int(np.argmax(runs)) if runs.any() else None
    lowest_deg = float(np.degrees(np.abs(np.angle(relative[0]))))
    if lowest_deg >= STATIC_deg or (fallen is not None and f[fallen] <= LOW_BAND * f[0]):
        return unmeasured(
            stated_Hz, f"lines from {with_unit(f[0], 'Hz')} do not show the static gain"
        )
    peak = int(np.argmax(gain[: None if fallen is None else fallen + 1]))
    peak_Hz, ratio = float(f[peak]), float(gain[peak])
    is_peak = peak < len(f) - 1 and ratio * (1.0 - PEAK_SIGMAS * spread[peak]) > CLEAR_PEAK
    kind: Kind = "resonance" if is_peak else "undecided"
    interval, fallen_Hz = None, None
    if fallen is not None:
        pair = slice(fallen - 1, fallen + 1)
        fallen_Hz = float(np.interp(-MINUS_3_dB, -gain[pair], f[pair]))
        phase_deg = float(np.degrees(np.angle(np.interp(fallen_Hz, f, relative))))
        phase_deg -= 360.0 if phase_deg > 90.0 else 0.0
        half = NORMAL_95 * float(np.degrees(np.interp(fallen_Hz, f, spread) / np.sqrt(2.0)))
        delay_deg = 360.0 * fallen_Hz * (delay_s[1] - delay_s[0])
        interval = (phase_deg - half, max(min(phase_deg + delay_deg, 0.0), phase_deg) + half)
        kind = _kind(interval, bool(is_peak))
    stated, remedy = _declared_and_remedy(stated_Hz)
    text = (
        f"{MEANING[kind]}: the largest gain is {ratio:.3g} times the static gain, at "
        f"{with_unit(peak_Hz, 'Hz')}"
    )
    if fallen_Hz is not None and interval is not None:
        advice = f" {ADVICE}" if kind == "undecided" else ""
        text += (
            f"; without declared poles, the gain has fallen by 3 dB at "
            f"{with_unit(fallen_Hz, 'Hz')}, with a phase between {interval[0]:.0f}° and "
            f"{interval[1]:.0f}°.{advice}"
        )
    elif is_peak:
        text += "."
    else:
        text = (
            f"{UNDECIDED}: they end at {with_unit(f[-1], 'Hz')}, where the gain is still "
            f"{gain[-1]:.2f} times the static gain. {remedy}"
        )
    return BandwidthVerdict(
        kind=kind,
        stated_Hz=stated_Hz,
        fallen_Hz=fallen_Hz,
        phase_interval_deg=interval,
        peak_ratio=ratio,
        peak_Hz=peak_Hz,
        highest_Hz=float(f[-1]),
        text=stated + text,
    )


def unfitted(
    verdict: BandwidthVerdict, recording: str, reason: str, *, has_mode: bool = False
) -> BandwidthVerdict:
    """Return the verdict with the reason why no pole or mode was fitted.

    recording  name of the recording of the response
    reason     why no dynamics could be fitted
    has_mode   whether the model has a mode that a diagnosis added
    """
    declared, remedy = _declared_and_remedy(verdict.stated_Hz)
    if verdict.kind == "undecided":
        advice = verdict.text if verdict.highest_Hz > 0.0 else remedy
        text = f"{recording}: no resonance or pole could be fitted: {reason}. {advice}"
        return replace(verdict, text=text)
    feature, feature_Hz, size = "a first-order pole", verdict.fallen_Hz, ""
    if verdict.resonance_Hz is not None:
        feature, feature_Hz = "a resonance", verdict.resonance_Hz
    if feature_Hz == verdict.peak_Hz:
        size = f" ({verdict.peak_ratio:.3g} times the static gain)"
    model = "takes the mode from the diagnosis" if has_mode else "keeps a pure lag"
    location, chirp = f"near {with_unit(feature_Hz or 0.0, 'Hz')}", "through it"
    peak_Hz = verdict.peak_Hz or 0.0
    if verdict.fallen_Hz is None and peak_Hz > BAND_END * verdict.highest_Hz:
        location = f"at {with_unit(feature_Hz or 0.0, 'Hz')} or above, where its response ends"
        chirp = f"to at least {2.0 * verdict.highest_Hz:.0f} Hz"
    share_percent = 100.0 * CHIRP_AMPLITUDE / max(verdict.peak_ratio or 1.0, 1.0)
    text = (
        f"{recording} shows {feature} {location}{size}. Its frequency response could not be fitted"
        f": {reason}. The model {model}. Record a small chirp {chirp}, about "
        f"{share_percent:.2g} % of the range of the drive, sampled at three times its highest "
        "frequency or faster."
    )
    return replace(verdict, text=declared + text)


def unmeasured(stated_Hz: float | None, reason: str) -> BandwidthVerdict:
    """Return an undecided verdict with its reason."""
    declared, remedy = _declared_and_remedy(stated_Hz)
    return BandwidthVerdict(
        kind="undecided",
        stated_Hz=stated_Hz,
        text=f"{declared}{UNDECIDED}: {reason}. {remedy}",
    )


def _kind(interval_deg: tuple[float, float], is_peak: bool) -> Kind:
    low_deg, high_deg = interval_deg
    if low_deg > MIN_LAG_deg:
        return "undecided"
    if is_peak or high_deg < BETWEEN_deg:
        return "resonance"
    return "first_order" if low_deg > BETWEEN_deg else "undecided"


def _declared_and_remedy(stated_Hz: float | None) -> tuple[str, str]:
    """Return a sentence with the declared bandwidth ('' without), and the recording to make."""
    if stated_Hz is None:
        return "", (
            "Record a small chirp until the gain has fallen, sampled at three times its highest "
            "frequency or faster."
        )
    return f"lab.toml states a bandwidth of {stated_Hz:g} Hz. ", (
        "Record a small chirp through that frequency, sampled at three times that frequency or "
        "faster."
    )
