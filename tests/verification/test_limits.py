"""Limits come from a file, by the names under which they are judged."""

import pytest

from piezoid.errors import LabFileError
from piezoid.verification.criteria import Limits, limits_from_toml


def test_a_limit_that_is_written_replaces_the_default_and_no_other() -> None:
    found = limits_from_toml("aligned_percent = 0.25\njudged_Hz = 20\n")
    assert (found.aligned_percent, found.judged_Hz) == (0.25, 20.0)
    assert found.settling_s == Limits().settling_s


def test_every_limit_can_be_written() -> None:
    names = Limits.__struct_fields__
    text = "\n".join(f"{name} = 0.125" for name in names)
    assert limits_from_toml(text) == Limits(**dict.fromkeys(names, 0.125))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("aligned = 1", "Object contains unknown field `aligned`"),
        ("settling_s = nan", "Expected `float` > 0.*settling_s"),
        ("settling_s = inf", "Expected `float` <=.*settling_s"),
        ("settling_s = 0", "Expected `float` > 0.*settling_s"),
        ("settling_s = true", "Expected `float`, got `bool`.*settling_s"),
        ("settling_s = 'short'", "Expected `float`, got `str`.*settling_s"),
        ("settling_s = ", "not TOML"),
    ],
)
def test_a_limit_nobody_can_judge_by_is_refused_where_it_stands(text: str, said: str) -> None:
    with pytest.raises(LabFileError, match=rf"mine\.toml: {said}"):
        limits_from_toml(text, "mine.toml")
