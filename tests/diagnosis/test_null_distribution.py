"""What is left, and every cause, is ranked among what healthy stages show."""

import json
from importlib.resources import files

import numpy as np
import pytest
from scipy.stats import kstest

from piezoid.diagnosis.null_distribution import (
    evidence_p_value,
    rank_p_value,
    smallest_structure_p_value,
    structure_p_value,
)


def table(kind: str) -> dict[str, list[float]]:
    text = files("piezoid.diagnosis").joinpath("healthy_scores.json").read_text("utf-8")
    return json.loads(text)[kind]


@pytest.mark.parametrize("draw", ["exponential", "lognormal", "standard_cauchy"])
def test_the_chance_of_one_more_healthy_stage_is_uniform_whatever_scores_are(draw):
    rng = np.random.default_rng(7)
    chances = []
    for _ in range(400):
        scores = np.abs(getattr(rng, draw)(size=60))
        chances.append(rank_p_value(scores[0], scores[1:]))
    assert kstest(chances, "uniform").pvalue > 0.01


def test_the_more_is_left_the_smaller_the_chance_and_it_is_never_none():
    chances = [structure_p_value(gain, 1.0, 1.0) for gain in (0.0, 0.01, 0.1, 0.5, 1.0)]
    assert chances == sorted(chances, reverse=True)
    assert chances[0] == 1.0
    assert 0.0 < chances[-1] <= 0.05


def test_healthy_stages_of_a_law_are_not_accused_by_the_other_laws_table():
    """Of n stages at most 5 % and two standard deviations have a probability of 0.05 or less."""
    strengths = table("strengths")
    chances = []
    for law, own in strengths.items():
        others = [one for other, of_it in strengths.items() if other != law for one in of_it]
        chances += [rank_p_value(one, others) for one in own]
    count = len(chances)
    assert (
        sum(chance <= 0.05 for chance in chances) <= 0.05 * count + 2.0 * (0.0475 * count) ** 0.5
    )


def test_a_cause_is_as_sure_as_the_table_is_large_and_no_surer():
    healthy = sum(len(of_law) for of_law in table("strengths").values())
    assert evidence_p_value(1e9) == pytest.approx(1.0 / (1.0 + healthy))
    assert evidence_p_value(0.0) == 1.0
    assert smallest_structure_p_value() <= 0.02
