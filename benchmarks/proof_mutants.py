"""Mutants of the runtime that the proof must refuse, as each violates a limit, a bound or C.

    python -m benchmarks.proof_mutants docs/measured/proof_mutants.md

Each row changes `piezoid_runtime.c` so that some input leads to a voltage beyond its limits, a
state beyond its bound, or undefined behaviour. A mutant counts as refused if the analysis ends
with alarms. It counts as missed if it does not parse or takes too long. The mutants are analysed
with two small axes, whose limits are not whole codes. The drive of x cannot reach 0 V.
"""

import argparse
import re
from pathlib import Path

from benchmarks.mutation_trial import ROOT
from piezoid.export.bundle import bundle
from piezoid.export.parameter_file import ParameterFile
from piezoid.numerics.executor import Executor
from piezoid.verification.limit_proof import LimitProof, prove_axis
from tests.verification.rig import stage

SOURCE = "piezoid_runtime.c"
Mutation = tuple[str, str, str]  # function, original text, mutated text

LATERAL: tuple[Mutation, ...] = (
    ("clamp", "x > low ? x : low", "x"),
    ("play_sum", "i < p->play_count", "i <= PZ_MAX_PLAYS"),
    ("play_follow", "i < p->play_count", "i <= PZ_MAX_PLAYS"),
    ("play_follow", "clamp(z[i], u - p->play_threshold_V[i], u + p->play_threshold_V[i])",
     "z[i] + u"),
    ("dead_zones", "knot[i] < ZERO", "knot[i] < ONE"),
    ("dead_zones", "i >= 0 && i < count", "i < count"),
    ("dead_zones", "i >= 0 && i < count", "i >= 0"),
    ("remember", "s->voltage_V - p->voltage_offset_V", "PZ_REAL(1e3) * s->voltage_V"),
    ("relax", "i < p->relaxation_count", "i <= PZ_MAX_RELAXATIONS"),
    ("filter", "i < count", "i <= PZ_MAX_SECTIONS"),
    ("pz_checksum", "i < sizeof(pz_parameters)", "i <= 2 * sizeof(pz_parameters)"),
    ("to_code", "--code", "++code"),
    ("to_code", "++code", "--code"),
    ("to_code", "PZ_REAL(0.5)", "PZ_REAL(1.5)"),
    ("to_code", "return (pz_real)code * p->lsb_V", "return (pz_real)(code + 1) * p->lsb_V"),
    ("convert", "clamp(wanted, p->voltage_minimum_V, p->voltage_maximum_V)", "wanted"),
    ("convert", "s->command_V = command", "s->command_V = wanted"),
    ("convert", "to_code(p, command)", "to_code(p, wanted)"),
    ("recall", "i < p->play_count", "i <= PZ_MAX_PLAYS"),
    ("start_lateral", "clamp(s->measured, p->reference_minimum_m, p->reference_maximum_m)",
     "s->measured"),
    ("take_reference", "clamp(reference, p->reference_minimum_m, p->reference_maximum_m)",
     "reference"),
    ("take_innovation", "!is_finite(measured)", "p->blind_samples < 0"),
    ("predict", "i < n", "i <= PZ_MAX_ORDER"),
    ("leaves_hold", "is_finite(measured)", "p->blind_samples > 0"),
    ("leaves_hold", "clamp(s->measured, p->reference_minimum_m, p->reference_maximum_m)",
     "s->measured"),
    ("step_lateral", "convert(s, p, volts)", "s->voltage_V = volts"),
    ("step_lateral", "!is_finite(volts) || !is_finite(command)", "s->voltage_V > volts"),
    ("idle_voltage", "clamp(ZERO, p->voltage_minimum_V, p->voltage_maximum_V)", "ZERO"),
    ("pz_step_feedforward", "return idle_voltage(parameters)", "return state->voltage_V"),
)  # fmt: skip
TIP: tuple[Mutation, ...] = (
    ("clamp", "x > low ? x : low", "x < low ? x : low"),
    ("clamp", "raised < high ? raised : high", "raised"),
    ("clamp", "raised < high ? raised : high", "raised > high ? raised : high"),
    ("dot", "i < count", "i < count + PZ_MAX_TAPS"),
    ("pz_log", "i < 7", "i <= 7"),
    ("to_code", "PZ_REAL(-0.5)", "PZ_REAL(-1.5)"),
    ("to_code", "(pz_real)code * p->lsb_V > p->voltage_maximum_V", "code > INT32_MAX - 1"),
    ("to_code", "(pz_real)code * p->lsb_V < p->voltage_minimum_V", "code < INT32_MIN + 1"),
    ("to_code", "return (pz_real)code * p->lsb_V", "return (pz_real)code / p->lsb_V"),
    ("to_code", "volts / p->lsb_V + half", "volts / (p->lsb_V * p->lsb_V) + half"),
    ("to_code", "volts / p->lsb_V + half", "volts / p->voltage_step_V + half"),
    ("convert", "clamp(wanted, p->voltage_minimum_V,", "clamp(wanted, -REAL_MAX,"),
    ("convert", "clamp(wanted, p->voltage_minimum_V, p->voltage_maximum_V)",
     "clamp(wanted, p->voltage_minimum_V, REAL_MAX)"),
    ("convert", "clamp(wanted, p->voltage_minimum_V, p->voltage_maximum_V)",
     "clamp(wanted, p->voltage_minimum_V, p->voltage_maximum_V + p->lsb_V)"),
    ("convert", "clamp(wanted, p->voltage_minimum_V, p->voltage_maximum_V)",
     "clamp(wanted, PZ_REAL(2) * p->voltage_minimum_V, p->voltage_maximum_V)"),
    ("rest_rst", "i < PZ_MAX_TAPS", "i <= PZ_MAX_TAPS"),
    ("pz_start", "clamp(is_finite(voltage_V) ? voltage_V : ZERO,\n"
     "                             parameters->voltage_minimum_V, parameters->voltage_maximum_V)",
     "voltage_V"),
    ("pz_schedule", "clamp(ratio, ONE / parameters->schedule_limit, parameters->schedule_limit)",
     "ratio"),
    ("is_stuck", "s->unchanged < p->stuck_samples", "s->unchanged >= 0"),
    ("take_current_reference", "clamp(reference_A, p->current_floor_A, p->current_ceiling_A)",
     "reference_A"),
    ("take_current_reference", "clamp(reference_A, p->current_floor_A,",
     "clamp(reference_A, ZERO,"),
    ("wait_for_current", "s->unusable < p->bad_samples", "s->unusable >= 0"),
    ("take_current", "!is_finite(current_A)", "s->unusable < 0"),
    ("retract", ": p->voltage_minimum_V", ": -p->voltage_maximum_V - ONE"),
    ("retract", "p->retract_voltage_V : p->voltage_minimum_V",
     "p->retract_voltage_V - ONE : p->voltage_minimum_V"),
    ("retract", "s->command_V - p->retract_step_V > end_V",
     "s->command_V > p->retract_step_V - ONE"),
    ("retract", "s->trips < MOST_DOUBLED ? s->trips : MOST_DOUBLED", "s->trips"),
    ("retract", "s->trips < INT32_MAX ? 1 : 0", "1"),
    ("retract", "s->command_V = target_V", "s->command_V = target_V - p->retract_step_V"),
    ("stays_retracted", "s->trip_age < p->trip_samples", "s->trip_age >= 0"),
    ("stays_retracted", "s->retract_left > 0", "s->retract_left >= 0"),
    ("stays_retracted", "s->mode = APPROACHES", "s->mode = APPROACHES + LATCHED"),
    ("touch", "s->contact < p->contact_samples ? 1 : 0", "1"),
    ("shift_in", "i > 0", "i >= 0"),
    ("shift_in", "history[i - 1]", "history[i - 2]"),
    ("control_current", "p->rst_S_count, s->command_V - before_V",
     "p->rst_S_count, asked - before_V"),
    ("pz_step_feedforward", "return state->voltage_V",
     "return state->voltage_V + state->command_V"),
)  # fmt: skip


