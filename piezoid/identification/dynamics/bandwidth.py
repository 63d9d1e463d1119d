"""What a data sheet's "bandwidth" means: a first-order pole, or a resonance."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.dynamics.fit_dynamics import Declaration, declared_response
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.periodic_estimate import interpolated
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import NORMAL_95

Kind = Literal["first_order", "resonance", "undecided"]

FALLEN = 1.0 / np.sqrt(2.0)
IN_A_ROW = 3  # lines below that: one alone may be noise
BETWEEN_DEG = -67.5  # half way from -45 (first order) to -90 (resonance)
TURNED_DEG = -22.5  # at rest a stage has turned by less
# Where a slew limit leaves 0.707 of a sine its triangle lags by acos(0.707 pi^2 / 8) = 29 degrees,
# a pole by 45: a gain that falls with less than half way between them is neither's.
PHASELESS_DEG = -37.0
CLEAR_PEAK = 1.2  # a first-order pole never rises; noise and distortion do a little
SURE = 4.0  # standard deviations: the peak is the largest of many lines
REST = 2.0  # the gain at rest is the median up to so many times the lowest line
UNKNOWN_DELAY_s = (0.0, np.inf)


@dataclass(frozen=True, kw_only=True)
class BandwidthVerdict:
    """What limits the stage first, and why; None where nothing was seen.

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
    fallen_Hz: float | None
    phase_interval_deg: tuple[float, float] | None
    peak_ratio: float | None
    peak_Hz: float | None
    highest_Hz: float
    text: str


@dataclass(frozen=True, kw_only=True, eq=False)
class _Gains:
    """Usable lines of one path behind what is declared: relative to rest, and how surely."""

    frequency_Hz: Array
    relative: NDArray[np.complex128]
    spread: Array
    fallen: int | None
    peak: int

    @property
    def from_rest(self) -> bool:
        """Whether the lowest lines lie below what limits the stage, at the gain at rest."""
        turned_deg = np.degrees(np.abs(np.angle(self.relative[0])))
        falls_above = self.fallen is None or self.frequency_Hz[self.fallen] > REST * self.lowest_Hz
        return bool(turned_deg < -TURNED_DEG and falls_above)

    @property
    def lowest_Hz(self) -> float:
        """The lowest usable line."""
        return float(self.frequency_Hz[0])

    @property
    def is_peak(self) -> bool:
        """Whether the gain rises for certain, and falls again."""
        ratio = float(np.abs(self.relative[self.peak]))
        inside = self.peak < len(self.relative) - 1
        return inside and ratio * (1.0 - SURE * float(self.spread[self.peak])) > CLEAR_PEAK


