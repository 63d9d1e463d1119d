"""Fits and designs without their slowest candidates, for tests of other steps."""

import sys
from functools import partial

import pytest

from piezoid.design.hysteresis_bounds import draw_replicates
from piezoid.design.lateral_task import lateral_task
from piezoid.design.loop_search import search
from piezoid.design.tuning import tune_observer
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.loop_shape_blocks import Errors


def fit_plays_alone(patch: pytest.MonkeyPatch) -> None:
    """Fit a sum of plays without loop shape, and diagnose as if loop shape explained everything.

    A cause of weak evidence, or that the model needs little, is then named only if the final
    model, a sum of plays, is clearly worse without it.
    """
    patch.setattr("piezoid.identification.fit.with_loop_shape", lambda axis, _: axis)
    no_error = Errors(explained=0.0, held_out=0.0)
    patch.setattr("piezoid.diagnosis.diagnose.errors_with_loop_shape_m", lambda *_: no_error)


def fit_one_order(patch: pytest.MonkeyPatch) -> None:
    """Fit a single number of plays and no envelope."""
    estimate = partial(estimate_axis, orders=((8, 2),))
    patch.setattr("piezoid.identification.fit.estimate_axis", estimate)
    patch.setattr("piezoid.identification.hysteresis.order_selection.BENDS", ())


def fit_few_rows(patch: pytest.MonkeyPatch, rows: int = 3000) -> None:
    """Fit and diagnose about this number of rows of all recordings instead of 12,000."""
    patch.setattr("piezoid.diagnosis.segments.ROWS", rows)
    patch.setattr("piezoid.identification.extended_fit.MAX_ROWS", rows)
    patch.setattr("piezoid.identification.hysteresis.estimate.CHOOSING_ROWS", rows // 2)
    patch.setattr("piezoid.identification.hysteresis.estimate.FINAL_ROWS", 2 * rows)
    patch.setattr("piezoid.identification.loop_shape_columns.MAX_ROWS", rows)


def design_briefly(patch: pytest.MonkeyPatch) -> None:
    """Design with 30 draws of the fit instead of 200, and 60 loops from each start, not 250."""
    few = partial(draw_replicates, draws=30)
    patch.setattr(sys.modules[lateral_task.__module__], "draw_replicates", few)
    patch.setattr(sys.modules[tune_observer.__module__], "search", partial(search, evaluations=60))
