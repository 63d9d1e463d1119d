"""The section on the verification: rows with limits, figures of the errors."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.runtime.schema import METHOD_NAMES
from piezoid.verification.rebuild import Proof
from piezoid.verification.scenarios import SCENARIOS
from piezoid.verification.tracking import SPIRAL_POINTS, SpiralTrace
from piezoid.verification.verification import ErrorBound, Verification, verification_from_json
from piezoid.verification.verify import verify
from piezoid_reports.page import Page
from piezoid_reports.parts import Section, Table
from piezoid_reports.quantities import number
from piezoid_reports.sections import verification
from piezoid_reports.sections.verification import MAX_VERDICTS, SHADES, STEPS, motions, spiral
from tests.design.designed import known_design
from tests.reports.anatomy import Anatomy
from tests.reports.known_page import page_of
from tests.reports.known_stage import axis_model, stage_model
from tests.verification.rig import PLANTS, stage

AT_10_Hz = [s for s in SCENARIOS if s.name == "spiral, 10 Hz"]


@pytest.fixture(scope="module")
def result() -> Verification:
    built = Proof(build="cc", is_built=True, samples=12, differing=0)
    return replace(verify(stage(), PLANTS, scenarios=AT_10_Hz), proofs=(built,))


def chapter(result: Verification) -> tuple[Section, Anatomy]:
    page = page_of(axis_model(), verification=result)
    section = verification.render(Page(model=stage_model(axis_model()), verification=result))
    assert section is not None
    assert len(page) < 3_000_000
    return section, Anatomy(page)


def texts(result: Verification) -> list[str]:
    return [e.text.replace("\u202f", " ") for e in chapter(result)[1].elements if e.tag == "tr"]


def test_without_a_verification_there_is_no_chapter():
    assert 'id="verification"' not in page_of(axis_model())


def test_every_method_and_verdict_has_its_row(result):
    rows = texts(result)
    for row in result.comparison:
        start = f"{METHOD_NAMES[row.method]}{number(row.rms_m, 'm')}".replace("\u202f", " ")
        assert any(line.startswith(start) for line in rows)
    names = {verdict.name for verdict in result.verdicts}
    assert sum(row.endswith("passed") for row in rows) == min(len(names), MAX_VERDICTS)
    assert any(row.startswith("cc12") for row in rows)


def test_requested_bounds_of_errors_have_rows(result):
    bound = ErrorBound(
        axis="x",
        slew_m_per_s=1e-3,
        bound_m=None,
        probable_m=150e-9,
        probability=0.95,
        worst_found_m=357e-9,
        simulated_m=91e-9,
        runs=59,
    )
    with_bounds = replace(result, bounds=(bound,))
    rows = texts(with_bounds)
    row_of_x = "x1.00 mm/sno useful bound150 nm357 nm91.0 nm"
    assert any(row.startswith(row_of_x) for row in rows), rows
    guaranteed = replace(with_bounds, bounds=(replace(bound, bound_m=400e-9),))
    assert any(row.startswith("x1.00 mm/s400 nm150 nm") for row in texts(guaranteed))
    exceeded = replace(with_bounds, bounds=(replace(bound, bound_m=300e-9),))
    assert any("300 nm, exceeded on some sampled stages" in row for row in texts(exceeded))
    read = verification_from_json(with_bounds.to_json())
    assert read.bounds == with_bounds.bounds


def test_one_reason_for_a_missing_guarantee_is_stated_once(result):
    method = result.methods["x"]
    design = known_design()
    loop = design.axis("x").loop(method)
    unbounded = replace(design.axis("x"), loops=(replace(loop, certificate=None),))
    page = Page(model=stage_model(axis_model()), design=replace(design, axes=(unbounded,)))
    table = verification.comparison_table(page, result)
    assert not any(row[0].startswith("guaranteed") for row in table.rows)
    assert table.caption.count(f"Guaranteed error of {METHOD_NAMES[method]}") == 1


def test_failed_verdicts_are_first(result):
    failed_verdict = replace(result.verdicts[-1], value=2.0 * result.verdicts[-1].limit + 1.0)
    failed = replace(result, verdicts=(*result.verdicts[:-1], failed_verdict))
    rows = texts(failed)
    verdict_rows = [k for k, row in enumerate(rows) if row.endswith(("passed", "failed"))]
    assert rows[verdict_rows[0]].endswith("failed")
    assert failed_verdict.name in rows[verdict_rows[0]]


def test_traces_of_spirals_are_stored_and_read(result):
    assert {trace.method for trace in result.traces} == {"mpi_dob", "none"}
    assert all(len(trace.x_m) == SPIRAL_POINTS for trace in result.traces)
    assert verification_from_json(result.to_json()).traces == result.traces
    shipped = {row.method: row.aligned_rms_m for row in result.comparison}
    for trace in result.traces:
        rms_m = float(np.sqrt(np.mean(np.square(trace.shape_error_m))))
        # The comparison excludes both ends, where a delay is not identifiable.
        assert rms_m == pytest.approx(shipped[trace.method], rel=0.1)


def test_steps_are_drawn_over_time_with_the_uncompensated_motion():
    scenarios = [s for s in SCENARIOS if s.kind in ("raster", "steps")]
    result = verify(stage(), PLANTS, scenarios=scenarios, trials=())
    assert [(m.scenario, m.axis) for m in result.motions] == [
        (s.name, axis) for s in scenarios for axis in ("x", "y")
    ]
    read = verification_from_json(result.to_json())
    assert read.motions == result.motions
    figures = motions(read)
    steps = [motion for motion in result.motions if motion.scenario == STEPS]
    assert len(figures) == len(steps) > 0
    for motion, figure in zip(steps, figures, strict=True):
        assert [layer.role for layer in figure.layers] == ["grey", "model"]
        reference_m, shipped_m, uncompensated_m = (
            np.array(v) for v in (motion.reference_m, motion.shipped_m, motion.uncompensated_m)
        )
        errors_m = [
            float(np.median(np.abs(motion_m - reference_m)))
            for motion_m in (shipped_m, uncompensated_m)
        ]
        assert errors_m[0] < 0.5 * errors_m[1]
    shipped_only = replace(
        result, motions=tuple(replace(m, uncompensated_m=()) for m in result.motions)
    )
    assert [layer.role for layer in motions(shipped_only)[0].layers] == ["model"]
    assert b"motions" not in replace(result, motions=()).to_json()


def test_a_point_has_the_colour_of_its_share_of_the_limit(result):
    limit_m = 0.01 * 2.0 * result.radius_m
    levels = 0.9 * limit_m * np.array([min(share, 10.0) for share in SHADES.values()])
    trace = SpiralTrace(
        method="none",
        frequency_Hz=10.0,
        axes=("x", "y"),
        x_m=(0.0, 1e-6, 2e-6, 3e-6),
        y_m=(0.0, 0.0, 0.0, 0.0),
        shape_error_m=tuple(levels.tolist()),
    )
    figure = spiral(trace, result)
    assert [layer.role for layer in figure.layers] == [f"error-{shade}" for shade in SHADES]
    exact = replace(trace, shape_error_m=(0.0, 0.0, 0.0, 0.0))
    assert [layer.role for layer in spiral(exact, result).layers] == ["error-measured"]


def test_a_method_with_a_smaller_error_than_the_shipped_one_is_named(result):
    shipped, *comparison = result.comparison
    worse = replace(result, comparison=(replace(shipped, aligned_rms_m=1.0), *comparison))
    captions = [
        " ".join(e.text.replace("\u202f", " ") for e in chapter(r)[1].all("figcaption"))
        for r in (result, worse)
    ]
    assert "The curves cross" not in captions[0]
    assert "The curves cross: at 10.0 Hz" in captions[1]


def test_the_error_of_a_spiral_names_its_axes(result):
    def caption(methods: dict[str, str]) -> str:
        section, _ = chapter(replace(result, methods=methods))
        return next(part.caption for part in section.parts if isinstance(part, Table))

    assert "axes x and y together" in caption({"x": "mpi_dob", "y": "mpi_dob", "z": "rst"})
    assert "axis x with an ideal second axis" in caption({"x": "mpi_dob"})
