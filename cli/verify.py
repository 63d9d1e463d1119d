"""`piezoid verify`: runs what ships against the identified stage, and says whether it may ship."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezoid_cli.statements import MAX_SHOWN
from piezoid_cli.terminal import Force, Quiet, StageLab, hand_over, plain, say, table

if TYPE_CHECKING:
    from rich.table import Table

    from piezoid.design.design import Design
    from piezoid.export.parameter_file import ParameterFile
    from piezoid.numerics.executor import Executor
    from piezoid.verification.criteria import Verdict
    from piezoid.verification.limit_proof import LimitProof
    from piezoid.verification.rebuild import Proof
    from piezoid.verification.verification import ErrorBound, Verification

CORE_Hz = 168e6  # a usual Cortex-M4F, to compare instructions with


def verify(
    stage: Annotated[Path, typer.Argument(help="Folder with model.json, params.json, bundle/.")],
    rebuild: Annotated[
        bool, typer.Option("--rebuild", help="Compile bundle/ here and compare every bit.")
    ] = False,
    target: Annotated[
        str, typer.Option(help="cortex-m4: compile bundle/ for it and emulate it.")
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
        Path | None, typer.Option(help="limits.toml; by default \\[verification] of lab.toml.")
    ] = None,
    lab: StageLab = None,
    seed: Annotated[int, typer.Option(help="Random seed.", min=0)] = 0,
    force: Force = False,
    quiet: Quiet = False,
    json: Annotated[
        bool, typer.Option("--json", help="For scripts: print verification.json itself.")
    ] = False,
) -> None:
    """Run the compiled controller of params.json against the stage; write verification.json.

    Exit status 1 means that a verdict failed; verification.json is still written.

    [bold]Examples[/bold]

    piezoid verify stage42/

    piezoid verify stage42/ --rebuild --target cortex-m4 --json | jq .passed

    piezoid verify stage42/ --prove

    piezoid verify stage42/ --bounds
    """
    if target not in ("", "cortex-m4"):
        raise typer.BadParameter(f"--target {target!r} is not known; cortex-m4 is")
    from piezoid.errors import ParameterFileError
    from piezoid.export.parameter_file import from_json
    from piezoid.numerics.executor import Executor
    from piezoid.output_folder import add_to_folder, check_folder
    from piezoid.sealed_files import read_model
    from piezoid.verification.criteria import limits_from_toml
    from piezoid.verification.verify_stage import verify_stage
    from piezoid_cli.progress import shown
    from piezoid_cli.stage_files import changed_in_bundle, content_of, lab_of, same_model, text_of
    from piezoid_cli.workers import usable_cores

    file = from_json(content_of(stage / "params.json"), str(stage / "params.json"))
    content = content_of(stage / "model.json")
    model = read_model(content, str(stage / "model.json"))
    same_model(content, file.sources.get("model", ""), "params.json", "piezoid export")
    design = _design(stage, file) if bounds or (stage / "design.json").exists() else None
    declared = lab_of(stage, lab)
    if design is not None and declared is not None and design.rig_digest != declared.rig_digest:
        raise ParameterFileError(
            f"{declared.place} declares another rig than the design was made for",
            needed="the converters, amplifiers and set point of the design",
            remedy=f"Run `piezoid design {stage}`, then `piezoid export {stage}`.",
        )
    chosen = None if limits is None else limits_from_toml(text_of(limits), limits.name)
    check_folder(stage, force=force, names=("verification.json",))
    with shown(quiet=quiet or json) as told:
        told("compiling and comparing" if rebuild or target else "running the controller")
        held = _held(stage / "bundle")
        proofs = _proofs(file, held, is_host=rebuild, is_target=target != "")
        proved = (
            _proved(file, held, Executor(progress=told, threads=usable_cores())) if prove else ()
        )
        told("running the compiled controller against the stage")
        found = verify_stage(
            file,
            model,
            lab=declared,
            limits=chosen,
            proofs=proofs,
            limit_proofs=proved,
            seed=seed,
            threads=usable_cores(),
            design=design if bounds else None,
            bounds=bounds,
        )
        if changed := changed_in_bundle(stage, file):
            found = replace(found, verdicts=(*found.verdicts, _changed(changed)))
        written = found.to_json()
        add_to_folder(stage, {"verification.json": written}, force=force)
    if json:
        hand_over(written)
    elif not quiet:
        show(found, file)
        say(f"verification: {stage / 'verification.json'}")
    if not found.passed:
        raise typer.Exit(1)


def _changed(names: Sequence[str]) -> "Verdict":
    """Return the verdict on a bundle that is not what was run."""
    from piezoid.verification.criteria import Verdict

    return Verdict(
        name="files of bundle/ that are missing or not those of params.json",
        scenario=", ".join(names),
        value=float(len(names)),
        limit=0.0,
        unit="1",
    )


def _design(stage: Path, file: "ParameterFile") -> "Design":
    """Return the design that the parameters were exported from, or refuse another one."""
    from json import loads

    from piezoid.design.design import design_from_json
    from piezoid.errors import ParameterFileError
    from piezoid_cli.stage_files import content_of

    place = stage / "design.json"
    content = content_of(place)
    design = design_from_json(content, str(place))
    if str(loads(content)["digest"]) != file.sources.get("design"):
        raise ParameterFileError(
            f"{place} is not the design that params.json was exported from",
            needed="files of one and the same design",
            remedy="Run `piezoid export` again, then verify.",
        )
    return design


def _held(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.glob("*")) if p.is_file()}


def _proofs(
    file: "ParameterFile", held: Mapping[str, bytes], *, is_host: bool, is_target: bool
) -> "tuple[Proof, ...]":
    from piezoid.verification.rebuild import emulate, rebuild

    host = rebuild(file, held) if is_host else ()
    return (*host, *((emulate(file, held),) if is_target else ()))


def _proved(
    file: "ParameterFile", held: Mapping[str, bytes], executor: "Executor"
) -> "tuple[LimitProof, ...]":
    from piezoid.verification.limit_proof import prove

    executor.report("proving that no input exceeds a limit, about a minute per axis")
    return prove(file, held, executor=executor)


def show(found: "Verification", file: "ParameterFile") -> None:
    """Print the comparison, the proofs, and the verdicts that failed."""
    from rich.console import Console

    from piezoid.verification.criteria import describe_failure

    console = Console()
    if found.comparison:
        console.print(_comparison(found))
    for row in found.bounds:
        console.print(plain(_bound_line(row)))
    for proof in found.proofs:
        console.print(plain(_proof_line(proof, file), style="" if proof.passed else "bold red"))
    for claimed in found.limit_proofs:
        console.print(plain(_claim_line(claimed), style="" if claimed.passed else "bold red"))
    failed = [verdict for verdict in found.verdicts if not verdict.passed]
    for verdict in failed[:MAX_SHOWN]:
        console.print(plain(f"failed: {describe_failure(verdict)}", style="bold red"))
    if len(failed) > MAX_SHOWN:
        console.print(plain(f"{len(failed) - MAX_SHOWN} more failed: see verification.json"))
    n_passed = len(found.verdicts) - len(failed)
    console.print(plain(f"{n_passed} of {len(found.verdicts)} verdicts passed"))


def _comparison(found: "Verification") -> "Table":
    """Return the rms error of each method, spirals of one rate in a column."""
    from piezoid.formatting import with_unit

    rates_Hz = sorted({row.frequency_Hz for row in found.comparison})
    errors_m = {(row.method, row.frequency_Hz): row.rms_m for row in found.comparison}
    rows = [
        (
            method,
            *(
                with_unit(errors_m[method, rate_Hz], "m") if (method, rate_Hz) in errors_m else ""
                for rate_Hz in rates_Hz
            ),
        )
        for method in dict.fromkeys(row.method for row in found.comparison)
    ]
    title = f"spirals of radius {with_unit(found.radius_m, 'm')}: rms error by frequency"
    return table(title, ("method", *(with_unit(rate, "Hz") for rate in rates_Hz)), rows, left=1)


def _bound_line(row: "ErrorBound") -> str:
    from piezoid.formatting import with_unit

    bounded = "not bounded" if row.bound_m is None else f"bounded by {with_unit(row.bound_m, 'm')}"
    if row.is_exceeded:
        bounded += " (but not on all stages drawn here: some are farther from the model's class)"
    return (
        f"axis {row.axis}, at most {with_unit(row.slew_m_per_s, 'm/s')}: {bounded}, below "
        f"{with_unit(row.probable_m, 'm')} with {100.0 * row.probability:g} % probability, worst "
        f"found {with_unit(row.worst_found_m, 'm')}, simulated {with_unit(row.simulated_m, 'm')}"
    )


def _claim_line(claimed: "LimitProof") -> str:
    line = f"axis {claimed.axis}, {claimed.precision}: {claimed.verdict}"
    if claimed.is_proved:
        line += f" by {claimed.tool} in {claimed.seconds} s: for every input, for ever, "
        line += "; ".join(claimed.claims)
    return "\n  ".join((line, *claimed.alarms))


def _proof_line(proof: "Proof", file: "ParameterFile") -> str:
    if not proof.is_built:
        return f"not built: {proof.build}"
    line = f"{proof.build}: {proof.samples} samples, {proof.differing} differ"
    counted = proof.instructions_per_sample or {}
    for axis, instructions in counted.items():
        rate_Hz = float(file.axis(axis).values["sampling_rate_Hz"])
        share = 100.0 * instructions * rate_Hz / CORE_Hz
        line += f"; axis {axis} {instructions:.0f} instructions a sample, {share:.1f} % of a core"
    if counted:
        line += f" of {1e-6 * CORE_Hz:.0f} MHz at one instruction a cycle"
    if proof.stack_bytes:
        line += f"; {proof.stack_bytes} bytes of stack, {proof.state_bytes} of state for each axis"
    return line
