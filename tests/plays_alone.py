"""Fits without the trials that take most of their time, for tests of what follows a fit."""

from functools import partial

import numpy as np
import pytest

from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.loop_shape_blocks import Errors


def fit_plays_alone(patch: pytest.MonkeyPatch) -> None:
    """Let a fit end with its sum of plays, and a diagnosis compare no name with loop shape.

    Loop shape decides no verdict; over which names it decides is tested where it is fitted.
    """
    patch.setattr("piezoid.identification.fit.with_loop_shape", lambda axis, _: axis)
    no_shape = Errors(explained=np.inf, held_out=np.inf)
    patch.setattr("piezoid.diagnosis.diagnose.errors_with_loop_shape_m", lambda *_: no_shape)


def fit_one_order(patch: pytest.MonkeyPatch) -> None:
    """Let a fit try one number of plays, no envelope, and no lag of second order."""
    estimate = partial(estimate_axis, orders=((8, 2),))
    patch.setattr("piezoid.identification.fit.estimate_axis", estimate)
    patch.setattr("piezoid.identification.hysteresis.order_selection.BENDS", ())
    patch.setattr("piezoid.identification.hysteresis.estimate.limits_of_lag", lambda *_: ((), ""))
