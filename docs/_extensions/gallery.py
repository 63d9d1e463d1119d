"""One page for every effect, written from the effect's own file when the documentation is built.

The text is the docstring of ``piezoid/diagnosis/effects/NAME.py`` and what the report says about
control; the picture is its ``inject`` applied to a healthy recording of the virtual laboratory.
"""

import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

import made_pages
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from sphinx.application import Sphinx

from piezoid.diagnosis.effect import HEADINGS, Effect
from piezoid.diagnosis.effects import EFFECTS
from piezoid.formatting import words
from piezoid.numerics.arrays import Array
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import draw_campaign
from piezoid_datasets.virtual_lab.write import write_campaign

SEED = 20
SHARE = 0.02  # of the stroke: large, so that the loops show it as well
# The recording that shows what is drawn against a coordinate; the sweep shows the others.
PLAYED: Mapping[str, str] = {
    "time in a hold": "staircase",
    "speed of the drive": "rates",
    "frequency": "chirp",
    "drive of the other axis": "other_axis",
}
CLASSES = 40
POINTS = 5000  # of a curve
BLUE, ORANGE = "#0072b2", "#d55e00"


def _write(app: Sphinx) -> None:
    recordings = _healthy()
    written = {"index.md": _index().encode()}
    for effect in EFFECTS:
        played = PLAYED.get(effect.shows.label, "sweep")
        written[f"{effect.name}.md"] = _page(effect).encode()
        written[f"{effect.name}.svg"] = _picture(effect, recordings[played])
    made_pages.write(app, "effects", written)


def _healthy() -> dict[str, Recording]:
    plans = ("sweep", *dict.fromkeys(PLAYED.values()))
    with tempfile.TemporaryDirectory() as made:
        write_campaign(draw_campaign(SEED, truth="preisach", plans=plans), Path(made))
        place = Path(made) / "recordings"
        lab = read_lab(place / "lab.toml")
        found = collect([place / f"{plan}.csv" for plan in plans], lab).recordings
        return dict(zip(plans, found, strict=True))


def _index() -> str:
    rows = [
        f"| [{words(effect.name)}]({effect.name}.md) | {_title(effect)} | {effect.unit} |"
        for effect in EFFECTS
    ]
    names = "\n".join(effect.name for effect in EFFECTS)
    return (
        "# Gallery of effects\n\n"
        "The diagnosis looks for these effects, in this order: faults of the data, then what acts "
        "on the drive, then the rest. Each page is written from the file of the effect in "
        "`piezoid/diagnosis/effects/` when this documentation is built.\n\n"
        "| effect | in one sentence | unit of the size |\n| --- | --- | --- |\n"
        + "\n".join(rows)
        + f"\n\n```{{toctree}}\n:hidden:\n\n{names}\n```\n"
    )


def _title(effect: Effect) -> str:
    first = effect.explanation.strip().splitlines()[0].partition(": ")[2]
    return first[0].upper() + first[1:]


def _sections(effect: Effect) -> dict[str, str]:
    parts = re.split(rf"^({'|'.join(HEADINGS)})$", effect.explanation, flags=re.MULTILINE)
    return dict(zip(parts[1::2], map(_markdown, parts[2::2]), strict=True))


def _markdown(text: str) -> str:
    """Return a docstring's paragraphs; what is set in deeper is an equation in plain text."""
    blocks = re.split(r"\n\s*\n", re.sub(r"^ {4}", "", text.strip("\n"), flags=re.MULTILINE))
    return "\n\n".join(
        f"```text\n{block.strip()}\n```" if block.startswith(" ") else block for block in blocks
    )


