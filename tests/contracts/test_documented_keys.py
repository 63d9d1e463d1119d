"""Tables of keys in the documentation list exactly the keys that are read."""

import re
from dataclasses import fields
from pathlib import Path

from piezoid.design.specification import Specification

GUIDE = Path(__file__).parents[2] / "docs/guide/command_line.md"


def test_the_table_of_design_toml_lists_its_keys():
    section = GUIDE.read_text().split("## design.toml")[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    keys = [key for row in rows for key in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert sorted(keys) == sorted({f.name for f in fields(Specification)} - {"templates"})
