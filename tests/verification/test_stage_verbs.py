"""Export and verify a fitted and designed folder, then change its files."""

import json
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from piezoid.design.design_stage import design_stage
from piezoid.errors import LabFileError, ParameterFileError
from piezoid.export.export_stage import export_stage
from piezoid.export.parameter_file import from_json, to_json
from piezoid.identification.store import write_model
from piezoid.records.lab import read_lab
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.verification import verification_from_json
from piezoid.verification.verify_stage import plant_of
from piezoid_cli.export import export
from piezoid_cli.report import report
from piezoid_cli.verify import verify
from tests.design.designed import known_design
from tests.foreign_objects import KINDS, look, plant
from tests.verification.known_fit import fitted, junction_model

APP = typer.Typer()
APP.command()(export)
APP.command()(verify)
APP.command()(report)
TIGHT = "aligned_percent = 1e-4\n"
LAB_TOML = """
[sensor]
gain_V_per_m = 2e5
[acquisition]
dac_bits = 16
adc_bits = 16
input_range_V = [-10, 10]
[tunnelling]
set_point_A = 1e-9
floor_A = 1e-11
feedback_ohm = 1e9
barrier_range_eV = [0.25, 4]
"""
GUARDED = LAB_TOML + "ceiling_A = 9e-9\n"


def write_stage(folder, model, design):
    (folder / "model.json").write_bytes(write_model(model))
    (folder / "design.json").write_bytes(design.to_json())


@pytest.fixture(scope="module")
def designed():
    return known_design()


@pytest.fixture
def folder(designed, tmp_path):
    write_stage(tmp_path, fitted(), designed)
    return tmp_path


@pytest.fixture(scope="module")
def exported_once(designed, tmp_path_factory):
    folder = tmp_path_factory.mktemp("exported")
    write_stage(folder, fitted(), designed)
    succeed("export", folder)
    return folder


@pytest.fixture
def exported(exported_once, tmp_path):
    return Path(copytree(exported_once, tmp_path / "exported"))


def run_verb(*arguments):
    return CliRunner().invoke(APP, [str(argument) for argument in arguments])


def succeed(*arguments):
    result = run_verb(*arguments)
    assert result.exit_code == 0, result.output
    return result


def refusal(*arguments):
    error = run_verb(*arguments).exception
    assert isinstance(error, ParameterFileError)
    return str(error)


def names_in(folder):
    return {path.name for path in folder.iterdir()}


def test_verbs_leave_objects_of_all_kinds_in_the_folder_as_they_are(exported, tmp_path):
    names = [f"{sub}/{kind}" for sub in ("", "bundle", "refused", "mine") for kind in KINDS]
    for name in names:
        plant(kind=name.split("/")[1], path=exported / f"./{name}", beyond=tmp_path / "beyond")
    original = [look(exported / f"./{name}") for name in (*names, "beyond")]
    for verb in ("export", "verify"):
        succeed(verb, exported)
        assert [look(exported / f"./{name}") for name in (*names, "beyond")] == original
    (exported / "bundle/golden.csv").write_text("my notes")
    assert run_verb("export", exported).exception.exit_status == 2
    assert (exported / "bundle/golden.csv").read_text() == "my notes"


def test_targets_are_written_and_removed_by_the_next_export_without_them(folder):
    result = succeed("export", folder, "--target", "library", "--target", "fmu", "--json")
    listing = json.loads(result.stdout)
    assert listing["schema"] == "piezoid.exported/1"
    assert (listing["unshipped"], set(listing["methods"])) == ({}, {"x"})
    assert {"params.json", "bundle/piezo_params.h", "library/example.py"} <= set(listing["files"])
    assert all((folder / name).is_file() for name in listing["files"])
    assert names_in(folder / "fmu") == {"x_controller_fmi2.fmu", "x_plant_fmi2.fmu"}
    header = (folder / "bundle" / "piezo_params.h").read_bytes()
    assert (folder / "library" / "piezo_params.h").read_bytes() == header
    succeed("export", folder)
    assert not (folder / "fmu").exists()
    assert not (folder / "library").exists()


