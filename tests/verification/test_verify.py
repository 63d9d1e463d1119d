"""verify: what passes, what must fail, and the record that says so."""

import json
from dataclasses import replace

import numpy as np
import pytest

from piezoid.errors import ParameterFileError
from piezoid.export.bundle import source_digest
from piezoid.export.parameter_file import ParameterFile, digest_of
from piezoid.verification.criteria import Limits
from piezoid.verification.plant import with_gain
from piezoid.verification.rebuild import Proof
from piezoid.verification.scenarios import SCENARIOS
from piezoid.verification.tip_trials import TIP_TRIALS
from piezoid.verification.verification import verification_from_json
from piezoid.verification.verify import verify
from tests.verification.rig import PLANTS, junction, lateral, stage

TRIALS = {trial.name for trial in TIP_TRIALS}
NAMES = {scenario.name for scenario in SCENARIOS}
QUICK = tuple(s for s in SCENARIOS if s.name in ("spiral, 20 Hz", "spiral, 100 Hz"))


@pytest.fixture(scope="module")
def whole():
    variations = [[with_gain(p, g, f"gain x{g}") for p in PLANTS[:2]] for g in (0.9, 1.1)]
    return verify(stage(), PLANTS, variations=variations)


def test_a_sound_stage_passes_every_verdict(whole):
    assert [v for v in whole.verdicts if not v.passed] == []
    assert whole.passed


def test_every_scenario_is_judged(whole):
    assert {v.scenario for v in whole.verdicts} == NAMES | TRIALS | {"all"}


def test_the_table_has_every_method_at_every_frequency_once(whole):
    rows = [(row.method, row.frequency_Hz) for row in whole.comparison]
    compared = {s.frequency_Hz for s in SCENARIOS if s.is_compared}
    assert len(rows) == len(set(rows)) == 4 * len(compared)
    assert {m for m, _ in rows} == {"none", "mpi", "dob", "mpi_dob"}
    steady, hurried = (
        next(row.ln_current_std for row in whole.currents if row.scenario == f"spiral, {f} Hz")
        for f in (1, 100)
    )
    assert hurried > 3 * steady  # the current shows the surface that the loop does not follow


def test_with_a_good_model_the_combination_is_never_worse_than_the_observer_alone(whole):
    found = {(row.method, row.frequency_Hz): row.aligned_rms_m for row in whole.comparison}
    for (method, f), aligned_m in found.items():
        if method == "mpi_dob":
            assert aligned_m < found["dob", f] < found["none", f]


def at_20_Hz(response):
    """Errors of every method at 20 Hz, the plant having this response."""
    file = ParameterFile(name="one axis", axes=(stage().axis("x"),))
    found = verify(file, [lateral(response=response)], scenarios=QUICK[:1], trials=())
    return {row.method: row for row in found.comparison}


def test_the_figures_foretell_stages_with_any_past(rng):
    """Nobody knows how a stage was driven before it came to rest; its figures allow for it."""
    known = PLANTS[0].response
    turned = ((10.0, -10.0, 5.0), (-10.0, 10.0))
    own = at_20_Hz(replace(known, histories_V=turned))
    each = [at_20_Hz(replace(known, history_V=past_V)) for past_V in turned]
    for method, row in own.items():
        worse_m = max(found[method].rms_m for found in each)
        assert row.rms_m == pytest.approx(worse_m, rel=0.05), method  # noise of another run
    ratios = {method: [] for method in own}
    for _ in range(6):
        past_V = tuple(rng.uniform(-10.0, 10.0, 3).tolist())
        for method, row in at_20_Hz(replace(known, history_V=past_V)).items():
            ratios[method].append(row.rms_m / own[method].rms_m)
    for method, found in ratios.items():
        assert max(found) < 2.0, method
        assert np.median(found) > 0.25, method


def test_a_path_is_judged_from_where_the_stage_was_led_to():
    """No sample of the comparison shows the jump from rest to the path, 10 um away."""
    file = ParameterFile(name="one axis", axes=(stage().axis("x"),))
    away = lateral(rest_voltage_V=3.0)
    row = verify(file, [away], scenarios=QUICK[:1], trials=()).comparison[0]
    assert row.method == "mpi_dob"
    assert row.max_m < 10.0 * row.rms_m


def test_the_record_returns_exactly_and_a_changed_bit_is_refused(whole):
    content = whole.to_json()
    assert verification_from_json(content).to_json() == content
    assert verification_from_json(content) == whole
    place = content.index(b'"radius_m": ') + 12
    changed = content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]
    with pytest.raises(ParameterFileError, match="digest"):
        verification_from_json(changed)


def test_a_record_that_compares_what_it_never_ran_is_refused(whole):
    with pytest.raises(ParameterFileError, match=r"no spiral of .* at .* Hz"):
        verification_from_json(replace(whole, spirals=whole.spirals[1:]).to_json())


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        ({"radius_m": 1e30}, "a path reaches"),
        ({"motion": {"duration_s": 0.0}}, "duration_s is 0"),
        ({"motion": {"shipped_m": (1e-9,)}}, "reference_m has 1000 points"),
        ({"motion": {"axis": "q"}}, "axis q, which does not ship"),
        ({"radius_m": 0.0}, "radius_m is 0.0"),
        ({"radius_m": -1.0}, "radius_m is -1.0"),
        ({"trace": {"frequency_Hz": 0.0}}, "frequency_Hz is 0.0"),
        ({"trace": {"x_m": (1e308,)}}, "x_m of a spiral has 1 points"),
        ({"trace": {"x_m": (), "y_m": (), "shape_error_m": ()}}, "x_m of a spiral has 0 points"),
        ({"verdict": {"limit": 1e300}}, "a limit is larger"),
    ],
)
def test_numbers_that_no_picture_can_show_are_refused(whole, changed, found):
    first = {
        "trace": lambda c: {"traces": (replace(whole.traces[0], **c), *whole.traces[1:])},
        "motion": lambda c: {"motions": (replace(whole.motions[0], **c),)},
        "verdict": lambda c: {"verdicts": (replace(whole.verdicts[0], **c),)},
    }
    for key, make in first.items():
        changed = make(changed[key]) if key in changed else changed
    with pytest.raises(ParameterFileError, match=found):
        verification_from_json(replace(whole, **changed).to_json())


