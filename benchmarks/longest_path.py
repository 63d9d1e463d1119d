"""Worst-case execution time of a runtime step: the longest path through the compiled code.

    python -m benchmarks.longest_path STAGE...

The stages are folders of ``piezoid fit`` or ``piezoid demo``. For each axis the program prints a
row of the table in docs/proof.md. It needs arm-none-eabi-gcc with its C library, and
qemu-system-arm.

A function is a graph of basic blocks. With x the number of passes over each edge, the longest path
is at most

    max sum of c_b x_b   with   in = out at every block,   back edges <= n (edges into the loop)

This is a linear program [Li & Malik 1995] with the cost c of a block and the bound n of a loop.
The bounds follow from the source, as every loop of the runtime counts to a member of the
parameters or to a constant. The data are arbitrary. Some paths therefore exclude each other, and
the result is an upper bound.
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
from piezoid.export.parameter_file import ParameterFile
from piezoid.verification.rebuild import build_for_cortex_m4, emulate, run_program
from piezoid_cli.stage_files import StageFolder

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
    """Upper bounds of one call."""

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
    address: int
    name: str
    operands: str
    line: int


def longest_path(disassembly: str, source: str, counts: Mapping[str, int], *, entry: str) -> Bound:
    """Return upper bounds of one call of a function.

    disassembly  output of ``objdump -d -l --no-show-raw-insn`` for an object with line numbers
    source       text of piezoid_runtime.c
    counts       end values of the loops: members of the parameters and constants by name
    entry        name of the function

    Raises ``RuntimeLibraryError`` for code without a bound: a jump through a register, a call of
    a missing function, recursion, or a loop that no source line bounds.
    """
    bounds = _loop_lines(source, counts)
    return _function(_functions(disassembly), bounds, entry, ())


def loop_counts(values: Mapping[str, object]) -> dict[str, int]:
    """Return the end values of the loops of a step.

    values  of ``AxisParameters``

    A name with a dot is valid inside one function, whose ``count`` depends on the caller.
    """
    counts = {name: int(float(str(values[name]))) for name in values if name.endswith("_count")}
    order = int(float(str(values["observer_order"])))
    taps = max(counts[f"rst_{name}_count"] for name in ("T", "R", "S", "A0"))
    sections = max(counts["reference_section_count"], counts["command_section_count"])
    kinks = max(counts["knot_count"], counts["envelope_count"])
    inner, steps = max(counts["edge_count"] - 2, 0), int(float(str(values["edge_steps"])))
    plays = counts["play_count"] if counts["edge_count"] else 0  # plays behind functions
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
    """Return the bounds of the loops by their first line."""
    bounds = {}
    function = ""
    for number, text in enumerate(source.splitlines(), 1):
        if head := _HEAD.match(text):
            function = head[1]
        if not _LOOP.search(text):
            continue
        condition = text.split(";")[1] if ";" in text else text
        end_values = [
            counts[key]
            for name in _BOUND.findall(condition)
            for key in (name, f"{function}.{name}")
            if key in counts
        ]
        if end_values:
            bounds[number] = max(end_values)
    return bounds


def _functions(disassembly: str) -> dict[str, list[_Instruction]]:
    functions: dict[str, list[_Instruction]] = {}
    code: list[_Instruction] = []
    line = 0
    for text in disassembly.splitlines():
        if head := _FUNCTION.match(text):
            code = functions.setdefault(head[1], [])
        elif number := _SOURCE.search(text):
            line = int(number[1])
        elif match := _INSTRUCTION.match(text):
            operands = match[3].split("\t@")[0].split(" @ ")[0]
            address = int(match[1], 16)
            code.append(_Instruction(address=address, name=match[2], operands=operands, line=line))
    return functions


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
        callee: _function(functions, bounds, callee, (*callers, name))
        for callee in {callee for block in blocks.values() for callee in block.calls}
    }
    cost = {
        start: np.sum(
            [*block.costs, *((inner[c].instructions, inner[c].cycles) for c in block.calls)],
            axis=0,
        )
        for start, block in blocks.items()
    }
    instructions, cycles = (
        _largest_cost(blocks, bounds, {b: float(c[k]) for b, c in cost.items()}, name)
        for k in (0, 1)
    )
    return Bound(instructions=instructions, cycles=cycles)


def _blocks(code: list[_Instruction], name: str) -> dict[int, _Block]:
    """Return basic blocks by the address of their first instruction."""
    code = [instruction for instruction in code if not instruction.name.startswith(".")]
    addresses = {instruction.address for instruction in code}
    pairs = list(zip(code, [*code[1:], None], strict=True))
    starts = {code[0].address}
    for instruction, successor in pairs:
        if _is_indirect_jump(instruction) or _JUMP.match(instruction.name):
            starts |= {successor.address} if successor is not None else set()
            target = _target(instruction)
            starts |= {target[0]} & addresses if target is not None else set()
    blocks: dict[int, _Block] = {}
    block = _Block(start=code[0].address)
    for instruction, successor in pairs:
        if instruction.address in starts:
            block = blocks.setdefault(instruction.address, _Block(start=instruction.address))
        block.costs.append((1, _cycles(instruction)))
        if _JUMP.match(instruction.name):
            block.branch_lines.add(instruction.line)
        following, calls = _successors(instruction, successor, addresses, name)
        block.calls += calls
        if successor is None or successor.address in starts:
            block.following += following
    return _reachable(blocks, code[0].address)


def _successors(
    instruction: _Instruction, successor: _Instruction | None, addresses: set[int], name: str
) -> tuple[list[int], list[str]]:
    """Return the addresses inside the function that may follow, and the called functions."""
    following = [] if successor is None else [successor.address]
    target = _target(instruction)
    if _JUMP.match(instruction.name):
        assert target is not None
        following = [] if instruction.name in ("b", "b.n", "b.w") else following
        if target[0] in addresses:
            return [target[0], *following], []
        return following, [target[1]]  # a tail call
    if instruction.name in ("bl", "blx"):
        if target is None:
            raise _unbounded(name, f"calls through a register at {instruction.address:#x}")
        return following, [target[1]]
    if _is_indirect_jump(instruction):
        if not _is_return(instruction):
            raise _unbounded(name, f"jumps through a register at {instruction.address:#x}")
        is_conditional = re.search(rf"({_CONDITIONS})(\.[nw])?$", instruction.name) is not None
        return (following if is_conditional else []), []
    return following, []


def _is_indirect_jump(instruction: _Instruction) -> bool:
    """Return whether an instruction returns or jumps to a computed address."""
    if instruction.name.startswith(("bx", "tb")):
        return True
    if instruction.name.startswith(("pop", "ldm")):
        return "pc" in instruction.operands
    is_load = instruction.name.startswith(("ldr", "mov", "add"))
    return is_load and instruction.operands.startswith("pc,")


def _is_return(instruction: _Instruction) -> bool:
    """Return whether an indirect jump goes to the caller, through lr or the stack."""
    if instruction.name.startswith("bx"):
        return instruction.operands.strip() == "lr"
    is_pop = instruction.name.startswith(("pop", "ldm"))
    return is_pop or instruction.operands.startswith("pc, [sp]")


def _target(instruction: _Instruction) -> tuple[int, str] | None:
    match = _TARGET.search(instruction.operands)
    return None if match is None else (int(match[1], 16), match[2])


def _cycles(instruction: _Instruction) -> int:
    if _MANY.match(instruction.name):
        registers = re.search(r"\{(.*)\}", instruction.operands)
        count = 0
        for item in (registers[1] if registers else "").split(","):
            limits = [int(n) for n in re.findall(r"\d+", item)]
            count += limits[1] - limits[0] + 1 if "-" in item and len(limits) == 2 else 1
        return 1 + count + (_REFILL if "pc" in instruction.operands else 0)
    for pattern, cycles in _CYCLES:
        if re.match(pattern, instruction.name):
            return cycles
    return 1


def _reachable(blocks: dict[int, _Block], first: int) -> dict[int, _Block]:
    """Remove blocks that no edge reaches, such as constants between functions."""
    reachable, waiting = set(), [first]
    while waiting:
        address = waiting.pop()
        if address not in reachable:
            reachable.add(address)
            waiting.extend(blocks[address].following)
    return {address: block for address, block in blocks.items() if address in reachable}


def _loops(blocks: Mapping[int, _Block], first: int) -> dict[int, set[int]]:
    """Return natural loops by their header: the blocks that reach a back edge without it."""
    predecessors: dict[int, set[int]] = {address: set() for address in blocks}
    for address, block in blocks.items():
        for target in block.following:
            predecessors[target].add(address)
    dominators = {address: set(blocks) for address in blocks}
    dominators[first] = {first}
    changed = True
    while changed:
        changed = False
        for address in blocks:
            if address != first:
                common = set.intersection(*(dominators[p] for p in predecessors[address]))
                changed |= common | {address} != dominators[address]
                dominators[address] = common | {address}
    loops: dict[int, set[int]] = {}
    for address, block in blocks.items():
        for header in set(block.following) & dominators[address]:
            members, waiting = loops.setdefault(header, {header}), [address]
            while waiting:
                member = waiting.pop()
                if member not in members:
                    members.add(member)
                    waiting.extend(predecessors[member])
    return loops


def _largest_cost(
    blocks: Mapping[int, _Block], bounds: Mapping[int, int], cost: Mapping[int, float], name: str
) -> int:
    """Solve the linear program of one function."""
    first = min(blocks)
    loops = _loops(blocks, first)
    edges = [(-1, first)]
    edges += [(start, end) for start, b in blocks.items() for end in sorted(set(b.following))]
    edges += [(start, -2) for start, b in blocks.items() if not b.following]
    order = {start: row for row, start in enumerate(blocks)}
    flow = lil_matrix((len(blocks) + 1, len(edges)))
    for k, (origin, target) in enumerate(edges):
        if target in order:
            flow[order[target], k] += 1.0
        if origin in order:
            flow[order[origin], k] -= 1.0
    flow[len(blocks), 0] = 1.0
    entry_flow = np.zeros(len(blocks) + 1)
    entry_flow[-1] = 1.0
    limits = lil_matrix((len(loops), len(edges)))
    for row, (header, members) in enumerate(loops.items()):
        nested = [loop for head, loop in loops.items() if head != header and loop < members]
        outer = members - set().union(*nested) if nested else members
        lines = {line for start in outer for line in blocks[start].branch_lines} & set(bounds)
        if not lines:
            raise _unbounded(name, f"has a loop at {header:#x} that no line of the source bounds")
        bound = max(bounds[line] for line in lines)
        for k, (origin, target) in enumerate(edges):
            if target == header:
                limits[row, k] = 1.0 if origin in members else -float(bound)
    edge_cost = np.array([-cost[target] if target in cost else 0.0 for _, target in edges])
    solution = linprog(
        edge_cost,
        A_ub=limits.tocsr() if loops else None,
        b_ub=np.zeros(len(loops)) if loops else None,
        A_eq=flow.tocsr(),
        b_eq=entry_flow,
        method="highs",
    )
    if not solution.success:
        raise _unbounded(name, "has no longest path")
    return int(np.ceil(-solution.fun - 1e-6))


def _unbounded(name: str, reason: str) -> RuntimeLibraryError:
    return RuntimeLibraryError(
        f"{name} {reason}",
        needed="code whose longest path can be computed",
        remedy="Build with gcc, -O2 -fno-jump-tables -fno-tree-loop-distribute-patterns.",
    )


def bounds_of(file: ParameterFile) -> dict[str, Bound]:
    """Return the longest path of a step by axis, in the binary that ``verify`` emulates."""
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
    print("| stage, axis | instructions, typical | largest observed | longest path | its cycles |")
    print("| --- | --- | --- | --- | --- |")
    for folder in map(Path, sys.argv[1:]):
        file = StageFolder(folder).parameters
        proof = emulate(file)
        if not proof.is_built:
            sys.exit(proof.build)
        mean, largest = proof.instructions_per_sample or {}, proof.most_instructions or {}
        for axis, bound in bounds_of(file).items():
            print(
                f"| {folder.name}, {axis} | {mean[axis]:.0f} | {largest[axis]} "
                f"| {bound.instructions} | {bound.cycles} |"
            )


if __name__ == "__main__":
    main()
