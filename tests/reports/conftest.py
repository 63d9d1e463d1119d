"""A page that many tests share."""

import pytest

from tests.reports.known_page import page_of
from tests.reports.known_stage import axis_model, recording


@pytest.fixture(scope="session")
def page() -> str:
    """A good stage of two axes, the second with two recordings."""
    recordings = (recording(), recording("up.csv", "y"), recording("down.csv", "y", noise_m=2e-8))
    axes = (axis_model("x"), axis_model("y", ("up.csv", "down.csv")))
    return page_of(*axes, recordings=recordings)
