"""Views of recordings hold hundreds of columns for all rows: none outlives a test file."""

from collections.abc import Iterator

import pytest

from tests.diagnosis import bench, play_stage, played


@pytest.fixture(scope="module", autouse=True)
def drop_cached_views() -> Iterator[None]:
    yield
    for view in (bench.healthy_view, play_stage.healthy, played.view_after):
        view.cache_clear()
