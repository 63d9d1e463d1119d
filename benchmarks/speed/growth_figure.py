"""How every stage grows: time over size, each as a multiple of its own smallest."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from benchmarks.speed.stopwatch import Growth
from benchmarks.speed.table import SIZES

MARKS = "osD^v<>pPX*h"


def draw(growths: Sequence[Growth], folder: Path) -> tuple[Path, ...]:
    """Write growth.svg and growth.png into a folder, and return where they are."""
    mpl.rcParams.update({"svg.hashsalt": "piezoid", "font.size": 9, "svg.fonttype": "none"})
    stages = list(dict.fromkeys(one.stage for one in growths))
    grew = [what for what in SIZES if any(one.what == what for one in growths)]
    figure, grid = plt.subplots(1, len(grew), figsize=(11, 4.2), squeeze=False)
    panels = grid[0]
    for what, panel in zip(grew, panels, strict=True):
        _panel(panel, what, [one for one in growths if one.what == what], stages)
    handles = {
        label: handle
        for panel in panels
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    known = [stage for stage in stages if stage in handles]
    figure.legend([handles[s] for s in known], known, loc="lower center", ncols=5, frameon=False)
    figure.tight_layout(rect=(0, 0.13, 1, 1))
    places = tuple(folder / f"growth.{ending}" for ending in ("svg", "png"))
    for place in places:
        figure.savefig(place, dpi=120)
    plt.close(figure)
    return places


def _panel(panel: Axes, what: str, growths: Sequence[Growth], stages: Sequence[str]) -> None:
    for one in growths:
        place = stages.index(one.stage)
        panel.plot(
            [size / one.size[0] for size in one.size],
            [time_s / one.time_s[0] for time_s in one.time_s],
            f"{MARKS[place % len(MARKS)]}-",
            color=f"C{place % 10}",
            ms=4,
            lw=1,
            label=one.stage,
        )
    reach = max(one.size[-1] / one.size[0] for one in growths)
    panel.plot([1, reach], [1, reach], ":", color="#888888", lw=1)
    panel.set(xlabel=f"{what}, times the fewest", ylabel="time, times that of the fewest")
    for scale, axis in ((panel.set_xscale, panel.xaxis), (panel.set_yscale, panel.yaxis)):
        scale("log", base=2)
        axis.set_major_formatter("{x:g}")
    panel.set_title(f"with {what} (dotted: in proportion)", fontsize=9)
    panel.spines[["top", "right"]].set_visible(False)
