"""`piezoid verify`: run the shipped controller on the identified stage."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezoid_cli.options import ForceEdited, JsonFile, Quiet, StageLab
from piezoid_cli.tables import MAX_SHOWN, report_table
from piezoid_cli.terminal import display, print_raw, say, show_progress

if TYPE_CHECKING:
    from piezoid.design.design import Design
    from piezoid.verification.verification import Verification
    from piezoid_cli.stage_files import StageFolder
    from piezoid_reports.page import Page


def verify(
    stage: Annotated[Path, typer.Argument(help="Folder with model.json, params.json, bundle/.")],
    rebuild: Annotated[
        bool,
        typer.Option(
            "--rebuild",
            help="Compile bundle/; compare every output bit with the packaged library.",
        ),
    ] = False,
    target: Annotated[
        str, typer.Option(help="cortex-m4: compile bundle/ for that core and emulate it.")
    ] = "",
    prove: Annotated[
        bool,
        typer.Option(
            "--prove", help="Prove with Frama-C that the output never leaves its limits."
        ),
    ] = False,
    bounds: Annotated[
        bool, typer.Option("--bounds", help="Report probable and worst-case errors.")
    ] = False,
    limits: Annotated[
        Path | None, typer.Option(help="limits.toml; default: \\[verification] of lab.toml.")
    ] = None,
    lab: StageLab = None,
    seed: Annotated[int, typer.Option(help="Random seed.", min=0)] = 0,
    force: ForceEdited = False,
    quiet: Quiet = False,
    json: JsonFile = False,
) -> None:
    """Run the compiled controller of params.json on the simulated stage: write verification.json.

    Exit status 1 means that a verdict failed; verification.json is still written. It contains
    only the results of this run: repeat --rebuild, --prove and --bounds to keep theirs.

    [bold]Examples[/bold]

    piezoid verify stage42/

    piezoid verify stage42/ --rebuild --target cortex-m4 --json | jq .passed

    piezoid verify stage42/ --prove

    piezoid verify stage42/ --bounds
    """
    if target not in ("", "cortex-m4"):
        raise typer.BadParameter(f"--target {target!r} is unknown; the only target is cortex-m4")
    from piezoid.numerics.executor import Executor
    from piezoid.output_folder import add_to_folder, check_folder
    from piezoid.verification.criteria import limits_from_toml, none_of
    from piezoid.verification.limit_proof import prove as prove_limits
    from piezoid.verification.rebuild import emulate
    from piezoid.verification.rebuild import rebuild as build_on_host
    from piezoid.verification.verify_stage import verify_stage
    from piezoid_cli.stage_files import StageFolder, changed_in_bundle, text_of
    from piezoid_cli.workers import usable_cores
    from piezoid_reports.page import Page

    folder = StageFolder(stage, lab)
    file, model = folder.parameters, folder.model
    design = _design(folder) if bounds or (stage / "design.json").exists() else None
    applied_limits = None if limits is None else limits_from_toml(text_of(limits), limits.name)
    check_folder(stage, force=force, names=("verification.json",))
    threads = usable_cores()
    with show_progress(quiet=quiet or json) as progress:
        progress("compiling and comparing" if rebuild or target else "running the controller")
        paths = [path for path in sorted((stage / "bundle").glob("*")) if path.is_file()]
        bundle = {path.name: path.read_bytes() for path in paths}
        proofs = build_on_host(file, bundle) if rebuild else ()
        proofs = (*proofs, emulate(file, bundle)) if target else proofs
        if prove:
            progress("proving that no input exceeds a limit, about a minute per axis")
        executor = Executor(progress=progress, threads=threads)
        limit_proofs = prove_limits(file, bundle, executor=executor) if prove else ()
        progress("running the compiled controller against the stage")
        verification = verify_stage(
            file,
            model,
            lab=folder.lab,
            limits=applied_limits,
            seed=seed,
            threads=threads,
            design=design if bounds else None,
            bounds=bounds,
        )
        verification = replace(verification, proofs=proofs, limit_proofs=limit_proofs)
        if changed := changed_in_bundle(stage, file):
            name = "files of bundle/ that are missing or differ from those of params.json"
            verdict = none_of(name, ", ".join(changed), len(changed))
            verification = replace(verification, verdicts=(*verification.verdicts, verdict))
        content = verification.to_json()
        add_to_folder(stage, {"verification.json": content}, force=force)
    if json:
        print_raw(content)
    elif not quiet:
        show(Page(model=model, design=design, verification=verification), verification)
        say(f"verification: {stage / 'verification.json'}")
    if not verification.passed:
        raise typer.Exit(1)


def _design(folder: "StageFolder") -> "Design":
    """Return the design of the parameters; raise if the design or the rig has changed since."""
    from piezoid.design.design import design_from_json
    from piezoid.digests import digest_in
    from piezoid.errors import ParameterFileError
    from piezoid_cli.stage_files import content_of

    path, lab = folder.folder / "design.json", folder.lab
    content = content_of(path)
    design = design_from_json(content, str(path))
    if digest_in(content) != folder.parameters.sources.get("design"):
        raise ParameterFileError(
            f"{path} is not the design from which params.json was exported",
            needed="files of the same design",
            remedy="Run `piezoid export` again, then verify.",
        )
    if lab is not None and design.rig_digest != lab.rig_digest:
        stage = folder.folder
        raise ParameterFileError(
            f"{lab.place} declares another rig than that of the design",
            needed="the converters, amplifiers and set point of the design",
            remedy=f"Run `piezoid design {stage}`, then `piezoid export {stage}`.",
        )
    return design


def show(page: "Page", verification: "Verification") -> None:
    """Print the comparison, the proofs, and the verdicts that failed."""
    from piezoid.verification.criteria import describe_failure
    from piezoid_reports.parts import with_rows
    from piezoid_reports.sections.verification import bounds_table, comparison_table, proof_tables

    comparison = comparison_table(page, verification)
    bounds, proofs = bounds_table(verification), proof_tables(verification)
    for table in with_rows(comparison, *proofs, bounds):
        display(report_table(table))
        if table.details and table not in proofs:
            display(f"({table.details})")
    failed = [verdict for verdict in verification.verdicts if not verdict.passed]
    for verdict in failed[:MAX_SHOWN]:
        display(f"failed: {describe_failure(verdict)}", "bold red")
    if len(failed) > MAX_SHOWN:
        display(f"{len(failed) - MAX_SHOWN} more failed: see verification.json")
    n_all = len(verification.verdicts)
    display(f"{n_all - len(failed)} of {n_all} checks passed")
