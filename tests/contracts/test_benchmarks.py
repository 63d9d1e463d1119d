"""The speed benchmarks run at small sizes and compare equal results."""

import numpy as np
import pytest

from benchmarks import ratios, streamed_fit
from benchmarks.speed.closed_loop import Loop, loop_growths, loop_row
from benchmarks.speed.stopwatch import Stopwatch
from benchmarks.speed.table import HEADINGS
from tests.verification.rig import lateral, lateral_parameters

SINGLE_RUN = Stopwatch(patience_s=0.0)
SIZES = ["--patience", "0", "--samples", "800"]


def test_every_compared_program_has_the_same_result(capsys):
    ratios.main([*SIZES, "--parts", "kernels", "programs"])
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


def test_the_closed_loop_of_a_benchmark_is_the_verified_loop():
    loop = Loop(
        plant=lateral(),
        parameters=lateral_parameters(),
        reference_m=1e-5 * np.sin(np.linspace(0.0, 20.0, 400)),
    )
    row = loop_row(SINGLE_RUN, loop)
    assert row.loop is not None
    assert min(row.loop, *row.bounds.values()) > 0.0
    by_samples, by_plays = loop_growths(SINGLE_RUN, loop)
    assert (by_samples.size, by_plays.size) == ((25, 100, 400), (4, 8, 16, 32))


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_a_recording_is_fitted_from_its_file(tmp_path, capsys):
    path = tmp_path / "long_5e+03.parquet"
    streamed_fit.write(path, 5000)
    streamed_fit.fit_one(path)
    row = capsys.readouterr().out
    assert row.startswith("| 5e+03 |")
    assert row.count("|") == len(streamed_fit.HEADINGS) + 1
    assert list(tmp_path.iterdir()) == [path]
