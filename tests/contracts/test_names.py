"""Names are nouns and verbs of the field, and messages are short sentences.

The number of bad names in a room may fall and never rise; a room that got better lowers its number
in the table. An exception is a comment on its line: ``# name: why`` or ``# sentence: why``.
"""

import ast
import re
import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ALLOWED = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
# Pronouns, participles and prepositions that say nothing about the value they stand for.
EMPTY_NAMES = frozenset(ALLOWED["empty"])
LONGEST_SENTENCE = 30  # words of a message


def room_of(path: Path) -> str:
    parts = path.relative_to(ROOT).parts
    return "/".join(parts[:2]) if parts[0] == "piezoid" and len(parts) > 2 else parts[0]


def sources() -> list[Path]:
    folders = ("piezoid", "cli", "reports")
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def empty_names(text: str) -> int:
    """Count how often names are bound that say nothing."""
    lines, count = text.splitlines(), 0
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            name = node.id
        elif isinstance(node, ast.arg):
            name = node.arg
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            name = node.name
        else:
            continue
        excused = "# name:" in lines[node.lineno - 1]
        count += name.lstrip("_").lower() in EMPTY_NAMES and not excused
    return count


def long_sentences(text: str) -> int:
    """Count sentences of more than ``LONGEST_SENTENCE`` words in strings that are no docstrings.

    Strings of several lines are files that piezoid writes, such as C headers, and not messages.
    """
    tree, lines = ast.parse(text), text.splitlines()
    nodes = list(ast.walk(tree))
    parts = [part for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values]
    docstrings = [node.value for node in nodes if isinstance(node, ast.Expr)]
    skipped = {id(node) for node in (*parts, *docstrings)}
    count = 0
    for node in nodes:
        if id(node) in skipped or not isinstance(node, ast.Constant | ast.JoinedStr):
            continue
        message = literal_text(node)
        excused = "# sentence:" in lines[node.lineno - 1] or "\n" in message
        lengths = (len(sentence.split()) for sentence in re.split(r"[.;:]\s", message))
        count += 0 if excused else sum(length > LONGEST_SENTENCE for length in lengths)
    return count


def literal_text(node: ast.expr) -> str:
    """Return the words of a string or f-string, one for each formatted value."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(literal_text(part) or "value" for part in node.values)
    return ""


def test_no_room_gets_more_bad_names_or_long_sentences():
    counted: Counter[tuple[str, str]] = Counter()
    for path in sources():
        text, room = path.read_text(encoding="utf-8"), room_of(path)
        counted["names", room] += empty_names(text)
        counted["sentences", room] += long_sentences(text)
    allowed = {key: ALLOWED[key[0]].get(key[1], 0) for key in counted}
    exceeded = {
        key: f"{n}, allowed {allowed[key]}" for key, n in counted.items() if n > allowed[key]
    }
    assert exceeded == {}


def test_a_bad_name_and_a_long_sentence_are_counted():
    assert empty_names("found = 1\nfor one in x:\n    residual_m = one\n") == 2
    assert empty_names("found = 1  # name: a quotation\n") == 0
    assert long_sentences(f"raise DesignError('{'word ' * 31}')") == 1
    assert long_sentences(f"raise DesignError('{'word ' * 20}. {'word ' * 20}')") == 0
    assert long_sentences(f"REASON = f'{{x}} {'word ' * 31}'") == 1
    assert long_sentences(f"REASON = '{'word ' * 31}'  # sentence: a quotation") == 0
    assert long_sentences(f"def f():\n    '{'word ' * 31}'\n") == 0
