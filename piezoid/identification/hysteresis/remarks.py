"""A result admits its weakness: what the reader of a fit must know beside its numbers."""

from collections.abc import Sequence

from piezoid.formatting import told
from piezoid.identification.hysteresis.forgetting import Transient
from piezoid.identification.hysteresis.jackknife import Jackknife
from piezoid.identification.hysteresis.order import Choice
from piezoid.identification.hysteresis.search import Fitted
from piezoid.identification.piece_start import PieceStart, wandering_zeros
from piezoid.identification.quality import IN_SAMPLE, SECOND_HALF
from piezoid.operators.play import forgetting_sample

LOOSE_KKT = 1e-6


def remarks_on(
    fitted: Fitted,
    found: Jackknife,
    transients: Sequence[Transient],
    starts: Sequence[PieceStart],
    choice: Choice,
    stroke_m: float,
) -> tuple[str, ...]:
    """Return one sentence for every weakness of a fit."""
    return (
        *_about_data(fitted, transients, choice),
        *remarks_on_numbers(fitted, found, starts, stroke_m),
    )


def remarks_on_numbers(
    fitted: Fitted, found: Jackknife, starts: Sequence[PieceStart], stroke_m: float
) -> tuple[str, ...]:
    """Return one sentence for every weakness that the fitted numbers alone show."""
    return (
        *_about_weights(fitted),
        *_about_lag(fitted),
        *_about_zero(starts, fitted.minimum.rms * stroke_m, stroke_m),
        *_about_search(fitted, found),
    )


def _about_data(fitted: Fitted, transients: Sequence[Transient], choice: Choice) -> list[str]:
    said = [
        f"{fitted.task.pieces[t.piece].name}: the first {t.rows} samples were left out; no "
        f"initial memory explains them ({t.misfit:.1f} times the later error)."
        for t in transients
    ]
    if choice.kind == SECOND_HALF:
        said.append(
            "The shape was chosen by its error on the second half of the only recording; another "
            "excitation would test the model harder."
        )
    if choice.kind == IN_SAMPLE:
        said.append(
            "The model cannot be tested on one loop: a part left out would be a branch that the "
            "rest never saw. The error told is that of the fit itself."
        )
    for piece in fitted.task.pieces:
        drive = piece.drive[piece.first : piece.last]
        never = int((forgetting_sample(drive, fitted.operator.threshold) >= len(drive)).sum())
        if never:
            said.append(
                f"{piece.name}: {never} of {fitted.shape.plays} play thresholds are wider than "
                "this recording's drive moves; it says nothing of their weights."
            )
    return said


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
            "The fitted lag lies on 0: the displacement may lead the drive. Are the two channels "
            "sampled at the same instant?"
        ]
    if lag_s >= 0.999 * fitted.task.longest_lag_s:
        return [f"The fitted lag lies on its upper bound, {told(lag_s, 's')}."]
    return []


def _about_zero(starts: Sequence[PieceStart], rms_m: float, stroke_m: float) -> list[str]:
    return [
        f"{start.recording}: the zero moves by {told(by_m, 'm')} "
        f"({50.0 * by_m / stroke_m:.2g} % of the range, {by_m / rms_m:.2g} times what the fit "
        "leaves) during the recording, by drift or creep, which the diagnosis tells apart where "
        "it can; the fit follows it, the held-out error does not."
        for start, by_m in wandering_zeros(starts, rms_m, 2.0 * stroke_m)
    ]


def _about_search(fitted: Fitted, found: Jackknife) -> list[str]:
    said = []
    if not fitted.minimum.converged:
        said.append("The search stopped at its limit of iterations; a better fit may exist.")
    if fitted.kkt_gap > LOOSE_KKT:
        said.append(f"The convex start is optimal only to {fitted.kkt_gap:.1e}.")
    if found.blocks < 10:
        said.append(f"Intervals rest on {found.blocks} blocks of cycles only.")
    return said
