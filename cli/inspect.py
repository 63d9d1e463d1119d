"""`piezoid inspect`: show the contents of each file, and every problem with its location."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezoid_cli.options import Json, Quiet, RecordingLab
from piezoid_cli.terminal import display, print_record, rich_text, say, show_progress

if TYPE_CHECKING:
    from rich.table import Table

    from piezoid.records.inspection import ColumnSummary, Inspection
    from piezoid.statement import Statement


MAX_PEAKS = 8
FIRST_LINE_s = 2.0  # without a terminal

# Other units of a file may already have a prefix, as nN has.
PREFIXED_UNITS = ("s", "V", "m", "A", "K", "Hz")
WORDY = ("column", "is")  # headings of the columns with words
OPTIONAL = ("noise rms", "step", "state")  # columns that are shown only if they have an entry
GAP, MIN_WORDS = 2, 24  # characters: between columns, and for both columns with words
ROUNDING = 1e-10  # of the range of a column: smaller noise is rounding of ten digits
MAX_TEXT = 600  # characters; the headings of a damaged file can be very long


def inspect(
    files: Annotated[list[Path], typer.Argument(help="Recordings in any format piezoid reads.")],
    lab: RecordingLab = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Show the channels, units, clock, noise and problems of recordings.

    noise rms: white noise, from differences of neighbouring samples; a fast signal raises it.
    step: smallest difference of two values, such as one step of the converter.

    If a file cannot be used as a recording, the reason is shown, and the exit status is 3 after
    all files.

    [bold]Examples[/bold]

    piezoid inspect sweep.csv check.csv

    piezoid inspect *.csv --lab lab.toml --json > understood.json

    piezoid inspect night/*.csv --quiet && echo all of them can be read
    """
    from dataclasses import asdict

    from piezoid.records.inspection import inspect_files
    from piezoid.records.lab import read_lab

    with show_progress(quiet=quiet or json, interval_s=FIRST_LINE_s) as report:
        names = files[0].name if len(files) == 1 else f"{len(files)} files"
        report(f"reading {names}")
        inspections = inspect_files(files, None if lab is None else read_lab(lab))
    if json:
        records = [asdict(inspection) for inspection in inspections]
        for record, inspection in zip(records, inspections, strict=True):
            del record["statements"]
            record["problems"] = [
                {
                    "kind": statement.quantity,
                    "place": _location(statement),
                    "text": statement.text,
                    "value": statement.value,
                    "unit": statement.unit,
                }
                for statement in inspection.statements
            ]
        print_record("inspection", files=records)
    elif quiet:
        for inspection in inspections:
            if inspection.refusal:
                say(f"not a recording: {inspection.refusal}", err=True)
    else:
        show(inspections)
    if any(inspection.refusal for inspection in inspections):
        raise typer.Exit(3)


def _location(statement: "Statement") -> str:
    """Return the location of a statement: a position in the file, an axis, or the recording."""
    return statement.place or (f"axis {statement.axis}" if statement.axis else "recording")


def show(inspections: "tuple[Inspection, ...]") -> None:
    """Print the columns, the clock and the problems of every file."""
    from piezoid.formatting import count_of
    from piezoid.raw_counts import in_counts

    for inspection in inspections:
        about = f": {inspection.format}, {inspection.rows} rows" if inspection.format else ""
        display(f"{inspection.name}{about}", "bold")
        if inspection.columns:
            has_noise = inspection.response is None
            display(_table(inspection.columns, has_noise=has_noise))
        if inspection.axis is not None:
            line = (
                f"  axis {inspection.axis}, {inspection.sampling_rate_Hz:.9g} Hz for "
                f"{inspection.duration_s:.6g} s"
            )
            if inspection.breaks:
                line += f", {count_of(inspection.breaks, 'gap')}"
            if inspection.reversals is not None:
                line += f", {inspection.reversals} reversals of the drive"
            if inspection.levels_V:
                levels_V = dict.fromkeys(f"{u:.4g} V" for u in inspection.levels_V)
                line += in_counts(f" near {', '.join(levels_V)}", inspection.counted)
            if not inspection.axis_is_named:
                line += f"; no axis named in the file, {inspection.axis} assumed"
            display(line)
        for line in response_lines(inspection):
            display(line)
        for statement in inspection.statements:
            location, text = _truncate(_location(statement)), _truncate(statement.text)
            display(f"  {statement.quantity} ({location}): {text}", "yellow")
        if inspection.refusal is not None:
            display(f"  not a recording: {inspection.refusal}", "red")
        elif not inspection.statements:
            display("  no problem found")
        display("")


