"""Draft a first lab.toml: an entry for each recording, and comments for facts the user must add.

Facts that the files state are written as entries; all other keys are comments with an example.
"""

import os
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill

import numpy as np

from piezoid.errors import PiezoidError
from piezoid.records.checks.command_range import DRIVE_VOLTAGE_NOTE
from piezoid.records.collection import is_over_height
from piezoid.records.column_refusals import entry_template, with_axis
from piezoid.records.columns import assign_columns
from piezoid.records.ingest import ingest_parts
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.readers import read_table
from piezoid.records.recording import Quantity, Recording
from piezoid.records.response_columns import is_response, response_block
from piezoid.records.response_ingest import ingest_response
from piezoid.records.table import RawTable
from piezoid.records.units import unit_of

SCALE_NOTE = (
    "If a recording has the high voltage, add a line to its entry below, for a gain of 15: "
    "scale = { voltage = 0.06667 }"
)
HEAD = f"""\
# Description of the rig, drafted by `piezoid init` from the recordings below. Lines that begin
# with # are comments. Everything is optional: complete the values that you know, remove the #,
# and pass the file with --lab. The end of each name is its unit, always SI.

[rig]
# name = "stage 42"              # heads the report

{fill(f"{DRIVE_VOLTAGE_NOTE} {SCALE_NOTE}", 98, initial_indent="# ", subsequent_indent="# ")}

[amplifier]                      # between the controller's output and the piezo
# gain_V_per_V = 15              # for the limits below, which are volts at the piezo
# bandwidth_Hz = 4000            # -3 dB; the fit accounts for this pole
# output_min_V = -30             # where the output clips
# output_max_V = 180
# slew_V_per_s = 20000           # largest slew rate

[actuator]
# bandwidth_Hz = 630             # first resonance or pole, from the data sheet; else leave out

[sensor]
# bandwidth_Hz = 8500            # -3 dB
# gain_V_per_m = 2e5             # needed if a recording is in volts of the sensor

[acquisition]                    # without the rate no controller is designed
# sampling_rate_Hz = 20000       # of the controller; also of recordings without a time column
# dac_bits = 16
# adc_bits = 16
# input_range_V = [-10, 10]      # full range of the DAC and of the ADC

[uncertainty]                    # from certificates; otherwise the budget is a lower bound
# sensor_gain_relative = 0.001   # relative standard uncertainty
# sensor_linearity_m = 5e-9      # limits of the linearity error, plus and minus
# tilt_rad = 0.01                # between the sensor's axis and the motion
# temperature_range_K = 2        # of the room
# expansion_m_per_K = 50e-9      # apparent motion per kelvin
"""


@dataclass(frozen=True, kw_only=True)
class LabDraft:
    """Draft of a lab.toml.

    text        TOML with comments
    incomplete  names of files that need their entry completed before they can be used
    """

    text: str
    incomplete: tuple[str, ...]


def draft_lab(paths: Sequence[Path], folder: Path) -> LabDraft:
    """Return a lab.toml for some recordings, to be written into a folder.

    An unambiguous file becomes an entry with which it is read the same way; any other file becomes
    a comment with the reason and the entry to complete.
    """
    parts, incomplete = [HEAD], []
    for path in paths:
        # Unlike Path.resolve, realpath accepts circular links.
        name = Path(os.path.relpath(os.path.realpath(path), os.path.realpath(folder))).as_posix()
        text, is_usable = _describe_file(path, name)
        parts.append(text)
        if not is_usable:
            incomplete.append(path.name)
    text = "\n".join(parts)
    axes = re.findall(r'^axis = "(.*)"$', text, flags=re.MULTILINE)
    return LabDraft(text=with_axis(text, axes), incomplete=tuple(incomplete))


