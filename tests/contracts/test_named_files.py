"""Files and names that docstrings and documentation mention exist."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PRODUCT = ("piezoid", "cli", "reports", "datasets")
FILE = re.compile(r"[\w/]*\w\.(?:py|c|h)\b")
NAME = re.compile(r"``([A-Za-z_][\w.]*)``")
# Files that the export writes, and files of other software.
GENERATED = {"piezo_params.h", "plant_of_axis.h", "x_feedforward.h", "library/example.py"}
GENERATED |= {"nanonis/send.py", "logic/chains.py", "iir.py", "bundle/piezoid_runtime.c"}
GENERATED |= {"library/piezoid_controller.h"}

EXISTING = [
    path.relative_to(ROOT).as_posix()
    for folder in (*PRODUCT, "tests", "benchmarks", "docs")
    for path in (ROOT / folder).rglob("*")
    if path.suffix in (".py", ".c", ".h")
]
MODULES = sorted(path for folder in PRODUCT for path in (ROOT / folder).rglob("*.py"))
# Names in the pages for contributors; a renamed test or function leaves them behind.
SPAN = re.compile(r"`([A-Za-z_]\w*(?:\.\w+)*)(?:\([^`]*\))?`")
OF_CODE = ("docs/map.md", "docs/extend.md")
PAGES = sorted([*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"])


def docstring(module: Path) -> str:
    return ast.get_docstring(ast.parse(module.read_text(encoding="utf-8"))) or ""


def missing_files(text: str, existing: list[str]) -> list[str]:
    return [
        name
        for name in FILE.findall(text)
        if not name.endswith(tuple(GENERATED))
        and not any(f"/{path}".endswith(f"/{name.lstrip('/')}") for path in existing)
    ]


def missing_in(path: Path) -> list[str]:
    text = docstring(path) if path.suffix == ".py" else path.read_text(encoding="utf-8")
    existing = EXISTING
    if path.name == "__init__.py" and path.parent.name not in PRODUCT:
        package = path.parent.relative_to(ROOT).as_posix()
        existing = [k for k in EXISTING if k.startswith((f"{package}/", "tests/"))]
    return missing_files(text, existing)


def test_files_named_in_docstrings_and_documentation_exist():
    missing = {str(path): missing_in(path) for path in (*MODULES, *PAGES)}
    assert {path: names for path, names in missing.items() if names} == {}


def unknown_names(package: Path) -> list[str]:
    code = "\n".join(path.read_text(encoding="utf-8") for path in package.parent.rglob("*.py"))
    code = code.replace(docstring(package), "")
    modules = {path.stem for path in package.parent.rglob("*.py")}
    names = [part for name in NAME.findall(docstring(package)) for part in name.split(".")]
    allowed = {"piezoid", "piezoid_cli", "piezoid_reports", "piezoid_datasets", *PRODUCT, *modules}
    return [n for n in names if n not in allowed and not re.search(rf"\b{n}\b", code)]


def test_names_in_package_docstrings_exist():
    packages = [path for path in MODULES if path.name == "__init__.py"]
    unknown = {str(package): unknown_names(package) for package in packages}
    assert {package: names for package, names in unknown.items() if names} == {}


def test_names_in_the_pages_for_contributors_exist():
    code = "\n".join(
        path.read_text(encoding="utf-8")
        for folder in (*PRODUCT, "tests", "benchmarks")
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".py", ".c", ".h", ".css")
    )
    code += (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    words = set(re.findall(r"\w+", code))
    unknown = {
        page: [
            name
            for name in SPAN.findall((ROOT / page).read_text(encoding="utf-8"))
            if not missing_files(name, []) and not words.issuperset(name.split("."))
        ]
        for page in OF_CODE
    }
    assert {page: names for page, names in unknown.items() if names} == {}


def test_the_map_names_every_module_outside_the_rooms():
    names = {path.name for path in (ROOT / "piezoid").glob("*.py")}
    text = (ROOT / "docs/map.md").read_text(encoding="utf-8")
    assert {name for name in names if name not in text} == set()
