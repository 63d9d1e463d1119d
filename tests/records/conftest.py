"""The fixture that writes the known recording."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.records.formats import DESCRIBED, UNDESCRIBED


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    """Write one of the files into a fresh folder and return its path."""

    def write_file(name: str) -> Path:
        path = tmp_path / name
        {**DESCRIBED, **UNDESCRIBED}[name](path)
        return path

    return write_file
