"""Several recordings in blocks: scaled as in memory, and judged by the same loops."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.identification.hysteresis.pieces import Rig, scales_of
from piezoid.identification.model import AxisModel
from piezoid.identification.streamed.fit_streamed import fit_streamed
from piezoid.identification.streamed.stream import streams_of
from piezoid.numerics.arrays import Array
from piezoid.records.ingest import ingest
from piezoid.records.streams.spool import spooled
from tests.identification.hysteresis.stages import RATE_Hz, decaying, play_sum

PER_VOLT = 100  # samples: branches long enough to be thinned before loops are looked at
HELD_OUT = "second half of the only recording"


def written(place: Path, *stretches: tuple[Array, Array]) -> Path:
    """A recording whose stretches are a second apart."""
    rows, begins_s = [], 0.0
    for drive_V, moved_m in stretches:
        time_s = begins_s + np.arange(len(drive_V)) / RATE_Hz
        rows.append(np.column_stack([time_s, drive_V, 1e6 * moved_m]))
        begins_s = float(time_s[-1]) + 1.0
    header = "time [s],voltage [V],position [um]"
    np.savetxt(place, np.concatenate(rows), "%.12g", ",", header=header, comments="")
    return place


def swept(top_V: float, share: float = 0.3, seed: int = 1) -> tuple[Array, Array]:
    """Falling triangles on two plays; a share below zero makes loops that open the wrong way."""
    drive_V = decaying(8, top_V, PER_VOLT)
    threshold_V, weight = np.array([0.0, 1.0]), 1e-6 * np.array([1.0, share])
    moved_m = play_sum(drive_V, threshold_V, weight, np.zeros(2))
    return drive_V, moved_m + np.random.default_rng(seed).normal(0.0, 3e-9, len(drive_V))


def fitted(*paths: Path) -> AxisModel:
    with spooled(paths) as spool:
        return fit_streamed(spool, orders=((2, 1),), workers=1)["x"]


def test_the_widest_recording_scales_all_of_them_as_in_memory(tmp_path: Path) -> None:
    high, low = swept(5.0), swept(2.0)
    raised = low[0] + 3.5, low[1] + 5e-6
    paths = [
        written(tmp_path / "a.csv", low, high, raised),
        written(tmp_path / "b.csv", raised, low),
    ]
    expected = scales_of([ingest(path) for path in paths], "x")
    with spooled(paths) as spool:
        streams = streams_of(spool.pieces["x"], "x", Rig())
    assert len(streams) == 5
    for stream in streams:
        assert stream.scales.voltage_V == pytest.approx(expected.voltage_V)
        assert stream.scales.voltage_offset_V == pytest.approx(expected.voltage_offset_V)
        assert stream.scales.displacement_m == pytest.approx(expected.displacement_m, abs=0.0)


def test_a_loop_that_opens_the_wrong_way_is_refused(tmp_path: Path) -> None:
    assert fitted(written(tmp_path / "right.csv", swept(5.0))).verdict.applies
    verdict = fitted(written(tmp_path / "wrong.csv", swept(5.0, -0.3))).verdict
    assert not verdict.applies
    assert "wrong way" in verdict.reason


def test_it_is_said_where_the_only_recording_had_to_test_itself(tmp_path: Path) -> None:
    # Noise of its own makes the second a run of the same drive, and no copy of the first.
    paths = [written(tmp_path / f"{name}.csv", swept(5.0, seed=k)) for k, name in enumerate("ab")]
    for count, alone in ((1, True), (2, False)):
        model = fitted(*paths[:count])
        assert (model.quality.held_out_kind == "second half") is alone
        assert any(HELD_OUT in remark for remark in model.verdict.remarks) is alone
