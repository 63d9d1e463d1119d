"""How long a step of the runtime can take: the longest path through the compiled code.

    python -m benchmarks.longest_path STAGE...

The stages are folders of ``piezoid fit`` or ``piezoid demo``. For each axis it prints a row of the
table in docs/proof.md. Needs arm-none-eabi-gcc with its C library, and qemu-system-arm.

A function is a graph of basic blocks. With x the number of times each edge is taken, the longest
path is at most

    max sum of c_b x_b   with   in = out at every block,   back edges <= n (edges into the loop)

a linear program [Li & Malik 1995], for c the cost of a block and n the bound of a loop. Bounds
come from the source: every loop of the runtime counts to a member of the parameters or to a
constant. Nothing is assumed of the data, so paths are in that no data can take; the answer is a
bound, not a time that is reached.
"""

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import lil_matrix

from piezoid.errors import RuntimeLibraryError
from piezoid.export.bundle import bundle
from piezoid.export.parameter_file import ParameterFile, from_json
from piezoid.verification.rebuild import build_for_cortex_m4, emulate, run_program

_FUNCTION = re.compile(r"^[0-9a-f]+ <([^>]+)>:$")
_SOURCE = re.compile(r"piezoid_runtime\.c:(\d+)")
_INSTRUCTION = re.compile(r"^\s+([0-9a-f]+):\t(\S+)\s*(.*)$")
_TARGET = re.compile(r"([0-9a-f]+) <([^>+]+)(\+0x[0-9a-f]+)?>")
_CONDITIONS = "eq|ne|cs|cc|hs|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le"
_JUMP = re.compile(rf"^b({_CONDITIONS})?(\.[nw])?$|^cbn?z$")
_HEAD = re.compile(r"^[a-z].*?\b(\w+)\(")
_LOOP = re.compile(r"\b(?:for|while) \(")
_BOUND = re.compile(r"[<>]=? (?:p->|parameters->)?(\w+)")

# Cortex-M4 technical reference manual, tables 3-1 and 7-1, no wait states: taken branches refill
# the pipeline in up to 3 cycles, a result of the floating-point unit is used at once.
_REFILL = 3
_CYCLES = (
    (r"^vdiv|^vsqrt", 15),
    (r"^vn?ml|^vf", 4),
    (r"^v(add|sub|mul|nmul|cvt|abs|neg)", 2),
    (r"^v(ldr|str)", 2),
    (r"^vmov", 2),
    (r"^[su]div", 12),
    (r"^(ml[as]|[su]ml|[su]mull)", 2),
    (r"^(ldrd|strd)", 3),
    (r"^(ldr|str)", 2),
    (
        r"^(b|bl|bx|blx|cbz|cbnz)($|\.|eq|ne|cs|cc|hs|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)",
        1 + _REFILL,
    ),
)
_DISASSEMBLE = ("arm-none-eabi-objdump", "-d", "-l", "--no-show-raw-insn", "replay.elf")
_MANY = re.compile(r"^(push|pop|ldm|stm|vpush|vpop|vldm|vstm)")


@dataclass(frozen=True, kw_only=True)
class Bound:
    """What one call can take at most."""

    instructions: int
    cycles: int


@dataclass(kw_only=True, eq=False)
class _Block:
    start: int
    costs: list[tuple[int, int]] = field(default_factory=list)  # instructions, cycles
    branch_lines: set[int] = field(default_factory=set)
    calls: list[str] = field(default_factory=list)
    following: list[int] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class _Instruction:
    place: int
    name: str
    operands: str
    line: int


def longest_path(disassembly: str, source: str, counts: Mapping[str, int], *, entry: str) -> Bound:
    """Return the most that one call of a function can execute.

    disassembly  of ``objdump -d -l --no-show-raw-insn``, of an object with line numbers
    source       of piezoid_runtime.c
    counts       by name, how far loops count: members of the parameters and constants
    entry        the function

    Raises ``RuntimeLibraryError`` for code that this cannot bound: a jump through a register, a
    call of what is not there, recursion, or a loop without a line that bounds it.
    """
    bounds = _loop_lines(source, counts)
    return _function(_functions(disassembly), bounds, entry, ())


