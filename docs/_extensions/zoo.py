"""One page with every hysteresis law of the virtual laboratory, written when docs are built.

The text is the docstring of the function that draws the law; the picture is two ceramics
of that law, the straight line between the ends of the stroke taken off so that loops can be seen.
"""

import inspect
import itertools
import tempfile

import made_pages
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from sphinx.application import Sphinx

from piezoid.numerics.arrays import Array
from piezoid_datasets.virtual_lab.truths import TRUTHS, ZOO
from piezoid_datasets.virtual_lab.truths.truth import Truth

SEEDS = (3, 7)
COLOURS = ("#0072b2", "#d55e00")
CYCLED = np.array([1.0, -1.0, 1.0, -1.0])
TURNS = (-1.0, 1.0, -0.6, 0.6, -0.2, 0.2, -0.2, 0.2, -1.0)
AROUND = (-1.0, 0.2, -0.2, 0.2)
NOTHING_MISSING = 1e-9  # of the stroke


def _write(app: Sphinx) -> None:
    written = {"index.md": _index().encode()}
    written |= {f"{law.name}.svg": _picture(law) for law in ZOO}
    made_pages.write(app, "laws", written)


def _index() -> str:
    drawn = ", ".join(f"`{law.name}`" for law in TRUTHS)
    rows = "\n".join(f"| [{law.name}](#{law.name}) | {_closes(law)} |" for law in ZOO)
    return (
        "# Zoo of hysteresis laws\n\n"
        "The virtual laboratory makes recordings with these laws; none is a sum of plays, which "
        "is what piezoid's own model is. All are rate independent: what depends on speed is an "
        "effect, and hidden on purpose. `piezoid simulate --truth NAME` takes any; without a name "
        f"it draws {drawn}. How the diagnosis does on each is in [](../measured/zoo.md).\n\n"
        "| law | a minor loop of a fifth of the range |\n| --- | --- |\n"
        f"{rows}\n\n" + "\n\n".join(_section(law) for law in ZOO) + "\n"
    )


def _closes(law: Truth) -> str:
    ceramic = law.draw(np.random.default_rng(SEEDS[0]))
    path = np.concatenate([np.linspace(a, b, 60) for a, b in itertools.pairwise(AROUND)])
    gap = float(np.ptp(sum(ceramic.respond(path, CYCLED))[[59, -1]]))
    if gap < NOTHING_MISSING:
        return "closes at once, and is forgotten when the drive leaves it"
    return f"misses its beginning by {100 * gap:.1f} % of the stroke, and is forgotten by and by"


def _section(law: Truth) -> str:
    title, _, text = (inspect.getdoc(law.draw) or "").partition("\n")
    blocks = [
        f"```text\n{block.strip(chr(10))}\n```" if block.startswith(" ") else block.strip()
        for block in text.strip("\n").split("\n\n")
    ]
    return "\n\n".join(
        (f"## {law.name}", f"**{title}**", *blocks, f"![two {law.name} ceramics]({law.name}.svg)")
    )


def _picture(law: Truth) -> bytes:
    field = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(TURNS)])
    figure = Figure(figsize=(4.2, 2.6), layout="constrained")
    axes = figure.subplots()
    for seed, colour in zip(SEEDS, COLOURS, strict=True):
        ceramic = law.draw(np.random.default_rng(seed))
        strain: Array = np.asarray(sum(ceramic.respond(field, CYCLED)))
        axes.plot(field, 100 * (strain - 0.5 * (field + 1.0)), color=colour, lw=0.8)
    axes.set(xlabel="field, of the drive range", ylabel="strain off the line [%]")
    axes.spines[["top", "right"]].set_visible(False)
    with tempfile.TemporaryFile() as file, mpl.rc_context({"svg.hashsalt": "piezoid"}):
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": "piezoid"})
        file.seek(0)
        return file.read()


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page before any is read."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