def _describe_file(path: Path, name: str) -> tuple[str, bool]:
    """Return the text about one file, and whether the file can be used without changes."""
    try:
        table = read_table(path)
    except PiezoidError as error:
        return as_comments(f"{name}: {error}"), False
    if is_over_height(table):
        text = f"{name}: a table over {table.independent!r}, used for the tunnelling junction."
        return as_comments(text), True
    entry = RecordingEntry(file=table.name)
    if is_response(table, entry):
        block = _with_file_name(response_block(table), name)
        try:
            response = ingest_response(table, Lab(), entry)
        except PiezoidError as error:
            return as_comments(str(error).partition("\n")[0]) + as_comments(block), False
        frequency_Hz = response.frequency_Hz
        summary = (
            f"{table.name}: a frequency response of {', '.join(response.axes)}, "
            f"{frequency_Hz[0]:.6g} to {frequency_Hz[-1]:.6g} Hz, {len(frequency_Hz)} lines; it "
            "is read by its headings"
        )
        includes = 'includes = ["amplifier", "sensor"]  # poles it was measured through'
        lines = f"[[recording]]\nfile = {_toml(name)}\n{includes}\n"
        axis = "" if response.axis_is_named else '# axis = "x"\n'
        return as_comments(summary) + lines + axis, True
    try:
        return _draft_entry(table, ingest_parts(table, Lab(), entry), name), True
    except PiezoidError as error:
        reason = str(error).partition("\n")[0]
        _, header, lines = error.remedy.partition("[[recording]]")
        block = f"{header}{lines.rstrip()}" if header else entry_template(table)
        return as_comments(reason) + as_comments(_with_file_name(block, name)), False


def _with_file_name(block: str, name: str) -> str:
    """Return an entry with the file's name relative to the folder of lab.toml."""
    return re.sub(r"^file = .*$", lambda _: f"file = {_toml(name)}", block, count=1, flags=re.M)


def _draft_entry(table: RawTable, recordings: Sequence[Recording], name: str) -> str:
    assignment = assign_columns(table, Lab(), RecordingEntry(file=table.name))
    clock = [("time", assignment.time)] if assignment.time is not None else []
    read = [
        *clock,
        *((f"{a.quantity.name.lower()}_{a.axis}", a) for a in assignment.channels if a.quantity),
    ]
    names = []
    for key, a in read:
        # A column is named by its heading, or by its number if the heading is not unique.
        label = a.column.label
        is_printable = label == label.strip() and label.isprintable()
        is_unique = table.find(label) is a.column
        names.append(f"{key} = {_toml(label) if is_printable and is_unique else a.column.number}")
    units = ", ".join(
        f"{key} = {_toml(a.unit.symbol)}" for key, a in read if unit_of(a.unit.symbol) == a.unit
    )
    summary: list[str] = []
    for recording in recordings:
        summary.append(
            f"{recording.name}: {recording.samples} samples, {recording.sampling_rate_Hz:.9g} Hz, "
            f"{recording.duration_s:.6g} s"
        )
        for channel in recording.channels:
            unit = "" if channel.quantity is Quantity.HUMIDITY else f" {channel.unit}"
            low, high = float(np.min(channel.values)), float(np.max(channel.values))
            kind = channel.quantity.name.lower()
            summary.append(f"  {kind} of {channel.axis}: {low:.4g} to {high:.4g}{unit}")
        summary += [f"  {s.quantity}: {s.text}" for s in recording.statements]
    lines = [
        "[[recording]]",
        f"file = {_toml(name)}",
        f"axis = {_toml(recordings[0].axis)}",
        f"columns = {{ {', '.join(names)} }}",
        f"units = {{ {units} }}",
    ]
    return as_comments("\n".join(summary)) + "\n".join(lines) + "\n"


def as_comments(text: str) -> str:
    """Return a text as lines of comments, with control characters escaped."""
    lines = [
        "".join(c if unicodedata.category(c)[0] != "C" else ascii(c)[1:-1] for c in line)
        for line in text.splitlines() or [""]
    ]
    return "".join(f"# {line}".rstrip() + "\n" for line in lines)


def _toml(text: str) -> str:
    """Return a text as a TOML basic string, with escape codes for unprintable characters."""
    escaped = (c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in text)
    return '"' + "".join(escaped) + '"'