def axes() -> ParameterFile:
    """Return two small axes whose limits lie between codes; the range of x excludes 0 V."""
    x, z = stage("x", "z").axes
    x = x.with_values({"voltage_minimum_V": 0.9999, "voltage_maximum_V": 9.79156,
                       "reference_step_m": 1e-7})  # fmt: skip
    z = z.with_values({"voltage_minimum_V": -9.99999, "voltage_maximum_V": 9.791565,
                       "retract_voltage_V": -9.5, "trip_limit": 0})  # fmt: skip
    return ParameterFile(name="two axes", axes=(x, z))


def mutate(source: str, mutation: Mutation) -> str:
    """Return the source with one change in the body of one function.

    Raises ``ValueError`` if the function does not contain the original text.
    """
    function, text, mutated = mutation
    head = re.search(rf"^[a-z].*\b{function}\([^;]*?\) \{{$", source, re.MULTILINE)
    if head is None:
        raise ValueError(f"no function {function}")
    start = head.start()
    end = source.index("\n}", start)
    body = source[start:end]
    if text not in body:
        raise ValueError(f"{function} does not hold {text!r}")
    return source[:start] + body.replace(text, mutated, 1) + source[end:]


def prove(file: ParameterFile, source: str, index: int) -> LimitProof:
    """Prove one axis in double precision with the given source of the runtime."""
    contents = {**bundle(file), SOURCE: source.encode()}
    return prove_axis(contents, file.axes[index], index, "double", limit_s=300.0)


