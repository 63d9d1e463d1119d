"""`piezoid diagnose`: find the effects that the base model lacks."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezoid_cli.options import Force, JsonFile, Quiet, RecordingLab
from piezoid_cli.tables import budget_lines, report_table, show_statements
from piezoid_cli.terminal import display, print_raw, say, show_progress

if TYPE_CHECKING:
    from piezoid.diagnosis.compare import ModelComparison
    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.records.recording import Recording


def diagnose(
    files: Annotated[
        list[Path],
        typer.Argument(help="Recordings of one stage, in order; optionally model.json first."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    lab: RecordingLab = None,
    axis: Annotated[str | None, typer.Option(help="Axis; default: the first.")] = None,
    force: Force = False,
    quiet: Quiet = False,
    json: JsonFile = False,
) -> None:
    """Find the effects beyond hysteresis: write diagnosis.json, diagnosis.html.

    If the first file is the model.json of an earlier fit, that model is refitted, and its changes
    are reported as well.

    [bold]Examples[/bold]

    piezoid diagnose sweep.csv staircase.csv --lab lab.toml --out diag42/

    piezoid diagnose *.csv --lab lab.toml --axis y --out diag42y/ --json | jq .findings[].effect

    piezoid diagnose stage42/model.json today.csv --lab lab.toml --out today42/
    """
    from piezoid.output_folder import check_folder, write_folder
    from piezoid.raw_counts import in_counts

    inputs = [*files, *([] if lab is None else [lab])]
    names = ("diagnosis.json", "diagnosis.html")
    check_folder(out, force=force, new=True, names=names, inputs=inputs)
    with show_progress(quiet=quiet or json) as progress:
        progress("reading recordings")
        recordings, diagnosis, comparison, contents = _diagnose_files(files, lab, axis, progress)
        write_folder(out, contents, force=force)
    if json:
        print_raw(contents["diagnosis.json"])
    elif not quiet:
        if comparison is not None:
            say(in_counts(comparison.statement.text, comparison.counted))
            display("a new diagnosis of these recordings alone:")
        _show(diagnosis, recordings)
        say(f"diagnosis: {', '.join(str(out / name) for name in names)}")


def _diagnose_files(
    files: list[Path], lab: Path | None, axis: str | None, progress: "Callable[[str], None]"
) -> "tuple[Sequence[Recording], Diagnosis, ModelComparison | None, dict[str, bytes]]":
    """Return the recordings, their diagnosis, the comparison with a model, and the output."""
    from piezoid.diagnosis.compare import compare
    from piezoid.diagnosis.diagnose import diagnose as find_effects
    from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
    from piezoid.digests import digest_in
    from piezoid.identification.actuator_model import ActuatorModel
    from piezoid.identification.coupled.from_recordings import as_single_axes
    from piezoid.identification.fit import driven_recordings
    from piezoid.raw_counts import errors_in_counts, texts_in_counts
    from piezoid.records.checks import refuse_unusable
    from piezoid.records.collection import collect
    from piezoid.records.lab import read_lab
    from piezoid.records.recording import counted_in
    from piezoid.sealed_files import read_model
    from piezoid_cli.stage_files import content_of
    from piezoid_cli.workers import usable_cores
    from piezoid_reports.render import render_diagnosis

    declared = None if lab is None else read_lab(lab)
    earlier, digest, coupled = None, "", None
    if files[0].suffix.lower() == ".json":  # a model before the recordings
        if len(files) == 1:
            raise typer.BadParameter(f"{files[0]} is a model; name recordings after it")
        model_file, *files = files
        content = content_of(model_file)
        earlier, digest = read_model(content, str(model_file)), digest_in(content)
        coupled = earlier.coupled
    collected = collect(files, declared).recordings
    recordings = as_single_axes(collected, declared, coupled, progress=progress)
    refuse_unusable(recordings)
    earlier_axes = {} if earlier is None else earlier.axes
    axis = axis or next(iter(earlier_axes), None)
    earlier_axis, comparison = earlier_axes.get(axis or ""), None
    with errors_in_counts(counted_in(recordings)):
        diagnosis = find_effects(
            recordings,
            axis=axis,
            lab=declared,
            # The initial states of the model belong to the recordings of its fit.
            model=None if earlier_axis is None else replace(earlier_axis, starts=()),
            progress=progress,
            threads=usable_cores(),
        )
        if earlier is not None:
            comparison = compare(
                earlier[diagnosis.axis],
                driven_recordings(recordings, diagnosis.axis),
                digest=digest,
                progress=progress,
            )
    diagnosis = texts_in_counts(diagnosis)
    changes = None if comparison is None else comparison.to_json()
    content = write_diagnosis(diagnosis, changes=changes)
    model = ActuatorModel(
        stage=("" if declared is None else declared.name) or recordings[0].name,
        axes={} if diagnosis.model is None else {diagnosis.axis: diagnosis.model},
        sources={recording.name: recording.digest for recording in recordings},
        lab=None if declared is None else declared.digest or None,
    )
    page = render_diagnosis(model, recordings, diagnosis, comparison=comparison, written=content)
    contents = {"diagnosis.json": content, "diagnosis.html": page.encode()}
    return recordings, diagnosis, comparison, contents


def _show(diagnosis: "Diagnosis", recordings: "Sequence[Recording]") -> None:
    """Print findings, errors and statements, and the recordings that do not contribute."""
    from piezoid.diagnosis.diagnosis_statements import diagnosis_statements
    from piezoid.formatting import count_of, with_unit
    from piezoid.identification.dynamics.behind_hysteresis import excites_dynamics
    from piezoid.identification.fit import driven_recordings, recordings_of_axis
    from piezoid.raw_counts import in_counts, record_in_counts
    from piezoid.records.checks.plausibility import is_held_throughout
    from piezoid.statement import Level
    from piezoid_reports.sections.findings import findings_table

    counted = diagnosis.counted
    if diagnosis.findings:
        findings = record_in_counts(findings_table([diagnosis]), counted)
        title = f"axis {diagnosis.axis}: {count_of(len(diagnosis.findings), 'effect')} found"
        display(report_table(findings, title))
    baseline, final = (with_unit(e.rms_m, "m") for e in (diagnosis.baseline, diagnosis.final))
    is_tested = diagnosis.model is None or diagnosis.model.quality.is_tested
    name = "simulation" if diagnosis.model is None else "base model"
    line = (
        f"axis {diagnosis.axis}: {'held-out error' if is_tested else 'error in sample'} "
        f"{baseline} of the {name}, {final} of the final model; sensor noise "
        f"{with_unit(diagnosis.noise_floor_rms_m, 'm')}"
    )
    for text in (in_counts(line, counted), *budget_lines([diagnosis])):
        display(text)
    statements = diagnosis_statements(diagnosis)
    minimum = Level.ACTION if diagnosis.findings else Level.NOTE
    if any(statement.quantity == "no_effect_tested" for statement in statements):
        minimum = min(minimum, Level.WARNING)
    show_statements(record_in_counts(statements, counted), minimum)
    # Recordings that do not contribute to the diagnosis.
    axis = diagnosis.axis
    used_names = {recording.name for recording in driven_recordings(recordings, axis)}
    servo = [r.name for r in recordings_of_axis(recordings, axis) if is_held_throughout(r, axis)]
    unused = [r.name for r in recordings if r.name not in (*used_names, *servo)]
    if servo and not set(servo) & used_names:
        say(f"{', '.join(servo)}: recorded in closed loop; only creep was tested")
    fast_names = {recording.name for recording, _ in excites_dynamics(recordings, axis)}
    fast = [name for name in unused if name in fast_names]
    if fast:
        say(
            f"used for the dynamics only: {', '.join(fast)} (the drive of axis {axis} is too "
            "small to show hysteresis)"
        )
    unused = [name for name in unused if name not in fast]
    if unused:
        say(
            f"not used: {', '.join(unused)} (axis {axis} does not move or was not recorded; see "
            "piezoid inspect, or choose another --axis)"
        )
