"""Verify a stage: which controllers pass, which fail, and the record of the result."""

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
FAST_SPIRALS = tuple(s for s in SCENARIOS if s.name in ("spiral, 20 Hz", "spiral, 100 Hz"))


def changed(*axes, **values):
    """Return the stage of these axes with other values."""
    new_axes = tuple(axis.with_values(values) for axis in stage(*axes).axes)
    return ParameterFile(name="changed", axes=new_axes)


def failed_names(result):
    return {verdict.name for verdict in result.verdicts if not verdict.passed}


@pytest.fixture(scope="module")
def verification():
    variations = [[with_gain(p, g, f"gain x{g}") for p in PLANTS[:2]] for g in (0.9, 1.1)]
    return verify(stage(), PLANTS, variations=variations)


def test_a_sound_stage_passes_every_scenario_and_trial(verification):
    assert [v for v in verification.verdicts if not v.passed] == []
    assert verification.passed
    assert {v.scenario for v in verification.verdicts} == NAMES | TRIALS | {"all"}


def test_the_table_has_every_method_at_every_frequency_once(verification):
    rows = [(row.method, row.frequency_Hz) for row in verification.comparison]
    compared = {s.frequency_Hz for s in SCENARIOS if s.is_compared}
    assert len(rows) == len(set(rows)) == 4 * len(compared)
    assert {m for m, _ in rows} == {"none", "mpi", "dob", "mpi_dob"}
    steady, hurried = (
        next(
            row.ln_current_std
            for row in verification.currents
            if row.scenario == f"spiral, {f} Hz"
        )
        for f in (1, 100)
    )
    assert hurried > 3 * steady  # the loop does not follow the surface at 100 Hz


def test_with_a_good_model_the_combination_is_never_worse_than_the_observer_alone(verification):
    aligned_by_row = {
        (row.method, row.frequency_Hz): row.aligned_rms_m for row in verification.comparison
    }
    for (method, f), aligned_m in aligned_by_row.items():
        if method == "mpi_dob":
            assert aligned_m < aligned_by_row["dob", f] < aligned_by_row["none", f]


def at_20_Hz(response):
    """Return the errors of every method at 20 Hz for a plant with this response."""
    result = verify(
        stage("x"), [lateral(response=response)], scenarios=FAST_SPIRALS[:1], trials=()
    )
    return {row.method: row for row in result.comparison}


def test_the_figures_predict_stages_with_any_drive_history(rng):
    """The drive history before rest is unknown, so the figures cover all histories."""
    response = PLANTS[0].response
    histories_V = ((10.0, -10.0, 5.0), (-10.0, 10.0))
    combined = at_20_Hz(replace(response, histories_V=histories_V))
    separate = [at_20_Hz(replace(response, history_V=past_V)) for past_V in histories_V]
    for method, row in combined.items():
        largest_m = max(rows[method].rms_m for rows in separate)
        assert row.rms_m == pytest.approx(largest_m, rel=0.05), method  # the noise differs
    ratios = {method: [] for method in combined}
    for _ in range(6):
        past_V = tuple(rng.uniform(-10.0, 10.0, 3).tolist())
        for method, row in at_20_Hz(replace(response, history_V=past_V)).items():
            ratios[method].append(row.rms_m / combined[method].rms_m)
    for method, values in ratios.items():
        assert max(values) < 2.0, method
        assert np.median(values) > 0.25, method


def test_the_approach_to_the_path_is_not_in_the_comparison():
    """The comparison excludes the jump of 10 um from rest to the path."""
    plant = lateral(rest_voltage_V=3.0)
    row = verify(stage("x"), [plant], scenarios=FAST_SPIRALS[:1], trials=()).comparison[0]
    assert row.method == "mpi_dob"
    assert row.max_m < 10.0 * row.rms_m


def test_the_record_returns_exactly_and_a_changed_bit_is_refused(verification):
    content = verification.to_json()
    assert verification_from_json(content).to_json() == content
    assert verification_from_json(content) == verification
    offset = content.index(b'"radius_m": ') + 12
    changed = content[:offset] + bytes([content[offset] ^ 1]) + content[offset + 1 :]
    with pytest.raises(ParameterFileError, match="digest"):
        verification_from_json(changed)


def test_a_record_with_a_comparison_but_no_spiral_is_refused(verification):
    with pytest.raises(ParameterFileError, match=r"no spiral of .* at .* Hz"):
        verification_from_json(replace(verification, spirals=verification.spirals[1:]).to_json())


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"radius_m": 1e30}, "radius_m: Expected `float` <= 1000"),
        ({"motion": {"duration_s": 0.0}}, "duration_s: Expected `float` >= 1e-09"),
        ({"motion": {"shipped_m": (1e-9,)}}, "reference_m has 1000 points"),
        ({"motion": {"axis": "q"}}, "axis q, which does not ship"),
        ({"radius_m": 0.0}, "radius_m is 0.0"),
        ({"radius_m": -1.0}, "radius_m is -1.0"),
        ({"trace": {"frequency_Hz": 0.0}}, "frequency_Hz: Expected `float` >= 1e-09"),
        ({"trace": {"x_m": (1e308,)}}, r"x_m\[0\]: Expected `float` <= 1000"),
        ({"trace": {"x_m": (1e-6,)}}, "x_m of a spiral has 1 points"),
        ({"trace": {"x_m": (), "y_m": (), "shape_error_m": ()}}, "x_m of a spiral has 0 points"),
        ({"verdict": {"limit": 1e300}}, "limit: Expected `float` <= 1000000000"),
    ],
)
def test_numbers_outside_the_range_of_the_plots_are_refused(verification, changed, message):
    changes = {
        "trace": lambda c: {
            "traces": (replace(verification.traces[0], **c), *verification.traces[1:])
        },
        "motion": lambda c: {"motions": (replace(verification.motions[0], **c),)},
        "verdict": lambda c: {"verdicts": (replace(verification.verdicts[0], **c),)},
    }
    for key, change in changes.items():
        changed = change(changed[key]) if key in changed else changed
    with pytest.raises(ParameterFileError, match=message):
        verification_from_json(replace(verification, **changed).to_json())


