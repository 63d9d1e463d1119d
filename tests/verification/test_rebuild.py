"""The packaged library, a rebuilt bundle and an emulated core give the same bits."""

import pytest

from piezoid.errors import ParameterFileError, RuntimeLibraryError
from piezoid.export.bundle import bundle
from piezoid.verification.rebuild import (
    SAMPLES,
    Proof,
    compare,
    emulate,
    expected_outputs,
    rebuild,
)
from tests.runtime.compiler import require_tool
from tests.verification.rig import stage

CORE_Hz, RATE_Hz = 168e6, 20e3


def on_target(file):
    proof = emulate(file)
    if not proof.is_built:
        pytest.skip(proof.build)
    return proof


def test_a_rebuilt_bundle_answers_bit_for_bit_in_both_precisions():
    require_tool("cc", "gcc", "clang")
    proofs = rebuild(stage())
    assert [proof.samples for proof in proofs] == [3 * SAMPLES] * 2
    assert all(proof.is_built and proof.passed and proof.differing == 0 for proof in proofs)


def test_the_emulated_core_answers_bit_for_bit_and_has_time_to_spare():
    proof = on_target(stage())
    assert (proof.samples, proof.differing) == (3 * SAMPLES, 0)
    counted = proof.instructions_per_sample
    assert set(counted) == {"x", "y", "z"}
    assert all(100 < n < 0.5 * CORE_Hz / RATE_Hz for n in counted.values())
    assert 0 < proof.stack_bytes < 1024


def test_differing_answers_are_counted_and_missing_answers_refused(tmp_path):
    file = stage("x")
    answers = bytearray(expected_outputs(file, "float"))
    answers[8 * 4321] ^= 1
    (tmp_path / "answers.bin").write_bytes(bytes(answers))
    proof = compare(tmp_path, ("echo", "0 0 0 0 892"), file, "float", build="echo")
    assert (proof.samples, proof.differing) == (SAMPLES, 1)
    (tmp_path / "answers.bin").write_bytes(b"")
    with pytest.raises(RuntimeLibraryError, match="0 bytes"):
        compare(tmp_path, ("echo", "0 0 0 0 892"), stage("x"), "float", build="")


def test_an_edited_bundle_is_refused_by_name():
    files = dict(bundle(stage("x")))
    files["piezoid_runtime.c"] += b"\n"
    with pytest.raises(ParameterFileError, match=r"bundle/piezoid_runtime\.c"):
        rebuild(stage("x"), files)
    with pytest.raises(ParameterFileError, match="bundle/"):
        emulate(stage("x"), {})


def test_without_a_compiler_nothing_is_claimed(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    for proof in (*rebuild(stage("x")), emulate(stage("x"))):
        assert not proof.is_built
        assert "on this machine" in proof.build
        assert proof.samples == 0
    assert not Proof(build="empty", is_built=True).passed


def test_a_cross_compiler_without_its_c_library_claims_nothing(monkeypatch, tmp_path):
    """Such a compiler prints the bare name of the missing library."""
    for name in ("arm-none-eabi-gcc", "qemu-system-arm"):
        (tmp_path / name).write_text("#!/bin/sh\necho rdimon.specs\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    proof = emulate(stage("x"))
    assert not proof.is_built
    assert "no rdimon.specs" in proof.build
