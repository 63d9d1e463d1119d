"""A designed loop for scipy.signal and python-control, polynomial by polynomial."""

from typing import TYPE_CHECKING, Any

import numpy as np

from piezoid.design.design import LoopDesign
from piezoid.design.sensitivity import closed_loop_polynomial
from piezoid.errors import DesignError
from piezoid.identification.interchange import control
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import product

if TYPE_CHECKING:
    from scipy.signal import TransferFunction

PARTS = ("controller", "prefilter", "plant", "sensitivity", "closed_loop")


def fraction_of(loop: LoopDesign, part: str) -> tuple[Array, Array]:
    """Return numerator and denominator of a part of the nominal loop, in z, highest power first.

        S u = T r' - R y,   A y = B u,   P = A S + B R          [Landau & Zito 2006]

    Raises ``DesignError`` for a part that is none of ``PARTS``.
    """
    R, S, T, B, A = loop.R, loop.S, loop.T, loop.members[0].B, loop.members[0].A
    if part not in PARTS:
        raise DesignError(
            f"part {part!r} of a loop",
            needed=f"one of {', '.join(PARTS)}",
            remedy="Name one of those.",
        )
    P = closed_loop_polynomial(loop.members[0], R, S)
    return _in_z(
        *{
            "controller": (R, S),
            "prefilter": (T, R),
            "plant": (B, A),
            "sensitivity": (product(A, S), P),
            "closed_loop": (product(T, B), P),
        }[part]
    )


def to_scipy(loop: LoopDesign, part: str) -> "TransferFunction":
    """Return a part as ``scipy.signal.TransferFunction``, discrete at the controller's rate."""
    from scipy.signal import TransferFunction

    numerator, denominator = fraction_of(loop, part)
    lead = int(np.flatnonzero(numerator)[0])  # scipy warns of leading zeros
    interval_s = 1.0 / loop.members[0].sampling_rate_Hz
    return TransferFunction(numerator[lead:], denominator, dt=interval_s)


def to_control(loop: LoopDesign, part: str) -> Any:
    """Return a part as ``control.TransferFunction``."""
    numerator, denominator = fraction_of(loop, part)
    return control().tf(numerator, denominator, 1.0 / loop.members[0].sampling_rate_Hz)


def _in_z(numerator: Array, denominator: Array) -> tuple[Array, Array]:
    """Bring coefficients in q^-1 to powers of z: both padded behind to one length."""
    length = max(len(numerator), len(denominator))
    made = [np.pad(p, (0, length - len(p))) for p in (numerator, denominator)]
    return made[0], made[1]
