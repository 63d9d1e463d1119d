"""Fits without their slowest candidates, for tests of the steps after a fit."""

from functools import partial

import numpy as np
import pytest

from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.loop_shape_blocks import Errors


def fit_plays_alone(patch: pytest.MonkeyPatch) -> None:
    """Fit a sum of plays without loop shape, and diagnose without comparing loop shape.

    Loop shape decides no verdict; its effect on findings has tests in the identification.
    """
    patch.setattr("piezoid.identification.fit.with_loop_shape", lambda axis, _: axis)
    no_shape = Errors(explained=np.inf, held_out=np.inf)
    patch.setattr("piezoid.diagnosis.diagnose.errors_with_loop_shape_m", lambda *_: no_shape)


def fit_one_order(patch: pytest.MonkeyPatch) -> None:
    """Fit a single number of plays and no envelope."""
    estimate = partial(estimate_axis, orders=((8, 2),))
    patch.setattr("piezoid.identification.fit.estimate_axis", estimate)
    patch.setattr("piezoid.identification.hysteresis.order_selection.BENDS", ())
