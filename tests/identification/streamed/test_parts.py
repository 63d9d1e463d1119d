"""A recording cut into parts, followed by others, is the recording followed in one go."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.store import write_model
from piezoid.identification.streamed.fit_streamed import fit_streamed
from piezoid.identification.streamed.passes import rows_of_part, rows_of_stream
from piezoid.records.ingest import ingest
from piezoid.records.streams.spool import spooled
from tests.identification.streamed import test_fit_streamed as known

path = known.path
# A declared pole has forgotten what lies before a part to e^-37; states of plays are the bits.
FORGOTTEN = 1e-12


@pytest.fixture(scope="module")
def elsewhere() -> Iterator[ProcessPoolExecutor]:
    """Two processes that share nothing with this one but the disk."""
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        yield pool


@pytest.mark.parametrize(
    ("chunk", "rig", "allowed"),
    [
        (7, Rig(), 0.0),
        (1000, Rig(), 0.0),
        (1000, Rig(amplifier_bandwidth_Hz=100.0), FORGOTTEN),
        (1000, Rig(sensor_bandwidth_Hz=200.0), FORGOTTEN),
    ],
)
def test_rows_of_the_parts_are_those_of_the_whole(
    chunk: int, rig: Rig, allowed: float, path: Path
) -> None:
    with spooled([path]) as spool:
        task = known.task_of(spool.pieces["x"], rig, chunk, 3)
        task = replace(task, edges=([0, 500, 1234, 3000, task.streams[0].samples],))
        theta = known.somewhere(task, ingest(path))
        whole = list(rows_of_stream(theta, task, 0))
        parts = [rows for part in task.parts for rows in rows_of_part(theta, task, part)]
    assert [len(part.before) > 0 for part in task.parts] == [False, True, True, True]
    for held in (0, 1):
        expected, found = (np.concatenate([one[held] for one in rows]) for rows in (whole, parts))
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=allowed)


def test_a_fit_whose_passes_others_make_is_the_same_bytes(
    path: Path, tmp_path: Path, elsewhere: ProcessPoolExecutor
) -> None:
    models = []
    for spread in (None, elsewhere.map):
        with spooled([path], folder=tmp_path, named=spread is not None) as spool:
            models.append(write_model(fit_streamed(spool, orders=((2, 1),), spread=spread)))
    assert models[0] == models[1]
    assert not [place for place in tmp_path.iterdir() if place.is_file()]


def test_a_scratch_file_without_a_name_is_not_sent_elsewhere(
    path: Path, elsewhere: ProcessPoolExecutor
) -> None:
    with (
        spooled([path]) as spool,
        pytest.raises(TypeError, match="only a scratch file with a name"),
    ):
        fit_streamed(spool, orders=((2, 1),), spread=elsewhere.map)
