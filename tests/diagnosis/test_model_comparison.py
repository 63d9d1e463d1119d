"""When two causes are too close to be told apart."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.blocked_regression import CrossValidated, paired_z
from piezoid.diagnosis.candidate import Candidate
from piezoid.diagnosis.effects import creep
from piezoid.diagnosis.model_comparison import SEPARABLE, is_confounded

from .leaving import candidate_of, view_leaving

BLOCKS = 40
WITHOUT = 2.0


def left(rms: float, *, sound: bool = True, sure: bool = True) -> Candidate:
    """Return a cause beside which so much is left, in all blocks alike or here and there."""
    uneven = np.zeros(BLOCKS) if sure else np.random.default_rng(2).normal(0.0, 1.0, BLOCKS)
    held = CrossValidated(
        gain=1.0 - rms / WITHOUT,
        z=9.0,
        coefficient=np.ones(1),
        spread=np.zeros(1),
        loss=rms**2 + uneven - uneven.mean(),
        rms=rms,
    )
    views = {"without": view_leaving(WITHOUT), "view": view_leaving(rms)}
    return candidate_of(creep.EFFECT, held, physical=sound, **views)


@pytest.mark.parametrize("rms", [1.0 + 1e-9, 1.005, 1.01])
def test_causes_that_leave_within_one_percent_are_close_however_sure_blocks_are(rms) -> None:
    cause, alternative = left(1.0), left(rms)
    assert paired_z(alternative.cv.loss, cause.cv.loss) > SEPARABLE
    assert is_confounded(alternative, cause)


def test_one_percent_of_what_is_left_is_much_where_hardly_anything_was_explained() -> None:
    cause, alternative = left(1.0), left(1.01)
    cause = replace(cause, without=view_leaving(1.05))  # of whose square a tenth was explained
    assert not is_confounded(alternative, cause)


def test_one_percent_of_what_was_explained_is_much_where_hardly_anything_is_left() -> None:
    cause, alternative = left(0.1), left(0.2)
    assert alternative.cv.rms**2 - cause.cv.rms**2 < 0.01 * (WITHOUT**2 - cause.cv.rms**2)
    assert not is_confounded(alternative, cause)


@pytest.mark.parametrize(("sure", "close"), [(True, False), (False, True)])
def test_a_rival_that_leaves_a_tenth_more_is_close_only_where_blocks_are_not_sure(
    sure, close
) -> None:
    assert is_confounded(left(1.1, sure=sure), left(1.0)) is close


def test_an_unsound_rival_is_close_where_it_leaves_less_and_only_there() -> None:
    assert is_confounded(left(0.9, sound=False), left(1.0))
    assert not is_confounded(left(1.0 + 1e-9, sound=False, sure=False), left(1.0))