def test_the_record_names_what_was_verified(whole):
    assert whole.parameters_digest == digest_of(stage())
    assert whole.runtime_digest == source_digest()
    plain = json.loads(whole.to_json())
    assert plain["schema"] == "piezoid.verification/1"
    assert plain["passed"] is True
    columns = {"method", "frequency_Hz", "rms_m", "rms_percent", "max_m"}
    assert set(plain["comparison"][0]) == columns | {"aligned_rms_m", "delay_s"}


def test_the_same_seed_gives_the_same_bytes_in_any_number_of_threads_and_another_does_not():
    runs = [
        verify(stage(), PLANTS, scenarios=QUICK[:1], trials=(), seed=s, threads=n).to_json()
        for s, n in ((3, 1), (3, 2), (4, 1))
    ]
    assert runs[0] == runs[1] != runs[2]


def test_what_ships_is_verified_and_nothing_else():
    """Without its feedback the very same file no longer passes the fault-free shape limit."""
    axes = tuple(
        replace(axis, values=axis.for_method("none").values, alternatives=())
        for axis in stage("x", "y").axes
    )
    judged = [s for s in SCENARIOS if s.name == "spiral, 10 Hz"]
    bare = verify(ParameterFile(name="bare", axes=axes), PLANTS[:2], scenarios=judged)
    failed = {v.name for v in bare.verdicts if not v.passed}
    assert "shape error of the controller" in failed
    assert not bare.passed


def furthest(found):
    return next(v.value for v in found.verdicts if v.name == "largest distance from the path")


def test_a_runtime_that_does_not_watch_its_sensor_fails_the_frozen_sensor():
    axes = tuple(a.with_values({"stuck_samples": 0}) for a in stage("x", "y").axes)
    frozen = [s for s in SCENARIOS if s.fault == 1.0]
    found = verify(ParameterFile(name="blind", axes=axes), PLANTS[:2], scenarios=frozen)
    failed = {v.name for v in found.verdicts if not v.passed}
    assert "faults not reported by the status" in failed
    watching = verify(stage("x", "y"), PLANTS[:2], scenarios=frozen)
    assert furthest(found) > 2 * furthest(watching) > 0


def test_the_worst_plant_the_uncertainty_allows_is_judged():
    spread = [s for s in SCENARIOS if s.is_varied]
    plants, limits = PLANTS[:1], Limits(varied_percent=10.0)
    runs = [
        [with_gain(lateral(), 1.0, "same")],
        [with_gain(lateral(weight_factor=3.0), 1.3, "far")],
    ]
    each = [
        verify(stage("x"), plants, variations=[r], scenarios=spread, limits=limits).verdicts[-1]
        for r in runs
    ]
    both = verify(stage("x"), plants, variations=runs, scenarios=spread, limits=limits)
    # noise differs with the order of the runs
    assert both.verdicts[-1].value == pytest.approx(max(v.value for v in each), rel=0.01)
    assert each[0].value < each[1].value


def test_a_drive_without_reserve_is_told():
    weak = [with_gain(plant, 0.3, "weak") for plant in PLANTS[:1]]
    found = verify(stage("x"), weak, scenarios=QUICK)
    failed = {(v.name, v.scenario) for v in found.verdicts if not v.passed}
    assert ("samples at a voltage limit", "spiral, 20 Hz") in failed


def test_a_tip_that_has_to_flee_is_told():
    file = stage("z")
    fast = ParameterFile(
        name="tip", axes=(file.axes[0].with_values({"current_ceiling_A": 1.002e-9}),)
    )
    slow = [s for s in SCENARIOS if s.name == "spiral, 10 Hz"]
    found = verify(fast, [junction()], scenarios=slow)
    failed = {v.name for v in found.verdicts if not v.passed}
    assert "samples with the tip retracted" in failed
    assert found.comparison == ()


def test_a_build_with_other_bits_fails_the_whole():
    other = Proof(build="another compiler", is_built=True, samples=100, differing=1)
    missing = Proof(build="none here", is_built=False)
    assert not verify(stage("x"), PLANTS[:1], scenarios=(), proofs=[other]).passed
    assert verify(stage("x"), PLANTS[:1], scenarios=(), proofs=[missing]).passed


def test_an_axis_without_a_plant_is_refused_by_name():
    with pytest.raises(ParameterFileError, match="axis y"):
        verify(stage("x", "y"), PLANTS[:1])


@pytest.mark.parametrize("how", ["lost", "frozen"])
def test_a_stage_that_flies_blind_for_ever_is_seen(how):
    scenario = next(s for s in SCENARIOS if s.name == f"spiral, 10 Hz, sensor {how} for good")
    held, endless = (
        ParameterFile(name="x", axes=(stage("x").axes[0].with_values({"blind_samples": n}),))
        for n in (2000, 0)
    )
    good, bad = (verify(f, PLANTS[:1], scenarios=(scenario,)) for f in (held, endless))
    until = "time without sensor until the output is held"
    found = {v.name: v for v in good.verdicts}
    assert good.passed
    assert 0.099 < found[until].value < 0.12
    assert not bad.passed
