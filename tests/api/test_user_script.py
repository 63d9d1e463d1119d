"""Types of the public names in a script of a user, checked by mypy --strict."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

import piezoid

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("mypy") is None, reason="mypy is not installed"),
]

SCRIPT = '''
"""Calibrate a stage from two recordings."""

from pathlib import Path

import piezoid


def calibrated(folder: Path) -> piezoid.Verification:
    """Return the verification of the controller, and write model, C source and report."""
    lab = piezoid.read_lab(folder / "lab.toml")
    recordings = piezoid.read(folder / "sweep.csv", folder / "check.csv", lab=lab)
    model = piezoid.fit(recordings, lab=lab)
    diagnosis = piezoid.diagnose(recordings, model=model, lab=lab)
    model = model.extended(diagnosis)
    design = piezoid.design(model, lab=lab, sampling_rate_Hz=20_000.0)
    shipping = piezoid.export(model, design, lab=lab)
    if shipping.parameters is None:
        raise SystemExit(f"not shipped: {shipping.reasons}")
    verification = piezoid.verify(shipping.parameters, model, lab=lab, design=design)
    page = piezoid.report(
        model, recordings, diagnoses=[diagnosis], design=design, shipping=shipping, lab=lab
    )
    (folder / "report.html").write_text(page, encoding="utf-8")
    piezoid.save(model, folder / "model.json")
    piezoid.plot(model)
    for record in (model, diagnosis, design, verification):
        print(record, record.summary())
    error_m: float = model["x"].quality.held_out_rms_m
    names: list[str] = [finding.effect for finding in diagnosis.findings]
    voltage_V = model.inverse(model.predict(recordings[0]))
    print(f"{1e9 * error_m:.1f} nm", names, voltage_V.max())
    return verification


if __name__ == "__main__":
    raise SystemExit(not calibrated(Path("stage42")).passed)
'''
MISTAKES = """
import piezoid

model = piezoid.fit(piezoid.read("sweep.csv"))
print(model["x"].quality.held_out_rms_nm)
piezoid.design(model, sampling_rate_kHz=20.0)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder whose ``names`` links to the package, installed or a checkout."""
    folder = tmp_path_factory.mktemp("script")
    (folder / "names").mkdir()
    (folder / "names" / "piezoid").symlink_to(Path(piezoid.__file__).parent)
    return folder


def mypy_output(folder: Path, script: str) -> str:
    """Return the messages of mypy --strict about a script."""
    (folder / "script.py").write_text(script, encoding="utf-8")
    options = ("--strict", "--follow-imports=silent", "--no-error-summary", "--config-file=")
    run = subprocess.run(
        [sys.executable, "-m", "mypy", *options, f"--cache-dir={folder / 'cache'}", "script.py"],
        cwd=folder,
        env={**os.environ, "MYPYPATH": str(folder / "names")},
        capture_output=True,
        text=True,
        check=False,
    )
    return run.stdout + run.stderr


def test_a_users_script_passes_mypy_strict(folder):
    assert mypy_output(folder, SCRIPT) == ""


def test_mypy_finds_a_misspelt_field_and_argument(folder):
    complaints = mypy_output(folder, MISTAKES)
    assert 'has no attribute "held_out_rms_nm"' in complaints
    assert 'Unexpected keyword argument "sampling_rate_kHz"' in complaints
