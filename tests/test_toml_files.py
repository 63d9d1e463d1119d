"""Strings that piezoid writes for lab.toml are read back as they were."""

import pytest

from piezoid.toml_files import read_toml, toml_string


@pytest.mark.parametrize(
    "text", ["x.csv", "Messung µm.csv", "🙂.csv", 'a "b" \\ c', "line\nbreak\ttab", "delete\x7f"]
)
def test_a_toml_string_is_read_back(text: str) -> None:
    assert read_toml(f"name = {toml_string(text)}") == {"name": text}
