"""What is left of a stream answers its rows as the whole stream does, nearly always to the bit."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.streamed.passes import rows_of_stream
from piezoid.identification.streamed.thinned import thinned, window_of, worth_thinning
from piezoid.records.ingest import ingest
from piezoid.records.streams.spool import Spool, spooled
from tests.identification.streamed import test_fit_streamed as known

LAG_s = (0.002, 0.008)  # the vector's lag is 4.5 ms
# A declared pole is followed exactly; what it remembers of before a stretch is below this.
FORGOTTEN = 1e-12


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording whose drive was measured, with noise: it turns at every other sample."""
    place = tmp_path_factory.mktemp("thinned") / "run.csv"
    t = np.arange(known.SAMPLES) / known.RATE_Hz
    noise = np.random.default_rng(5).standard_normal((2, len(t)))
    u = 5 * (0.2 + 0.8 * np.abs(np.cos(np.pi * t / 2))) * np.sin(6 * np.pi * t) + 0.01 * noise[0]
    y = u + 0.005 * noise[1]
    heading = "time [s],voltage [V],position [um]"
    np.savetxt(place, np.column_stack([t, u, y]), "%.9g", ",", header=heading, comments="")
    return place


@pytest.fixture(scope="module")
def spool(path: Path) -> Iterator[Spool]:
    """The recording on disk."""
    with spooled([path]) as held:
        yield held


@pytest.mark.parametrize("chunk", [7, 1000])
@pytest.mark.parametrize(
    ("rig", "allowed"),
    [
        (Rig(), 0.0),
        (Rig(amplifier_bandwidth_Hz=100.0), 0.0),
        (Rig(sensor_bandwidth_Hz=400.0), 0.0),  # quicker than half a sample: a delay
        (Rig(sensor_bandwidth_Hz=200.0), FORGOTTEN),
    ],
)
def test_rows_of_what_is_left_are_those_of_the_stream(
    chunk: int, rig: Rig, allowed: float, path: Path, spool: Spool
) -> None:
    task = known.task_of(spool.pieces["x"], rig, chunk, 211)
    (stream,) = task.streams
    theta = known.somewhere(task, ingest(path))
    window = window_of(rig, stream.rate_Hz, LAG_s)
    assert worth_thinning([window], 1000)
    assert not worth_thinning([window], 20)
    left = thinned(stream, 211, window)
    assert len(left.drive) < stream.samples / 2
    whole = list(rows_of_stream(theta, task, 0))
    short = list(rows_of_stream(theta, replace(task, thinned=(left,), lag_s=LAG_s), 0))
    samples = [np.concatenate([sample for sample, _ in rows]) for rows in (whole, short)]
    values = [np.vstack([block for _, block in rows]) for rows in (whole, short)]
    np.testing.assert_array_equal(*samples)
    np.testing.assert_allclose(values[1], values[0], rtol=0.0, atol=allowed)
