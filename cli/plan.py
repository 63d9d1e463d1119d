"""`piezoid plan`: compute the drive of the next experiment for an open question."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piezoid_cli.options import Force, JsonFile, Quiet
from piezoid_cli.tables import table
from piezoid_cli.terminal import display, print_raw, rich_text, show_progress

if TYPE_CHECKING:
    from collections.abc import Sequence

    from piezoid.diagnosis.experiment import Plan
    from piezoid_cli.stage_files import StageFolder


CHIRP_TO_RESONANCE = 2.0  # end of a chirp over the resonance that it shows


def plan(
    stage: Annotated[Path, typer.Argument(help="Folder with model.json and diagnosis.json.")],
    files: Annotated[
        list[Path] | None,
        typer.Argument(help="The diagnosed recordings, to compare the new drive with."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the plan; default: the stage folder.")
    ] = None,
    lab: Annotated[
        Path | None,
        typer.Option(help="lab.toml with range, slew and clock; default: in the stage folder."),
    ] = None,
    axis: Annotated[
        str | None, typer.Option(help="Axis; default: the first diagnosed axis.")
    ] = None,
    effect: Annotated[
        str | None, typer.Option(help="Effect to target; default: the least certain.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Sampling rate of the converters in Hz.", min=0.0)
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed.")] = 0,
    force: Force = False,
    quiet: Quiet = False,
    json: JsonFile = False,
) -> None:
    """Plan the next experiment: write drive.csv and plan.json.

    The plan answers an open question of the diagnosis, such as an effect that the recordings
    cannot show. `piezoid fit` states which gaps of the recordings limit the model.

    [bold]Examples[/bold]

    piezoid plan stage42/ sweep.csv steps.csv --lab lab.toml --out next/

    piezoid plan stage42/ --effect creep --out next/ --json | jq .alternatives[].name

    Every drive stays inside the recorded range and the limits of lab.toml. If no drive resolves
    the question, the best drive is written with its expected benefit and the limit that prevents
    a better one ("answers": false in plan.json). Exit status 3 means that no drive shows the
    effect.
    """
    from piezoid.digests import digest_in
    from piezoid.output_folder import add_to_folder, check_folder, write_folder
    from piezoid_cli.stage_files import StageFolder, content_of

    if out is None:
        check_folder(stage, force=force, names=("drive.csv", "plan.json"))
    else:
        read = [*(files or ()), stage / "model.json", *([] if lab is None else [lab])]
        check_folder(out, force=force, new=True, inputs=read)
    with show_progress(quiet=quiet or json) as progress:
        progress("reading the stage")
        from piezoid.diagnosis.experiment import plan as choose
        from piezoid.diagnosis.planning.plan_file import plan_files
        from piezoid.diagnosis.sealed_diagnosis import read_diagnoses
        from piezoid.records.collection import collect

        folder, path = StageFolder(stage, lab), stage / "diagnosis.json"
        model_digest, content = folder.model_digest, content_of(path)
        diagnoses = read_diagnoses(content, str(path))
        diagnosis = next((d for d in diagnoses if axis in (None, d.axis)), None)
        if diagnosis is None:
            axes = ", ".join(d.axis for d in diagnoses)
            raise typer.BadParameter(f"--axis {axis}: {path} contains {axes}")
        model, declared = folder.model, folder.lab
        collected = collect(files or (), declared)
        progress("simulating candidate drives")
        planned = choose(
            model,
            diagnosis,
            lab=declared,
            recordings=collected.recordings,
            effect=effect,
            clock_Hz=rate,
            seed=seed,
        )
        written = plan_files(
            planned, model_digest=model_digest, diagnosis_digest=digest_in(content)
        )
        if out is None:
            add_to_folder(stage, written, force=force)
        else:
            write_folder(out, written, force=force)
    if json:
        print_raw(written["plan.json"])
    elif not quiet:
        missing = model.missing_recordings(collected.files, axis=planned.axis) if files else ""
        _show(planned, (_controller_limit(folder, planned), missing))
        display(f"drive: {(out or stage) / 'drive.csv'}")


def _controller_limit(folder: "StageFolder", planned: "Plan") -> str:
    """Return what limits the controller of an axis and calls for a chirp; empty if nothing does.

    A plan answers the questions of the diagnosis, and a chirp for the dynamics is not one of them.
    """
    from piezoid.design.design_statements import design_statements
    from piezoid.diagnosis.planning.candidate_drives import MULTISINE_BAND
    from piezoid.errors import ParameterFileError
    from piezoid.formatting import with_unit

    axis, limits = folder.model[planned.axis], []
    if (folder.folder / "design.json").exists():
        with suppress(ParameterFileError):  # a design of an earlier fit
            statements = design_statements(folder.design, folder.model)
            limits = [
                s.text for s in statements if s.axis == axis.axis and s.quantity == "bandwidth"
            ]
    if axis.bandwidth is not None and axis.unfitted_resonance_Hz is not None:
        limits.append(axis.bandwidth.text)
    if not limits and not axis.has_dynamics:
        limits.append(
            f"No resonance or pole of axis {axis.axis} was fitted: for a fast controller record a "
            "small chirp first, sampled at three times the resonance or faster."
        )
    if not limits:
        return ""
    highest_Hz = MULTISINE_BAND * planned.bench.clock_Hz
    highest = with_unit(highest_Hz, "Hz", 2)
    resonance_Hz = axis.unfitted_resonance_Hz
    scope = f"None of the drives below replaces this chirp: they end at {highest}."
    if resonance_Hz is not None and CHIRP_TO_RESONANCE * resonance_Hz <= highest_Hz:
        scope = f"Of the drives below, small_multisine excites this band, up to {highest}."
    return f"{' '.join(limits)} {scope} The plan answers a question of the diagnosis."


def _show(planned: "Plan", preface: "Sequence[str]") -> None:
    """Print the plan after the sentences of a preface, which may be empty."""
    from piezoid.diagnosis.planning.open_questions import expected_limit_m
    from piezoid.diagnosis.planning.plan_file import sentences, standard_error
    from piezoid.formatting import resolved_percent, with_unit

    for sentence in filter(None, preface):
        display(sentence, "bold")
    for sentence in sentences(planned):
        display(sentence)
    # Separability is only defined if two effects compete.
    question = planned.question
    is_single, is_detection = question.kind != "separate", question.kind == "detect"
    headings = ("drive", "duration", *(() if is_single else ("separability",)))
    rows: list[tuple[Any, ...]] = []
    for candidate in planned.alternatives:
        name, estimate = candidate.name, candidate.estimate
        if estimate is None:
            rows.append((name, *[""] * (len(headings) - 1), candidate.refusal))
            continue
        rows.append(
            (
                rich_text(name, style="bold" if name == planned.drive.name else ""),
                f"{candidate.duration_s:.0f} s",
                *(() if is_single else (resolved_percent(estimate.separability),)),
                with_unit(expected_limit_m(question, planned.recorded, estimate), "m", 2)
                if is_detection
                else standard_error(question, estimate),
            )
        )
    title = f"axis {planned.axis}: {' against '.join(question.effects)}"
    if is_detection and question.limit_m is not None:
        title += f", so far detected from {with_unit(question.limit_m, 'm')} rms"
    source = "with the recordings" if planned.recorded is not None else "without the recordings"
    quantity = "detection limit, rms" if is_detection else "standard error of the size"
    last_heading = f"expected {quantity}, {source}"
    display(table(title, (*headings, last_heading), rows, n_words=1))
    is_best = planned.drive.name == planned.alternatives[0].name
    why = "the best drive" if is_best else "the shortest drive of at least 90 % of the best score"
    remark = "" if planned.answers else ", which does not answer the question"
    display(f"Chosen: {planned.drive.name}, {why}{remark}.")