def test_targets_of_boxes_are_written_with_their_expected_error(folder):
    (folder / "box.toml").write_text("[pid]\nnotches = 0\n[waveform]\nrange_V = [0, 10]\n")
    targets = ("--target", "pid", "--target", "waveform")
    result = succeed("export", folder, *targets, "--box", folder / "box.toml")
    output = " ".join(result.output.split())
    assert "and no notch, a spiral of 10 Hz errs by" in output
    assert "axis x: triangle of 10.0 Hz" in output
    assert "expected on the stage" in output
    assert names_in(folder / "pid") == {"README.md", "sections.csv", "settings.csv"}
    assert names_in(folder / "waveform") == {"README.md", "x.csv", "x_int16.bin"}


def test_no_target_is_written_without_a_shipped_controller(folder):
    (folder / "lab.toml").write_text("[verification]\n" + TIGHT)
    result = run_verb("export", folder, "--target", "fmu")
    assert result.exit_code == 1
    assert "no target was written" in result.output
    assert not (folder / "fmu").exists()
    assert not (folder / "bundle").exists()


def test_an_unknown_target_is_refused_before_anything_is_written(folder):
    result = run_verb("export", folder, "--target", "simulink")
    assert result.exit_code != 0
    assert "no target 'simulink'" in str(result.exception)
    assert run_verb("verify", folder, "--target", "z80").exit_code == 2
    assert not (folder / "params.json").exists()


def test_a_designed_folder_is_exported_and_verified(exported):
    assert {"piezo_params.h", "piezoid_runtime.c", "golden.csv"} <= names_in(exported / "bundle")
    output = succeed("verify", exported, "--rebuild", "--bounds").output
    assert "a probability below 5 %" in " ".join(output.split())
    record = verification_from_json((exported / "verification.json").read_bytes())
    assert record.passed
    file = from_json((exported / "params.json").read_bytes(), "params.json")
    assert record.parameters_digest == json.loads(to_json(file))["digest"]
    assert {row.method for row in record.comparison} == {"mpi_dob", "mpi", "none"}
    assert all(proof.samples or not proof.is_built for proof in record.proofs)
    for row in record.bounds:
        assert row.simulated_m < row.probable_m <= row.worst_found_m < row.bound_m
    assert [row.axis for row in record.bounds] == ["x"] * 3
    assert len(record.plants) > 1
    assert (exported / "model.json").exists()


def test_a_verification_that_misses_a_limit_fails_and_is_written(exported):
    parameters = (exported / "params.json").read_bytes()
    (exported / "limits.toml").write_text(TIGHT)
    result = run_verb("verify", exported, "--limits", exported / "limits.toml")
    assert result.exit_code == 1
    assert "allowed 0.0001" in result.output
    (exported / "lab.toml").write_text("[verification]\n" + TIGHT)
    assert run_verb("verify", exported).exit_code == 1
    assert (exported / "params.json").read_bytes() == parameters
    record = verification_from_json((exported / "verification.json").read_bytes())
    assert record.lab_digest == read_lab(exported / "lab.toml").digest
    assert not record.passed
    assert record.bounds == ()


def test_a_guard_changed_after_the_export_is_refused(guarded, tmp_path):
    """Without the guard the tip would retract only after contact with the surface."""
    folder = Path(copytree(guarded, tmp_path / "guarded"))
    shipped = from_json((folder / "params.json").read_bytes(), "params.json")
    assert shipped.sources["lab"] == read_lab(folder / "lab.toml").digest
    (folder / "lab.toml").write_text(GUARDED.replace("9e-9", "8e-9"))
    assert "other guards than params.json was exported with" in refusal("verify", folder)
    succeed("export", folder)
    renewed = from_json((folder / "params.json").read_bytes(), "params.json")
    assert renewed.sources["lab"] == read_lab(folder / "lab.toml").digest
    assert float(renewed.axis("z").values["current_ceiling_A"]) == 8e-9
    (folder / "lab.toml").write_text(GUARDED.replace("[-10, 10]", "[-5, 5]"))
    assert "piezoid design" in refusal("export", folder)


@pytest.fixture(scope="module")
def with_tip(designed, tmp_path_factory):
    """Return model, design and laboratory of the known stage with a tip."""
    lab_file = tmp_path_factory.mktemp("lab") / "lab.toml"
    lab_file.write_text(GUARDED)
    model = junction_model()
    tip_model = replace(model, axes={})
    tip_design = design_stage(tip_model, model_digest="sha256:none", lab=read_lab(lab_file))
    digest = json.loads(write_model(model))["digest"]
    axes = (*designed.axes, *tip_design.axes)
    return model, replace(tip_design, axes=axes, model_digest=digest), read_lab(lab_file)


