"""The README's example runs as printed, and its map names every floor."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_python_example_runs_from_the_checkout() -> None:
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", example],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"held-out error 0\.[0-3]\d % of the range", done.stdout)


def test_the_map_names_every_folder_of_the_library() -> None:
    folders = {path.parent.name for path in (ROOT / "piezoid").glob("*/__init__.py")}
    for folder in sorted(folders):
        assert f"`piezoid/{folder}/`" in README, folder


def test_files_the_readme_names_exist() -> None:
    for name in re.findall(r"benchmarks/\w+\.py|reports/gallery/\w+\.svg", README):
        assert (ROOT / name).is_file(), name
