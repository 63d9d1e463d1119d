"""The fit in blocks: the numbers of the fit in memory, whatever is in memory at one time."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piezoid.errors import ExcitationError
from piezoid.identification.hysteresis.coordinates import Coordinates, Shape, vector_of
from piezoid.identification.hysteresis.gauss_newton import Task as WholeTask
from piezoid.identification.hysteresis.gauss_newton import rms_of as whole_rms_of
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.rows import column_places, rows_of
from piezoid.identification.hysteresis.start import kuhnen_start
from piezoid.identification.store import read_model, write_model
from piezoid.identification.streamed.convex import grid_of, halves, starts_of_program
from piezoid.identification.streamed.fit_streamed import fit_streamed, lag_s_of, survey
from piezoid.identification.streamed.passes import Task, blocks_of, gathered, rms_of
from piezoid.identification.streamed.stream import streams_of
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.records.ingest import ingest
from piezoid.records.recording import Recording
from piezoid.records.streams.piece import Piece
from piezoid.records.streams.spool import Spool, spooled

RATE_Hz = 1000.0
SAMPLES = 4001
LAG_SAMPLES = 3
PLAYS = PrandtlIshlinskii(threshold=np.array([0.0, 0.8, 2.0]), weight=np.array([2e-6, 5e-7, 3e-7]))
ZONES = from_slopes(np.array([-3e-6, 0.0, 3e-6]), np.array([0.9, 1.0, 1.0, 0.95]))
ORDERS = ((2, 1), (4, 1))
RIG = Rig(sensor_bandwidth_Hz=200.0)
# Sums of some thousand terms of order one, gathered in another order.
ROUNDING = 1e-9


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a known stage: minor loops at all levels, 5 nm of noise."""
    t = np.arange(SAMPLES) / RATE_Hz
    u = 5 * (0.2 + 0.8 * np.abs(np.cos(np.pi * t / 2))) * np.sin(2 * np.pi * 3 * t)
    h, _ = PLAYS.run(np.concatenate([np.zeros(LAG_SAMPLES), u])[:SAMPLES], np.zeros(3))
    y = ZONES.run(h) + 5e-9 * np.random.default_rng(3).standard_normal(SAMPLES)
    rows = np.column_stack([t, u, 1e6 * y])
    place = tmp_path_factory.mktemp("streamed") / "run.csv"
    np.savetxt(place, rows, "%.9g", ",", header="time [s],voltage [V],position [um]", comments="")
    return place


@pytest.fixture
def spool(path: Path) -> Iterator[Spool]:
    """The recording on disk."""
    with spooled([path], rows=1500) as held:
        yield held


def task_of(held: tuple[Piece, ...], rig: Rig, chunk: int, stride: int) -> Task:
    """A task of three plays and two knots of the zero."""
    streams = streams_of(held, "x", rig, chunk)
    return Task(
        streams=streams,
        pieces=tuple(stream.described() for stream in streams),
        edges=tuple([0, 1234, stream.samples] for stream in streams),
        coordinates=Coordinates(
            shape=Shape(plays=3, below=1, above=1), offsets=(2,) * len(streams)
        ),
        sensor_pole_Hz=rig.sensor_bandwidth_Hz,
        stride=stride,
        longest_lag_s=0.02,
    )


def somewhere(task: Task, recording: Recording) -> np.ndarray:
    """A vector that is no optimum: the convex start of another lag."""
    pieces = pieces_of([recording], "x", scales_of([recording], "x"), Rig())
    start = kuhnen_start(pieces, Shape(plays=3, below=1, above=1), 0.0045)
    theta = vector_of(start.operator, task.coordinates)
    theta[task.coordinates.memory_slice(0)] = 0.2
    return theta