def table(results: list[tuple[Mutation, LimitProof]]) -> str:
    """Return the page: every mutant with the first alarm of the analysis."""
    refused = sum(bool(proof.alarms) for _, proof in results)
    rows = "".join(
        f"| {proof.axis} | `{function}` | `{_cell(text)}` | `{_cell(new)}` | {_alarm(proof)} |\n"
        for (function, text, new), proof in results
    )
    return (
        "# Mutants that the proof must refuse\n\n"
        f"{refused} of {len(results)} are refused. Measured by `benchmarks/proof_mutants.py`, "
        "whose first\nlines define the counts; [What is proved about the exported C](../proof.md) "
        "states the proved properties of the runtime.\n\n"
        "| axis | function | original | mutant | alarms: the first |\n"
        "| --- | --- | --- | --- | --- |\n"
        f"{rows}"
    )


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _alarm(proof: LimitProof) -> str:
    if not proof.alarms:
        return f"**missed**: {proof.verdict}"
    location, _, alarm = proof.alarms[0].partition(" ")
    return f"{len(proof.alarms)}: {location.replace('harness.c', 'claim')} `{_cell(alarm)[:90]}`"


def main(arguments: list[str] | None = None) -> None:
    """Prove the original source, then analyse every mutant."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("page", type=Path, help="Markdown file to write.")
    parser.add_argument("--first", type=int, default=0, help="Number of mutants of each axis.")
    options = parser.parse_args(arguments)
    source = (ROOT / "piezoid" / "runtime" / SOURCE).read_text(encoding="utf-8")
    file = axes()
    for index in range(len(file.axes)):
        proof = prove(file, source, index)
        print(f"original, axis {proof.axis}: {proof.verdict}, {proof.seconds} s", *proof.alarms)
        if not proof.is_proved:
            raise SystemExit("the original runtime must be proved first")

    def analyse(task: tuple[int, Mutation]) -> tuple[Mutation, LimitProof]:
        index, mutation = task
        proof = prove(file, mutate(source, mutation), index)
        function, text, mutated = mutation
        print(proof.axis, function, _cell(text), "->", _cell(mutated), proof.verdict, flush=True)
        return mutation, proof

    tasks = [
        (index, mutation)
        for index, mutations in enumerate((LATERAL, TIP))
        for mutation in mutations[: options.first or None]
    ]
    results = Executor(threads=2).map(analyse, tasks)
    options.page.write_text(table(results), encoding="utf-8")
    print(f"{sum(bool(proof.alarms) for _, proof in results)} of {len(results)} refused")


if __name__ == "__main__":
    main()
