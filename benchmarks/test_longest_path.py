"""The longest path of short code, against the value computed by hand."""

import pytest

from benchmarks.longest_path import Bound, bounds_of, longest_path, loop_counts
from piezoid.errors import RuntimeLibraryError
from piezoid.verification.rebuild import emulate
from tests.verification.rig import stage

SOURCE = """\
static int inner(int n) {
    for (int32_t i = 0; i < p->play_count; ++i) {
        sum += i;
    }
}
int step(int x) {
    return x > 0 ? inner(x) : 0;
}
"""

# inner: 2 instructions before the loop, 3 inside, 1 after it
INNER = """\
00000100 <inner>:
/made/piezoid_runtime.c:2
     100:\tmovs\tr2, #0
     102:\tcmp\tr1, #0
/made/piezoid_runtime.c:3
     104:\tadds\tr0, r0, r2
/made/piezoid_runtime.c:2
     106:\tadds\tr2, #1
     108:\tbne.n\t104 <inner+0x4>
     10a:\tbx\tlr
"""

# step: 2, then the more expensive branch: 1 and the called function and a jump, or 1; 1 at the end
STEP = """\
00000200 <step>:
/made/piezoid_runtime.c:7
     200:\tcmp\tr0, #0
     202:\tbeq.n\t20a <step+0xa>
     204:\tbl\t100 <inner>
     208:\tb.n\t20c <step+0xc>
     20a:\tmovs\tr0, #0
     20c:\tbx\tlr
"""


def bound_of(code, entry="step"):
    return longest_path(code, SOURCE, {"play_count": 5}, entry=entry)


def test_a_loop_counts_as_often_as_its_line_says():
    bound = bound_of(INNER, entry="inner")
    # The body runs once and returns to its start at most five times: one more than needed.
    assert bound.instructions == 2 + 6 * 3 + 1
    # 1 + 1 before, 1 + 1 + 4 for each pass, and 4 for the return
    assert bound.cycles == 2 + 6 * 6 + 4


def test_the_more_expensive_branch_counts_and_so_do_calls():
    inner = bound_of(INNER, entry="inner").instructions
    assert bound_of(INNER + STEP).instructions == 2 + (1 + inner + 1) + 1


def test_instructions_cost_what_the_manual_says():
    code = "00000000 <step>:\n" + "".join(
        f"     {2 * k:x}:\t{text}\n"
        for k, text in enumerate(
            (
                "push\t{r4, r5, r6, lr}",
                "vldr\ts0, [r1]",
                "vdiv.f32\ts0, s0, s1",
                "vadd.f32\ts0, s0, s1",
                "sdiv\tr0, r1, r2",
                "ldrd\tr0, r1, [r2]",
                "vpush\t{s16-s19}",
                "pop\t{r4, r5, r6, pc}",
            )
        )
    )
    assert bound_of(code) == Bound(instructions=8, cycles=5 + 2 + 15 + 2 + 12 + 3 + 5 + 8)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (INNER.replace("runtime.c:2", "runtime.c:3"), "has a loop at 0x104 that no line"),
        (STEP, "inner is not in the object"),
        (STEP.replace("100 <inner>", "200 <step>"), "step calls itself"),
        (STEP.replace("bl\t100 <inner>", "blx\tr3"), "calls through a register"),
        (STEP.replace("bx\tlr", "tbb\t[pc, r0]"), "jumps through a register"),
        (STEP.replace("bx\tlr", "ldr\tpc, [r3]"), "jumps through a register"),
    ],
)
def test_code_without_a_bound_is_refused(code, message):
    with pytest.raises(RuntimeLibraryError, match=message):
        bound_of(code, entry="inner" if code.startswith("00000100") else "step")


def test_every_loop_of_a_step_has_a_count_of_its_axis():
    for axis in stage().axes:
        counts = loop_counts(axis.values)
        assert counts["play_count"] == int(axis.values["play_count"])
        assert counts["dead_zones.count"] >= counts["knot_count"]


def test_no_step_takes_longer_than_the_longest_path():
    """Bound of the emulated binary, against the instructions that extreme inputs need."""
    proof = emulate(stage())
    if not proof.is_built:
        pytest.skip(proof.build)
    for axis, bound in bounds_of(stage()).items():
        largest = proof.most_instructions[axis]
        assert proof.instructions_per_sample[axis] < largest <= bound.instructions < 6 * largest
        assert bound.instructions < bound.cycles < 3 * bound.instructions
