"""Outcome of reading every messy file, the table of docs/messy_files.md."""

import tempfile
from pathlib import Path

from piezoid.errors import PiezoidError
from piezoid.records.inspection import Inspection, inspect_files
from piezoid.records.lab import Lab, read_lab
from tests.records.messy import characters, clocks, formats, quantities, tables
from tests.records.messy.writers import Messy, lines, text

FILES = (*characters.FILES, *tables.FILES, *clocks.FILES, *formats.FILES, *quantities.FILES)


def write_messy(name: str, folder: Path) -> Path:
    """Write the messy file of a name and return its path."""
    (messy,) = (m for m in FILES if m.name == name)
    messy.write(folder / name)
    return folder / name


def inspect_messy(messy: Messy, folder: Path, entry: str = "") -> tuple[Inspection, ...]:
    """Write a file, and a lab.toml if there is an entry, and inspect the file."""
    path = folder / messy.name
    messy.write(path)
    lab = Lab()
    if entry:
        (folder / "lab.toml").write_text(f'[[recording]]\nfile = "{messy.name}"\n{entry}')
        lab = read_lab(folder / "lab.toml")
    paths = [path]
    if messy.needs_clean_file:
        text(lines())(folder / "clean.csv")
        paths = [folder / "clean.csv", path]
    return tuple(i for i in inspect_files(paths, lab) if i.name.startswith(messy.name))


def outcome(messy: Messy, folder: Path) -> str:
    """Summarise the result of reading a file."""
    inspections = inspect_messy(messy, folder)
    entry = "`" + "`, `".join(messy.entry.split("\n")[:-1]) + "`"
    refusal = inspections[0].refusal
    if refusal is not None:
        reason = refusal.replace(f"{messy.name}: ", "").split(". Needed: ")[0].split(" (seen")[0]
        return f"refused: {' '.join(reason.split())}" + f", read with: {entry}" * bool(messy.entry)
    rates = " and ".join(f"{inspection.sampling_rate_Hz:.9g} Hz" for inspection in inspections)
    quantities = dict.fromkeys(f"`{s.quantity}`" for i in inspections for s in i.statements)
    reported = f"; told: {', '.join(quantities)}" if quantities else ""
    return f"read, {rates}{reported}" + f", goes with: {entry}" * bool(messy.entry)


def table() -> str:
    """Return the table of docs/messy_files.md."""
    rows = ["| file | what is wrong with it | what happens |", "| --- | --- | --- |"]
    for messy in FILES:
        with tempfile.TemporaryDirectory() as folder:
            try:
                result = outcome(messy, Path(folder))
            except PiezoidError as error:
                result = f"refused: {error.found}"
        cells = (f"`{messy.name}`", messy.fault, result)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows) + "\n"
