"""P-values are ranks of a statistic among healthy stages."""

import json
from importlib.resources import files
from itertools import chain

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
def test_the_rank_p_value_of_another_healthy_stage_is_uniform_for_any_scores(draw):
    rng = np.random.default_rng(7)
    p_values = []
    for _ in range(400):
        scores = np.abs(getattr(rng, draw)(size=60))
        p_values.append(rank_p_value(scores[0], scores[1:]))
    assert kstest(p_values, "uniform").pvalue > 0.01


def test_a_p_value_decreases_with_the_gain_and_stays_positive():
    p_values = [structure_p_value(gain, 1.0, 1.0) for gain in (0.0, 0.01, 0.1, 0.5, 1.0)]
    assert p_values == sorted(p_values, reverse=True)
    assert p_values[0] == 1.0
    assert 0.0 < p_values[-1] <= 0.05


def test_healthy_stages_are_not_accused_by_the_scores_of_other_laws():
    """At most 5 % plus two standard deviations of n stages have a p-value up to 0.05."""
    strengths = table("strengths")
    p_values = []
    for law, law_strengths in strengths.items():
        other_laws = {**strengths, law: []}
        other_strengths = list(chain.from_iterable(other_laws.values()))
        p_values += [rank_p_value(strength, other_strengths) for strength in law_strengths]
    count, accused = len(p_values), sum(p <= 0.05 for p in p_values)
    assert accused <= 0.05 * count + 2.0 * (0.0475 * count) ** 0.5


def test_the_size_of_the_table_limits_the_p_value():
    healthy = sum(len(strengths) for strengths in table("strengths").values())
    assert evidence_p_value(1e9) == pytest.approx(1.0 / (1.0 + healthy))
    assert evidence_p_value(0.0) == 1.0
    assert smallest_structure_p_value() <= 0.02
