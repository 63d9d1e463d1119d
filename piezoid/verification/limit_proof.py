"""Prove by abstract interpretation that the exported C never exceeds a limit, for any input.

Frama-C's EVA (Bühler 2017, *Structuring an abstract interpreter through value and state
abstractions*) interprets the runtime with the parameters of this stage on *sets* of numbers. In
every step, reference and reading are the set of all numbers, with NaN and infinities. The loop is
iterated until no step adds a value to the sets. A property of these sets holds in every run.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from subprocess import TimeoutExpired, run
from tempfile import TemporaryDirectory

import numpy as np

from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.numerics.executor import SERIAL, Executor
from piezoid.verification.rebuild import check_bundle

TOOL = "frama-c"
LIMIT_s = 600  # an axis takes 6 to 25 s of an idle core; a loaded machine takes longer
PRECISIONS: Mapping[str, str] = {"double": "", "float": "-DPZ_REAL_FLOAT"}
_ANALYSIS = (
    *("-no-unicode", "-machdep", "gcc_x86_64"),
    *("-kernel-warn-key", "parser:decimal-float=inactive"),
    *("-warn-special-float", "none"),  # infinity and NaN are values here, not errors
    *("-eva", "-eva-precision", "3", "-eva-no-show-progress"),
    # The table of pz_check has 75 rows; a loop over it is followed row by row.
    *("-eva-auto-loop-unroll", "100", "-eva-split-return-function", "is_finite:0:1,pz_start:0"),
)
_ROUNDED = 1 + 1e-5  # factor of the bounds: sums of a few floats have relative errors of 1e-6
_VALID = ("Valid", "Considered valid")
# The tool has built-in specifications of these functions; it must read the body of any other.
_SPECIFIED = frozenset({"memset", "Frama_C_nondet"})
_UNSPECIFIED = re.compile(
    r"using specification for function (\w+)|Neither code nor.* function (\w+)"
)

_WITHIN = "\\is_finite({0}) && p->voltage_minimum_V <= {0} <= p->voltage_maximum_V"
# The program that is proved: a start with any values, then endless steps.
_HARNESS = """\
#include "piezo_params.h"
#include "piezoid_runtime.h"
#include "__fc_builtin.h"
static pz_state state;
static volatile pz_real any;
int main(void) {
    const pz_parameters *const p = &piezo_params[AXIS];
    pz_real u = pz_step_feedforward(&state, p, any, any, any);
    //@ check @WITHIN@;
    if (pz_start(&state, p, any, any) != PZ_OK) {
        return 1;
    }
    while (1) {
        if (Frama_C_nondet(0, 1)) {
            pz_reset(&state);
        }
        if (Frama_C_nondet(0, 1)) {
            pz_schedule(&state, p, any);
        }
        u = pz_step_feedforward(&state, p, any, any, any);
@CHECKS@
    }
}
"""


@dataclass(frozen=True, kw_only=True)
class LimitProof:
    """Proof for one axis in one precision, for every input and any number of samples.

    axis       name
    precision  ``double`` or ``float``
    tool       with its version; empty if it is not installed
    claims     properties to be proved, in words
    alarms     places where a fault or the violation of a claim cannot be excluded
    why_not    reason for a missing result; empty if there is a result
    seconds    of a core, the only number here that differs from run to run
    """

    axis: str
    precision: str
    tool: str
    claims: tuple[str, ...] = ()
    alarms: tuple[str, ...] = ()
    why_not: str = ""
    seconds: int = 0

    @property
    def is_proved(self) -> bool:
        """Whether all claims hold and no operation of the C can fail."""
        return bool(self.tool and self.claims) and not (self.alarms or self.why_not)

    @property
    def passed(self) -> bool:
        """Whether the proof succeeded, or no tool for it is installed."""
        return self.is_proved or not self.tool

    @property
    def verdict(self) -> str:
        """``proved``, or the reason in a few words."""
        if not self.tool:
            return f"not proved here: no {TOOL}"
        if self.why_not:
            return f"not proved: {self.why_not}"
        count = len(self.alarms)
        return "proved" if not count else f"not proved: {count} alarm{'s' * (count > 1)}"


def prove(
    file: ParameterFile,
    contents: Mapping[str, bytes] | None = None,
    *,
    executor: Executor = SERIAL,
) -> tuple[LimitProof, ...]:
    """Prove the bundle's C for every axis of a parameter file, in both precisions.

    contents  the bundle's files to be checked; by default made of the parameter file

    Raises ``ParameterFileError`` for a bundle that was not made of this parameter file.
    """
    bundle_files = check_bundle(file, contents)
    jobs = [(index, real) for index in range(len(file.axes)) for real in PRECISIONS]
    return tuple(
        executor.map(lambda job: prove_axis(bundle_files, file.axes[job[0]], job[0], job[1]), jobs)
    )


def prove_axis(
    contents: Mapping[str, bytes],
    axis: AxisParameters,
    index: int,
    precision: str,
    *,
    limit_s: float = LIMIT_s,
) -> LimitProof:
    """Prove the claims for any sources of the runtime, with the parameters of one axis.

    contents  at least ``piezoid_runtime.h``, ``piezoid_runtime.c`` and ``piezo_params.h``
    index     of the axis in ``piezo_params``
    limit_s   after which the tool is stopped without a result
    """
    if which(TOOL) is None:
        return LimitProof(axis=axis.axis, precision=precision, tool="")
    claims = _claims(axis)
    with TemporaryDirectory(prefix="piezoid-") as name:
        folder = Path(name)
        for file_name, content in contents.items():
            (folder / file_name).write_bytes(content)
        checks = "\n".join(f"        //@ check {condition};" for condition in claims.values())
        harness = _HARNESS.replace("@WITHIN@", _WITHIN.format("u")).replace("@CHECKS@", checks)
        (folder / "harness.c").write_text(harness, encoding="utf-8")
        flags = f"-DAXIS={index} {PRECISIONS[precision]}".strip()
        alarms, why_not = _analyse(folder, flags, harness.splitlines(), limit_s)
        times = folder / "time.txt"  # absent where the tool was stopped before it could write it
        words = times.read_text(encoding="utf-8").split() if times.is_file() else []
        version = run(
            (TOOL, "-version"), cwd=folder, capture_output=True, text=True, timeout=60, check=False
        )
        return LimitProof(
            axis=axis.axis,
            precision=precision,
            tool=f"Frama-C {version.stdout.strip() or 'of unknown version'}, EVA",
            claims=("no operation of the C fails", *claims),
            alarms=alarms,
            why_not=why_not,
            seconds=round(float(words[-1])) if words else 0,
        )


def _analyse(
    folder: Path, flags: str, harness: Sequence[str], limit_s: float
) -> tuple[tuple[str, ...], str]:
    """Run the tool; return its alarms, and a reason if there is no result."""
    # The tool resolves paths relative to PWD, not to its working directory: paths are absolute.
    sources = [str(folder / name) for name in ("harness.c", "piezoid_runtime.c")]
    table = folder / "proved.csv"
    command = (
        *(TOOL, f"-cpp-extra-args=-I{folder} {flags}", *_ANALYSIS),
        *("-time", str(folder / "time.txt"), *sources, "-then", "-report-csv", str(table)),
    )
    try:
        completed = run(
            command, cwd=folder, capture_output=True, text=True, timeout=limit_s, check=False
        )
    except TimeoutExpired:
        return (), f"stopped after {limit_s:g} s"
    if completed.returncode != 0 or not table.is_file():
        errors = [
            line for line in (completed.stdout + completed.stderr).splitlines() if "rror" in line
        ]
        return (), f"{TOOL} ended with {completed.returncode}: {' '.join(errors[:2])[:300]}"
    functions = {name for pair in _UNSPECIFIED.findall(completed.stdout) for name in pair if name}
    unread = sorted(functions - _SPECIFIED)
    if unread:
        return (), f"no body of {', '.join(unread)}"
    if "done for function main" not in completed.stdout:
        return (), "the analysis did not come to its end"
    # Every claim must be in the table of all properties, and be reachable.
    with table.open(encoding="utf-8", newline="") as opened:
        rows = list(csv.DictReader(opened, delimiter="\t", quoting=csv.QUOTE_NONE))
    claimed = {str(k) for k, line in enumerate(harness, start=1) if "//@ check" in line}
    states = {row["line"]: row["status"] for row in rows if row["file"] == "harness.c"}
    missing = sorted(claimed - set(states), key=int)
    dead = sorted((line for line in claimed & set(states) if "ead" in states[line]), key=int)
    alarms = tuple(
        "{file}:{line} ({function}) {property kind}: {property}".format_map(row)
        for row in rows
        if "ead" not in row["status"] and row["status"] not in _VALID
    )
    if not alarms and (missing or dead):  # no code is reachable behind an operation that must fail
        lines = ", ".join(f"harness.c:{line}" for line in (*missing, *dead))
        return (), f"never reached: {lines}"
    return alarms, ""


def _claims(axis: AxisParameters) -> dict[str, str]:
    """Return the claims after every step: the condition in ACSL by its text."""
    common = {
        "the voltage put out is finite and inside the limits": _WITHIN.format("u"),
        "the state's voltages are inside the limits": " && ".join(
            _WITHIN.format(f"state.{name}") for name in ("voltage_V", "command_V", "moved_V")
        ),
        "no counter is negative": " && ".join(
            f"state.{name} >= 0"
            for name in ("unchanged", "unusable", "retract_left", "contact", "trips", "trip_age")
        ),
        "the mode is one of three": "0 <= state.mode <= 2",
        "the last reading kept is finite": "\\is_finite(state.measured)",
    }
    values = axis.values
    ends_V = axis.voltage_range_V
    if axis.is_tip:
        within = "p->current_floor_A <= state.reference_m <= p->current_ceiling_A"
        widest = f"{_ROUNDED * (ends_V[1] - ends_V[0])!r}"
        return {
            **common,
            "the reference stays between floor and ceiling": within,
            "the gain ratio stays inside the schedule's limit": "\\is_finite(state.gain_ratio) && "
            "1 / p->schedule_limit <= state.gain_ratio <= p->schedule_limit",
            "no remembered change of voltage is larger than the window": " && ".join(
                f"-{widest} <= state.rst_change_V[{k}] <= {widest}"
                for k in range(int(values["rst_S_count"]))
            ),
        }
    within = "p->reference_minimum_m <= state.reference_m <= p->reference_maximum_m"
    limited = {"the reference stays in its range": f"\\is_finite(state.reference_m) && {within}"}
    if not axis.method.startswith("mpi"):
        return {**common, **limited}
    # A bound of every play: |z_i| <= max |gamma(u)| + r_i; the slope of gamma is at most the sum
    # of the magnitudes of its weights.
    threshold_V = np.asarray(values["play_threshold_V"], dtype=float)[: int(values["play_count"])]
    weight = np.asarray(values["envelope_weight"], dtype=float)[: int(values["envelope_count"])]
    steepest = float(np.abs(weight).sum()) if weight.size else 1.0
    largest_V = max(abs(end - float(values["voltage_offset_V"])) for end in ends_V)
    bound_V = _ROUNDED * (steepest * largest_V + threshold_V)
    plays = (f"{-b!r} <= state.play_V[{k}] <= {b!r}" for k, b in enumerate(map(float, bound_V)))
    return {**common, **limited, "the memory of every play is bounded": " && ".join(plays)}
