"""Breakages of a source, one at a time: what a slip of the hand would make of it.

Python by its syntax tree, C by its text. Left alone: what an exception says, text, annotations,
and whatever C refuses to compile.
"""

import ast
import copy
import itertools
import re
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
UNSEEN = (ast.Raise, ast.JoinedStr, ast.arg, ast.AnnAssign)
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
    """One breakage.

    path      of the file, relative to the tree
    line      where
    function  the function or method it is in, empty at module level
    change    old -> new, in words of the source
    broken    makes the whole file with it
    """

    path: str
    line: int
    function: str
    change: str
    broken: Callable[[], str]

    @property
    def name(self) -> str:
        """What stays the same while other lines move."""
        return f"{self.path} {self.function or 'module'}: {self.change}"


Made = tuple[int, str, str, Callable[[], str]]


def mutants_of(path: Path, root: Path) -> list[Mutant]:
    """Return every breakage of one file."""
    source = path.read_text()
    made = _of_c(source) if path.suffix == ".c" else _of_python(source)
    place = path.relative_to(root).as_posix()
    seen: dict[str, int] = {}
    found = []
    for line, function, change, broken in made:
        count = seen[function + change] = seen.get(function + change, 0) + 1
        words = change if count == 1 else f"{change} ({count})"
        found.append(Mutant(path=place, line=line, function=function, change=words, broken=broken))
    return found


def _of_python(source: str) -> Iterator[Made]:
    tree = ast.parse(source)
    functions = _functions(tree)
    for number, node in enumerate(_visible(tree)):
        for variant, new in enumerate(_changed(node)):
            line = getattr(node, "lineno", 0)
            inside = [name for low, high, name in functions if low <= line <= high]
            change = f"{_words(node)} -> {_words(new)}"
            broken = partial(_broken_python, source, number, variant)
            yield line, inside[-1] if inside else "", change, broken


def _words(node: ast.AST) -> str:
    """The node as source; of a statement with a body only its condition."""
    shown = node.test if isinstance(node, ast.If | ast.While) else node
    return ast.unparse(ast.fix_missing_locations(copy.copy(shown)))


def _broken_python(source: str, number: int, variant: int) -> str:
    tree = ast.parse(source)
    node = next(itertools.islice(_visible(tree), number, None))
    _replace(tree, node, _changed(node)[variant])
    return ast.unparse(tree)


def _functions(tree: ast.Module) -> list[tuple[int, int, str]]:
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    found = [(n.lineno, n.end_lineno or 0, n.name) for n in ast.walk(tree) if isinstance(n, kinds)]
    return sorted(found, key=lambda place: (place[0], -place[1]))


def _visible(node: ast.AST) -> Iterator[ast.AST]:
    """Every node that a reader of numbers cares about."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "slice") and name != "slice":
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST):
                continue
            if isinstance(child, ast.AnnAssign) and child.value is not None:
                yield child.value
                yield from _visible(child.value)
            elif not isinstance(child, UNSEEN):
                yield child
                yield from _visible(child)


def _changed(node: ast.AST) -> list[ast.AST]:
    """Return what a node may become."""
    if isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC and not _is_text(node):
        return [ast.BinOp(left=node.left, op=ARITHMETIC[type(node.op)](), right=node.right)]
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        other = COMPARISON[type(node.ops[0])]()
        return [ast.Compare(left=node.left, ops=[other], comparators=node.comparators)]
    if isinstance(node, ast.BoolOp):
        other = ast.And() if isinstance(node.op, ast.Or) else ast.Or()
        return [ast.BoolOp(op=other, values=node.values)]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        return [node.operand]
    if isinstance(node, ast.If | ast.IfExp | ast.While):
        negated = copy.copy(node)
        negated.test = ast.UnaryOp(op=ast.Not(), operand=node.test)
        return [negated]
    return _changed_leaf(node)


def _changed_leaf(node: ast.AST) -> list[ast.AST]:
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
        named = ast.Name(id=NAMES[node.func.id], ctx=ast.Load())
        return [ast.Call(func=named, args=node.args, keywords=node.keywords)]
    if isinstance(node, ast.Return) and isinstance(node.value, ast.BinOp | ast.Call | ast.Name):
        return [ast.Return(value=ast.UnaryOp(op=ast.USub(), operand=node.value))]
    return []


def _is_text(node: ast.BinOp) -> bool:
    sides = (node.left, node.right)
    return any(isinstance(s, ast.JoinedStr) or _is_string(s) for s in sides)


def _is_string(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _replace(tree: ast.AST, old: ast.AST, new: ast.AST) -> None:
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is old:
                setattr(parent, name, new)
            elif isinstance(value, list) and any(item is old for item in value):
                setattr(parent, name, [new if item is old else item for item in value])
    ast.fix_missing_locations(tree)


def _of_c(source: str) -> Iterator[Made]:
    blank = re.sub(r"/\*.*?\*/|\"[^\"\n]*\"|^#[^\n]*$", _same_length, source, flags=re.S | re.M)
    first = re.search(r"^(?:static )?[a-z].*\{$", blank, flags=re.M)
    begin = first.start() if first else 0
    for match in re.finditer(r"if \((?!!)", blank):
        close = _closing(blank, match.end() - 1)
        inside = f"!({source[match.end() : close]})"
        yield _of_text(source, blank, (match.end(), close), inside, "if -> if not")
    for old, new in C_SWAPS:
        for match in re.finditer(re.escape(old), blank[begin:]):
            span = (begin + match.start(), begin + match.end())
            yield _of_text(source, blank, span, new, f"{old.strip()} -> {new.strip()}")


def _same_length(match: re.Match[str]) -> str:
    return re.sub(r"[^\n]", " ", match.group())


def _closing(text: str, place: int) -> int:
    depth = 0
    for k in range(place, len(text)):
        depth += (text[k] == "(") - (text[k] == ")")
        if depth == 0:
            return k
    return place


def _of_text(source: str, blank: str, span: tuple[int, int], new: str, change: str) -> Made:
    line = source.count("\n", 0, span[0]) + 1
    heads = re.findall(r"^[a-z][^\n;=]*?(\w+)\(", blank[: span[0] + 1], flags=re.M)
    words = source.splitlines()[line - 1].strip()
    broken = partial(_broken_text, source, span, new)
    return line, heads[-1] if heads else "", f"{change} in `{words}`", broken


def _broken_text(source: str, span: tuple[int, int], new: str) -> str:
    return source[: span[0]] + new + source[span[1] :]
