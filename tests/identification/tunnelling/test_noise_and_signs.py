"""A drive counted the wrong way is refused."""

from dataclasses import replace

import pytest

from piezoid.errors import ExcitationError
from piezoid_datasets.virtual_lab.junction import Junction
from tests.identification.tunnelling.loops import identified, record_of


def test_a_current_that_falls_as_the_drive_rises_is_refused() -> None:
    record = record_of(Junction(), 10)
    turned = replace(record, drive_V=-record.drive_V)
    with pytest.raises(ExcitationError, match="the current falls as the drive rises"):
        identified(turned, Junction())
