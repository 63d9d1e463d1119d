"""Band-stop filters for sensitivity shaping: a numerator for H_S or H_R, a denominator for P_F."""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array


@dataclass(frozen=True, kw_only=True)
class BandStop:
    """One digital band-stop around a frequency.

    part               ``S`` lowers |Syp| there, ``R`` lowers |Sup|
    frequency_Hz       of the deepest attenuation
    numerator_damping  > 0
    denominator_damping  larger; the ratio is the attenuation, before the equation is re-solved
    """

    part: str
    frequency_Hz: float
    numerator_damping: float
    denominator_damping: float

    def __post_init__(self) -> None:
        if self.part not in ("S", "R"):
            raise ValueError(f"part is {self.part!r}, expected 'S' or 'R'")
        if not 0 < self.numerator_damping < self.denominator_damping:
            raise ValueError(
                f"dampings are {self.numerator_damping} over {self.denominator_damping}, expected "
                "0 < numerator < denominator"
            )


def band_stop_polynomials(filter_: BandStop, sampling_rate_Hz: float) -> tuple[Array, Array]:
    """Return the monic numerator and denominator in q^-1.

        (s^2 + 2 z_n w0 s + w0^2) / (s^2 + 2 z_d w0 s + w0^2),  s = c (1 - q^-1)/(1 + q^-1)

    with c = 2 fs and w0 = c tan(pi f0 / fs): the bilinear map, prewarped so that the attenuation
    is exactly at f0.                                                     [Landau & Zito 2006]
    """
    c = 2.0 * sampling_rate_Hz
    w0 = c * np.tan(np.pi * filter_.frequency_Hz / sampling_rate_Hz)

    def mapped(damping: float) -> Array:
        middle, side = 2.0 * w0**2 - 2.0 * c**2, 2.0 * damping * w0 * c
        raw = np.array([c**2 + side + w0**2, middle, c**2 - side + w0**2])
        return np.asarray(raw / raw[0])

    return mapped(filter_.numerator_damping), mapped(filter_.denominator_damping)
