"""What a data sheet's "bandwidth" means: a first-order pole, or a resonance."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from piezoid.errors import ExcitationError
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.modal import NORMAL_95
from piezoid.identification.dynamics.periodic_estimate import interpolated

BETWEEN_DEG = -67.5  # half way from -45 (first order) to -90 (resonance)
CLEAR_PEAK = 1.2  # a first-order pole never rises; noise and distortion do a little


@dataclass(frozen=True, kw_only=True)
class BandwidthVerdict:
    """What the stated bandwidth is, and why.

    kind                ``first_order``, ``resonance`` or ``undecided``
    phase_deg           at the stated frequency, against rest, without the declared delay
    phase_interval_deg  its 95 % interval
    peak_ratio          largest gain up to twice the stated frequency over the gain at rest
    peak_frequency_Hz   where that is
    text                one sentence
    """

    kind: Literal["first_order", "resonance", "undecided"]
    phase_deg: float
    phase_interval_deg: tuple[float, float]
    peak_ratio: float
    peak_frequency_Hz: float
    text: str


def decide_bandwidth(
    measured: FrequencyResponse,
    bandwidth_Hz: float,
    *,
    output: int = 0,
    drive: int = 0,
    delay_s: float = 0.0,
) -> BandwidthVerdict:
    """Decide by phase and peak whether "bandwidth f" is a first-order pole or a resonance.

        w / (s + w):                        -45 degrees at f, gain 0.71, no peak
        w^2 / (s^2 + 2 zeta w s + w^2):     -90 degrees at f, gain 1 / (2 zeta)

    bandwidth_Hz  as stated, inside the measured band
    delay_s       of converters and declared filters at that frequency: taken out of the phase

    Undecided where phase and peak disagree or the phase's interval holds both sides; an unknown
    delay of 1 / (8 f) moves the one to the other, so declare what is known.
    """
    f = measured.frequency_Hz
    usable = ~measured.is_rejected[:, output]
    if not (usable.any() and f[usable][0] <= 0.5 * bandwidth_Hz <= bandwidth_Hz <= f[usable][-1]):
        raise ExcitationError(
            f"usable lines from {f[usable].min(initial=np.inf):g} to "
            f"{f[usable].max(initial=0.0):g} Hz",
            needed=f"lines from half of {bandwidth_Hz:g} Hz to beyond it",
            remedy="Excite that band, small enough to stay linear.",
        )
    f = f[usable]
    G = measured.response[usable, output, drive] * np.exp(2j * np.pi * f * delay_s)
    relative = np.sqrt(measured.variance[usable, output, drive]) / np.abs(G)
    rest = np.abs(G[0])
    sign = np.sign(G[0].real) or 1.0
    near = interpolated(sign * G[:, None, None], f, np.array([bandwidth_Hz]))[0, 0, 0]
    phase_deg = float(np.degrees(np.angle(near)))
    spread = float(np.interp(bandwidth_Hz, f, relative)) / np.sqrt(2)
    half = NORMAL_95 * float(np.degrees(spread))
    search = f <= 2 * bandwidth_Hz
    peak = int(np.argmax(np.abs(G[search])))
    ratio = float(np.abs(G[peak]) / rest)
    has_peak = ratio * (1 - NORMAL_95 * float(relative[peak])) > CLEAR_PEAK
    kind = _kind(phase_deg, half, has_peak)
    return BandwidthVerdict(
        kind=kind,
        phase_deg=phase_deg,
        phase_interval_deg=(phase_deg - half, phase_deg + half),
        peak_ratio=ratio,
        peak_frequency_Hz=float(f[peak]),
        text=f"At {bandwidth_Hz:g} Hz the phase is {phase_deg:.0f} +- {half:.0f} degrees and the "
        f"largest gain is {ratio:.2f} times that at rest, at {f[peak]:.4g} Hz: {_SAID[kind]}.",
    )


_SAID = {
    "first_order": "the bandwidth is a first-order pole",
    "resonance": "the bandwidth is a resonance",
    "undecided": "phase and peak do not decide; declare the delay, or measure more lines",
}


def _kind(
    phase_deg: float, half: float, has_peak: bool
) -> Literal["first_order", "resonance", "undecided"]:
    if has_peak:
        return "resonance" if phase_deg - half < BETWEEN_DEG or phase_deg > 90 else "undecided"
    if phase_deg - half > BETWEEN_DEG and phase_deg + half <= 0:
        return "first_order"
    return "resonance" if -135 < phase_deg + half < BETWEEN_DEG else "undecided"
