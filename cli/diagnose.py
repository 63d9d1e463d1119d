"""`piezoid diagnose`: recordings in, what the simulation gets wrong and why out."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezoid_cli.statements import show_statements
from piezoid_cli.terminal import Force, Quiet, hand_over, plain, say, table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.table import Table

    from piezoid.diagnosis.compare import ModelComparison
    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.identification.actuator_model import ActuatorModel
    from piezoid.identification.model import AxisModel
    from piezoid.records.recording import Recording

    _Model = tuple[ActuatorModel, str]  # and the digest of its file
    from piezoid.records.lab import Lab


def diagnose(
    files: Annotated[
        list[Path],
        typer.Argument(help="Recordings of one stage, in order; an older model.json in front."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    lab: Annotated[Path | None, typer.Option(help="lab.toml: rig, columns and units.")] = None,
    axis: Annotated[str | None, typer.Option(help="Which axis; default: the first.")] = None,
    force: Force = False,
    quiet: Quiet = False,
    json: Annotated[
        bool, typer.Option("--json", help="For scripts: print diagnosis.json itself.")
    ] = False,
) -> None:
    """Find the effects that hysteresis alone does not explain: write diagnosis.json and .html.

    Errors are those of the fitted model. If the first file is the model.json of an earlier fit,
    that model is refitted, and changes since then are reported as well.

    [bold]Examples[/bold]

    piezoid diagnose sweep.csv staircase.csv --lab lab.toml --out diag42/

    piezoid diagnose *.csv --lab lab.toml --axis y --out diag42y/ --json | jq .findings[].effect

    piezoid diagnose stage42/model.json today.csv --lab lab.toml --out today42/
    """
    from piezoid.output_folder import check_folder, write_folder
    from piezoid_cli.progress import shown
    from piezoid_cli.workers import usable_cores

    written = ("diagnosis.json", "diagnosis.html")
    read = [*files, *([] if lab is None else [lab])]
    check_folder(out, force=force, new=True, names=written, inputs=read)
    with shown(quiet=quiet or json) as told:
        told("reading recordings")
        from piezoid.diagnosis.diagnose import diagnose as find
        from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
        from piezoid.identification.coupled.from_recordings import as_single_axes
        from piezoid.raw_counts import errors_in_counts, in_counts, texts_in_counts
        from piezoid.records.checks import refuse_unusable
        from piezoid.records.collection import collect
        from piezoid.records.lab import read_lab
        from piezoid.records.recording import counted_in

        declared = None if lab is None else read_lab(lab)
        model, rest = _model_in_front(files)
        coupled = None if model is None else model[0].coupled
        recordings = collect(rest, declared).recordings
        recordings = as_single_axes(recordings, declared, coupled, progress=told)
        refuse_unusable(recordings)
        with errors_in_counts(counted_in(recordings)):
            diagnosis = find(
                recordings,
                axis=axis or _first(model),
                lab=declared,
                model=None if model is None else _known(model, axis),
                progress=told,
                threads=usable_cores(),
            )
            comparison = (
                None if model is None else _compared(model, recordings, diagnosis.axis, told)
            )
        diagnosis = texts_in_counts(diagnosis)
        since = None if comparison is None else comparison.to_json()
        content = write_diagnosis(diagnosis, since=since)
        page = diagnosis_page(diagnosis, recordings, declared, content, comparison)
        pages = {"diagnosis.json": content, "diagnosis.html": page.encode()}
        write_folder(out, pages, force=force)
    if json:
        hand_over(content)
    elif not quiet:
        _show(diagnosis, out)
        _tell_unused(recordings, diagnosis.axis)
        if comparison is not None:
            say(in_counts(comparison.statement.text, comparison.counted))


def _model_in_front(files: list[Path]) -> "tuple[_Model | None, list[Path]]":
    """Return the model named before the recordings, if there is one, and the recordings."""
    from json import loads

    from piezoid.sealed_files import read_model
    from piezoid_cli.stage_files import content_of

    if files[0].suffix.lower() != ".json":
        return None, files
    if len(files) == 1:
        raise typer.BadParameter(f"{files[0]} is a model; name recordings behind it")
    content = content_of(files[0])
    return (read_model(content, str(files[0])), str(loads(content)["digest"])), files[1:]


def _first(model: "_Model | None") -> str | None:
    return None if model is None else next(iter(model[0].axes), None)


def _known(model: "_Model", axis: str | None) -> "AxisModel | None":
    """Return an axis of the earlier model, without the memory of the recordings of then."""

    known = model[0].axes.get(axis or _first(model) or "")
    return None if known is None else replace(known, starts=())


def _compared(
    model: "_Model", recordings: "Sequence[Recording]", axis: str, told: "Callable[[str], None]"
) -> "ModelComparison":
    from piezoid.diagnosis.compare import compare
    from piezoid.identification.fit import moving

    known, digest = model
    return compare(known[axis], moving(recordings, axis), digest=digest, progress=told)


def _tell_unused(recordings: "Sequence[Recording]", axis: str) -> None:
    """Print which recordings do not contribute to the diagnosis of an axis."""
    from piezoid.identification.fit import moving, recorded_of
    from piezoid.records.checks.feedback import is_held_throughout

    used = {recording.name for recording in moving(recordings, axis)}
    held = [r.name for r in recorded_of(recordings, axis) if is_held_throughout(r, axis)]
    unused = [r.name for r in recordings if r.name not in (*used, *held)]
    if held and not set(held) & used:
        say(f"{', '.join(held)}: recorded in closed loop; only creep was tested")
    if unused:
        say(
            f"not used: {', '.join(unused)} (axis {axis} does not move or was not recorded; see "
            "piezoid inspect, or choose another --axis)"
        )


def _show(found: "Diagnosis", out: Path) -> None:
    from rich.console import Console

    from piezoid.diagnosis.diagnosis_statements import diagnosis_statements
    from piezoid.formatting import with_unit
    from piezoid.raw_counts import in_counts, record_in_counts
    from piezoid.statement import Level

    console = Console()
    if found.findings:
        console.print(_table(found))
    before, after = with_unit(found.baseline.rms_m, "m"), with_unit(found.final.rms_m, "m")
    noise = with_unit(found.noise_floor_rms_m, "m")
    line = (
        f"axis {found.axis}: held-out error {before} without the findings, {after} with "
        f"them; sensor noise {noise}"
    )
    console.print(plain(in_counts(line, found.counted)))
    facts = diagnosis_statements(found)
    least = Level.ACTION if found.findings else Level.NOTE
    if any(fact.quantity == "no_effect_tested" for fact in facts):
        least = min(least, Level.WARNING)
    show_statements(record_in_counts(facts, found.counted), least)
    console.print(plain(f"details: {out / 'diagnosis.html'}"))


def _table(found: "Diagnosis") -> "Table":
    from piezoid.diagnosis.diagnosis_statements import largest_first
    from piezoid.formatting import significant

    rows = [
        (
            finding.effect + (f" ({finding.coordinate})" if finding.coordinate else ""),
            f"{100 * finding.held_out_gain:.1f} %",
            f"{significant(finding.size.value)} {finding.size.unit}",
            " .. ".join(significant(end) for end in finding.size.ci95),
            ", ".join(finding.not_separable_from),
        )
        for finding in largest_first(found)
    ]
    headings = ("effect", "gain", "size", "95 %", "not separable from")
    return table(f"axis {found.axis}: {len(found.findings)} effects found", headings, rows, left=5)


def diagnosis_page(
    found: "Diagnosis",
    recordings: "Sequence[Recording]",
    lab: "Lab | None",
    written: bytes,
    comparison: "ModelComparison | None" = None,
) -> str:
    """Return the page of one diagnosis.

    recordings  that were diagnosed
    lab         what the laboratory declares
    written     diagnosis.json, for the chain of digests
    comparison  of the earlier model that was named before the recordings
    """
    from piezoid.identification.actuator_model import ActuatorModel
    from piezoid_reports.render import render_diagnosis

    model = ActuatorModel(
        stage=(lab.name if lab is not None else "") or recordings[0].name,
        axes={} if found.model is None else {found.axis: found.model},
        sources={recording.name: recording.digest for recording in recordings},
        lab=None if lab is None else lab.digest or None,
    )
    return render_diagnosis(model, recordings, found, comparison=comparison, written=written)
