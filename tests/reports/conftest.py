"""Pages made once and looked at by many tests."""

import pytest

from piezoid_reports.page import Page
from piezoid_reports.render import render
from tests.reports.known_stage import axis_model, recording, stage_model

REASON = "sweep.csv: the loop opens the wrong way by 3.1 % of the range"


@pytest.fixture(scope="session")
def page() -> str:
    """A good stage of two axes, the second with two recordings."""
    model = stage_model(axis_model("x"), axis_model("y", ("up.csv", "down.csv")))
    return render(
        Page(
            model=model,
            recordings=[
                recording(),
                recording("up.csv", "y"),
                recording("down.csv", "y", noise_m=2e-8),
            ],
        )
    )


@pytest.fixture(scope="session")
def page_of_wrong_class() -> str:
    """A stage whose only axis the model class does not fit."""
    return render(Page(model=stage_model(axis_model(reason=REASON)), recordings=[recording()]))