def decide_bandwidth(
    measured: FrequencyResponse,
    declaration: Declaration,
    *,
    delay_s: tuple[float, float] = UNKNOWN_DELAY_s,
    stated_Hz: float | None = None,
    output: int = 0,
    drive: int = 0,
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
    usable = ~measured.is_rejected[:, output]
    if usable.sum() <= IN_A_ROW:
        return unseen(stated_Hz, f"{int(usable.sum())} lines of the response are usable")
    found = _gains(measured, declaration, usable, (output, drive), delay_s[0])
    if not found.from_rest:
        return unseen(
            stated_Hz, f"lines from {found.lowest_Hz:.4g} Hz do not show the gain at rest"
        )
    if found.fallen is None:
        return _without_fall(found, stated_Hz)
    return _at_the_fall(found, found.fallen, delay_s, stated_Hz)


def unseen(stated_Hz: float | None, why: str) -> BandwidthVerdict:
    """Return the verdict where the lines, if there are any, say nothing."""
    return BandwidthVerdict(
        kind="undecided",
        stated_Hz=stated_Hz,
        fallen_Hz=None,
        phase_interval_deg=None,
        peak_ratio=None,
        peak_Hz=None,
        highest_Hz=0.0,
        text=f"{_stated(stated_Hz)}Pole or resonance is not decidable on this data: {why}. "
        f"{_remedy(stated_Hz)}",
    )


def _gains(
    measured: FrequencyResponse,
    declaration: Declaration,
    usable: NDArray[np.bool_],
    path: tuple[int, int],
    delay_s: float,
) -> _Gains:
    f = measured.frequency_Hz[usable]
    known = declared_response(measured, declaration)[usable] * np.exp(-2j * np.pi * f * delay_s)
    raw = measured.response[usable][:, *path]
    spread = np.sqrt(measured.variance[usable][:, *path]) / np.abs(raw)
    rest = f <= REST * f[0]
    sign = np.sign(np.median(raw[rest].real)) or 1.0
    relative = sign * raw / known / np.median(np.abs(raw[rest] / known[rest]))
    low = np.abs(relative) < FALLEN
    runs = np.flatnonzero(np.convolve(low, np.ones(IN_A_ROW), "valid") == IN_A_ROW)
    fallen = int(runs[0]) if len(runs) else None
    peak = int(np.argmax(np.abs(relative[: None if fallen is None else fallen + 1])))
    return _Gains(frequency_Hz=f, relative=relative, spread=spread, fallen=fallen, peak=peak)


def _without_fall(found: _Gains, stated_Hz: float | None) -> BandwidthVerdict:
    """The lines end before the gain has fallen: only a peak can still decide."""
    f, gain = found.frequency_Hz, np.abs(found.relative)
    peak_Hz, ratio = float(f[found.peak]), float(gain[found.peak])
    kind: Kind = "resonance" if found.is_peak else "undecided"
    text = (
        f"the gain peaks at {peak_Hz:.4g} Hz with {ratio:.3g} times that at rest: {_SAID[kind]}."
        if found.is_peak
        else f"pole or resonance is not decidable on this data: usable lines end at {f[-1]:.4g} "
        f"Hz, where the gain is still {gain[-1]:.2f} times that at rest. {_remedy(stated_Hz)}"
    )
    return BandwidthVerdict(
        kind=kind,
        stated_Hz=stated_Hz,
        fallen_Hz=None,
        phase_interval_deg=None,
        peak_ratio=ratio,
        peak_Hz=peak_Hz,
        highest_Hz=float(f[-1]),
        text=_stated(stated_Hz) + (text[0].upper() + text[1:]),
    )


def _at_the_fall(
    found: _Gains, fallen: int, delay_s: tuple[float, float], stated_Hz: float | None
) -> BandwidthVerdict:
    f, gain = found.frequency_Hz, np.abs(found.relative)
    pair = slice(fallen - 1, fallen + 1)
    fallen_Hz = float(np.interp(-FALLEN, -gain[pair], f[pair]))
    at = interpolated(found.relative[:, None, None], f, np.array([fallen_Hz]))[0, 0, 0]
    phase_deg = float(np.degrees(np.angle(at)))
    phase_deg -= 360.0 if phase_deg > 90.0 else 0.0
    spread = float(np.interp(fallen_Hz, f, found.spread)) / np.sqrt(2.0)
    half = NORMAL_95 * float(np.degrees(spread))
    later = 360.0 * fallen_Hz * (delay_s[1] - delay_s[0])
    interval = (phase_deg - half, max(min(phase_deg + later, 0.0), phase_deg) + half)
    kind = _kind(interval, found.is_peak)
    ratio, peak_Hz = float(gain[found.peak]), float(f[found.peak])
    return BandwidthVerdict(
        kind=kind,
        stated_Hz=stated_Hz,
        fallen_Hz=fallen_Hz,
        phase_interval_deg=interval,
        peak_ratio=ratio,
        peak_Hz=peak_Hz,
        highest_Hz=float(f[-1]),
        text=f"{_stated(stated_Hz)}The gain has fallen by 3 dB at {fallen_Hz:.4g} Hz with a phase "
        f"between {interval[0]:.0f} and {interval[1]:.0f} degrees; the largest gain before is "
        f"{ratio:.3g} times that at rest, at {peak_Hz:.4g} Hz: {_SAID[kind]}.",
    )


def _kind(interval_deg: tuple[float, float], is_peak: bool) -> Kind:
    low_deg, high_deg = interval_deg
    if low_deg > PHASELESS_DEG:
        return "undecided"
    if is_peak or high_deg < BETWEEN_DEG:
        return "resonance"
    return "first_order" if low_deg > BETWEEN_DEG else "undecided"


_SAID = {
    "first_order": "a first-order pole limits the stage",
    "resonance": "a resonance limits the stage",
    "undecided": "pole or resonance is not decidable on this data; declare amplifier and sensor, "
    "and record a chirp or a multisine from a tenth of that frequency to three times it",
}


def _stated(stated_Hz: float | None) -> str:
    return "" if stated_Hz is None else f"A bandwidth of {stated_Hz:g} Hz is stated. "


def _remedy(stated_Hz: float | None) -> str:
    far = "until the gain has fallen" if stated_Hz is None else f"to {3.0 * stated_Hz:g} Hz"
    return f"Record a chirp or a multisine {far}."
