"""The response of a table, measured: what two periods with different tables say of it.

    G_h = (Y_h - Y'_h) / (f_h - f'_h)

where no linear filter contracts on all plants that recordings allow, for example beside a mode
whose frequency is known worse than the mode is wide. The plant that is there tells it; a small
step, which no plant of the family answers with much, is enough to ask. [Kim & Zou 2013] divide
output by input instead of their changes, which a loop around the table does not allow.
"""

import numpy as np

from piezoid.learning.contraction import LearningFilter
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import Response

SHARE_OF_MEASURED = 0.8
_KNOWN = (
    0.3  # relative uncertainty of a response, with the sector's width: 0.8 (1 + 0.3) contracts
)


def measured_response(
    changed_V: Array,
    moved_m: Array,
    noise_rms_m: float,
    before: Response | None,
    found: LearningFilter,
) -> Response:
    """Return the response of every harmonic that was asked clearly enough, 0 elsewhere.

    changed_V, moved_m  (points,)  between two tables and their mean periods; empty: there is one
    noise_rms_m         of one reading of a mean period
    before              (harmonics,)  what earlier periods told; kept where these tell less
    """
    known = np.zeros(len(found.learns), dtype=complex) if before is None else before.copy()
    if not len(changed_V) or not len(moved_m):
        return known
    points = len(changed_V)
    df, dy = np.fft.rfft(changed_V), np.fft.rfft(moved_m) / found.sensed
    # noise of both means, and what the hysteresis turns of other harmonics into this one
    noise = np.sqrt(2.0 * points) * noise_rms_m
    turned = found.sector * np.sqrt(np.mean(np.abs(dy) ** 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.hypot(noise, turned) / np.abs(dy)
        response = dy / df
    clear = np.isfinite(response) & (spread < _KNOWN) & (response != 0.0)
    return np.where(clear, response, known)
