"""The speed benchmarks run at small sizes, and what they compare is the same result."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import million_samples, ratios, streamed_fit
from benchmarks.speed.campaign import made
from benchmarks.speed.chain import Loop
from benchmarks.speed.chain_rows import loop_growths, loop_row
from benchmarks.speed.stopwatch import Stopwatch
from benchmarks.speed.table import HEADINGS
from tests.verification.rig import lateral, lateral_parameters

ONCE = Stopwatch(patience_s=0.0)
SIZES = ["--patience", "0", "--samples", "800"]


def test_every_rival_of_kernels_and_programs_comes_to_our_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ratios.main([str(tmp_path), *SIZES, "--parts", "kernels", "programs"])
    lines = capsys.readouterr().out.splitlines()
    rows = [
        [cell.strip() for cell in line.strip("| ").split("|")] for line in lines if "|" in line
    ]
    assert rows[0] == list(HEADINGS)
    assert [row[0] for row in rows[2:]] == [
        *("play bank", "model forward", "inverse"),
        *("weights of the plays, from all rows", "weights on the triangle"),
        *("Kuhnen's program", "fit of one shape"),
    ]
    assert {place.name for place in tmp_path.iterdir()} == {"growth.svg", "growth.png"}


def test_the_closed_loop_of_a_benchmark_is_the_one_that_is_verified() -> None:
    loop = Loop(
        plant=lateral(),
        parameters=lateral_parameters(),
        reference_m=1e-5 * np.sin(np.linspace(0.0, 20.0, 400)),
    )
    row = loop_row(ONCE, loop)
    assert row.loop is not None
    assert min(row.loop, *row.bounds.values()) > 0.0
    by_samples, by_plays = loop_growths(ONCE, loop)
    assert (by_samples.size, by_plays.size) == ((25, 100, 400), (4, 8, 16, 32))


def test_a_longer_recording_has_the_same_loops() -> None:
    short, long = made(500, 2), made(2000, 2)
    for slow, quick in zip(long.recordings, short.recordings, strict=True):
        assert (slow.samples, quick.samples) == (2000, 500)
        assert np.ptp(slow.voltage_V()) == pytest.approx(np.ptp(quick.voltage_V()), rel=0.02)
    assert len({one.name for one in long.recordings}) == 2


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_a_recording_is_fitted_in_memory_and_from_its_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    million_samples.main(["1500"], watch=ONCE)
    assert "residual" in capsys.readouterr().out
    place = tmp_path / "long_5e+03.parquet"
    streamed_fit.write(place, 5000)
    streamed_fit.fit_one(place)
    row = capsys.readouterr().out
    assert row.startswith("| 5e+03 |")
    assert row.count("|") == len(streamed_fit.HEADINGS) + 1
    assert list(tmp_path.iterdir()) == [place]
