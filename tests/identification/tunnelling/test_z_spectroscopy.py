"""Sweeps of a Z spectroscopy file are read with height, direction and bias."""

import numpy as np
import pytest

from piezoid.errors import RecordingError, UnitError
from piezoid.identification.tunnelling.approach import Direction, read_z_spectroscopy
from piezoid.identification.tunnelling.junction import curves_of, fit_junction
from piezoid.records.collection import collect
from piezoid.records.inspection import inspect_files
from piezoid.records.table import Column, RawTable
from tests.identification.tunnelling.sweeps import real_sweep, real_table


def _table(*labels: str, metadata: dict[str, str] | None = None) -> RawTable:
    columns = tuple(
        Column(number=n + 1, label=label, values=np.linspace(n + 1.0, n + 2.0, 10))
        for n, label in enumerate(labels)
    )
    return RawTable(
        name="made.dat",
        digest="sha256:0",
        format="Nanonis",
        columns=columns,
        independent=labels[0],
        metadata=metadata or {},
    )


def test_the_real_file_holds_three_sweeps_each_way(realdata):
    table = real_table(realdata)
    curves = read_z_spectroscopy(table)
    assert [curve.direction for curve in curves] == [Direction.FORWARD] * 3 + [
        Direction.BACKWARD
    ] * 3
    assert {curve.bias_V for curve in curves} == {-0.02}
    expected = real_sweep(table, "00002", Direction.BACKWARD)
    assert np.array_equal(curves[4].current_A, expected.current_A)
    assert np.array_equal(curves[4].height_m, expected.height_m)


def test_sweeps_of_several_files_keep_their_order():
    head = {"Bias>Bias (V)": "-20E-3"}
    first = _table("Z rel (nm)", "Current (nA)", "Current [bwd] (nA)", metadata=head)
    second = _table("Z rel (nm)", "Current (pA)", metadata=head)
    assert [curve.label.partition(": ")[2] for curve in curves_of([second, first])] == [
        "Current (pA)",
        "Current (nA)",
        "Current [bwd] (nA)",
    ]


def test_an_average_is_read_only_without_single_sweeps():
    average_only = _table("Z rel (nm)", "Current [AVG] (pA)", "Bias [AVG] (V)")
    average_and_sweep = _table(
        "Z rel (nm)", "Current [AVG] (pA)", "Current [00001] (pA)", "Bias [00001] (V)"
    )
    assert [c.label for c in read_z_spectroscopy(average_only)] == ["made.dat: Current [AVG] (pA)"]
    assert [c.label for c in read_z_spectroscopy(average_and_sweep)] == [
        "made.dat: Current [00001] (pA)"
    ]


def test_units_of_the_headings_are_converted():
    (curve,) = read_z_spectroscopy(_table("Z rel (nm)", "Current (pA)", "Bias (mV)"))
    assert curve.height_m[0] == pytest.approx(1e-9, abs=0.0)
    assert curve.current_A[0] == pytest.approx(2e-12, abs=0.0)
    assert curve.bias_V == pytest.approx(3.5e-3)


def test_the_bias_of_the_header_is_used_for_a_sweep_without_bias():
    table = _table("Z rel (m)", "Current [bwd] (A)", metadata={"Bias>Bias (V)": "-20E-3"})
    (curve,) = read_z_spectroscopy(table)
    assert curve.bias_V == -0.02
    assert curve.direction is Direction.BACKWARD


def test_a_sweep_over_bias_is_refused():
    with pytest.raises(UnitError, match="swept column is 'Bias"):
        read_z_spectroscopy(_table("Bias (V)", "Current (A)"))


def test_a_table_without_current_is_refused():
    with pytest.raises(RecordingError, match="no current among"):
        read_z_spectroscopy(_table("Z rel (m)", "LIX 1 omega (A)"))


@pytest.mark.parametrize("name", ["Current (A)", "I (A)"])
def test_a_table_without_bias_has_none(name):
    (curve,) = read_z_spectroscopy(_table("Z rel (m)", name))
    assert curve.bias_V is None


def test_a_text_table_of_height_and_current_is_an_approach_curve(tmp_path, rng):
    """I = 700 pA exp(-19 z/nm) + 0.3 pA, noise 0.1 pA."""
    z_nm = np.linspace(0.0, 0.7, 300)
    picoamperes = 700.0 * np.exp(-19.0 * z_nm) + 0.3 + 0.1 * rng.standard_normal(300)
    path = tmp_path / "iz.csv"
    rows = "".join(f"{z:.6f},{i:.5f}\n" for z, i in zip(z_nm, picoamperes, strict=True))
    path.write_text("Z (nm),Current (pA)\n" + rows)
    (inspection,) = inspect_files([path])
    assert inspection.refusal is None
    assert "approach_curve" in {statement.quantity for statement in inspection.statements}
    collection = collect([path])
    law = fit_junction(collection.sweeps)
    low_per_m, high_per_m = law.gap_law.decay_interval_per_m
    assert low_per_m < 19e9 < high_per_m
