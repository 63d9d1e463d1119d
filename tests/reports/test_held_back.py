"""A loop that is slow because nobody has seen a mode says so, where its bandwidth stands."""

import re
from dataclasses import replace

import piezoid
from piezoid.identification.dynamics.bandwidth import unseen
from piezoid.identification.model import AxisModel
from tests.verification.known_fit import fitted
from tests.verification.rig import RATE_Hz

FACT = r"<dt>Bandwidth</dt><dd>([\d.]+)\sHz, of at most ([\d.]+)\sHz while no mode is known</dd>"


def _page(axis: AxisModel) -> str:
    model = replace(fitted(), axes={"x": axis})
    return piezoid.report(model, design=piezoid.design(model, sampling_rate_Hz=RATE_Hz))


def test_no_mode_and_no_data_sheet_is_why_the_loop_is_slow() -> None:
    page = _page(replace(fitted()["x"], bandwidth=unseen(None, "nothing was recorded")))
    reached_Hz, most_Hz = map(float, re.search(FACT, page).groups())  # type: ignore[union-attr]
    assert reached_Hz <= most_Hz
    assert most_Hz < 4.0  # 200 Hz over a peak of 60
    said = re.search(r"No bandwidth above ([\d.]+)\sHz was tried: ([^<]*)", page)
    assert said is not None
    assert float(said[1]) == most_Hz
    assert "bandwidth_Hz under [actuator] in lab.toml" in said[2]


def test_a_data_sheet_whose_mode_is_beyond_the_converter_holds_nothing_back() -> None:
    page = _page(fitted()["x"])
    assert "of at most" not in page
    assert "No bandwidth above" not in page
