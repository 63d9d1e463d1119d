"""The page of a batch: what was put into the fleet is named, and nothing else."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from piezoid.errors import ParameterFileError
from piezoid_reports.fleet.records import (
    FAILED,
    PASSED,
    REFUSED,
    Fleet,
    FleetAxis,
    FleetStage,
    stage_from_json,
)
from piezoid_reports.fleet.sections import render_fleet
from piezoid_reports.fleet.statistics import FALSE_ALARMS, compare_stages
from tests.reports.anatomy import Anatomy

MIDDLE = {"sensitivity_m_per_V": 3.3e-6, "noise_rms_m": 1e-8, "held_out_rms_percent": 0.1}


def stage(
    serial: int,
    rng: np.random.Generator,
    errors: Mapping[str, float] | None = None,
    **changes: float,
) -> FleetStage:
    values = {name: value * (1 + 0.02 * rng.standard_normal()) for name, value in MIDDLE.items()}
    axis = FleetAxis(
        axis="x",
        applies=True,
        values=values | changes,
        parameters={"play_weight_m_per_V": [1e-6, 2e-6], "voltage_offset_V": 5.0},
        errors=errors or {},
    )
    return FleetStage(name=f"unit {serial:03d}", state=PASSED, axes=(axis,), version="1")


def fleet(count: int, seed: int = 1, **changes: float) -> Fleet:
    rng = np.random.default_rng(seed)
    made = [stage(k, rng) for k in range(count)]
    if changes:
        made[count // 2] = stage(count // 2, rng, **changes)
    return Fleet(name="night", stages=tuple(made))


def test_the_one_noisy_stage_is_named_with_its_number() -> None:
    found = compare_stages(fleet(40, noise_rms_m=4e-8))
    noise = next(one for one in found if one.quantity.name == "noise_rms_m")
    assert [noise.stages[k] for k in noise.outliers] == ["unit 020"]
    rows = Anatomy(render_fleet(fleet(40, noise_rms_m=4e-8))).all("tr")
    first = next(row.text for row in rows if "sigma" in row.text)
    assert "unit 020" in first  # the farthest stands on top
    assert "40.0\u202fnm" in first


@pytest.mark.parametrize("count", [6, 40])
def test_where_nothing_is_wrong_chance_names_as_few_as_the_page_says(count: int) -> None:
    named = [
        sum(len(one.outliers) for one in compare_stages(fleet(count, seed))) for seed in range(60)
    ]
    assert np.mean(named) < FALSE_ALARMS * 1.2


def test_a_long_tail_of_errors_names_no_more_stages_than_the_page_says() -> None:
    named = 0
    for seed in range(60):
        rng = np.random.default_rng([9, seed])
        made = [
            stage(k, rng, error_bound_m=float(2e-6 * np.exp(0.6 * rng.standard_normal())))
            for k in range(40)
        ]
        found = compare_stages(Fleet(name="night", stages=tuple(made)))
        named += sum(len(one.outliers) for one in found)
    assert named / 60 < FALSE_ALARMS * 1.2


def lags(seed: int, true_s: Mapping[int, float] | None = None) -> Fleet:
    """Sixty stages of 50 us; every sixth was swept so short that its lag is hardly known."""
    rng = np.random.default_rng([11, seed])
    made = []
    for k in range(60):
        error_s = 1.5e-4 if k % 6 == 0 else 4e-6
        lag_s = (true_s or {}).get(k, 5e-5 + 5e-6 * rng.standard_normal())
        measured_s = lag_s + error_s * rng.standard_normal()
        made.append(stage(k, rng, {"lag_s": error_s}, lag_s=float(measured_s)))
    return Fleet(name="night", stages=tuple(made))


def _odd_lags(fleet: Fleet) -> list[str]:
    (found,) = (one for one in compare_stages(fleet) if one.quantity.name == "lag_s")
    return [found.stages[k] for k in found.outliers]


def test_a_lag_that_a_short_sweep_hardly_knows_is_nothing_to_stand_out_by() -> None:
    named = [len(_odd_lags(lags(seed))) for seed in range(60)]
    assert np.mean(named) < FALSE_ALARMS


def test_a_lag_that_is_known_and_off_stands_out_among_those_that_are_not_known() -> None:
    # 30 us off by a lag known to 4 us; 30 us of a lag known to 150 us is nothing.
    found = [_odd_lags(lags(seed, {20: 9e-5, 24: 9e-5})) for seed in range(20)]
    assert sum("unit 020" in names for names in found) >= 18
    assert sum("unit 024" in names for names in found) <= 1


def test_a_drift_over_the_serial_numbers_is_seen_and_the_drifted_are_no_outliers() -> None:
    rng = np.random.default_rng(2)
    stages = tuple(
        stage(k, rng, sensitivity_m_per_V=3.3e-6 * (1 - 2e-3 * k) * (1 + 1e-3 * rng.normal()))
        for k in range(60)
    )
    (found,) = (
        one
        for one in compare_stages(Fleet(name="night", stages=stages))
        if one.quantity.name == "sensitivity_m_per_V"
    )
    assert found.drifts
    assert found.trend is not None
    assert found.trend.slope == pytest.approx(-2e-3 * 3.3e-6, rel=0.05)
    assert not found.outliers
    assert "Drift over the serial numbers: " in render_fleet(Fleet(name="night", stages=stages))


def test_a_constant_quantity_and_a_missing_serial_are_no_trouble() -> None:
    same = FleetAxis(axis="x", applies=True, values={"lag_s": 0.0}, parameters={})
    stages = tuple(FleetStage(name=name, state=PASSED, axes=(same,)) for name in "abcdefghij")
    page = render_fleet(Fleet(name="night", stages=stages))
    assert "Too few stage names contain a serial number" in page
    Anatomy(page)


def test_every_failure_stands_there_with_its_reason() -> None:
    bad = (
        FleetStage(name="a/1", state=REFUSED, reason="sweep.csv: no <column> is a displacement"),
        FleetStage(name="a/2", state=FAILED, reason="rms (spiral): 3e-08, allowed 2e-08, m"),
    )
    page = render_fleet(Fleet(name="night", stages=bad))
    assert "0 of 2 stages passed; 1 failed a verdict, 1 could not be used." in page
    assert "no &lt;column&gt; is a displacement" in page
    links = [e.attributes["href"] for e in Anatomy(page).all("a")]
    assert "./stages/a/2/report.html" in links
    assert "./stages/a/1/report.html" not in links


def test_a_hostile_name_of_a_folder_is_neither_markup_nor_another_place() -> None:
    name = "javascript:alert(1)//<b>&\"'"
    page = render_fleet(
        Fleet(name="<i>", stages=(FleetStage(name=name, state=FAILED, reason="x"),))
    )
    assert "<b>&" not in page
    links = [e.attributes["href"] for e in Anatomy(page).all("a")]
    assert any("javascript%3A" in link for link in links)
    assert all(link.startswith(("./stages/", "#")) for link in links)


def test_a_record_comes_back_and_a_changed_bit_is_refused() -> None:
    made = stage(7, np.random.default_rng(3))
    content = made.to_json()
    assert stage_from_json(content, "batch.json") == made
    assert made.serial == 7
    with pytest.raises(ParameterFileError):
        stage_from_json(content.replace(b"unit 007", b"unit 008"), "batch.json")


def test_a_page_of_very_many_stages_stays_small_and_shows_the_worst() -> None:
    odd = {"noise_rms_m": 4e-8, "held_out_rms_percent": 9.0}
    many = fleet(1201, **odd)
    text = render_fleet(many)
    assert len(text) < 1.3 * len(render_fleet(fleet(200, **odd)))
    assert "unit 600" in text
    assert max(table.count("<tr") for table in text.split("<table")) <= 202
    assert "200 of 1201 rows are shown; parameters.parquet lists all stages" in text


def test_many_stages_of_which_few_carry_a_number_still_make_a_page() -> None:
    many = fleet(1201)
    named = [
        replace(one, name=one.name if k < 20 else "unit " + "abcdefghij"[k % 10] * (k // 10))
        for k, one in enumerate(many.stages)
    ]
    text = render_fleet(replace(many, stages=tuple(named)))
    assert "over the serial numbers" in text
    assert "9 of 10 stages" not in text


def test_stages_that_passed_without_a_controller_are_counted() -> None:
    rng = np.random.default_rng(5)
    bare = replace(stage(1, rng), outputs={"model.json": "sha256:1"})
    shipped = replace(stage(2, rng), outputs={"model.json": "", "params.json": "sha256:2"})
    fleet = Fleet(name="night", stages=(bare, shipped))
    assert fleet.without_controller == 1
    page = Anatomy(render_fleet(fleet))
    (said,) = [e.text for e in page.elements if "All 2 stages passed." in e.text and e.tag == "p"]
    assert "1 passed without a controller" in said