def loop_counts(values: Mapping[str, object]) -> dict[str, int]:
    """Return how far the loops of a step count with an axis' parameters.

    values  of ``AxisParameters``

    A name with a dot holds inside one function, where callers share a ``count``.
    """
    counts = {name: int(float(str(values[name]))) for name in values if name.endswith("_count")}
    order = int(float(str(values["observer_order"])))
    taps = max(counts[f"rst_{name}_count"] for name in ("T", "R", "S", "A0"))
    sections = max(counts["reference_section_count"], counts["command_section_count"])
    kinks = max(counts["knot_count"], counts["envelope_count"])
    inner, steps = max(counts["edge_count"] - 2, 0), int(float(str(values["edge_steps"])))
    plays = counts["play_count"] if counts["edge_count"] else 0  # behind functions
    return counts | {
        "observer_order": order,
        "predict.n": order,
        "dot.count": max(order, taps),
        "filter.count": sections,
        "filter_rest.count": sections,
        "dead_zones.ZERO": kinks,  # while (knot[i] < ZERO)
        "dead_zones.count": kinks,
        "value_inverse.count": inner * steps + 2 * plays,  # marks and plays
        "value_inverse.moving": -(-plays // max(steps, 1)),
        "shift_in.0": taps,  # from count - 1 down
        "pz_log.7": 7,
        "pz_log.3": 10,  # from 21 down, the odd ones
        "rest_rst.PZ_MAX_TAPS": 32,
    }


def _loop_lines(source: str, counts: Mapping[str, int]) -> dict[int, int]:
    """Return by line the bound of the loop that begins there."""
    found = {}
    function = ""
    for number, text in enumerate(source.splitlines(), 1):
        if head := _HEAD.match(text):
            function = head[1]
        if not _LOOP.search(text):
            continue
        condition = text.split(";")[1] if ";" in text else text
        known = [
            counts[full]
            for name in _BOUND.findall(condition)
            for full in (name, f"{function}.{name}")
            if full in counts
        ]
        if known:
            found[number] = max(known)
    return found


def _functions(disassembly: str) -> dict[str, list[_Instruction]]:
    found: dict[str, list[_Instruction]] = {}
    current: list[_Instruction] = []
    line = 0
    for text in disassembly.splitlines():
        if head := _FUNCTION.match(text):
            current = found.setdefault(head[1], [])
        elif number := _SOURCE.search(text):
            line = int(number[1])
        elif one := _INSTRUCTION.match(text):
            name, operands = one[2], one[3].split("\t@")[0].split(" @ ")[0]
            current.append(
                _Instruction(place=int(one[1], 16), name=name, operands=operands, line=line)
            )
    return found


def _function(
    functions: Mapping[str, list[_Instruction]],
    bounds: Mapping[int, int],
    name: str,
    callers: tuple[str, ...],
) -> Bound:
    if name not in functions or name in callers:
        raise _unbounded(name, "calls itself" if name in callers else "is not in the object")
    blocks = _blocks(functions[name], name)
    inner = {
        called: _function(functions, bounds, called, (*callers, name))
        for called in {called for block in blocks.values() for called in block.calls}
    }
    cost = {
        start: np.sum(
            [*block.costs, *((inner[c].instructions, inner[c].cycles) for c in block.calls)],
            axis=0,
        )
        for start, block in blocks.items()
    }
    longest = [
        _most(blocks, bounds, {b: float(c[k]) for b, c in cost.items()}, name) for k in (0, 1)
    ]
    return Bound(instructions=longest[0], cycles=longest[1])


def _blocks(code: list[_Instruction], name: str) -> dict[int, _Block]:
    """Return basic blocks by the address of their first instruction."""
    code = [one for one in code if not one.name.startswith(".")]
    places = {one.place for one in code}
    pairs = list(zip(code, [*code[1:], None], strict=True))
    starts = {code[0].place}
    for one, after in pairs:
        if _leaves(one) or _JUMP.match(one.name):
            starts |= {after.place} if after is not None else set()
            target = _target(one)
            starts |= {target[0]} & places if target is not None else set()
    blocks: dict[int, _Block] = {}
    block = _Block(start=code[0].place)
    for one, after in pairs:
        if one.place in starts:
            block = blocks.setdefault(one.place, _Block(start=one.place))
        block.costs.append((1, _cycles(one)))
        if _JUMP.match(one.name):
            block.branch_lines.add(one.line)
        following, called = _ways(one, after, places, name)
        block.calls += called
        if after is None or after.place in starts:
            block.following += following
    return _reached(blocks, code[0].place)


def _ways(
    one: _Instruction, after: _Instruction | None, places: set[int], name: str
) -> tuple[list[int], list[str]]:
    """Return where an instruction can lead inside its function, and what it calls."""
    on = [] if after is None else [after.place]
    target = _target(one)
    if _JUMP.match(one.name):
        assert target is not None
        on = [] if one.name in ("b", "b.n", "b.w") else on
        # A jump to another function: it returns for us
        return ([target[0], *on], []) if target[0] in places else (on, [target[1]])
    if one.name in ("bl", "blx"):
        if target is None:
            raise _unbounded(name, f"calls through a register at {one.place:#x}")
        return on, [target[1]]
    if _leaves(one):
        if not _returns(one):
            raise _unbounded(name, f"jumps through a register at {one.place:#x}")
        is_conditional = re.search(rf"({_CONDITIONS})(\.[nw])?$", one.name) is not None
        return (on if is_conditional else []), []
    return on, []


def _leaves(one: _Instruction) -> bool:
    """Whether an instruction returns, or jumps where its operands say."""
    if one.name.startswith(("bx", "tb")):
        return True
    if one.name.startswith(("pop", "ldm")):
        return "pc" in one.operands
    return one.name.startswith(("ldr", "mov", "add")) and one.operands.startswith("pc,")


def _returns(one: _Instruction) -> bool:
    """Whether what leaves goes back to the caller: through lr, or what was put on the stack."""
    if one.name.startswith("bx"):
        return one.operands.strip() == "lr"
    return one.name.startswith(("pop", "ldm")) or one.operands.startswith("pc, [sp]")


def _target(one: _Instruction) -> tuple[int, str] | None:
    found = _TARGET.search(one.operands)
    return None if found is None else (int(found[1], 16), found[2])


def _cycles(one: _Instruction) -> int:
    if _MANY.match(one.name):
        listed = re.search(r"\{(.*)\}", one.operands)
        count = 0
        for part in (listed[1] if listed else "").split(","):
            ends = [int(n) for n in re.findall(r"\d+", part)]
            count += ends[1] - ends[0] + 1 if "-" in part and len(ends) == 2 else 1
        return 1 + count + (_REFILL if "pc" in one.operands else 0)
    for pattern, cycles in _CYCLES:
        if re.match(pattern, one.name):
            return cycles
    return 1


def _reached(blocks: dict[int, _Block], first: int) -> dict[int, _Block]:
    """Leave out what no edge leads to: constants between functions."""
    seen, waiting = set(), [first]
    while waiting:
        place = waiting.pop()
        if place not in seen:
            seen.add(place)
            waiting.extend(blocks[place].following)
    return {place: block for place, block in blocks.items() if place in seen}


def _loops(blocks: Mapping[int, _Block], first: int) -> dict[int, set[int]]:
    """Return natural loops by their header: the blocks that reach a back edge without it."""
    before: dict[int, set[int]] = {place: set() for place in blocks}
    for place, block in blocks.items():
        for target in block.following:
            before[target].add(place)
    dominators = {place: set(blocks) for place in blocks}
    dominators[first] = {first}
    changed = True
    while changed:
        changed = False
        for place in blocks:
            if place != first:
                found = set.intersection(*(dominators[p] for p in before[place])) | {place}
                changed |= found != dominators[place]
                dominators[place] = found
    loops: dict[int, set[int]] = {}
    for place, block in blocks.items():
        for header in set(block.following) & dominators[place]:
            inside, waiting = loops.setdefault(header, {header}), [place]
            while waiting:
                one = waiting.pop()
                if one not in inside:
                    inside.add(one)
                    waiting.extend(before[one])
    return loops


def _most(
    blocks: Mapping[int, _Block], bounds: Mapping[int, int], cost: Mapping[int, float], name: str
) -> int:
    """Solve the program of one function."""
    first = min(blocks)
    loops = _loops(blocks, first)
    edges = [(-1, first)]
    edges += [(place, after) for place, b in blocks.items() for after in sorted(set(b.following))]
    edges += [(place, -2) for place, b in blocks.items() if not b.following]
    order = {place: row for row, place in enumerate(blocks)}
    flow = lil_matrix((len(blocks) + 1, len(edges)))
    for k, (origin, target) in enumerate(edges):
        if target in order:
            flow[order[target], k] += 1.0
        if origin in order:
            flow[order[origin], k] -= 1.0
    flow[len(blocks), 0] = 1.0
    once = np.zeros(len(blocks) + 1)
    once[-1] = 1.0
    limits = lil_matrix((len(loops), len(edges)))
    for row, (header, inside) in enumerate(loops.items()):
        nested = [other for head, other in loops.items() if head != header and other < inside]
        own = inside - set().union(*nested) if nested else inside
        lines = {line for place in own for line in blocks[place].branch_lines} & set(bounds)
        if not lines:
            raise _unbounded(name, f"has a loop at {header:#x} that no line of the source bounds")
        most = max(bounds[line] for line in lines)
        for k, (origin, target) in enumerate(edges):
            if target == header:
                limits[row, k] = 1.0 if origin in inside else -float(most)
    taken = np.array([-cost[target] if target in cost else 0.0 for _, target in edges])
    solved = linprog(
        taken,
        A_ub=limits.tocsr() if loops else None,
        b_ub=np.zeros(len(loops)) if loops else None,
        A_eq=flow.tocsr(),
        b_eq=once,
        method="highs",
    )
    if not solved.success:
        raise _unbounded(name, "has no longest path")
    return int(np.ceil(-solved.fun - 1e-6))


def _unbounded(name: str, why: str) -> RuntimeLibraryError:
    return RuntimeLibraryError(
        f"{name} {why}",
        needed="code whose longest path can be computed",
        remedy="Build with gcc, -O2 -fno-jump-tables -fno-tree-loop-distribute-patterns.",
    )


def bounds_of(file: ParameterFile) -> dict[str, Bound]:
    """Return by axis the longest path of a step in the binary that ``verify`` emulates."""
    contents = bundle(file)
    with TemporaryDirectory() as name:
        folder = Path(name)
        build_for_cortex_m4(folder, contents, file)
        disassembly = run_program(_DISASSEMBLE, folder)
    source = contents["piezoid_runtime.c"].decode()
    return {
        axis.axis: longest_path(disassembly, source, loop_counts(axis.values), entry="pz_step")
        for axis in file.axes
    }


def main() -> None:
    """Print a row for every axis of the stages."""
    print("| stage, axis | instructions, ordinary | most seen | longest path | its cycles |")
    print("| --- | --- | --- | --- | --- |")
    for folder in map(Path, sys.argv[1:]):
        file = from_json((folder / "params.json").read_bytes(), str(folder / "params.json"))
        proof = emulate(file)
        if not proof.is_built:
            sys.exit(proof.build)
        mean, most = proof.instructions_per_sample or {}, proof.most_instructions or {}
        for axis, bound in bounds_of(file).items():
            print(
                f"| {folder.name}, {axis} | {mean[axis]:.0f} | {most[axis]} "
                f"| {bound.instructions} | {bound.cycles} |"
            )


if __name__ == "__main__":
    main()
