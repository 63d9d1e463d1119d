"""The Bouc-Wen benchmark is met on its own data; absent records are passed over, a line each."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.records import bouc_wen
from benchmarks.records.__main__ import RECORDS, main


def test_a_record_that_is_absent_is_named_and_passed_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--data", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"{record.NAME}: skipped, {tmp_path / record.FOLDER} is absent. "
        "Name its parent with --data."
        for record in RECORDS
    ]


def test_a_record_of_another_name_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["bouc-wen"])
    assert "no record bouc-wen; there are bouc_wen" in capsys.readouterr().err


def test_the_restoring_force_of_the_benchmark_is_learnt_from_its_training_record(
    realdata: Path,
) -> None:
    folder = realdata / bouc_wen.FOLDER
    model = bouc_wen.ours(*bouc_wen.training(folder))
    assert model.law == "bouc_wen"
    for name, limit_m in (("multisine", 2e-6), ("sinesweep", 5e-6)):
        force, truth_m = bouc_wen.validation(folder, name)
        found_m = model.simulate(force, bouc_wen.RATE_HZ, periodic=name == "multisine")
        assert np.sqrt(np.mean((found_m - truth_m) ** 2)) < limit_m
    for name, truth in (("mass", 2.0), ("damping", 10.0), ("spring_stiffness", 5e4)):
        low, high = model.interval[name]
        assert low - 1e-3 * truth < truth < high + 1e-3 * truth
