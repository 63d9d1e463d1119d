"""Limits of the verification come from a file, by name."""

import pytest

from piezoid.errors import LabFileError
from piezoid.verification.criteria import Limits, limits_from_toml


def test_written_limits_replace_the_defaults():
    limits = limits_from_toml("aligned_percent = 0.25\njudged_Hz = 20\n")
    assert (limits.aligned_percent, limits.judged_Hz) == (0.25, 20.0)
    assert limits.settling_s == Limits().settling_s
    names = Limits.__struct_fields__
    text = "\n".join(f"{name} = 0.125" for name in names)
    assert limits_from_toml(text) == Limits(**dict.fromkeys(names, 0.125))


@pytest.mark.parametrize(
    ("text", "message"),
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
def test_an_invalid_limit_is_refused_by_name(text, message):
    with pytest.raises(LabFileError, match=rf"mine\.toml: {message}"):
        limits_from_toml(text, "mine.toml")
