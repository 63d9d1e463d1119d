"""Limits come from a file, by the names under which they are judged."""

from dataclasses import fields

import pytest

from piezoid.errors import LabFileError
from piezoid.verification.criteria import Limits, limits_from_toml


def test_a_limit_that_is_written_replaces_the_default_and_no_other() -> None:
    found = limits_from_toml("aligned_percent = 0.25\njudged_Hz = 20\n")
    assert (found.aligned_percent, found.judged_Hz) == (0.25, 20.0)
    assert found.settling_s == Limits().settling_s


def test_every_limit_can_be_written() -> None:
    text = "\n".join(f"{field.name} = 0.125" for field in fields(Limits))
    assert limits_from_toml(text) == Limits(**{field.name: 0.125 for field in fields(Limits)})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("aligned = 1", "unknown limit 'aligned'"),
        ("settling_s = 0", "settling_s is 0"),
        ("settling_s = nan", "settling_s is nan"),
        ("settling_s = true", "settling_s is True"),
        ("settling_s = 'short'", "settling_s is 'short'"),
        ("settling_s = ", "not TOML"),
    ],
)
def test_a_limit_nobody_can_judge_by_is_refused_where_it_stands(text: str, said: str) -> None:
    with pytest.raises(LabFileError, match=rf"mine\.toml: {said}"):
        limits_from_toml(text, "mine.toml")
