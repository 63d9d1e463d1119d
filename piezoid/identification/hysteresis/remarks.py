"""Remarks of a fit: samples left out, thresholds without excitation, weights and lags on bounds.

What the numbers of the model show by themselves is said by ``fit_statements``.
"""

from collections.abc import Sequence

from piezoid.formatting import with_unit
from piezoid.identification.hysteresis.forgetting import Transient
from piezoid.identification.hysteresis.order import Choice
from piezoid.identification.hysteresis.search import Fitted
from piezoid.identification.quality import IN_SAMPLE, SECOND_HALF
from piezoid.operators.play import forgetting_sample

LOOSE_KKT = 1e-6


def remarks_on(fitted: Fitted, transients: Sequence[Transient], choice: Choice) -> tuple[str, ...]:
    """Return the remarks of a fit, a sentence each."""
    return (*_about_data(fitted, transients, choice), *remarks_on_numbers(fitted))


def remarks_on_numbers(fitted: Fitted) -> tuple[str, ...]:
    """Return the remarks that need only the fitted parameters."""
    return (*_about_weights(fitted), *_about_lag(fitted), *_about_start(fitted))


def _about_data(fitted: Fitted, transients: Sequence[Transient], choice: Choice) -> list[str]:
    remarks = [
        f"{fitted.task.pieces[t.piece].name}: the first {t.rows} samples were left out; no "
        f"initial memory explains them ({t.misfit:.1f} times the later error)."
        for t in transients
    ]
    if choice.kind == SECOND_HALF:
        remarks.append(
            "The order was chosen by the error on the second half of the only recording."
        )
    if choice.kind == IN_SAMPLE:
        remarks.append(
            "The error is in sample: a single loop leaves nothing to test the model on."
        )
    for piece in fitted.task.pieces:
        drive = piece.drive[piece.first : piece.last]
        never = int((forgetting_sample(drive, fitted.operator.threshold) >= len(drive)).sum())
        if never:
            remarks.append(
                f"{piece.name} does not excite the largest {never} of {fitted.shape.plays} play "
                "thresholds."
            )
    return remarks


def _about_weights(fitted: Fitted) -> list[str]:
    on_zero = int((fitted.operator.weight[1:] <= 0.0).sum())
    if not on_zero:
        return []
    return [
        f"{on_zero} of {fitted.shape.plays} play weights lie on 0; only upper limits are given."
    ]


def _about_lag(fitted: Fitted) -> list[str]:
    lag_s = fitted.operator.lag_s
    if fitted.shape.lag == "none":
        return []
    if lag_s <= 0.0:
        return [
            "The fitted lag lies on 0: the displacement may lead the drive. Check that both "
            "channels are sampled at the same instant."
        ]
    if lag_s >= 0.999 * fitted.task.longest_lag_s:
        return [f"The fitted lag lies on its upper bound, {with_unit(lag_s, 's')}."]
    return []


def _about_start(fitted: Fitted) -> list[str]:
    if fitted.kkt_gap <= LOOSE_KKT:
        return []
    return [f"The convex start is optimal only to {fitted.kkt_gap:.1e}."]
