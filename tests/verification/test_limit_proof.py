"""Proofs of the shipped C: correct code is proved, broken or unanalysed code is not."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.proof_mutants import LATERAL, SOURCE, TIP, mutate
from piezoid.errors import ParameterFileError
from piezoid.export.bundle import bundle, runtime_source
from piezoid.export.export_stage import function_values
from piezoid.operators.preisach_plays import PreisachPlays
from piezoid.verification.limit_proof import TOOL, LimitProof, prove, prove_axis
from piezoid.verification.verification import verification_from_json
from piezoid.verification.verify import verify
from tests.verification.rig import PLANTS, stage

PROVED = LimitProof(
    axis="x", precision="float", tool="Frama-C 25.0, EVA", claims=("it is so",), seconds=7
)
ALARM = "piezoid_runtime.c:603 (to_code) is_nan_or_infinite: x"


@pytest.fixture
def tool():
    if shutil.which(TOOL) is None:
        pytest.skip(f"no {TOOL} on this machine: nothing is proved here")


@pytest.mark.usefixtures("tool")
def test_the_tip_is_proved_and_a_step_without_limits_raises_an_alarm():
    file = stage("z")
    files = bundle(file)
    proof = prove_axis(files, file.axes[0], 0, "float")
    assert (proof.verdict, proof.alarms) == ("proved", ())
    assert proof.tool.startswith("Frama-C")
    assert any("inside the limits" in claim for claim in proof.claims)
    step = "step_rst(state, parameters, reference, measured)"
    slip = ("pz_step_feedforward", step, "state->voltage_V += ONE")
    source = mutate(files[SOURCE].decode(), slip)
    disproof = prove_axis({**files, SOURCE: source.encode()}, file.axes[0], 0, "float")
    assert not disproof.passed
    assert any("voltage_maximum_V" in alarm for alarm in disproof.alarms)


@pytest.mark.usefixtures("tool")
def test_an_axis_of_plays_behind_functions_is_proved():
    edge_V = np.linspace(-12.0, 12.0, 3)
    straight = PreisachPlays(step_V=3.0, edge_V=edge_V, value_m=np.tile(edge_V, (2, 1)))
    rise_m = np.random.default_rng(0).uniform(1e-7, 2e-6, (2, 2))
    file = stage("x")
    values = dict(file.axes[0].values) | {"knot_count": 0, "envelope_count": 0}
    values |= function_values(straight.with_rises(rise_m)) | {"play_memory_V": np.zeros(2)}
    axis = replace(file.axes[0], values=values)
    files = bundle(replace(file, axes=(axis, *file.axes[1:])))
    proof = prove_axis(files, axis, 0, "float")
    assert (proof.verdict, proof.alarms) == ("proved", ())


@pytest.mark.usefixtures("tool")
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("pz_real pz_step_feedforward(", "pz_real pz_stop(", "no body of pz_step_feedforward"),
        ("    state->ready = READY;", "    while (1) {\n    }", "never reached"),
        ("#include <float.h>", "#error broken", "ended with"),
    ],
)
def test_an_incomplete_analysis_is_no_proof(old, new, message):
    file = stage("z")
    source = runtime_source(SOURCE).decode().replace(old, new)
    proof = prove_axis({**bundle(file), SOURCE: source.encode()}, file.axes[0], 0, "double")
    assert not proof.is_proved
    assert not proof.passed
    assert message in proof.verdict


@pytest.mark.usefixtures("tool")
def test_a_proof_beyond_its_time_limit_fails():
    file = stage("z")
    proof = prove_axis(bundle(file), file.axes[0], 0, "double", limit_s=0.01)
    assert proof.verdict == "not proved: stopped after 0.01 s"
    assert not proof.passed


def test_without_the_tool_nothing_is_claimed_and_nothing_fails(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    proofs = prove(stage("x", "z"))
    assert [(p.axis, p.precision) for p in proofs] == [
        *(("x", "double"), ("x", "float")),
        *(("z", "double"), ("z", "float")),
    ]
    assert all(p.verdict == "not proved here: no frama-c" for p in proofs)
    assert all(p.passed and not p.is_proved for p in proofs)


def test_an_edited_bundle_is_not_proved():
    with pytest.raises(ParameterFileError, match="bundle/"):
        prove(stage("x"), {})


def test_an_alarm_fails_the_verification_and_is_in_its_file():
    alarmed = replace(PROVED, alarms=(ALARM,))
    for proof, passed in ((PROVED, True), (alarmed, False)):
        verification = replace(verify(stage("x"), PLANTS[:1], scenarios=()), limit_proofs=(proof,))
        assert verification.passed is passed
        read = verification_from_json(verification.to_json())
        assert read.limit_proofs == (proof,)
    assert alarmed.verdict == "not proved: 1 alarm"
    assert PROVED.verdict == "proved"
    assert not replace(PROVED, claims=()).is_proved


def test_every_mutant_changes_the_source():
    source = runtime_source(SOURCE).decode()
    assert len(LATERAL) + len(TIP) >= 50
    assert len({mutate(source, slip) for slip in LATERAL + TIP}) == len(LATERAL) + len(TIP)
    with pytest.raises(ValueError, match="clamp does not hold"):
        mutate(source, ("clamp", "x ==", "x !="))