def _page(effect: Effect) -> str:
    said = _sections(effect)
    rivals = ", ".join(f"[{words(name)}]({name}.md)" for name in effect.confounded)
    picture = (
        f"A healthy recording of the virtual laboratory, and the same recording with this effect "
        f"injected at {100 * SHARE:g} % of the stroke. Left: the loops. Right: what the effect "
        f"adds, against the {effect.shows.label}."
    )
    blocks = [
        f"# {words(effect.name).capitalize()}",
        f"**{_title(effect)}**",
        f"![{words(effect.name)}]({effect.name}.svg)",
        picture,
        f"## What you see\n\n{said['What you see']}",
        f"## Why it happens\n\n{said['Why it happens']}",
        f"## How large it is\n\nThe diagnosis states the size in {effect.unit}, with a 95 % "
        "interval where the data give one.",
        f"## How it is detected\n\n{said['How it is detected']}",
        f"## What it means for control\n\n{effect.control}",
        f"## What the model takes in\n\n{said['What the extension adds']}",
        f"## What to record\n\n{effect.experiment}",
        *([f"## What it is confused with\n\n{rivals}"] if rivals else []),
        f"## Source\n\n{said['Source']} (see [](../reference/sources.md))",
        f"`{effect.name}` in `diagnosis.json`; defined in "
        f"`piezoid/diagnosis/effects/{effect.name}.py`.",
    ]
    return "\n\n".join(blocks) + "\n"


def _picture(effect: Effect, recording: Recording) -> bytes:
    changed = effect.inject(recording, SHARE)
    figure = Figure(figsize=(7.6, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.4))
    added_m = changed.displacement_m() - recording.displacement_m()
    rows = _largest(added_m)
    for one, colour, name in ((changed, ORANGE, "with the effect"), (recording, BLUE, "healthy")):
        drawn = one.voltage_V()[rows], 1e6 * one.displacement_m()[rows]
        left.plot(*drawn, color=colour, lw=0.6, label=name)
    left.set(xlabel="drive [V]", ylabel="displacement [µm]")
    left.legend(frameon=False, fontsize=8)
    where = effect.shows
    if where.kind == "spectrum":
        _draw_spectrum(right, added_m, recording.sampling_rate_Hz)
    else:
        place, sign = where.along(recording)
        scaled = 1e6 * place if where.unit == "m" else place
        _draw_along(right, scaled, 1e9 * sign * added_m, in_time=where.kind == "time")
        right.set(ylabel="what it adds [nm]")
        right.set_xlabel(f"{where.label} [{'µm' if where.unit == 'm' else where.unit}]")
        if where.decades:
            right.xaxis.set_major_formatter(lambda value, _: f"$10^{{{value:g}}}$")
            right.xaxis.get_major_locator().set_params(integer=True)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    with tempfile.TemporaryFile() as file, mpl.rc_context({"svg.hashsalt": "piezoid"}):
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": "piezoid"})
        file.seek(0)
        return file.read()


def _draw_along(axes: mpl.axes.Axes, place: Array, added_nm: Array, *, in_time: bool) -> None:
    there = np.isfinite(place)
    place, added_nm = place[there], added_nm[there]
    rows = _largest(added_nm)
    if in_time:
        axes.plot(place[rows], added_nm[rows], color=ORANGE, lw=0.7)
        return
    axes.plot(place[rows], added_nm[rows], ".", color="#bbbbbb", ms=1.5, rasterized=True)
    edges = np.linspace(place.min(), place.max(), CLASSES + 1)
    number = np.clip(np.digitize(place, edges) - 1, 0, CLASSES - 1)
    filled = [k for k in range(CLASSES) if (number == k).sum() > 3]
    middle = [float(np.median(place[number == k])) for k in filled]
    mean = [float(np.mean(added_nm[number == k])) for k in filled]
    axes.plot(middle, mean, color=ORANGE, lw=1.5, label="mean")
    axes.legend(frameon=False, fontsize=8)


def _largest(values: Array) -> Array:
    """Return the row of the largest magnitude in each of many blocks: no spike is left out."""
    blocks = np.array_split(np.arange(len(values)), min(POINTS, len(values)))
    return np.array([rows[np.argmax(np.abs(values[rows]))] for rows in blocks])


def _draw_spectrum(axes: mpl.axes.Axes, added_m: Array, rate_Hz: float) -> None:
    window = np.hanning(len(added_m))
    spectrum = np.abs(np.fft.rfft((added_m - added_m.mean()) * window))[1:]
    density = spectrum * np.sqrt(2.0 / (rate_Hz * np.sum(window**2)))
    axes.loglog(
        np.fft.rfftfreq(len(added_m), 1 / rate_Hz)[1:], 1e9 * density, color=ORANGE, lw=0.7
    )
    axes.set(xlabel="frequency [Hz]", ylabel="what it adds [nm/√Hz]")


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before any is read."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
