"""Fits of the hysteresis that try two orders instead of five."""

from functools import partial

import pytest

from piezoid.identification.hysteresis.estimate import estimate_axis


@pytest.fixture
def few_orders(monkeypatch: pytest.MonkeyPatch) -> None:
    estimate = partial(estimate_axis, orders=((2, 0), (8, 2)))
    monkeypatch.setattr("piezoid.identification.fit.estimate_axis", estimate)