def _table(columns: "tuple[ColumnSummary, ...]", *, has_noise: bool) -> "Table":
    """Return a row for each column of a file; numbers are not broken if the terminal has room.

    has_noise  whether the rows are samples
    """
    from rich.console import Console
    from rich.table import Table

    rows = []
    for column in columns:
        is_clock = column.meaning == "time"  # the line below the table describes the clock
        noise, low, high = column.noise_rms, column.minimum, column.maximum
        if noise is not None and low is not None and high is not None:
            # The noise of a computed ramp is rounding.
            noise = noise if noise > ROUNDING * (high - low) else None
        noise_rms = _quantity(noise, column.si_unit)
        if has_noise and column.noise_rms is None and low is not None:
            noise_rms = "unknown"  # too few samples, or too fast a signal
        states = (
            ("empty", low is None),
            (f"{column.missing} missing", low is not None and column.missing),
            ("dead", column.is_dead),
            (f"{100 * column.clipped:.2g} % clipped", column.clipped),
        )
        cells = {
            "#": str(column.number),
            "column": column.label,
            "is": column.meaning,
            "unit": column.unit,
            "from": _quantity(low, column.si_unit),
            "to": _quantity(high, column.si_unit),
            "noise rms": "" if is_clock else noise_rms,
            "step": "" if is_clock else _quantity(column.step or None, column.si_unit),
            "state": ", ".join(state for state, is_shown in states if is_shown),
        }
        rows.append({heading: _truncate(text) for heading, text in cells.items()})
    visible = [h for h in rows[0] if h not in OPTIONAL or any(row[h] for row in rows)]
    numbers = [heading for heading in visible if heading not in WORDY]
    spent = sum(max(len(h), *(len(row[h]) for row in rows)) for h in numbers)
    has_room = Console().width - spent - GAP * len(visible) >= MIN_WORDS
    table = Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0))
    for heading in visible:
        no_wrap = has_room and heading in numbers
        table.add_column(heading, overflow="fold", no_wrap=no_wrap)
    for row in rows:
        table.add_row(*(rich_text(row[heading]) for heading in visible))
    return table


def _truncate(text: str) -> str:
    return text if len(text) <= MAX_TEXT else f"{text[:MAX_TEXT]} ..."


def _quantity(value: float | None, unit: str) -> str:
    from piezoid_reports.quantities import NARROW, number

    if value is None:
        return ""
    if unit not in PREFIXED_UNITS:
        return f"{number(value, '', 4)} {unit}".strip()
    return number(value, unit, 4).replace(NARROW, " ")


def response_lines(inspection: "Inspection") -> list[str]:
    """Return band, included poles, gain and peaks of each axis, and coupling, as lines."""
    from piezoid.formatting import significant, with_unit

    response = inspection.response
    if response is None:
        return []
    through = " and ".join(response.includes) or "neither amplifier nor sensor"
    band = f"{with_unit(response.lowest_Hz, 'Hz')} to {with_unit(response.highest_Hz, 'Hz')}"
    lines = [
        f"  a frequency response, {band}, {response.lines} lines, which includes the poles of "
        f"{through}"
    ]
    for path in (path for path in response.paths if path.output == path.drive):
        resonances = []
        for peak in path.peaks[:MAX_PEAKS]:
            quality = "" if peak.quality is None else f" (Q about {significant(peak.quality, 2)})"
            resonances.append(f"{with_unit(peak.frequency_Hz, 'Hz')}{quality}")
        peaks = f"possible resonances at {', '.join(resonances)}" if resonances else "no peak"
        if len(path.peaks) > MAX_PEAKS:
            peaks += f" and {len(path.peaks) - MAX_PEAKS} more"
        coherence = f"{path.coherent} of {response.lines} lines coherent"
        coherence = coherence if path.has_coherence else "no coherence"
        gain = f"{with_unit(path.gain_m_per_V, 'm')}/V at low frequency"
        lines.append(f"  axis {path.output}: {gain}, {coherence}, {peaks}")
    if not inspection.axis_is_named:
        lines.append("  no axis named in the file, x assumed")
    for coupling in response.couplings:
        low, drive = significant(100.0 * coupling.low, 2), coupling.drive
        line = f"  {coupling.output} moves by {low} % of {drive} when {drive} is driven, at low "
        line += "frequencies"
        if coupling.at_mode is not None:
            at_mode = significant(100.0 * coupling.at_mode, 2)
            line += f", and {at_mode} % at the mode of {drive}"
        lines.append(line)
    if response.couplings:
        lines.append("  each axis has its own response; coupling is reported, not controlled")
    return lines
