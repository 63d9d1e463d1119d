"""Figure of the growth of every stage: time over size, relative to the smallest size."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from benchmarks.speed.stopwatch import Growth
from benchmarks.speed.table import SIZES

MARKS = "osD^v<>pPX*h"


def draw(growths: Sequence[Growth], folder: Path) -> tuple[Path, ...]:
    """Write growth.svg and growth.png into a folder, and return their paths."""
    mpl.rcParams.update({"svg.hashsalt": "piezoid", "font.size": 9, "svg.fonttype": "none"})
    stages = list(dict.fromkeys(growth.stage for growth in growths))
    by_quantity = {
        quantity: [growth for growth in growths if growth.quantity == quantity]
        for quantity in SIZES
        if any(growth.quantity == quantity for growth in growths)
    }
    figure, grid = plt.subplots(1, len(by_quantity), figsize=(11, 4.2), squeeze=False)
    panels = grid[0]
    for (quantity, rows), panel in zip(by_quantity.items(), panels, strict=True):
        _panel(panel, quantity, rows, stages)
    handles = {
        label: handle
        for panel in panels
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    labels = [stage for stage in stages if stage in handles]
    entries = [handles[stage] for stage in labels]
    figure.legend(entries, labels, loc="lower center", ncols=5, frameon=False)
    figure.tight_layout(rect=(0, 0.13, 1, 1))
    paths = tuple(folder / f"growth.{suffix}" for suffix in ("svg", "png"))
    for path in paths:
        figure.savefig(path, dpi=120)
    plt.close(figure)
    return paths


def _panel(panel: Axes, quantity: str, growths: Sequence[Growth], stages: Sequence[str]) -> None:
    for growth in growths:
        index = stages.index(growth.stage)
        panel.plot(
            [size / growth.size[0] for size in growth.size],
            [time_s / growth.time_s[0] for time_s in growth.time_s],
            f"{MARKS[index % len(MARKS)]}-",
            color=f"C{index % 10}",
            ms=4,
            lw=1,
            label=growth.stage,
        )
    ratio = max(growth.size[-1] / growth.size[0] for growth in growths)
    panel.plot([1, ratio], [1, ratio], ":", color="#888888", lw=1)
    panel.set(xlabel=f"{quantity} / fewest", ylabel="time / time with the fewest")
    for scale, axis in ((panel.set_xscale, panel.xaxis), (panel.set_yscale, panel.yaxis)):
        scale("log", base=2)
        axis.set_major_formatter("{x:g}")
    panel.set_title(f"growth with {quantity} (dotted: proportional)", fontsize=9)
    panel.spines[["top", "right"]].set_visible(False)
