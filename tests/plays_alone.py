"""Fits without the trials that take most of their time, for tests of what follows a fit."""

from functools import partial

import pytest

from piezoid.identification.hysteresis.estimate import estimate_axis


def fit_plays_alone(patch: pytest.MonkeyPatch) -> None:
    """Let a fit end with its sum of plays.

    Loop shape decides no verdict, and no name but its own and `something_else`.
    """
    patch.setattr("piezoid.identification.fit.with_loop_shape", lambda axis, _: axis)


def fit_one_order(patch: pytest.MonkeyPatch) -> None:
    """Let a fit try one number of plays, no envelope, and no lag of second order."""
    estimate = partial(estimate_axis, orders=((8, 2),))
    patch.setattr("piezoid.identification.fit.estimate_axis", estimate)
    patch.setattr("piezoid.identification.hysteresis.order_selection.BENDS", ())
    patch.setattr("piezoid.identification.hysteresis.estimate.limits_of_lag", lambda *_: ((), ""))