@pytest.fixture(scope="module")
def guarded(with_tip, tmp_path_factory):
    """Return a folder exported first without the guard of the tip, then with it."""
    folder = tmp_path_factory.mktemp("guarded")
    write_stage(folder, *with_tip[:2])
    (folder / "lab.toml").write_text(LAB_TOML)
    result = run_verb("export", folder)
    assert result.exit_code == 1
    assert "axis z does not ship" in result.output
    assert json.loads((folder / "params.json").read_bytes())["axes"][0]["axis"] == "x"
    assert b"Axis z is not included" in (folder / "bundle" / "README.md").read_bytes()
    (folder / "lab.toml").write_text(GUARDED)
    succeed("export", folder)
    return folder


def test_a_lateral_axis_and_a_tip_are_exported_and_verified(guarded):
    succeed("verify", guarded)
    record = verification_from_json((guarded / "verification.json").read_bytes())
    assert record.methods == {"x": "mpi_dob", "z": "rst"}
    current = {row.scenario: row for row in record.currents}["spiral, 10 Hz"]
    assert 0.0 < current.ln_current_std < 0.5
    assert current.retracted_samples == 0
    assert {"gain x0.5, axis z", "gain x2, axis z"} <= set(record.plants)


def test_a_stage_without_any_axis_to_ship_is_refused_with_the_line_to_write(with_tip, tmp_path):
    model, design, _ = with_tip
    unguarded = tmp_path / "lab.toml"
    unguarded.write_text(LAB_TOML)
    tip = replace(design, axes=design.axes[1:])
    with pytest.raises(LabFileError, match=r"`ceiling_A = 1e-8` under \[tunnelling\]"):
        export_stage(model, tip, design_digest="sha256:none", lab=read_lab(unguarded))


def test_readings_come_in_steps_of_the_declared_converter(with_tip, rng):
    model, design, lab = with_tip
    file = export_stage(model, design, design_digest="sha256:none", lab=lab)
    x, z = (plant_of(axis, model, lab) for axis in file.axes)
    assert z.reading_step == pytest.approx(20 / 2**16 / 1e9)
    assert z.reading_range == (-1e-8, 1e-8)
    assert x.reading_step == pytest.approx(20 / 2**16 / 2e5)
    steps = run_axis(x, file.axis("x"), np.full(50, 5e-6), rng=rng).measured / x.reading_step
    assert steps == pytest.approx(np.round(steps), abs=1e-6)


def test_a_refitted_model_is_refused(exported):
    refitted = replace(fitted(), stage="another")
    (exported / "model.json").write_bytes(write_model(refitted))
    for verb in ("export", "verify"):
        assert "was made from the model" in refusal(verb, exported)


def test_another_design_than_the_exported_design_is_refused(exported, designed):
    redesigned = replace(designed, remarks=("made again",))
    (exported / "design.json").write_bytes(redesigned.to_json())
    for flags in ((), ("--bounds",)):
        assert "not the design" in refusal("verify", exported, *flags)


def test_a_verdict_counts_only_for_the_bundle_it_was_computed_from(exported, designed):

    def reported():
        result = succeed("report", exported, "--force")
        page = (exported / "report.html").read_text()
        return "not verified" not in page, " ".join(result.output.split())

    assert reported()[0]
    runtime = exported / "bundle/piezoid_runtime.c"
    original = runtime.read_bytes()
    for content in (None, original + b" "):
        runtime.write_bytes(content) if content else runtime.unlink()
        is_verified, output = reported()
        assert not is_verified
        assert "bundle/piezoid_runtime.c is missing or changed; run piezoid export" in output
    result = run_verb("verify", exported)
    assert result.exit_code == 1
    assert "piezoid_runtime.c" in result.output
    assert b'"passed": false' in (exported / "verification.json").read_bytes()
    runtime.write_bytes(original)
    succeed("verify", exported)
    assert reported()[0]
    (exported / "lab.toml").write_text("[acquisition]\ninput_range_V = [-1, 1]\n")
    is_verified, output = reported()
    assert not is_verified
    assert "the rig in lab.toml was changed; run piezoid design" in output
    assert "another rig" in str(run_verb("verify", exported).exception)
    (exported / "lab.toml").unlink()
    redesigned = replace(designed, remarks=("made again",))
    (exported / "design.json").write_bytes(redesigned.to_json())
    is_verified, output = reported()
    assert not is_verified
    assert "params.json (exported from another design.json; run piezoid export" in output
