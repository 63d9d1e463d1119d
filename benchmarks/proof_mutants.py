"""Broken runtimes that a proof must refuse: every one leaves a limit, a bound, or C itself.

    python -m benchmarks.proof_mutants docs/measured/proof_mutants.md

Each row is one slip of the hand in `piezoid_runtime.c` that some input, some day, turns into a
voltage beyond its limits, a state beyond its bound, or an operation that C leaves undefined. A
mutant counts as refused where the analysis came to its end with alarms; one that does not parse or
takes too long counts as missed. Two small axes are proved: their limits are not whole codes, and
the drive of x does not reach down to 0.
"""

import argparse
import re
from collections.abc import Callable
from pathlib import Path

from benchmarks.mutation_trial import ROOT
from piezoid.export.bundle import bundle
from piezoid.export.parameter_file import ParameterFile
from piezoid.numerics.executor import Executor
from piezoid.verification.limit_proof import LimitProof, prove_axis
from tests.verification.rig import stage

SOURCE = "piezoid_runtime.c"
Slip = tuple[str, str, str]  # function, text, what stands there instead

LATERAL: tuple[Slip, ...] = (
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
TIP: tuple[Slip, ...] = (
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
    """Return two small axes whose limits lie between codes; x cannot put out 0 V."""
    x, z = stage("x", "z").axes
    x = x.with_values({"voltage_minimum_V": 0.9999, "voltage_maximum_V": 9.79156,
                       "reference_step_m": 1e-7})  # fmt: skip
    z = z.with_values({"voltage_minimum_V": -9.99999, "voltage_maximum_V": 9.791565,
                       "retract_voltage_V": -9.5, "trip_limit": 0})  # fmt: skip
    return ParameterFile(name="two axes", axes=(x, z))


def broken(source: str, slip: Slip) -> str:
    """Return the source with one slip in the body of one function.

    Raises ``ValueError`` where the text does not stand there, so that no mutant is the original.
    """
    function, text, instead = slip
    found = re.search(rf"^[a-z].*\b{function}\([^;]*?\) \{{$", source, re.MULTILINE)
    if found is None:
        raise ValueError(f"no function {function}")
    head = found.start()
    tail = source.index("\n}", head)
    body = source[head:tail]
    if text not in body:
        raise ValueError(f"{function} does not hold {text!r}")
    return source[:head] + body.replace(text, instead, 1) + source[tail:]


def trial(file: ParameterFile, source: str, slip: Slip | None, place: int) -> LimitProof:
    """Prove one axis in double precision with a slip in the source, or with none."""
    made = source if slip is None else broken(source, slip)
    contents = {**bundle(file), SOURCE: made.encode()}
    return prove_axis(contents, file.axes[place], place, "double", limit_s=300.0)


def table(tried: list[tuple[str, Slip, LimitProof]]) -> str:
    """Return the page: every mutant with what the analysis said first."""
    refused = sum(bool(proof.alarms) for _, _, proof in tried)
    rows = "".join(
        f"| {axis} | `{slip[0]}` | `{_cell(slip[1])}` | `{_cell(slip[2])}` | {_said(proof)} |\n"
        for axis, slip, proof in tried
    )
    return (
        "# Mutants that the proof must refuse\n\n"
        f"{refused} of {len(tried)} are refused. Measured by `benchmarks/proof_mutants.py`, whose "
        "first\nlines say what counts; [](../proof.md) says what is proved of the runtime as it "
        "ships.\n\n"
        "| axis | function | instead of | stands | said first |\n| --- | --- | --- | --- | --- |\n"
        f"{rows}"
    )


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _said(proof: LimitProof) -> str:
    if not proof.alarms:
        return f"**missed**: {proof.verdict}"
    place, _, what = proof.alarms[0].partition(" ")
    return f"{len(proof.alarms)}: {place.replace('harness.c', 'claim')} `{_cell(what)[:90]}`"


def main(given: list[str] | None = None) -> None:
    """Prove the unbroken source, then refuse every broken one."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("page", type=Path, help="Markdown to write.")
    parser.add_argument("--first", type=int, default=0, help="Only so many of each axis.")
    chosen = parser.parse_args(given)
    source = (ROOT / "piezoid" / "runtime" / SOURCE).read_text(encoding="utf-8")
    file = axes()
    for place in range(len(file.axes)):
        whole = trial(file, source, None, place)
        print(f"unbroken, axis {whole.axis}: {whole.verdict}, {whole.seconds} s", *whole.alarms)
        if not whole.is_proved:
            raise SystemExit("the unbroken runtime must be proved first")
    count = chosen.first or None
    wanted = [(place, slip) for place, all_ in enumerate((LATERAL, TIP)) for slip in all_[:count]]
    tried = Executor(threads=2).map(_trier(file, source), wanted)
    chosen.page.write_text(table(tried), encoding="utf-8")
    print(f"{sum(bool(proof.alarms) for _, _, proof in tried)} of {len(tried)} refused")


def _trier(
    file: ParameterFile, source: str
) -> Callable[[tuple[int, Slip]], tuple[str, Slip, LimitProof]]:
    def tried(one: tuple[int, Slip]) -> tuple[str, Slip, LimitProof]:
        place, slip = one
        proof = trial(file, source, slip, place)
        print(proof.axis, slip[0], _cell(slip[1]), "->", _cell(slip[2]), proof.verdict, flush=True)
        return proof.axis, slip, proof

    return tried


if __name__ == "__main__":
    main()
