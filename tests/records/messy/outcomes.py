"""What happens to every messy file: the table of docs/messy_files.md."""

import tempfile
from pathlib import Path

from piezoid.errors import PiezoidError
from piezoid.records.inspection import Inspection, inspect_files
from piezoid.records.lab import Lab, read_lab
from tests.records.messy.files import FILES
from tests.records.messy.writers import Messy, lines, text


def inspected(messy: Messy, folder: Path, entry: str = "") -> tuple[Inspection, ...]:
    """Write a file, and a lab.toml where there is an entry, and inspect it."""
    path = folder / messy.name
    messy.write(path)
    lab = Lab()
    if entry:
        (folder / "lab.toml").write_text(f'[[recording]]\nfile = "{messy.name}"\n{entry}')
        lab = read_lab(folder / "lab.toml")
    paths = [path]
    if messy.beside:
        text(lines())(folder / "clean.csv")
        paths = [folder / "clean.csv", path]
    return tuple(i for i in inspect_files(paths, lab) if i.name.startswith(messy.name))


def outcome(messy: Messy, folder: Path) -> str:
    """Say in a few words what happens to a file."""
    found = inspected(messy, folder)
    first = found[0]
    if first.refusal is not None:
        found_here = first.refusal.replace(f"{messy.name}: ", "").split(". Needed: ")[0]
        reason = found_here.split(" (seen")[0]
        mended = ", read with: `" + "`, `".join(messy.lines.split("\n")[:-1]) + "`"
        return f"refused: {' '.join(reason.split())}" + (mended if messy.lines else "")
    rates = " and ".join(f"{one.sampling_rate_Hz:.9g} Hz" for one in found)
    odd = dict.fromkeys(problem.quantity for one in found for problem in one.statements)
    mended = ", goes with: `" + "`, `".join(messy.lines.split("\n")[:-1]) + "`"
    told = f"; told: {', '.join(f'`{kind}`' for kind in odd)}" if odd else ""
    return f"read, {rates}{told}" + (mended if messy.lines else "")


def table() -> str:
    """Return the table of docs/messy_files.md."""
    rows = ["| file | what is wrong with it | what happens |", "| --- | --- | --- |"]
    for messy in FILES:
        with tempfile.TemporaryDirectory() as folder:
            try:
                said = outcome(messy, Path(folder))
            except PiezoidError as error:
                said = f"refused: {error.found}"
        cells = (f"`{messy.name}`", messy.wrong, said)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows) + "\n"
