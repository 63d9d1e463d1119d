"""A recording as a table of text, the way acquisition programs write it."""

from piezoid_datasets.virtual_lab.stage import Rows

MICRONS_PER_M = 1e6


def csv_text(rows: Rows, *, axis: str = "") -> str:
    """Return the rows as CSV: time in s, voltage in V, displacement in um, other axes' voltages.

    axis  suffix of this axis' columns; empty while there is only one
    """
    mark = f"_{axis}" if axis else ""
    names = ["time [s]", f"voltage{mark} [V]", f"displacement{mark} [um]"]
    names += [f"voltage_{other} [V]" for other in rows.others_V]
    columns = [
        [f"{value:.{decimals(rows)}f}" for value in rows.time_s.tolist()],
        [f"{value:.5f}" for value in rows.voltage_V.tolist()],
        [f"{value * MICRONS_PER_M:.5f}" for value in rows.displacement_m.tolist()],
    ]
    columns += [[f"{value:.5f}" for value in u.tolist()] for u in rows.others_V.values()]
    lines = [",".join(names), *(",".join(cells) for cells in zip(*columns, strict=True))]
    return "\n".join(lines) + "\n"


def decimals(rows: Rows) -> int:
    """Return how many decimals the time column needs to show the sampling interval exactly."""
    interval_s = 1.0 / rows.run.sampling_rate_Hz
    return next((n for n in range(1, 9) if abs(round(interval_s, n) - interval_s) < 1e-12), 9)
