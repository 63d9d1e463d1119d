"""The chapter on what was run: every number with its limit, pictures that show the error."""

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
from piezoid_reports.parts import Section
from piezoid_reports.quantities import number
from piezoid_reports.sections import verification
from piezoid_reports.sections.verification import (
    MAX_VERDICTS,
    SHADES,
    STEPS,
    motions,
    spiral,
)
from tests.reports.anatomy import Anatomy
from tests.reports.known_page import page_of
from tests.reports.known_stage import axis_model, stage_model
from tests.verification.rig import PLANTS, stage

AT_10_Hz = [s for s in SCENARIOS if s.name == "spiral, 10 Hz"]


@pytest.fixture(scope="module")
def found() -> Verification:
    built = Proof(build="cc", is_built=True, samples=12, differing=0)
    return verify(stage(), PLANTS, scenarios=AT_10_Hz, proofs=[built])


def chapter(found: Verification) -> tuple[Section, Anatomy]:
    page = page_of(axis_model(), verification=found)
    made = verification.render(Page(model=stage_model(axis_model()), verification=found))
    assert made is not None
    assert len(page) < 3_000_000
    return made, Anatomy(page)


def texts(found: Verification) -> list[str]:
    return [e.text.replace("\u202f", " ") for e in chapter(found)[1].elements if e.tag == "tr"]


def test_without_a_verification_there_is_no_chapter() -> None:
    assert 'id="verification"' not in page_of(axis_model())


def test_every_method_and_verdict_has_its_row_and_every_verdict_its_limit(
    found: Verification,
) -> None:
    rows = texts(found)
    for row in found.comparison:
        shown = f"{METHOD_NAMES[row.method]}{number(row.rms_m, 'm')}".replace("\u202f", " ")
        assert any(line.startswith(shown) for line in rows)
    names = {verdict.name for verdict in found.verdicts}
    assert sum(row.endswith("passed") for row in rows) == min(len(names), MAX_VERDICTS)
    assert any(row.startswith("cc12") for row in rows)


def test_bounds_of_errors_have_rows_where_asked_for(found: Verification) -> None:
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
    asked = replace(found, bounds=(bound,))
    rows = texts(asked)
    assert any(row.startswith("x1.00 mm/snone150 nm357 nm91.0 nm") for row in rows), rows
    held = replace(asked, bounds=(replace(bound, bound_m=400e-9),))
    assert any(row.startswith("x1.00 mm/s400 nm150 nm") for row in texts(held))
    broken = replace(asked, bounds=(replace(bound, bound_m=300e-9),))
    assert any("300 nm, exceeded on some sampled stages" in row for row in texts(broken))
    again = verification_from_json(asked.to_json())
    assert again.bounds == asked.bounds


def test_what_failed_is_said_first(found: Verification) -> None:
    worse = replace(found.verdicts[-1], value=2.0 * found.verdicts[-1].limit + 1.0)
    failed = replace(found, verdicts=(*found.verdicts[:-1], worse))
    rows = texts(failed)
    named = [k for k, row in enumerate(rows) if row.endswith(("passed", "failed"))]
    assert rows[named[0]].endswith("failed")
    assert worse.name in rows[named[0]]


def test_spirals_are_kept_place_by_place_and_come_back(found: Verification) -> None:
    assert {trace.method for trace in found.traces} == {"mpi_dob", "none"}
    assert all(len(trace.x_m) == SPIRAL_POINTS for trace in found.traces)
    assert verification_from_json(found.to_json()).traces == found.traces
    shipped = {row.method: row.aligned_rms_m for row in found.comparison}
    for trace in found.traces:
        rms_m = float(np.sqrt(np.mean(np.square(trace.shape_error_m))))
        # The comparison leaves out both ends, where a delay cannot be told.
        assert rms_m == pytest.approx(shipped[trace.method], rel=0.1)


def test_raster_and_steps_are_shown_in_time_beside_what_has_no_control() -> None:
    shown = [s for s in SCENARIOS if s.kind in ("raster", "steps")]
    found = verify(stage(), PLANTS, scenarios=shown, trials=())
    assert [(m.scenario, m.axis) for m in found.motions] == [
        (s.name, axis) for s in shown for axis in ("x", "y")
    ]
    read = verification_from_json(found.to_json())
    assert read.motions == found.motions
    figures = motions(read)
    steps = [motion for motion in found.motions if motion.scenario == STEPS]
    assert len(figures) == len(steps) > 0
    for motion, figure in zip(steps, figures, strict=True):
        assert [layer.role for layer in figure.layers] == ["grey", "model"]
        wanted, shipped, plain = (
            np.array(v) for v in (motion.reference_m, motion.shipped_m, motion.uncompensated_m)
        )
        off = [float(np.median(np.abs(moved - wanted))) for moved in (shipped, plain)]
        assert off[0] < 0.5 * off[1]
    bare = replace(found, motions=tuple(replace(m, uncompensated_m=()) for m in found.motions))
    assert [layer.role for layer in motions(bare)[0].layers] == ["model"]
    assert b"motions" not in replace(found, motions=()).to_json()


def test_a_place_gets_the_colour_of_its_share_of_the_limit(found: Verification) -> None:
    limit_m = 0.01 * 2.0 * found.radius_m
    levels = 0.9 * limit_m * np.array([min(share, 10.0) for share in SHADES.values()])
    made = SpiralTrace(
        method="none",
        frequency_Hz=10.0,
        axes=("x", "y"),
        x_m=(0.0, 1e-6, 2e-6, 3e-6),
        y_m=(0.0, 0.0, 0.0, 0.0),
        shape_error_m=tuple(levels.tolist()),
    )
    figure = spiral(made, found)
    assert [layer.role for layer in figure.layers] == [f"error-{shade}" for shade in SHADES]
    alone = replace(made, shape_error_m=(0.0, 0.0, 0.0, 0.0))
    assert [layer.role for layer in spiral(alone, found).layers] == ["error-measured"]
