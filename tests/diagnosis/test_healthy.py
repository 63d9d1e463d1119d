"""What is left is ranked among what healthy stages leave."""

import json
from importlib.resources import files

import numpy as np
import pytest
from scipy.stats import kstest

from piezoid.diagnosis.healthy import chance_of, score_of
from piezoid_datasets.virtual_lab.truths import ZOO


def table() -> dict[str, list[float]]:
    text = files("piezoid.diagnosis").joinpath("healthy_scores.json").read_text("utf-8")
    return json.loads(text)["scores"]


@pytest.mark.parametrize("draw", ["exponential", "lognormal", "standard_cauchy"])
def test_the_chance_of_one_more_healthy_stage_is_uniform_whatever_scores_are(draw) -> None:
    rng = np.random.default_rng(7)
    chances = []
    for _ in range(400):
        scores = np.abs(getattr(rng, draw)(size=60))
        chances.append(chance_of(scores[0], scores[1:]))
    assert kstest(chances, "uniform").pvalue > 0.01


def test_the_more_is_left_the_smaller_the_chance_and_it_is_never_none() -> None:
    chances = [chance_of(score) for score in (0.0, 0.01, 0.1, 1.0, 1e6)]
    assert chances == sorted(chances, reverse=True)
    assert chances[0] == 1.0
    assert 0.0 < chances[-1] <= 0.05


def test_a_remainder_of_noise_scores_next_to_nothing_and_a_strong_curve_much() -> None:
    assert score_of(0.001, 1.0, 1.0) == pytest.approx(0.001)
    assert score_of(0.9, 5.0, 1.0) == pytest.approx(22.5)
    assert score_of(-0.1, 5.0, 1.0) == 0.0


def test_the_table_holds_healthy_stages_of_every_law() -> None:
    scores = table()
    assert set(scores) == {truth.name for truth in ZOO}
    assert all(len(of_law) >= 3 for of_law in scores.values())