@pytest.mark.parametrize(
    ("chunk", "stride", "rig"),
    [
        (1, 1, RIG),
        (7, 5, RIG),
        (7, 1, Rig()),
        (1000, 5, Rig()),
        (1000, 1, Rig(amplifier_bandwidth_Hz=100.0)),
        (10_000, 5, RIG),
    ],
)
def test_the_triangle_is_that_of_the_rows_in_memory(
    chunk: int, stride: int, rig: Rig, path: Path, spool: Spool
) -> None:
    recording = ingest(path)
    task = task_of(spool.pieces["x"], rig, chunk, stride)
    theta = somewhere(task, recording)
    (piece,) = pieces_of([recording], "x", scales_of([recording], "x"), rig)
    rows = [
        part.block
        for part in rows_of(
            theta, task.coordinates, 0, piece, sensor_pole=rig.sensor_bandwidth_Hz, stride=stride
        )
    ]
    whole = np.vstack(rows)
    order = [*column_places(task.coordinates, 0), task.coordinates.total]
    expected = np.zeros((task.coordinates.total + 1,) * 2)
    expected[np.ix_(order, order)] = whole.T @ whole
    blocks = blocks_of(theta, task)
    triangle = gathered(blocks, task.coordinates)
    np.testing.assert_allclose(
        triangle.T @ triangle, expected, rtol=0, atol=ROUNDING * np.abs(expected).max()
    )
    assert len(blocks) == 2
    assert sum(block.rows for block in blocks) == len(whole)
    in_memory = WholeTask(
        pieces=(piece,),
        coordinates=task.coordinates,
        sensor_pole_Hz=rig.sensor_bandwidth_Hz,
        stride=stride,
        longest_lag_s=0.02,
    )
    assert rms_of(blocks) == pytest.approx(whole_rms_of(theta, in_memory), rel=ROUNDING)


@pytest.mark.parametrize("chunk", [7, 1000, 10_000])
def test_the_convex_start_is_kuhnens_on_the_whole_recording(
    chunk: int, path: Path, spool: Spool
) -> None:
    recording = ingest(path)
    shape, lag_s = Shape(plays=4, below=1, above=1), 0.0034
    pieces = pieces_of([recording], "x", scales_of([recording], "x"), Rig())
    expected = kuhnen_start(pieces, shape, lag_s)
    streams = streams_of(spool.pieces["x"], "x", Rig(), chunk)
    grid = grid_of(streams, (1,), ORDERS)
    parts = halves(streams, grid, lag_s, rows=SAMPLES)
    found = starts_of_program(streams, grid, parts, shape, lag_s)[0]
    for name in ("weight", "threshold", "knot", "slope"):
        mine, theirs = getattr(found.operator, name), getattr(expected.operator, name)
        np.testing.assert_allclose(mine, theirs, atol=1e-6, rtol=0)
    assert found.offset == pytest.approx(expected.offset, abs=1e-6)


def test_all_lags_are_tried_in_one_pass(spool: Spool) -> None:
    streams = streams_of(spool.pieces["x"], "x", Rig(), 100)
    surveys = [survey(stream, [1000, 2000]) for stream in streams]
    assert lag_s_of(streams, surveys, 0.05) == LAG_SAMPLES / RATE_Hz
    (found,) = surveys
    assert found.cycles == pytest.approx(12, abs=1)
    assert found.turns == pytest.approx(24, abs=1)
    assert all(
        0 <= k - wanted < 350 for k, wanted in zip(found.crossings, (1000, 2000), strict=True)
    )


def test_the_fit_finds_the_stage_and_its_lag_whatever_the_chunk(spool: Spool) -> None:
    models = [
        fit_streamed(spool, chunk=chunk, orders=ORDERS, workers=workers)["x"]
        for chunk, workers in ((997, 1), (8192, 2))
    ]
    for model in models:
        assert model.quality.rms_m == pytest.approx(5e-9, rel=0.1)
        assert model.quality.held_out_rms_m == pytest.approx(5e-9, rel=0.15)
        assert model.lag.time_s == pytest.approx(LAG_SAMPLES / RATE_Hz, rel=0.01)
        assert model.verdict.applies
        assert model.quality.converged
        assert "no diagnosis" in model.verdict.remarks[0]
    first, second = models
    assert second.quality.rms_m == pytest.approx(first.quality.rms_m, rel=1e-6)
    assert second.hysteresis.plays.weight == pytest.approx(first.hysteresis.plays.weight, rel=1e-3)


def test_the_model_of_a_fit_in_blocks_is_written_and_read(spool: Spool) -> None:
    model = fit_streamed(spool, orders=ORDERS[:1])
    content = write_model(model)
    assert write_model(read_model(content)) == content
    assert model.sources == spool.sources
    again = fit_streamed(spool, orders=ORDERS[:1], workers=1)
    assert write_model(again) == content


def test_a_drive_at_rest_is_refused(spool: Spool) -> None:
    (piece,) = spool.pieces["x"]
    still = replace(piece, voltage_V=(1.0, 1.0))
    with pytest.raises(ExcitationError, match="the drive of axis x never changes"):
        streams_of([still], "x", Rig())
    with pytest.raises(ExcitationError, match="no axis has a drive and a displacement"):
        fit_streamed(replace(spool, pieces={}))