def test_the_record_names_what_was_verified(verification):
    assert verification.parameters_digest == digest_of(stage())
    assert verification.runtime_digest == source_digest()
    document = json.loads(verification.to_json())
    assert document["schema"] == "piezoid.verification/1"
    assert document["passed"] is True
    columns = {"method", "frequency_Hz", "rms_m", "rms_percent", "max_m"}
    assert set(document["comparison"][0]) == columns | {"aligned_rms_m", "delay_s"}


def test_the_same_seed_gives_the_same_bytes_in_any_number_of_threads_and_another_does_not():
    runs = [
        verify(stage(), PLANTS, scenarios=FAST_SPIRALS[:1], trials=(), seed=s, threads=n).to_json()
        for s, n in ((3, 1), (3, 2), (4, 1))
    ]
    assert runs[0] == runs[1] != runs[2]


def test_the_shipped_method_decides_the_verdict():
    """The same file without feedback misses the limit of the fault-free shape error."""
    axes = tuple(
        replace(axis, values=axis.for_method("none").values, alternatives=())
        for axis in stage("x", "y").axes
    )
    scenarios = [s for s in SCENARIOS if s.name == "spiral, 10 Hz"]
    result = verify(ParameterFile(name="bare", axes=axes), PLANTS[:2], scenarios=scenarios)
    assert "shape error of the controller" in failed_names(result)
    assert not result.passed


def largest_distance_m(result):
    return next(v.value for v in result.verdicts if v.name == "largest distance from the path")


def test_a_runtime_that_does_not_watch_its_sensor_fails_the_frozen_sensor():
    frozen = [s for s in SCENARIOS if s.fault == 1.0]
    blind = verify(changed("x", "y", stuck_samples=0), PLANTS[:2], scenarios=frozen)
    assert "faults not reported by the status" in failed_names(blind)
    watching = verify(stage("x", "y"), PLANTS[:2], scenarios=frozen)
    assert largest_distance_m(blind) > 2 * largest_distance_m(watching) > 0


def test_the_worst_variation_decides_the_verdict():
    scenarios = [s for s in SCENARIOS if s.is_varied]
    plants, limits = PLANTS[:1], Limits(varied_percent=10.0)
    runs = [
        [with_gain(lateral(), 1.0, "same")],
        [with_gain(lateral(weight_factor=3.0), 1.3, "far")],
    ]
    separate = [
        verify(stage("x"), plants, variations=[r], scenarios=scenarios, limits=limits).verdicts[-1]
        for r in runs
    ]
    combined = verify(stage("x"), plants, variations=runs, scenarios=scenarios, limits=limits)
    # noise differs with the order of the runs
    assert combined.verdicts[-1].value == pytest.approx(max(v.value for v in separate), rel=0.01)
    assert separate[0].value < separate[1].value


def test_a_saturated_drive_fails():
    weak = [with_gain(plant, 0.3, "weak") for plant in PLANTS[:1]]
    result = verify(stage("x"), weak, scenarios=FAST_SPIRALS)
    failed = {(v.name, v.scenario) for v in result.verdicts if not v.passed}
    assert ("samples at a voltage limit", "spiral, 20 Hz") in failed


def test_a_tip_that_retracts_fails():
    guarded = changed("z", current_ceiling_A=1.002e-9)
    scenarios = [s for s in SCENARIOS if s.name == "spiral, 10 Hz"]
    result = verify(guarded, [junction()], scenarios=scenarios)
    assert "samples with the tip retracted" in failed_names(result)
    assert result.comparison == ()


def test_differing_builds_fail_and_an_axis_without_a_plant_is_refused():
    differing = Proof(build="another compiler", is_built=True, samples=100, differing=1)
    not_built = Proof(build="none here", is_built=False)
    verification = verify(stage("x"), PLANTS[:1], scenarios=())
    assert not replace(verification, proofs=(differing,)).passed
    assert replace(verification, proofs=(not_built,)).passed
    with pytest.raises(ParameterFileError, match="axis y"):
        verify(stage("x", "y"), PLANTS[:1])


@pytest.mark.parametrize("fault", ["lost", "frozen"])
def test_a_loop_without_sensor_must_hold_its_output(fault):
    scenario = next(s for s in SCENARIOS if s.name == f"spiral, 10 Hz, sensor {fault} for good")
    passing, failing = (
        verify(changed("x", blind_samples=n), PLANTS[:1], scenarios=(scenario,)) for n in (2000, 0)
    )
    name = "time without sensor until the output is held"
    by_name = {v.name: v for v in passing.verdicts}
    assert passing.passed
    assert 0.099 < by_name[name].value < 0.12
    assert not failing.passed
