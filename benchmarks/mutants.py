"""Mutants of a source file: one changed operator, constant, condition or function each.

Python is mutated through its syntax tree, C through its text. Messages of exceptions, strings and
annotations are not mutated; neither is C that does not compile.
"""

import ast
import copy
import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.Pow: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
}  # fmt: skip
COMPARISON: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
PAIRS = (
    ("min", "max"), ("minimum", "maximum"), ("argmin", "argmax"), ("sin", "cos"), ("any", "all"),
    ("floor", "ceil"), ("cumsum", "cumprod"), ("sum", "prod"), ("abs", "negative"),
)  # fmt: skip
NAMES = {a: b for a, b in PAIRS} | {b: a for a, b in PAIRS}
EXCLUDED = (ast.Raise, ast.JoinedStr, ast.arg, ast.AnnAssign)
C_SWAPS = (
    (" + ", " - "), (" - ", " + "), (" * ", " / "), (" / ", " * "), (" < ", " <= "),
    (" <= ", " < "), (" > ", " >= "), (" >= ", " > "), (" == ", " != "), (" != ", " == "),
    (" && ", " || "), (" || ", " && "), (" += ", " -= "), (" -= ", " += "),
    ("return -", "return "),
    ("ONE", "ZERO"), ("ZERO", "ONE"), (" | ", " & "), (" |= ", " &= "), ("? -", "? "),
    (": -", ": "), (" & ", " | "), ("0.0", "1.0"), ("1.0", "0.0"), ("0.5 *", "2.0 *"),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """One mutant of a source file.

    path      of the file, relative to the repository
    line      number of the mutated line
    function  name of the enclosing function or method, empty at module level
    change    old and new source, separated by an arrow
    source    returns the text of the mutated file
    """

    path: str
    line: int
    function: str
    change: str
    source: Callable[[], str]

    @property
    def name(self) -> str:
        """Identifier that does not depend on line numbers."""
        return f"{self.path} {self.function or 'module'}: {self.change}"


Mutation = tuple[int, str, str, Callable[[], str]]  # line, function, change, source


def mutants_of(path: Path, root: Path) -> list[Mutant]:
    """Return all mutants of one file."""
    source = path.read_text()
    mutations = _c_mutations(source) if path.suffix == ".c" else _python_mutations(source)
    counts: Counter[str] = Counter()
    mutants = []
    for line, function, change, mutated in mutations:
        counts[function + change] += 1
        count = counts[function + change]
        mutants.append(
            Mutant(
                path=path.relative_to(root).as_posix(),
                line=line,
                function=function,
                change=change if count == 1 else f"{change} ({count})",
                source=mutated,
            )
        )
    return mutants


def _python_mutations(source: str) -> Iterator[Mutation]:
    tree = ast.parse(source)
    functions = sorted(
        (
            (node.lineno, node.end_lineno or 0, node.name)
            for node in ast.walk(tree)
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        ),
        key=lambda function: (function[0], -function[1]),
    )
    for number, node in enumerate(_mutable_nodes(tree)):
        for variant, new in enumerate(_variants(node)):
            line = getattr(node, "lineno", 0)
            enclosing = [name for start, end, name in functions if start <= line <= end]
            change = f"{_source_of(node)} -> {_source_of(new)}"
            mutated = partial(_mutated_python, source, number, variant)
            yield line, enclosing[-1] if enclosing else "", change, mutated


def _source_of(node: ast.AST) -> str:
    """Return the source of a node, or only the condition of a statement with a body."""
    expression = node.test if isinstance(node, ast.If | ast.While) else node
    return ast.unparse(ast.fix_missing_locations(copy.copy(expression)))


def _mutated_python(source: str, number: int, variant: int) -> str:
    tree = ast.parse(source)
    node = next(itertools.islice(_mutable_nodes(tree), number, None))
    _replace(tree, node, _variants(node)[variant])
    return ast.unparse(tree)


def _mutable_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Return all nodes except annotations, decorators and the EXCLUDED types."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST):
                continue
            if isinstance(child, ast.AnnAssign) and child.value is not None:
                yield child.value
                yield from _mutable_nodes(child.value)
            elif not isinstance(child, EXCLUDED):
                yield child
                yield from _mutable_nodes(child)


def _variants(node: ast.AST) -> list[ast.AST]:
    """Return the mutated versions of a node."""
    if isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC and not _is_text(node):
        return [ast.BinOp(left=node.left, op=ARITHMETIC[type(node.op)](), right=node.right)]
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        opposite = COMPARISON[type(node.ops[0])]()
        return [ast.Compare(left=node.left, ops=[opposite], comparators=node.comparators)]
    if isinstance(node, ast.BoolOp):
        connective = ast.And() if isinstance(node.op, ast.Or) else ast.Or()
        return [ast.BoolOp(op=connective, values=node.values)]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        return [node.operand]
    if isinstance(node, ast.If | ast.IfExp | ast.While):
        negated = copy.copy(node)
        negated.test = ast.UnaryOp(op=ast.Not(), operand=node.test)
        return [negated]
    return _leaf_variants(node)


def _leaf_variants(node: ast.AST) -> list[ast.AST]:
    if isinstance(node, ast.Constant):
        if isinstance(node.value, bool):
            return [ast.Constant(value=not node.value)]
        if isinstance(node.value, int):
            return [ast.Constant(value=node.value + 1)]
        if isinstance(node.value, float):
            return [ast.Constant(value=2.0 * node.value if node.value else 1.0)]
    if isinstance(node, ast.Attribute) and node.attr in NAMES:
        return [ast.Attribute(value=node.value, attr=NAMES[node.attr], ctx=node.ctx)]
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in NAMES:
        function = ast.Name(id=NAMES[node.func.id], ctx=ast.Load())
        return [ast.Call(func=function, args=node.args, keywords=node.keywords)]
    if isinstance(node, ast.Return) and isinstance(node.value, ast.BinOp | ast.Call | ast.Name):
        return [ast.Return(value=ast.UnaryOp(op=ast.USub(), operand=node.value))]
    return []


def _is_text(node: ast.BinOp) -> bool:
    return any(
        isinstance(side, ast.JoinedStr)
        or (isinstance(side, ast.Constant) and isinstance(side.value, str))
        for side in (node.left, node.right)
    )


def _replace(tree: ast.AST, old: ast.AST, new: ast.AST) -> None:
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is old:
                setattr(parent, name, new)
            elif isinstance(value, list) and any(item is old for item in value):
                setattr(parent, name, [new if item is old else item for item in value])
    ast.fix_missing_locations(tree)


def _c_mutations(source: str) -> Iterator[Mutation]:
    blank = re.sub(r"/\*.*?\*/|\"[^\"\n]*\"|^#[^\n]*$", _same_length, source, flags=re.S | re.M)
    first = re.search(r"^(?:static )?[a-z].*\{$", blank, flags=re.M)
    begin = first.start() if first else 0
    for match in re.finditer(r"if \((?!!)", blank):
        close = _closing_parenthesis(blank, match.end() - 1)
        negated = f"!({source[match.end() : close]})"
        yield _text_mutation(source, blank, (match.end(), close), negated, "if -> if not")
    for old, new in C_SWAPS:
        for match in re.finditer(re.escape(old), blank[begin:]):
            span = (begin + match.start(), begin + match.end())
            yield _text_mutation(source, blank, span, new, f"{old.strip()} -> {new.strip()}")


def _same_length(match: re.Match[str]) -> str:
    return re.sub(r"[^\n]", " ", match.group())


def _closing_parenthesis(text: str, start: int) -> int:
    depth = 0
    for k in range(start, len(text)):
        depth += (text[k] == "(") - (text[k] == ")")
        if depth == 0:
            return k
    return start


def _text_mutation(
    source: str, blank: str, span: tuple[int, int], new: str, change: str
) -> Mutation:
    line = source.count("\n", 0, span[0]) + 1
    heads = re.findall(r"^[a-z][^\n;=]*?(\w+)\(", blank[: span[0] + 1], flags=re.M)
    statement = source.splitlines()[line - 1].strip()

    def mutated() -> str:
        return source[: span[0]] + new + source[span[1] :]

    return line, heads[-1] if heads else "", f"{change} in `{statement}`", mutated
