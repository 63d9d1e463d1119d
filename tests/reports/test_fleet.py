"""The page of a batch names the outliers and trends of a fleet."""

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
from piezoid_reports.fleet.statistics import FALSE_ALARMS, Distribution, compare_stages
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
    stages = [stage(k, rng) for k in range(count)]
    if changes:
        stages[count // 2] = stage(count // 2, rng, **changes)
    return Fleet(name="night", stages=tuple(stages))


def comparison_of(fleet: Fleet, name: str) -> Distribution:
    (comparison,) = (c for c in compare_stages(fleet) if c.quantity.name == name)
    return comparison


def outliers_in(fleet: Fleet, name: str) -> list[str]:
    comparison = comparison_of(fleet, name)
    return [comparison.stages[k] for k in comparison.outliers]


def number_of_outliers(fleet: Fleet) -> int:
    return sum(len(comparison.outliers) for comparison in compare_stages(fleet))


def test_a_noisy_stage_is_named_with_its_value():
    assert outliers_in(fleet(40, noise_rms_m=4e-8), "noise_rms_m") == ["unit 020"]
    rows = Anatomy(render_fleet(fleet(40, noise_rms_m=4e-8))).all("tr")
    top_row = next(row.text for row in rows if "sigma" in row.text)
    assert "unit 020" in top_row
    assert "40.0\u202fnm" in top_row


@pytest.mark.parametrize("count", [6, 40])
def test_a_healthy_fleet_has_at_most_the_stated_false_alarms(count):
    counts = [number_of_outliers(fleet(count, seed)) for seed in range(60)]
    assert np.mean(counts) < FALSE_ALARMS * 1.2


def test_a_heavy_tail_has_at_most_the_stated_false_alarms():
    outliers = 0
    for seed in range(60):
        rng = np.random.default_rng([9, seed])
        stages = [
            stage(k, rng, error_bound_m=float(2e-6 * np.exp(0.6 * rng.standard_normal())))
            for k in range(40)
        ]
        outliers += number_of_outliers(Fleet(name="night", stages=tuple(stages)))
    assert outliers / 60 < FALSE_ALARMS * 1.2


def lags(seed: int, true_s: Mapping[int, float] | None = None) -> Fleet:
    """Return 60 stages with lags of 50 us; the lag of every sixth stage is very uncertain."""
    rng = np.random.default_rng([11, seed])
    stages = []
    for k in range(60):
        error_s = 1.5e-4 if k % 6 == 0 else 4e-6
        lag_s = (true_s or {}).get(k, 5e-5 + 5e-6 * rng.standard_normal())
        measured_s = lag_s + error_s * rng.standard_normal()
        stages.append(stage(k, rng, {"lag_s": error_s}, lag_s=float(measured_s)))
    return Fleet(name="night", stages=tuple(stages))


def test_only_a_well_known_deviating_lag_is_an_outlier():
    counts = [len(outliers_in(lags(seed), "lag_s")) for seed in range(60)]
    assert np.mean(counts) < FALSE_ALARMS
    # A deviation of 40 us is significant with an error of 4 us, but not with 150 us.
    outliers = [outliers_in(lags(seed, {20: 9e-5, 24: 9e-5}), "lag_s") for seed in range(20)]
    assert sum("unit 020" in names for names in outliers) >= 18
    assert sum("unit 024" in names for names in outliers) <= 1


def test_a_drift_over_serial_numbers_is_a_trend_without_outliers():
    rng = np.random.default_rng(2)
    stages = tuple(
        stage(k, rng, sensitivity_m_per_V=3.3e-6 * (1 - 2e-3 * k) * (1 + 1e-3 * rng.normal()))
        for k in range(60)
    )
    sensitivity = comparison_of(Fleet(name="night", stages=stages), "sensitivity_m_per_V")
    assert sensitivity.drifts
    assert sensitivity.trend is not None
    assert sensitivity.trend.slope == pytest.approx(-2e-3 * 3.3e-6, rel=0.05)
    assert not sensitivity.outliers
    assert "Drift over the serial numbers: " in render_fleet(Fleet(name="night", stages=stages))


def test_a_constant_quantity_and_missing_serials_make_a_page():
    axis = FleetAxis(axis="x", applies=True, values={"lag_s": 0.0}, parameters={})
    stages = tuple(FleetStage(name=name, state=PASSED, axes=(axis,)) for name in "abcdefghij")
    page = render_fleet(Fleet(name="night", stages=stages))
    assert "Too few stage names contain a serial number" in page
    Anatomy(page)


def test_every_failure_is_listed_with_its_reason():
    stages = (
        FleetStage(name="a/1", state=REFUSED, reason="sweep.csv: no <column> is a displacement"),
        FleetStage(name="a/2", state=FAILED, reason="rms (spiral): 3e-08, allowed 2e-08, m"),
    )
    page = render_fleet(Fleet(name="night", stages=stages))
    assert "0 of 2 stages passed; 1 failed a verdict, 1 could not be used." in page
    assert "no &lt;column&gt; is a displacement" in page
    links = [e.attributes["href"] for e in Anatomy(page).all("a")]
    assert "./stages/a/2/report.html" in links
    assert "./stages/a/1/report.html" not in links


def test_a_hostile_folder_name_is_no_markup_and_no_foreign_link():
    name = "javascript:alert(1)//<b>&\"'"
    page = render_fleet(
        Fleet(name="<i>", stages=(FleetStage(name=name, state=FAILED, reason="x"),))
    )
    assert "<b>&" not in page
    links = [e.attributes["href"] for e in Anatomy(page).all("a")]
    assert any("javascript%3A" in link for link in links)
    assert all(link.startswith(("./stages/", "#")) for link in links)


def test_a_record_is_read_and_a_changed_bit_is_refused():
    record = stage(7, np.random.default_rng(3))
    content = record.to_json()
    assert stage_from_json(content, "batch.json") == record
    assert record.serial == 7
    with pytest.raises(ParameterFileError):
        stage_from_json(content.replace(b"unit 007", b"unit 008"), "batch.json")


def test_a_large_fleet_has_a_small_page_with_the_worst_stages():
    outlier = {"noise_rms_m": 4e-8, "held_out_rms_percent": 9.0}
    large_fleet = fleet(1201, **outlier)
    text = render_fleet(large_fleet)
    assert len(text) < 1.3 * len(render_fleet(fleet(200, **outlier)))
    assert "unit 600" in text
    assert max(table.count("<tr") for table in text.split("<table")) <= 202
    assert "200 of 1201 rows are shown; parameters.parquet lists all stages" in text
    large_fleet = fleet(1201)
    stages = [
        replace(
            fleet_stage,
            name=fleet_stage.name if k < 20 else "unit " + "abcdefghij"[k % 10] * (k // 10),
        )
        for k, fleet_stage in enumerate(large_fleet.stages)
    ]
    text = render_fleet(replace(large_fleet, stages=tuple(stages)))
    assert "over the serial numbers" in text
    assert "9 of 10 stages" not in text


def test_stages_that_passed_without_a_controller_are_counted():
    rng = np.random.default_rng(5)
    unshipped = replace(stage(1, rng), outputs={"model.json": "sha256:1"})
    shipped = replace(stage(2, rng), outputs={"model.json": "", "params.json": "sha256:2"})
    fleet = Fleet(name="night", stages=(unshipped, shipped))
    assert fleet.without_controller == 1
    page = Anatomy(render_fleet(fleet))
    (summary,) = [
        e.text for e in page.elements if "All 2 stages passed." in e.text and e.tag == "p"
    ]
    assert "1 passed without a controller" in summary
